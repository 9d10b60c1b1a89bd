"""Objects put into a photo by differential rendering (Debevec 1998, section 6), in the photo's own response.

Two pairs of renders, each pair with and without the edit under the same random numbers: where nothing changes both
renders of a pair are the same to the last bit, so that noise cancels and the photo stays. What the two pairs do not
agree on is noise, and the difference is shrunk by it (:func:`shrunk_difference`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import bpy
import numpy as np
from numpy.typing import NDArray

from ..capture.types import Camera
from ..response.curve import SATURATED, Response
from ..result.edits import SceneEdit
from ..result.types import Result
from .render import aim, render_coverage, render_linear, set_cycles
from .scene_out import build_scene

COVERAGE_SAMPLES = 32
NOISE_RADIUS = 3  # pixels around one over which noise is estimated

Pair = tuple[NDArray[np.floating], NDArray[np.floating]]


@dataclass(frozen=True)
class Differential:
    """How an edit changes one view.

    Attributes:
        without: (H, W, 3) linear radiance of the room as solved.
        with_edit: (H, W, 3) linear radiance with the edit.
        change: (H, W, 3) their difference, less its noise.
        covered: (H, W) share of each pixel that something inserted covers.
    """

    without: NDArray[np.floating]
    with_edit: NDArray[np.floating]
    change: NDArray[np.floating]
    covered: NDArray[np.floating]


def insert_onto_photo(
    result: Result,
    camera: Camera,
    photo: NDArray[np.floating],
    exposure: NDArray[np.floating],
    edit: SceneEdit,
    *,
    samples: int = 128,
    seed: int = 0,
    max_bounces: int = 24,
    gpu: bool = False,
) -> NDArray[np.float64]:
    """(H, W, 3) display values of the photo as it would have been with ``edit`` in the room.

    Args:
        photo: (H, W, 3) display values in [0, 1] of the undistorted photo.
        exposure: factor from radiance to the argument of the response, to be broadcast with the photo.
    """
    if edit.changes_nothing:
        return np.array(photo, dtype=np.float64)
    without = render_pair(result, camera, None, samples=samples, seed=seed, max_bounces=max_bounces, gpu=gpu)
    changed = render_change(result, camera, edit, without, samples=samples, seed=seed, max_bounces=max_bounces, gpu=gpu)
    return change_photo(photo, changed, result.response, exposure)[0]


def render_pair(
    result: Result,
    camera: Camera,
    edit: SceneEdit | None,
    *,
    samples: int,
    seed: int,
    max_bounces: int = 24,
    gpu: bool = False,
) -> Pair:
    """The view twice, (H, W, 3) linear radiance each, with half of ``samples`` and random numbers of its own each."""
    built = build_scene(result, edit)
    try:
        aim(built, camera)
        return render_halves(built.scene, samples=samples, seed=seed, max_bounces=max_bounces, gpu=gpu)
    finally:
        built.free()


def render_change(
    result: Result,
    camera: Camera,
    edit: SceneEdit,
    without: Pair,
    *,
    samples: int,
    seed: int,
    max_bounces: int = 24,
    gpu: bool = False,
) -> Differential:
    """How ``edit`` changes the view that ``without`` (:func:`render_pair` of the room alone, same settings) shows."""
    built = build_scene(result, edit)
    try:
        aim(built, camera)
        halves = render_halves(built.scene, samples=samples, seed=seed, max_bounces=max_bounces, gpu=gpu)
        backdrop = () if built.backdrop is None else (built.backdrop,)
        covered = coverage(built.scene, (built.room, *built.lamps, *built.lights, *backdrop))
    finally:
        built.free()
    return differential(without, halves, covered)


def render_halves(scene: bpy.types.Scene, *, samples: int, seed: int, max_bounces: int = 24, gpu: bool = False) -> Pair:
    """As :func:`render_pair`, of a scene as it stands from its active camera; changes how ``scene`` renders."""
    images = []
    for half in (0, 1):
        count = max(samples // 2, 1)
        set_cycles(scene, samples=count, denoise=True, seed=2 * seed + half, max_bounces=max_bounces, gpu=gpu)
        images.append(render_linear(scene))
    return images[0], images[1]


def differential(without: Pair, with_edit: Pair, covered: NDArray[np.floating]) -> Differential:
    """What two pairs of renders under the same random numbers say of the edit; ``covered`` is its :func:`coverage`."""
    change = shrunk_difference((with_edit[0] - without[0], with_edit[1] - without[1]))
    return Differential(np.mean(without, axis=0), np.mean(with_edit, axis=0), change, covered)


def shrunk_difference(differences: Pair) -> NDArray[np.float64]:
    """(H, W, 3) mean of two estimates of one difference, shrunk towards 0 where they do not agree.

    A Wiener filter with the empirical signal: each value is multiplied by 1 − σ²/d², where d² is the mean square of
    the difference around it and σ² the part of that which the two estimates say is noise.
    """
    first, second = (np.asarray(d, np.float64) for d in differences)
    mean = (first + second) / 2
    noise = _local_mean((first - second) ** 2 / 4)
    signal = _local_mean(mean**2)
    share = 1.0 - np.divide(noise, signal, out=np.ones_like(noise), where=signal > 0)
    return mean * np.clip(share, 0.0, 1.0)


def change_photo(
    photo: NDArray[np.floating], changed: Differential, response: Response, exposure: NDArray[np.floating]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The photo with the change in it: display values and linear radiance, (H, W, 3) each.

    The difference goes back through the response, so that a pixel whose light does not change keeps its value exactly.
    Where the photo is saturated, the render stands in for it if that is brighter: a shadow over a blown-out wall need
    not show.
    """
    seen = response.invert(photo)
    light = np.where(photo >= SATURATED, np.maximum(seen, changed.without * exposure), seen)
    after = change_light(light, changed, exposure)
    display = np.clip(photo + (response.apply(after) - response.apply(light)), 0.0, 1.0)
    return display, after / exposure


def change_light(
    light: NDArray[np.floating], changed: Differential, exposure: NDArray[np.floating] | float
) -> NDArray[np.float64]:
    """(H, W, 3) the light P of a photo with the change in it, both as radiance times ``exposure``.

    With the render O of the room alone, the render W with the edit, and the coverage A of what was put in, a pixel that
    shows nothing of it becomes, with the change D = W − O less its noise,

        P (1 + D / O)   where light is lost,        P + D   where it is gained,

    so that a shadow darkens by a factor, which the texture of the photo keeps, and a reflection or a bounce adds what
    it adds. A pixel that shows it becomes W + (1 − A) (P − O): the render, and the right blend on its rim.
    """
    without = changed.without * exposure
    gained = np.maximum(changed.change, 0.0) * exposure
    lost = np.clip(-changed.change * exposure, 0.0, without)
    beside = light * (1.0 - np.divide(lost, without, out=np.zeros_like(lost), where=without > 0)) + gained
    covered = changed.covered[..., None]
    shown = np.maximum(changed.with_edit * exposure + (1 - covered) * (light - without), 0.0)
    return np.where(covered > 0, shown, beside)


def coverage(scene: bpy.types.Scene, room: Iterable[bpy.types.Object]) -> NDArray[np.float32]:
    """(H, W) share of each pixel in which something else than ``room`` is seen, which may stand in front of it.

    Makes the room a holdout for good: render what it looks like before.
    """
    scene.render.film_transparent = True
    for thing in room:
        thing.is_holdout = True
    set_cycles(scene, samples=COVERAGE_SAMPLES, denoise=False, seed=0, max_bounces=0)
    return render_coverage(scene)


def _local_mean(values: NDArray[np.floating]) -> NDArray[np.float64]:
    """(H, W, C) mean over a square of 2 · NOISE_RADIUS + 1 pixels around each, cut off at the border."""
    for axis in (0, 1):
        n = values.shape[axis]
        total = np.concatenate([np.zeros_like(values.take([0], axis)), np.cumsum(values, axis)], axis)
        low, high = np.maximum(np.arange(n) - NOISE_RADIUS, 0), np.minimum(np.arange(n) + NOISE_RADIUS + 1, n)
        count = np.expand_dims(high - low, tuple(a for a in range(values.ndim) if a != axis))
        values = (total.take(high, axis) - total.take(low, axis)) / count
    return values
