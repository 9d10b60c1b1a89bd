"""Light whose source no photo shows: surfaces behind a corner that glow, and light from beyond the mesh.

Both enter the light balance as further emitters with form factors read off the gather rays: parts that no photo sees
(one radiance each, expected to be what they would reflect), and directions in which rays escape the mesh.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..result.sh import fit_sh, sh_basis
from ..transport.gather import GatherRays, Origins, with_schlick
from ..transport.sampling import dot
from ..transport.transport import ESCAPED, Transport

MIN_SHARE = 2e-3
"""A source that fills less than this share of the mean hemisphere is not worth an unknown."""
MAX_PARTS = 8
DIRECTIONAL_SHARE = 0.02
"""From this share of escaping rays on, light from outside may depend on direction."""


@dataclass(frozen=True)
class HiddenSources:
    """Unknowns beside the lamps.

    Attributes:
        parts: part ids that no photo sees.
        on_hidden: (N,) bool, patches of those parts; their radiance is an unknown, not inferred.
        directions: (D, 3) unit centres of the direction bins of outside light; D in {0, 1, 12}.
        form_factors: (N, len(parts) + D, 2) share of each patch's hemisphere, plain and times Schlick's S.
    """

    parts: NDArray[np.int64]
    on_hidden: NDArray[np.bool_]
    directions: NDArray[np.float64]
    form_factors: NDArray[np.float32]

    def with_directions(self, count: int) -> HiddenSources:
        """The same sources with 0, 1 (constant) or all direction bins of outside light."""
        if count == len(self.directions):
            return self
        n = len(self.parts)
        outside = self.form_factors[:, n:].sum(1, keepdims=True)[:, :count]
        directions = np.array([[0.0, 0.0, 1.0]])[:count]
        return replace(self, directions=directions, form_factors=np.concatenate([self.form_factors[:, :n], outside], 1))

    def outside_sh(self, radiance: NDArray[np.floating]) -> NDArray[np.float64] | None:
        """(1, 3) or (9, 3) spherical harmonics of the outside radiance (D, 3) per bin, None without bins."""
        if len(self.directions) == 0:
            return None
        if len(self.directions) == 1:
            return radiance / sh_basis(np.array([[0.0, 0.0, 1.0]]), 1)
        # Twelve bins and nine functions: few rays escape through some of them.
        return fit_sh(self.directions, radiance, np.ones(len(radiance)), ridge=0.05)


def dodecahedron() -> NDArray[np.float64]:
    """(12, 3) unit normals of a dodecahedron's faces: evenly spread directions."""
    golden = (1 + 5**0.5) / 2
    corners = [(0, s, t * golden) for s in (-1, 1) for t in (-1, 1)]
    points = np.array([np.roll(c, k) for c in corners for k in range(3)])
    return points / np.linalg.norm(points[0])


def nothing_hidden(transport: Transport) -> HiddenSources:
    """No light but that of surfaces the photos show."""
    n = transport.n_patches
    return HiddenSources(np.zeros(0, np.int64), np.zeros(n, bool), np.zeros((0, 3)), np.zeros((n, 0, 2), np.float32))


def find_hidden(transport: Transport, n_parts: int) -> HiddenSources:
    """Parts never seen and directions of escape that reach the seen surfaces."""
    n_seen, part = transport.n_seen, transport.part
    seen_part = np.zeros(n_parts, bool)
    seen_part[part[:n_seen]] = True
    unseen_patch = np.concatenate([np.zeros(n_seen, bool), ~seen_part[part[n_seen:]]])
    ids, share = _shares(transport, unseen_patch, n_parts)
    ids = ids[np.argsort(-share[ids])][:MAX_PARTS]
    label = np.full(n_parts, -1, np.int64)
    label[ids] = np.arange(len(ids))
    patch_label = np.where(unseen_patch, label[part], -1)
    escaped = float((transport.target == ESCAPED).mean())
    directions = np.zeros((0, 3))
    if escaped > MIN_SHARE:
        directions = dodecahedron() if escaped > DIRECTIONAL_SHARE else np.array([[0.0, 0.0, 1.0]])
    blocks = [
        _form_factors(target, origins, rays, patch_label, len(ids), directions)
        for target, origins, rays in (
            (transport.target, transport.origins, transport.rays),
            (transport.unseen_target, transport.unseen_origins, transport.unseen_rays),
        )
    ]
    return HiddenSources(ids, patch_label >= 0, directions, np.concatenate(blocks))


def _shares(transport: Transport, unseen: NDArray[np.bool_], n_parts: int) -> tuple[NDArray[np.int64], NDArray]:
    """Unseen parts worth an unknown, and the share of all gather rays that each part receives."""
    target = transport.target[transport.target >= transport.n_seen]
    hits = np.bincount(transport.part[target[unseen[target]]], minlength=n_parts) / transport.target.size
    return np.flatnonzero(hits > MIN_SHARE), hits


def _form_factors(
    target: NDArray[np.int32],
    origins: Origins,
    rays: GatherRays,
    patch_label: NDArray[np.int64],
    n_parts: int,
    directions: NDArray[np.float64],
) -> NDArray[np.float32]:
    """(rows, n_parts + D, 2) share of each row's rays that end on a hidden part or leave in a direction's bin."""
    n_rows, n_rays = target.shape
    result = np.zeros((n_rows, n_parts + len(directions), 2), np.float32)

    def add(row: NDArray[np.integer], column: NDArray[np.integer], source: NDArray[np.integer]) -> None:
        normal = origins.normal[row, column % origins.normal.shape[1]]
        cosine = dot(normal, rays.direction[row, column].astype(np.float32))
        np.add.at(result, (row, source), with_schlick(cosine) / n_rays)

    row, column = np.nonzero((target >= 0) & (patch_label[target] >= 0))
    add(row, column, patch_label[target[row, column]])
    if len(directions):
        row, column = np.nonzero(target == ESCAPED)
        bins = (rays.direction[row, column].astype(np.float32) @ directions.T.astype(np.float32)).argmax(1)
        add(row, column, n_parts + bins)
    return result
