"""Burley's lobe towards any direction, from a few sums over the light of a patch.

A factor of the light times one of the view, with a mean for the angle between the two
(:mod:`iris_addon.transport.diffuse`), serves where light comes from all sides. Beside a window it does not: a rough
wall is brighter seen from where its light comes from than seen against it, so that what stands beside the window gets
more of it back. The exact lobe is linear in the direction of light, cos²θd being (1 + l·v) / 2: a few sums over the
light of a patch serve all directions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .diffuse import grazing_gain
from .sampling import dot


@dataclass(frozen=True)
class LightMoments:
    """Means over the light that reaches each seen patch, weighted by what it adds to irradiance.

    Attributes:
        direction: (P, 3) mean of l, the unit vector towards the light.
        grazing: (P,) mean of S, Schlick's (1 - cos θi)^5.
        grazing_direction: (P, 3) mean of S l.
    """

    direction: NDArray[np.float32]
    grazing: NDArray[np.float32]
    grazing_direction: NDArray[np.float32]

    def view_factor(
        self,
        patch: NDArray[np.integer],
        roughness: NDArray[np.floating],
        schlick: NDArray[np.floating],
        toward: NDArray[np.floating],
    ) -> NDArray[np.float32]:
        """What Burley's lobe sends in a direction over albedo times irradiance / pi, (..., n).

        The irradiance is that of the patch under its lobe, ``1 + κ S``. The product of both S is small; in it the mean
        angle stays.

        Args:
            patch: (n,) patch seen.
            roughness: (..., n) or (..., 1).
            schlick: (n,) S of the direction.
            toward: (n, 3) unit vectors away from the patch.
        """
        grazing, k = self.grazing[patch], roughness - 0.5
        kappa = grazing_gain("burley", roughness)
        light = 1 + k * grazing + roughness * dot(self.grazing_direction[patch], toward)
        view = k + roughness * dot(self.direction[patch], toward) + kappa**2 * grazing
        return ((light + schlick * view) / (1 + kappa * grazing)).astype(np.float32)

    def lobes(self, roughness: NDArray[np.floating]) -> NDArray[np.float32]:
        """(P, 2, 4) lobe of every patch of ``roughness`` (P,): :meth:`view_factor` is (1, S) M (1, v), v being the unit
        vector away from the patch."""
        patch = np.arange(len(self.grazing))

        def factor(schlick: float, axis: int | None = None) -> NDArray[np.float32]:
            toward = np.zeros((len(patch), 3), np.float32)
            if axis is not None:
                toward[:, axis] = 1
            return self.view_factor(patch, roughness, np.full(len(patch), schlick, np.float32), toward)

        # It is linear in v, and in S: eight values tell all.
        values = np.stack([np.stack([factor(s), *(factor(s, axis) for axis in range(3))]) for s in (0.0, 1.0)])
        values[:, 1:] -= values[:, :1]
        values[1] -= values[0]
        return np.moveaxis(values, 2, 0)
