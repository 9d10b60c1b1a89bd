"""Where to take one more photo: cameras from which one sees most of what the photos of a capture show badly.

A greedy cover (Nemhauser, Wolsey and Fisher 1978: at least 63 % of the best choice of as many cameras) over places that
a person can stand at and directions there. What one photo shows well counts as shown for the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..model.capture import Camera, FloatArray, HitDistance, Mesh
from ..model.seen_classes import SEEN_OFTEN
from ..model.sphere import even_directions
from ..model.surface_points import even_points, interpolated

SURFACE_SAMPLES = 20_000
"""Points of the mesh that are looked up, evenly over its area."""
NEEDED_SAMPLES = 1_200
"""Of the badly seen among them, so many are aimed at."""
STANDING_PLACES = 90
"""Places that are tried, beside those of the photos."""
STANDING_MARGIN = 0.5
"""Metres beyond the box of the photos' places that are tried."""
STANDING_CLEARANCE = 0.25
"""Metres that a camera keeps from every surface."""
TURNED_PHOTOS = 40
"""Photos from whose places other directions are tried, at most."""
WORTH_A_PHOTO = 0.03
"""Share of what is badly seen that a photo must show to be suggested."""
FACING_FULL = 0.5
"""Cosine to the normal from which on a surface is seen well; less counts in proportion."""
FACING_LEAST = 0.15
"""Cosine to the normal below which a surface is not seen."""
FRAME_MARGIN = 0.04
"""Share of the frame's side that is not counted on, because nobody aims exactly."""
LOOKS = 60
"""Directions over the sphere that are tried at a place, but for steep ones."""
STEEPEST_VIEW = np.sin(np.radians(55.0))
RAY_OFFSET = 1e-3
"""Of the size of the room: how far rays start from their surface."""


@dataclass(frozen=True)
class BadlySeen:
    """Points of the surface that photos show seldom or never.

    Attributes:
        position: (n, 3) metres.
        normal: (n, 3) unit; either side may be the one that is seen.
        need: (n,) square metres, the area that each stands for times how badly it is seen.
        size: diagonal of the mesh, metres.
    """

    position: FloatArray
    normal: FloatArray
    need: FloatArray
    size: float

    @staticmethod
    def of(mesh: Mesh, coverage: NDArray[np.floating]) -> BadlySeen:
        """Points of ``mesh``, whose UVs address the map ``coverage`` (N, N)."""
        assert mesh.uv is not None
        corners = mesh.vertices[mesh.faces]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(cross, axis=1)
        face, weights = even_points(0.5 * length, SURFACE_SAMPLES)
        position, uv = interpolated(corners[face], weights), interpolated(mesh.uv[face], weights)
        side = len(coverage)
        column = np.clip((uv[:, 0] * side).astype(int), 0, side - 1)
        row = np.clip(((1 - uv[:, 1]) * side).astype(int), 0, side - 1)
        lacking = np.clip(1 - coverage[row, column] / SEEN_OFTEN, 0, 1)
        wanted = np.flatnonzero((lacking > 0) & (length[face] > 0))
        step = max(1.0, len(wanted) / NEEDED_SAMPLES)
        kept = wanted[(np.arange(min(len(wanted), NEEDED_SAMPLES)) * step).astype(int)]
        unit = cross[face[kept]] / length[face[kept], None]
        points = mesh.vertices[np.unique(mesh.faces)]
        return BadlySeen(
            position=position[kept],
            normal=unit,
            need=lacking[kept] * step * 0.5 * length.sum() / SURFACE_SAMPLES,
            size=float(np.linalg.norm(np.ptp(points, axis=0))),
        )


@dataclass(frozen=True)
class SuggestedPhoto:
    """A photo worth taking.

    Attributes:
        camera: with the lens of the photos, upright.
        share: of what is badly seen and visible from anywhere, that it shows beyond those suggested before it.
    """

    camera: Camera
    share: float


def next_photos(
    badly: BadlySeen, taken: Sequence[Camera], up: Sequence[float], hit_distance: HitDistance, count: int = 5
) -> list[SuggestedPhoto]:
    """Up to ``count`` photos that show most of what is ``badly`` seen, the most useful first.

    They stand where one sees the place of a photo that was ``taken``, so within the same rooms. Hidden faces, as those
    behind furniture, need no photo: nothing is suggested for what can be seen from nowhere.

    Args:
        up: (3,) unit vector.
        hit_distance: against the mesh of the room.
    """
    if not len(badly.need) or not taken:
        return []
    axes = _upright(np.asarray(up, float))
    places = _places(taken, axes[2], badly.size, hit_distance)
    reach = _usual_distance(taken, hit_distance, badly.size)
    quality = _qualities(places, badly, reach, hit_distance)
    best = quality.max(0)
    total = float((badly.need * best).sum())
    looks = _directions(axes)
    lens = _usual_lens(taken)
    rotations = np.stack([_rotation(look, axes[2]) for look in looks])
    left, found = badly.need.copy(), []
    frames = np.stack([_in_frames(place, rotations, badly.position, lens) for place in places])  # places, looks, points
    while total > 0 and len(found) < count:
        gain = np.einsum("pln,pn->pl", frames, quality * left, optimize=True)
        place, look = np.unravel_index(np.argmax(gain), gain.shape)
        share = float(gain[place, look]) / total
        if share < WORTH_A_PHOTO:
            break
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotations[look], places[place]
        found.append(SuggestedPhoto(replace(lens, c2w=pose), share))
        left = left * (1 - quality[place] * frames[place, look])
    return found


# ---- where to stand ------------------------------------------------------------------------------------------------


def _places(taken: Sequence[Camera], up: FloatArray, size: float, hit_distance: HitDistance) -> FloatArray:
    """(p, 3) places of photos, and others around them from where one of those is seen, clear of surfaces."""
    eyes = np.stack([camera.position for camera in taken])
    own = eyes[:: -(-len(eyes) // TURNED_PHOTOS)]
    axes = _upright(up)
    local = eyes @ axes.T
    low, high = local[:, :2].min(0) - STANDING_MARGIN, local[:, :2].max(0) + STANDING_MARGIN
    heights = np.unique(np.round(np.quantile(local[:, 2], (0.1, 0.5, 0.9)), 2))
    spacing = float(np.sqrt(np.prod(high - low) * len(heights) / STANDING_PLACES))
    x, y = (np.arange(a + 0.5 * spacing, b, spacing) for a, b in zip(low, high, strict=True))
    grid = np.stack(np.meshgrid(x, y, heights, indexing="ij"), -1).reshape(-1, 3) @ axes
    # From inside the room one sees the place of a photo; that of the nearest is asked for.
    nearest = eyes[np.argmin(np.linalg.norm(grid[:, None] - eyes[None], axis=2), axis=1)]
    offset = nearest - grid
    length = np.linalg.norm(offset, axis=1)
    inside = hit_distance(grid, offset / np.maximum(length, 1e-9)[:, None]) >= length - RAY_OFFSET * size
    around = np.concatenate([_directions(axes), [axes[2], -axes[2]]])[:: 2 if len(grid) > 400 else 1]
    rays = np.repeat(grid, len(around), 0), np.tile(around, (len(grid), 1))
    clear = hit_distance(*rays).reshape(len(grid), -1).min(1) > STANDING_CLEARANCE
    return np.concatenate([own, grid[inside & clear]])


def _usual_distance(taken: Sequence[Camera], hit_distance: HitDistance, size: float) -> float:
    """Metres from photos to what stands in their middle: the median."""
    eyes = np.stack([camera.position for camera in taken])
    found = hit_distance(eyes, -np.stack([camera.c2w[:3, 2] for camera in taken]))
    found = found[np.isfinite(found)]
    return float(np.median(found)) if len(found) else 0.3 * size


def _usual_lens(taken: Sequence[Camera]) -> Camera:
    """The camera of the photo with the median field of view."""
    order = sorted(taken, key=lambda camera: camera.fx / camera.width)
    return order[len(order) // 2]


# ---- what is seen from there ---------------------------------------------------------------------------------------


def _qualities(places: FloatArray, badly: BadlySeen, reach: float, hit_distance: HitDistance) -> FloatArray:
    """(p, n) how well each point is seen from each place, 0 to 1, if a camera there points at it."""
    quality = np.zeros((len(places), len(badly.need)))
    for row, place in zip(quality, places, strict=True):
        offset = place - badly.position
        distance = np.linalg.norm(offset, axis=1)
        toward = offset / np.maximum(distance, 1e-9)[:, None]
        cosine = np.einsum("nk,nk->n", toward, badly.normal)
        seen = np.flatnonzero(np.abs(cosine) > FACING_LEAST)
        near = RAY_OFFSET * badly.size
        start = badly.position[seen] + near * np.sign(cosine[seen])[:, None] * badly.normal[seen]
        seen = seen[hit_distance(start, toward[seen]) >= distance[seen] - 2 * near]
        row[seen] = np.minimum(np.abs(cosine[seen]) / FACING_FULL, 1)
        row[seen] *= np.minimum(reach / np.maximum(distance[seen], 1e-9), 1) ** 2
    return quality


def _in_frames(place: FloatArray, rotations: FloatArray, points: FloatArray, lens: Camera) -> NDArray[np.bool_]:
    """(l, n) whether a camera at ``place`` with rotation (l, 3, 3) has the points (n, 3) in its frame."""
    local = np.einsum("nk,lkj->lnj", points - place, rotations)
    depth = -local[..., 2]
    ahead = depth > 1e-6
    x = lens.cx + lens.fx * local[..., 0] / np.where(ahead, depth, 1)
    y = lens.cy - lens.fy * local[..., 1] / np.where(ahead, depth, 1)
    wide, high = FRAME_MARGIN * lens.width, FRAME_MARGIN * lens.height
    return ahead & (x > wide) & (x < lens.width - wide) & (y > high) & (y < lens.height - high)


def _directions(axes: FloatArray) -> FloatArray:
    """(l, 3) unit directions over the sphere, none steeper than a tripod likes."""
    local = even_directions(LOOKS)
    return local[np.abs(local[:, 2]) < STEEPEST_VIEW] @ axes


def _upright(up: FloatArray) -> FloatArray:
    """(3, 3) rows: two horizontal axes, and up."""
    up = up / np.linalg.norm(up)
    across = np.cross(up, [1.0, 0, 0] if abs(up[0]) < 0.9 else [0, 1.0, 0])
    across /= np.linalg.norm(across)
    return np.stack([across, np.cross(up, across), up])


def _rotation(look: FloatArray, up: FloatArray) -> FloatArray:
    """(3, 3) columns right, up, backward of an upright camera that looks along ``look``."""
    right = np.cross(look, up)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(right, look), -look], -1)
