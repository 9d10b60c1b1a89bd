"""Light at the seen patches, and the share of it that a diffuse lobe sends towards a camera.

A rough wall seen from the side of its light is brighter than seen from the opposite side, by a few per cent at grazing
angles. Rooms are photographed from the middle, so this is a trend between walls near the windows and walls far from
them, which the light balance would take for weaker windows. The moments of the light of a patch
(:class:`.LightMoments`, equation (10)) give its brightness in every direction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import BLOCK, over_blocks
from ..brdf.ggx import layered_factor
from ..lighting.lamp_radiance import mean_radiance
from ..lighting.problem import LightProblem, Lights
from ..model.recovered import DiffuseLobe
from ..surface.primary_rays import PixelSamples
from ..transport.transport import LightMoments, radiance_table, table_rows


@dataclass(frozen=True)
class Shading:
    """The light of all lamps at the seen patches.

    Attributes:
        irradiance: (P, 3) irradiance / pi, denoised but for the sun's.
        sunlight: (P, 3) the part of it that comes from the sun directly.
        moments: of its direction, for Burley's lobe; None for others.
        layered: whether dielectrics take the light they reflect off the diffuse light below, equation (11).
    """

    irradiance: NDArray[np.float32]
    sunlight: NDArray[np.float32]
    moments: LightMoments | None
    layered: bool = False

    @staticmethod
    def under(lights: Lights, problem: LightProblem, lobe: DiffuseLobe) -> Shading:
        """The light that ``lights`` cast on surfaces of a diffuse ``lobe``."""
        moments = light_moments(problem, lights) if lobe == "burley" else None
        sunlight = direct_sunlight(problem, lights)
        return Shading(smooth_irradiance(problem, lights) + sunlight, sunlight, moments, lobe == "layered")

    @property
    def smooth(self) -> NDArray[np.float32]:
        """(P, 3) irradiance / pi without direct sunlight: what may be interpolated between patches."""
        return self.irradiance - self.sunlight

    def at_pixels(self, problem: LightProblem, lights: Lights) -> NDArray[np.float32]:
        """(n, 3) irradiance / pi at all pixels: interpolated from patches, sunlight with its sharp borders."""
        sun, samples, patch = problem.hidden.sun, problem.samples, problem.surface.sample_patch
        light = problem.field.at_samples(samples, patch, self.smooth)
        return light if sun is None else light + _sunlight(problem, lights, samples, patch, sun.visible)

    def view_factor(
        self,
        patch: NDArray[np.integer],
        roughness: NDArray[np.floating],
        schlick: NDArray[np.floating],
        toward: NDArray[np.floating],
    ) -> NDArray[np.float32]:
        """(..., n) view factor F_d, equations (10) and (11): diffuse radiance over albedo times irradiance / pi.

        The irradiance is weighted by the separable lobe, ``1 + κ S``.

        Args:
            patch: (n,) patch that each view sees.
            roughness: (..., n) or (..., 1).
            schlick: (n,) S of the direction to the camera.
            toward: (n, 3) unit vectors to the camera.
        """
        if self.moments is not None:
            return self.moments.view_factor(patch, roughness, schlick, toward)
        if self.layered:
            return layered_factor(roughness, 1 - schlick.astype(np.float64) ** 0.2).astype(np.float32)
        return np.ones((*roughness.shape[:-1], len(patch)), np.float32)


def smooth_irradiance(problem: LightProblem, lights: Lights) -> NDArray[np.float32]:
    """(P, 3) denoised irradiance / pi of the seen patches, without direct sunlight."""
    return problem.field.denoise(lights.irradiance[: problem.transport.n_seen] - direct_sunlight(problem, lights))


def sunlight_at(
    problem: LightProblem, lights: Lights, samples: PixelSamples, patch: NDArray[np.int32]
) -> NDArray[np.float32]:
    """(k, 3) irradiance / pi by the sun of other points on ``patch`` (k,), such as texels, each seen by a pixel."""
    sun = problem.hidden.sun
    if sun is None:
        return np.zeros((len(patch), 3), np.float32)
    visible = sun.seen_by(problem.tracer, samples, patch, problem.seed)
    return _sunlight(problem, lights, samples, patch, visible)


def _sunlight(
    problem: LightProblem,
    lights: Lights,
    samples: PixelSamples,
    patch: NDArray[np.int32],
    visible: NDArray[np.float32],
) -> NDArray[np.float32]:
    sun = problem.hidden.sun
    assert sun is not None
    direct = sun.at_pixels(samples, visible, problem.transport.kappa[patch])
    return direct[:, None] * lights.hidden_radiance[-1].astype(np.float32)


def direct_sunlight(problem: LightProblem, lights: Lights) -> NDArray[np.float32]:
    """(P, 3) irradiance / pi of the seen patches by the sun."""
    sunlight = problem.hidden.sunlight(lights.hidden_radiance, problem.transport.kappa)
    return sunlight[: problem.transport.n_seen].astype(np.float32)


def light_moments(problem: LightProblem, lights: Lights) -> LightMoments:
    """Moments of the light of other patches and of the lamps at the seen patches.

    A lamp counts as one point, its centre. Light from outside and by way of glossy surfaces is assumed to have the mean
    direction of the rest.
    """
    sums = _gathered(problem, lights) + _of_lamps(problem, lights)
    lit = lights.irradiance[: len(sums)]
    sums = problem.field.denoise(sums, lit)
    total = np.maximum(sums[:, :1], 1e-12)
    # Where no ray found light, its direction is unknown; the normal is assumed.
    ahead = np.where(sums[:, :1] > 0, sums[:, 2:5] / total, problem.field.normal)
    return LightMoments(ahead, sums[:, 1] / total[:, 0], sums[:, 5:] / total)


def _gathered(problem: LightProblem, lights: Lights) -> NDArray[np.float32]:
    """(P, 8) sums over the gather rays: light, light times S, and both times its direction."""
    t = problem.transport
    table = radiance_table(lights.patch_radiance, mean_radiance(lights.patch_radiance, problem)).mean(1)
    sums = np.empty((t.n_seen, 8), np.float32)
    n_rays = t.target.shape[1]

    def work(rows: slice) -> None:
        light = table[table_rows(t.target[rows], t.rays.face[rows], lights.mask)] / np.float32(n_rays)
        both = np.stack([light, light * t.rays.schlick_start[rows]], 1)
        sums[rows, :2] = both.sum(2)
        sums[rows, 2:] = np.matmul(both, t.rays.direction[rows].astype(np.float32)).reshape(-1, 6)

    over_blocks(t.n_seen, BLOCK // n_rays, work)
    return sums


def _of_lamps(problem: LightProblem, lights: Lights) -> NDArray[np.float32]:
    """(P, 8) the sums of :func:`_gathered` over the lamps."""
    position, tracer = problem.field.position, problem.tracer
    sums = np.zeros((len(position), 8), np.float32)
    if not lights.emitters:
        return sums
    centre = [np.average(tracer.corners[f].mean(1), axis=0, weights=tracer.areas[f]) for f in lights.emitters]
    centres, level = np.array(centre, np.float32), lights.radiance.mean(1).astype(np.float32)

    def work(rows: slice) -> None:
        toward = centres - position[rows, None]
        toward /= np.maximum(np.linalg.norm(toward, axis=2, keepdims=True), 1e-6)
        cast = lights.form_factors[rows] * level[:, None]
        sums[rows, :2] = cast.sum(1)
        sums[rows, 2:] = np.matmul(cast.transpose(0, 2, 1), toward).reshape(-1, 6)

    over_blocks(len(position), BLOCK // len(centres), work)
    return sums
