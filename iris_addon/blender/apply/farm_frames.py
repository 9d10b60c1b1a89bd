"""The animation of a scene with an applied result, as files of the command line: the cameras of its frames, and a
relighting job with its lamps, its sun and its light from outside.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import bpy
import numpy as np

from ...base.errors import BadInput
from ...model.response import LUMINANCE
from ..camera import read_camera
from ..scene_out import lights
from ..scene_out.materials import LAMP_ID, RECOVERED
from ..scene_out.world import is_gray, sky_strength


def relit_frames(scene: bpy.types.Scene, to_capture: np.ndarray) -> tuple[dict[str, Any], dict[str, Any], int]:
    """Views and relighting job of the frames of ``scene`` as its camera and its lamps are animated.

    Lamps that the artist has rebuilt with other nodes shine as they were recovered; other objects are not in it.

    Args:
        to_capture: (4, 4) from the world of the scene to that of the capture.

    Returns:
        The content of a transforms.json, that of a lights.json, and the number of frames.

    Raises:
        BadInput: there is no camera, or none with a perspective.
    """
    if scene.camera is None:
        raise BadInput("this scene has no camera", "add the camera of the animation")
    numbers = range(scene.frame_start, scene.frame_end + 1, scene.frame_step)
    # A time of 1 is that of the frame after the last.
    views, states = [], []
    with _frame_kept(scene):
        for number in [*numbers, numbers[-1] + scene.frame_step]:
            scene.frame_set(number)
            views.append(_view(scene, number, to_capture))
            states.append(_lights(scene, to_capture))
    times = [k / len(numbers) for k in range(len(states))]
    still = all(view["transform_matrix"] == views[0]["transform_matrix"] for view in views[1:])
    still = still and all(view["fl_x"] == views[0]["fl_x"] for view in views[1:])
    job = _over_time(states, times)
    job["camera"] = {"view": 0} if still else {"path": "all"}
    return {"camera_model": "OPENCV", "frames": views[:1] if still else views}, job, len(numbers)


@contextmanager
def _frame_kept(scene: bpy.types.Scene) -> Iterator[None]:
    before = scene.frame_current, scene.frame_subframe
    try:
        yield
    finally:
        scene.frame_set(before[0], subframe=before[1])


def _view(scene: bpy.types.Scene, number: int, to_capture: np.ndarray) -> dict[str, Any]:
    camera = read_camera(scene, scene.camera)
    pose = to_capture @ camera.c2w
    pose[:3, :3] /= np.linalg.norm(pose[:3, :3], axis=0)
    return {
        "file_path": f"frame_{number:04d}.png",
        "transform_matrix": pose.tolist(),
        **{"w": camera.width, "h": camera.height, "fl_x": camera.fx, "fl_y": camera.fy},
        **{"cx": camera.cx, "cy": camera.cy},
    }


def _lights(scene: bpy.types.Scene, to_capture: np.ndarray) -> dict[str, Any]:
    """The relighting job of the present frame."""
    job: dict[str, Any] = {"recovered": {}}
    for material in lights.lamp_materials(scene.objects):
        if lights.is_plain(material) and RECOVERED in material:
            now = lights.strength(material) * np.array(lights.color(material), float) * lights.is_on(material)
            recovered = np.array(material[RECOVERED], float)
            if recovered.max() > 0:
                job["recovered"][str(material[LAMP_ID])] = _change(now, recovered)
            elif now.max() > 0:
                raise BadInput(
                    f"{material.name} shines, but is off in the light state whose lamps the farm scales",
                    "export the frames of its light state as a job of `relight --light-state`, or turn the lamp off",
                )
    outside = sky_strength(scene.world)
    if outside is not None:
        if is_gray(scene.world):
            raise BadInput(
                "the light from outside is gray, which the farm's jobs cannot say", "choose another look than Overcast"
            )
        job["outside"] = float(outside.default_value)
    sun = next((thing for thing in scene.objects if lights.is_recovered_sun(thing)), None)
    if sun is not None:
        now = sun.data.energy * np.array(sun.data.color, float) * (not sun.hide_render)
        shines = to_capture[:3, :3] @ -np.array(sun.matrix_world, float)[:3, 2]
        job["sun"] = {**_change(now, np.array(sun[RECOVERED], float)), "direction": shines.tolist()}
    return job


def _change(now: np.ndarray, recovered: np.ndarray) -> dict[str, Any]:
    """What makes light of the radiance ``recovered`` one of ``now``."""
    if now.max() <= 0:
        return {"scale": 0.0, "color": recovered.tolist()}
    return {"scale": float(now @ LUMINANCE / (recovered @ LUMINANCE)), "color": (now / now.max()).tolist()}


def _over_time(states: Sequence[Any], times: Sequence[float]) -> Any:
    """One value like those of ``states``, with keys at ``times`` in the places where they differ."""
    first = states[0]
    if isinstance(first, dict):
        return {key: _over_time([state[key] for state in states], times) for key in first}
    if all(state == first for state in states[1:]):
        return first
    return {"keys": [[time, state] for time, state in zip(times, states, strict=True)]}
