"""A picture of each lamp, cut from the photo that shows it best: people know a lamp by its looks, not by its number."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..base.files import require_own_folder
from ..base.images import to_codes, write_png
from ..capture.photos import load_photo, shrink
from ..model.capture import Camera, View
from ..model.response import grey_exposure, srgb
from ..model.surface_points import even_points, interpolated
from ..rays.tracer import Tracer
from .files import PICTURES, lamp_picture
from .result import Result

LAMP_SIDE = 96
"""Pixels along a side of a picture."""
LAMP_POINTS = 48
"""Points of a lamp that are looked for in every photo."""
LAMP_SURROUNDINGS = 2.5
"""Side of a picture in sizes of its lamp, so that one sees what it hangs from."""
LAMP_LEAST_SIDE = 0.1
"""Of the photo's width: a picture of a tiny lamp shows at least that."""
LAMP_LARGE = 0.25
"""Of the photo's width, squared: a lamp that takes more is shown no better by being larger."""
PHOTO_WIDTH = 1280
"""Pixels in a row of photos that pictures are cut from; larger ones are read reduced."""


def write_lamp_pictures(result: Result, views: Sequence[View], tracer: Tracer, folder: Path) -> dict[int, Path]:
    """Write a picture of each lamp of ``result`` that a photo shows into the folder of its report; earlier ones go.

    Returns:
        Paths by the lamp's id.

    Raises:
        BadInput: the folder of the report is a link, or a photo cannot be read.
    """
    require_own_folder(folder / PICTURES)
    for old in (folder / PICTURES).glob("lamp-*.png"):
        old.unlink()
    views = [view.reduced_to(PHOTO_WIDTH) for view in views if view.photo is not None]
    cuts: dict[int, list[tuple[int, NDArray[np.int64]]]] = defaultdict(list)
    for number, emitter in enumerate(result.emitters):
        lit = [k for k, view in enumerate(views) if _shows_lit(result, number, view)]
        best = best_view([views[k].camera for k in lit], emitter.faces, tracer)
        if best is not None:
            cuts[lit[best[0]]].append((emitter.id, best[1]))
    written = {}
    for index, lamps in cuts.items():
        photo = load_photo(views[index])
        shown = srgb(photo.values * grey_exposure(photo.values[photo.valid])) if photo.hdr else photo.values
        for number, (left, top, side) in lamps:
            cut = shrink(shown[top : top + side, left : left + side], LAMP_SIDE, LAMP_SIDE)
            written[number] = lamp_picture(folder, number)
            write_png(written[number], to_codes(np.clip(cut, 0, 1)))
    return written


def _shows_lit(result: Result, number: int, view: View) -> bool:
    """Whether the lamp of that ``number`` is on in the photo of ``view``."""
    named = [state for state in result.light_states if state.name == view.light_state]
    return all(state.radiance[number].any() for state in named)


def best_view(
    cameras: Sequence[Camera], faces: NDArray[np.integer], tracer: Tracer
) -> tuple[int, NDArray[np.int64]] | None:
    """The camera that shows most of the lamp of ``faces``, as large as useful, and the square to cut: left, top, side.

    None where no camera sees it.
    """
    points, normals = _points(faces, tracer)
    best, cut = 0.0, None
    for index, camera in enumerate(cameras):
        local = camera.local(points)
        ahead = np.flatnonzero(local[:, 2] < -1e-6)
        at = camera.project(local[ahead])
        ahead = ahead[((at > 0) & (at < [camera.width, camera.height])).all(1)]
        if not len(ahead):
            continue
        toward = camera.position - points[ahead]
        distance = np.linalg.norm(toward, axis=1)
        toward /= distance[:, None]
        cosine = np.einsum("nk,nk->n", toward, normals[ahead])
        start = points[ahead] + tracer.epsilon * np.sign(cosine)[:, None] * normals[ahead]
        clear = tracer.unoccluded(start, toward, distance - tracer.epsilon) & (np.abs(cosine) > 0.02)
        seen = ahead[clear]
        if len(seen) < 2:
            continue
        at = camera.project(local[seen])
        low, high = at.min(0), at.max(0)
        area = tracer.areas[faces].sum() * np.mean(np.abs(cosine[clear]) / distance[clear] ** 2) * camera.fx * camera.fy
        large = min(area / (LAMP_LARGE * camera.width) ** 2, 1.0)
        score = (len(seen) / len(points)) ** 2 * np.sqrt(large)
        if score > best:
            best, cut = score, (index, _square(low, high, camera))
    return cut


def _points(faces: NDArray[np.integer], tracer: Tracer) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points evenly over ``faces``, and the normals there."""
    chosen, weights = even_points(tracer.areas[faces], LAMP_POINTS)
    return interpolated(tracer.corners[faces[chosen]], weights), tracer.normals[faces[chosen]].astype(np.float64)


def _square(low: NDArray[np.floating], high: NDArray[np.floating], camera: Camera) -> NDArray[np.int64]:
    """Left, top and side of a square of pixels around the box from ``low`` to ``high``, within the photo."""
    side = max(LAMP_SURROUNDINGS * float((high - low).max()), LAMP_LEAST_SIDE * camera.width, 8.0)
    side = int(min(side, camera.width, camera.height))
    left, top = np.clip(0.5 * (low + high) - side / 2, 0, [camera.width - side, camera.height - side]).astype(int)
    return np.array([left, top, side])
