"""Panes of glass: flat parts through which photos show what lies behind them.

A pane reflects hardly anything and has no picture of its own. What a photo shows where a pane stands belongs to the
surface that the line of sight meets next, or to the direction in which it leaves the room: from another place another
part of it stands behind the same part of the pane. Each flat part of a modelled mesh is asked both ways. A pixel is
predicted by the pixels of other photos nearest to it on the part, and by those nearest to it behind, and
:mod:`iris_addon.decide` compares the errors. The rest of the solve sees a hole where a pane stands.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..base.group_by import group_means, thinned
from ..decide import PANE_LEAST_LOSS, Decisions, HeldOutLosses
from ..rays.sampling import dot
from ..rays.tracer import Tracer, points_on_faces
from .photo_samples import ShownPixels
from .primary_rays import PixelSamples
from .scan_surface import ScanSurface
from .topology import component_labels, smooth_components

FLAT = 0.005
"""Distance of the corners of a flat part from its plane, at most, metres."""
PANE_THICKNESS = 0.05
"""Depth of a pane with both sides and all its sheets of glass, at most, metres."""
MOST_SHEETS = 6
"""Surfaces of one pane that a line of sight may meet."""
PARALLEL = 0.99
"""Cosine between the normals of the sides of a pane, at least."""
SHEET_SHARE = 0.1
"""Share of the lines of sight through a pane that meet a part behind it for that to be another side of it."""
MIN_PIXELS, MAX_PIXELS = 60, 1500
"""Pixels of a part on which it is asked: with fewer it is none, of more that many are taken."""
NEAREST, OF_OTHERS = 64, 3
"""Pixels nearest to a pixel that are looked at, and those of other photos among them that predict it."""
TINY = 1e-6
ROBUST_LOG = 0.1
"""Error of a predicted log value at which it starts to count as an outlier."""
PLACES = 40
"""Pixels of a part that err independently, at most."""


@dataclass(frozen=True)
class _Behind:
    """What k lines of sight meet behind the part that they meet first.

    Attributes:
        place: (k, 3) metres, or the unit direction in which one leaves the room.
        leaves: (k,) bool.
        passed: (m,) part of each side of a pane that one passes on the way.
    """

    place: NDArray[np.float64]
    leaves: NDArray[np.bool_]
    passed: NDArray[np.int64]


def find_panes(
    surface: ScanSurface, tracer: Tracer, samples: PixelSamples, shown: ShownPixels, decisions: Decisions
) -> NDArray[np.int64]:
    """(k,) faces of panes.

    Args:
        tracer: of the mesh with its panes.
        samples: where pixels meet the mesh.
        shown: what photos show there.
    """
    if decisions.forbids("pane"):
        return np.zeros(0, np.int64)
    part = smooth_components(tracer.normals, surface.adjacency, surface.scanned)
    flat = _flat_parts(part, tracer) & ~surface.scanned[_first_face(part)]
    rows = _pixels_on(flat, part, samples, shown.usable)
    samples, level, clipped = samples.take(rows), np.log(np.maximum(shown.luminance, TINY))[rows], shown.clipped[rows]
    asked = part[samples.face]
    panes, passed = [], [np.zeros(0, np.int64)]
    for own in np.split(np.argsort(asked, kind="stable"), np.flatnonzero(np.diff(np.sort(asked))) + 1):
        if not len(own):
            continue
        pixels = samples.take(own)
        show = partial(_loss, view=pixels.view, level=level[own], clipped=clipped[own])
        on = show(pixels.position)
        if np.isfinite(on).sum() < MIN_PIXELS or np.nanmean(on) < PANE_LEAST_LOSS:
            continue
        behind = _behind(tracer, pixels, part)
        beyond = np.where(
            behind.leaves, show(behind.place, among=behind.leaves), show(behind.place, among=~behind.leaves)
        )
        known = np.flatnonzero(np.isfinite(on) & np.isfinite(beyond))
        if len(known) < MIN_PIXELS:
            continue
        smaller, larger = (HeldOutLosses(known, loss[known], np.ones(len(known)), PLACES) for loss in (on, beyond))
        number = int(asked[own[0]])
        losses = float(smaller.loss.mean()), float(larger.loss.mean()), smaller.paired_error(larger)
        if decisions.accept("pane", *losses, subject=f"part {number}"):
            panes.append(number)
            passed.append(_other_sides(behind, number))
    return _whole_panes(np.concatenate([panes, *passed]).astype(np.int64), part, surface, tracer)


def _first_face(part: NDArray[np.int32]) -> NDArray[np.int64]:
    """(P,) the first face of each part."""
    return np.unique(part, return_index=True)[1]


def _flat_parts(part: NDArray[np.int32], tracer: Tracer) -> NDArray[np.bool_]:
    """(P,) parts whose corners lie in one plane."""
    normal = tracer.normals * tracer.areas[:, None]
    # The two sides of a sheet may be turned either way.
    first = tracer.normals[_first_face(part)][part]
    normal *= np.where(dot(normal, first) < 0, -1, 1)[:, None]
    axis = group_means(normal, part, int(part.max()) + 1)
    axis /= np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-12)
    height = np.einsum("fck,fk->fc", tracer.corners, axis[part])
    low, high = np.full(len(axis), np.inf), np.full(len(axis), -np.inf)
    np.minimum.at(low, part, height.min(1))
    np.maximum.at(high, part, height.max(1))
    return (high - low < 2 * FLAT) & axis.any(1)


def _pixels_on(
    parts: NDArray[np.bool_], part: NDArray[np.int32], samples: PixelSamples, usable: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """``usable`` pixels that show one of the ``parts`` (P,), an even selection of each that enough of them show."""
    own = part[samples.face]
    counts = np.bincount(own[usable], minlength=len(parts))
    step = np.maximum(1, counts // MAX_PIXELS)
    rows = np.flatnonzero((parts & (counts >= MIN_PIXELS))[own] & usable)
    return thinned(rows, own, step)


def _behind(tracer: Tracer, samples: PixelSamples, part: NDArray[np.int32]) -> _Behind:
    """What the lines of sight of ``samples`` meet once they have passed all sides of what they meet first."""
    along = -samples.direction.astype(np.float64)
    place, leaves = samples.position.astype(np.float64), np.zeros(len(along), bool)
    passed = []
    going = np.arange(len(along))
    for _ in range(MOST_SHEETS):
        hits = tracer.closest(place[going] + 2 * tracer.epsilon * along[going], along[going])
        gone = hits.face < 0
        leaves[going[gone]] = True
        going, face, weights = going[~gone], hits.face[~gone], hits.barycentric[~gone]
        place[going] = points_on_faces(tracer.corners, face, weights)
        depth = np.abs(dot(place[going] - samples.position[going], samples.normal[going]))
        side = (np.abs(dot(tracer.normals[face], samples.normal[going])) > PARALLEL) & (depth < PANE_THICKNESS)
        passed.append(part[face[side]])
        going = going[side]
        if not len(going):
            break
    return _Behind(np.where(leaves[:, None], along, place), leaves, np.concatenate(passed))


def _loss(
    place: NDArray[np.floating],
    view: NDArray[np.integer],
    level: NDArray[np.floating],
    clipped: NDArray[np.bool_],
    among: NDArray[np.bool_] | None = None,
) -> NDArray[np.float64]:
    """(k,) robust loss of the level of each pixel as the nearest pixels of other photos predict it.

    Of clipped values only what contradicts a bound counts.

    Args:
        place: (k, 3) of the pixels.
        among: (k,) pixels that are looked at, by default all.

    Returns:
        NaN where no other photo shows a place near, and for pixels that are not looked at.
    """
    loss = np.full(len(place), np.nan)
    rows = np.arange(len(place)) if among is None else np.flatnonzero(among)
    if len(rows) < 2:
        return loss
    place, view, level, clipped = place[rows], view[rows], level[rows], clipped[rows]
    near = cKDTree(place).query(place, k=min(NEAREST, len(rows)), workers=-1)[1]
    other = view[near] != view[:, None]
    other &= np.cumsum(other, axis=1) <= OF_OTHERS
    deviation = level - (level[near] * other).sum(1) / np.maximum(other.sum(1), 1)
    deviation = np.where(clipped, np.maximum(deviation, 0), deviation)
    deviation = np.where((clipped[near] & other).any(1), np.minimum(deviation, 0), deviation)
    loss[rows] = np.where(other.any(1), np.log1p((deviation / ROBUST_LOG) ** 2), np.nan)
    return loss


def _other_sides(behind: _Behind, part: int) -> NDArray[np.int64]:
    """Parts that a fair share of the lines of sight through ``part`` pass."""
    number, count = np.unique(behind.passed, return_counts=True)
    return number[count > SHEET_SHARE * len(behind.leaves)]


def _whole_panes(
    parts: NDArray[np.int64], part: NDArray[np.int32], surface: ScanSurface, tracer: Tracer
) -> NDArray[np.int64]:
    """Faces of ``parts``, with the rims of those that are thin things of their own."""
    glass = np.isin(part, parts)
    thing = component_labels(len(part), *surface.adjacency)
    for number in np.unique(thing[glass]):
        faces = np.flatnonzero(thing == number)
        axis = tracer.normals[faces[np.argmax(tracer.areas[faces] * glass[faces])]].astype(np.float64)
        if np.ptp(tracer.corners[faces].reshape(-1, 3) @ axis) < PANE_THICKNESS:
            glass[faces] = True
    return np.flatnonzero(glass)
