"""Objects inserted into a photo by differential rendering (Debevec 1998, section 6), in the photo's own response.

Two pairs of renders, each with and without the edit under the same random numbers: where nothing changes, both renders
of a pair are equal to the last bit, so that noise cancels and the photo remains. The two pairs disagree by noise, and
the difference is shrunk accordingly (:func:`shrunk_difference`). Inserted objects appear as they were rendered, with
their noise; they cover a small area of most pictures, which is rendered again with more samples.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from ...base.color_spaces import ColorSpace
from ...base.exr_planes import layer_channels, write_exr_planes
from ...edits.scene_edit import SceneEdit
from ...model.capture import Camera
from ...model.render_settings import RenderSettings
from ...model.response import SATURATED, Response
from ...results.result import Result
from ..render.cycles import aim, render_coverage, render_linear, set_cycles
from ..scene_out.build import BuiltScene, build_scene

COVERAGE_SAMPLES = 32
MAX_SAMPLE_FACTOR = 8
"""Maximum samples of pixels that show something inserted, as a multiple of the others'. Up to an eighth of the picture
this costs no more than another render of all of it."""
BORDER_MARGIN = 8
"""Pixels around a rendered border that the denoiser sees."""
NOISE_RADIUS = 3
"""Radius in pixels of the window in which noise is estimated."""

Pair = tuple[NDArray[np.floating], NDArray[np.floating]]
Box = tuple[tuple[int, int], tuple[int, int]]


@dataclass(frozen=True)
class Differential:
    """How an edit changes one view.

    Attributes:
        without: (H, W, 3) linear radiance of the room as solved.
        with_edit: (H, W, 3) linear radiance with the edit.
        change: (H, W, 3) their difference, shrunk by its noise.
        covered: (H, W) share of each pixel that inserted objects cover.
    """

    without: NDArray[np.floating]
    with_edit: NDArray[np.floating]
    change: NDArray[np.floating]
    covered: NDArray[np.floating]


@dataclass(frozen=True)
class ChangedPhoto:
    """A photo with an edit in it, and what it is made of.

    Attributes:
        display: (H, W, 3) display values, or None where the photo holds radiance.
        radiance: (H, W, 3) linear Rec.709; in the unit of the photo where that holds radiance.
        plate: (H, W, 3) ``radiance`` without the edit.
        covered: (H, W) share of each pixel that inserted objects cover.
    """

    display: NDArray[np.floating] | None
    radiance: NDArray[np.floating]
    plate: NDArray[np.floating]
    covered: NDArray[np.floating]

    @property
    def shows_added(self) -> bool:
        """Whether anything of the inserted objects is visible."""
        return bool(self.covered.any())


def insert_onto_photo(
    result: Result,
    camera: Camera,
    photo: NDArray[np.floating],
    exposure: NDArray[np.floating],
    edit: SceneEdit,
    settings: RenderSettings,
    response: Response | None = None,
) -> NDArray[np.float64]:
    """(H, W, 3) display values of the photo as it would have been with ``edit`` in the room.

    Args:
        photo: (H, W, 3) display values in [0, 1] of the undistorted photo.
        exposure: factor from radiance to the argument of the response, broadcastable to the photo.
        response: that the photo was taken with; by default that of ``result``.
    """
    if edit.changes_nothing:
        return np.array(photo, dtype=np.float64)
    without = render_pair(result, camera, None, settings)
    changed = render_change(result, camera, edit, without, settings)
    return _change_display(photo, changed, response or result.response, exposure)[0]


def render_pair(
    result: Result,
    camera: Camera,
    edit: SceneEdit | None,
    settings: RenderSettings,
) -> Pair:
    """The view twice, (H, W, 3) linear radiance each, with half of the samples and random numbers of its own each."""
    with room_built(result, edit) as built:
        return pair_of(built, camera, settings)


def render_change(
    result: Result,
    camera: Camera,
    edit: SceneEdit,
    without: Pair,
    settings: RenderSettings,
) -> Differential:
    """How ``edit`` changes the view that ``without`` (:func:`render_pair` of the room alone, same settings) shows."""
    with room_built(result, edit) as built:
        return change_of(built, camera, without, settings)


@contextmanager
def room_built(result: Result, edit: SceneEdit | None) -> Iterator[BuiltScene]:
    """Inside, the room with ``edit`` is a scene, for :func:`pair_of` and :func:`change_of` of any number of cameras."""
    built = build_scene(result, edit)
    try:
        yield built
    finally:
        built.free()


def pair_of(built: BuiltScene, camera: Camera, settings: RenderSettings) -> Pair:
    """:func:`render_pair` of a scene that is built."""
    aim(built, camera)
    return render_halves(built.scene, settings)


def change_of(built: BuiltScene, camera: Camera, without: Pair, settings: RenderSettings) -> Differential:
    """:func:`render_change` of a scene that is built with the edit."""
    aim(built, camera)
    backdrop = () if built.backdrop is None else (built.backdrop,)
    room = (built.room, *built.lamps, *built.lights, *backdrop)
    return render_differential(built.scene, room, without, settings)


def render_differential(
    scene: bpy.types.Scene,
    room: Iterable[bpy.types.Object],
    without: Pair,
    settings: RenderSettings,
) -> Differential:
    """Like :func:`render_change`, for an existing scene in which everything but ``room`` was inserted."""
    halves = render_halves(scene, settings)
    change = shrunk_difference((halves[0] - without[0], halves[1] - without[1]))
    covered = coverage(scene, room)
    with_edit = np.mean(halves, axis=0)
    rows, columns = (np.flatnonzero(covered.any(axis=axis)) for axis in (1, 0))
    if rows.size:
        box = ((rows[0], rows[-1] + 1), (columns[0], columns[-1] + 1))
        with border(scene, box, covered.shape) as share:
            if (times := min(MAX_SAMPLE_FACTOR, int(1 / share))) > 1:
                set_cycles(scene, replace(settings, samples=times * settings.samples))
                with_edit = np.where(covered[..., None] > 0, render_linear(scene), with_edit)
    return Differential(np.mean(without, axis=0), with_edit, change, covered)


@contextmanager
def border(scene: bpy.types.Scene, box: Box, shape: tuple[int, ...]) -> Iterator[float]:
    """Inside, only ``box`` and BORDER_MARGIN pixels around it are rendered; the rest is black.

    Args:
        box: rows and columns, (first, last + 1) each.
        shape: (H, W) of the picture.

    Yields:
        the share of the picture that is rendered.
    """
    (top, bottom), (left, right) = (
        (max(low - BORDER_MARGIN, 0) / size, min(high + BORDER_MARGIN, size) / size)
        for (low, high), size in zip(box, shape, strict=True)
    )
    render = scene.render
    before = render.use_border, render.use_crop_to_border
    render.use_border, render.use_crop_to_border = True, False
    render.border_min_x, render.border_max_x = left, right
    render.border_min_y, render.border_max_y = 1 - bottom, 1 - top
    try:
        yield (bottom - top) * (right - left)
    finally:
        render.use_border, render.use_crop_to_border = before


def render_halves(scene: bpy.types.Scene, settings: RenderSettings) -> Pair:
    """Like :func:`render_pair`, for an existing scene and its active camera; changes its render settings."""
    images = []
    for half in (0, 1):
        samples, seed = max(settings.samples // 2, 1), 2 * settings.seed + half
        set_cycles(scene, replace(settings, samples=samples, seed=seed))
        images.append(render_linear(scene))
    return images[0], images[1]


def shrunk_difference(differences: Pair) -> NDArray[np.float64]:
    """(H, W, 3) mean of two estimates of a difference, shrunk towards 0 where they disagree.

    A Wiener filter with the empirical signal: each value is multiplied by 1 − σ²/d², where d² is the mean square of
    the difference around it and σ² the noise variance that follows from the two estimates.
    """
    first, second = (np.asarray(d, np.float64) for d in differences)
    mean = (first + second) / 2
    noise = _local_mean((first - second) ** 2 / 4)
    signal = _local_mean(mean**2)
    share = 1.0 - np.divide(noise, signal, out=np.ones_like(noise), where=signal > 0)
    return mean * np.clip(share, 0.0, 1.0)


def change_photo(
    photo: NDArray[np.floating], changed: Differential, response: Response | None, exposure: NDArray[np.floating]
) -> ChangedPhoto:
    """The photo with the change that was rendered for it.

    Args:
        photo: (H, W, 3) display values in [0, 1], or radiance.
        response: that the photo was taken with; None where it holds radiance.
        exposure: under which the render looks like the photo, broadcastable to it.
    """
    if response is None:
        return ChangedPhoto(None, change_light(photo, changed, exposure), photo, changed.covered)
    return ChangedPhoto(*_change_display(photo, changed, response, exposure), changed.covered)


def unchanged_photo(
    photo: NDArray[np.floating], response: Response | None, exposure: NDArray[np.floating] | float
) -> ChangedPhoto:
    """The photo as it is, for an edit that changes nothing; arguments as of :func:`change_photo`."""
    radiance = photo if response is None else response.invert(photo) / exposure
    return ChangedPhoto(None if response is None else photo, radiance, radiance, np.zeros(photo.shape[:2]))


def _change_display(
    photo: NDArray[np.floating], changed: Differential, response: Response, exposure: NDArray[np.floating]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Display values with the change in them, linear radiance with it and without it, (H, W, 3) each.

    The difference passes through the response, so that pixels whose light does not change keep their values exactly.
    Where the photo is clipped, the render replaces it if that is brighter: a shadow on a clipped wall need not show.
    """
    seen = response.invert(photo)
    light = np.where(photo >= SATURATED, np.maximum(seen, changed.without * exposure), seen)
    after = change_light(light, changed, exposure)
    display = np.clip(photo + (response.apply(after) - response.apply(light)), 0.0, 1.0)
    return display, after / exposure, light / exposure


def change_light(
    light: NDArray[np.floating], changed: Differential, exposure: NDArray[np.floating] | float
) -> NDArray[np.float64]:
    """(H, W, 3) the light P of a photo with the change in it, both as radiance times ``exposure``.

    With the render O of the room alone, the render W with the edit, and the coverage A of inserted objects, a pixel
    that shows none of them becomes, with the denoised change D = W − O,

        P (1 + D / O)   where light is lost,        P + D   where it is gained,

    so that a shadow multiplies, which keeps the texture of the photo, and a reflection or a bounce adds. A pixel that
    shows an inserted object becomes W + (1 − A) (P − O): the render, blended at the edges of the object.
    """
    without = changed.without * exposure
    gained = np.maximum(changed.change, 0.0) * exposure
    lost = np.clip(-changed.change * exposure, 0.0, without)
    beside = light * (1.0 - np.divide(lost, without, out=np.zeros_like(lost), where=without > 0)) + gained
    covered = changed.covered[..., None]
    shown = np.maximum(changed.with_edit * exposure + (1 - covered) * (light - without), 0.0)
    return np.where(covered > 0, shown, beside)


def write_layers(path: Path, photo: ChangedPhoto, space: ColorSpace | None) -> None:
    """Write a photo with an edit in it and what it is made of as one EXR, a layer each, for compositing.

    ``plate · (1 − object.A) + catcher + object`` is its radiance. The catcher is light that the objects take (negative)
    or add beside them, the object is premultiplied.

    Args:
        space: to convert to; None for Rec.709.

    Raises:
        IrisError: the file cannot be written.
    """
    alpha = photo.covered[..., None]
    layers = {
        "": photo.radiance,
        "plate": photo.plate,
        "catcher": (1 - alpha) * (photo.radiance - photo.plate),
        "object": alpha * photo.radiance,
    }
    write_exr_planes(path, layer_channels(layers, {"object": photo.covered}, space), space)


def coverage(scene: bpy.types.Scene, room: Iterable[bpy.types.Object]) -> NDArray[np.float32]:
    """(H, W) share of each pixel that objects other than ``room`` cover; ``room`` may occlude them."""
    held_out = {thing: thing.is_holdout for thing in room}
    transparent = scene.render.film_transparent
    try:
        scene.render.film_transparent = True
        for thing in held_out:
            thing.is_holdout = True
        set_cycles(scene, RenderSettings(samples=COVERAGE_SAMPLES, max_bounces=0, denoise=False))
        return render_coverage(scene)
    finally:
        scene.render.film_transparent = transparent
        for thing, before in held_out.items():
            thing.is_holdout = before


def _local_mean(values: NDArray[np.floating]) -> NDArray[np.float64]:
    """(H, W, C) mean over the square of 2 · NOISE_RADIUS + 1 pixels around each pixel, cropped at the border."""
    for axis in (0, 1):
        n = values.shape[axis]
        total = np.concatenate([np.zeros_like(values.take([0], axis)), np.cumsum(values, axis)], axis)
        low, high = np.maximum(np.arange(n) - NOISE_RADIUS, 0), np.minimum(np.arange(n) + NOISE_RADIUS + 1, n)
        count = np.expand_dims(high - low, tuple(a for a in range(values.ndim) if a != axis))
        values = (total.take(high, axis) - total.take(low, axis)) / count
    return values
