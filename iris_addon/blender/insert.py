"""Objects put into a photo by differential rendering (Debevec 1998, section 6), in the photo's own response."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..capture.types import Camera
from ..result.edits import SceneEdit
from ..result.types import Result
from .render import render_camera, render_coverage, render_views, set_cycles
from .scene_out import BuiltScene, build_scene

COVERAGE_SAMPLES = 32


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
    """The photo as it would have been with ``edit`` in the room.

    With the linearised photo P, the renders W with and O without the edit (same random numbers, so that noise cancels
    where nothing changes), and the coverage A of what was put in,

        linear = W + (1 - A) (P - O)

    which is the render on the object, P + (W - O) beside it, and the right blend on its rim. Back through the response
    as a difference, so that a pixel whose light does not change keeps its value exactly. Where the photo is saturated,
    O stands in for P if it is brighter, so that a shadow over a blown-out wall need not show.

    Args:
        photo: (H, W, 3) display values in [0, 1] of the undistorted photo.
        exposure: (3,) factor from radiance to the argument of the response.

    Returns:
        (H, W, 3) display values in [0, 1].
    """
    if edit.changes_nothing:
        return np.array(photo, dtype=np.float64)
    settings = {"samples": samples, "seed": seed, "max_bounces": max_bounces, "gpu": gpu, "denoise": True}
    (without,) = render_views(result, [camera], **settings)
    built = build_scene(result, edit)
    try:
        set_cycles(built.scene, **settings)
        with_edit = render_camera(built, camera)
        covered = _coverage(built)[..., None]
    finally:
        built.free()

    response = result.response
    seen = response.invert(photo)
    light = np.where(seen >= 1.0, np.maximum(seen, without * exposure), seen)
    changed = with_edit * exposure + (1 - covered) * (light - without * exposure)
    return np.clip(photo + response.apply(np.maximum(changed, 0.0)) - response.apply(light), 0.0, 1.0)


def _coverage(built: BuiltScene) -> NDArray[np.float32]:
    """(H, W) share of each pixel in which something inserted is seen, the room in front of it taken into account."""
    scene = built.scene
    scene.render.film_transparent = True
    for hidden in (built.room, *built.lights):
        hidden.is_holdout = True
    set_cycles(scene, samples=COVERAGE_SAMPLES, denoise=False, seed=0, max_bounces=0)
    return render_coverage(scene)
