"""Moving lights, objects and cameras: a job, and a camera, at a moment of an animation.

Time runs from 0 at the first frame to 1 one frame after the last, so that a full turn closes without a double frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..base.errors import BadInput
from ..model.capture import Camera
from ..model.corrections import rotation, rotation_vector
from .parsing import Json, array, json_list, json_map, known_keys, whole

CAMERA_KEYS = {"view", "path", "orbit"}


def at_time(value: Any, time: float) -> Any:
    """``value`` (anything JSON) at ``time``: every ``{"keys": [[t, v], ...]}`` in it becomes v at that time.

    Numbers and lists of numbers change linearly between their keys and stay before the first and after the last one;
    anything else keeps the value of the last key passed.

    Raises:
        BadInput: keys are no list of pairs in rising order of time.
    """
    if isinstance(value, Mapping):
        if set(value) == {"keys"}:
            return _interpolated(value["keys"], time)
        return {key: at_time(item, time) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [at_time(item, time) for item in value]
    return value


def _interpolated(keys: Any, time: float) -> Any:
    pairs = json_list(keys, "keys")
    if not pairs or any(not isinstance(pair, list | tuple) or len(pair) != 2 for pair in pairs):
        raise BadInput(f"'keys' is {keys!r}", "give a list of [time, value]")
    times = array([pair[0] for pair in pairs], (None,), "keys")
    if (np.diff(times) <= 0).any():
        raise BadInput("the times of 'keys' do not rise", "put them in order, from 0 to 1")
    last = max(int(np.searchsorted(times, time, "right")) - 1, 0)
    before, after = pairs[last][1], pairs[min(last + 1, len(pairs) - 1)][1]
    if time <= times[last] or last + 1 == len(pairs) or not _numeric(before) or not _numeric(after):
        return before
    share = (time - times[last]) / (times[last + 1] - times[last])
    first, second = np.asarray(before, float), np.asarray(after, float)
    if first.shape != second.shape:
        raise BadInput(f"'keys' go from {before!r} to {after!r}", "give values of one length")
    return ((1 - share) * first + share * second).tolist()


def _numeric(value: Any) -> bool:
    items = value if isinstance(value, list | tuple) else [value]
    return all(isinstance(item, int | float) and not isinstance(item, bool) for item in items)


def camera_at(move: Json, cameras: Sequence[Camera], up: Sequence[float], time: float) -> Camera:
    """The camera at ``time`` of a move.

    Args:
        move: ``{"view": k}`` holds view k; ``{"path": [k, l, ...]}`` goes through those views, ``{"path": "all"}``
            through every one; ``{"view": k, "orbit": {"center": [x, y, z], "turns": 1}}`` carries view k around.
        cameras: of the views.
        up: unit up vector of the capture.

    Raises:
        BadInput: the move names a view that is not there, or is none of the above.
    """
    known_keys(move, CAMERA_KEYS, "camera")
    if "path" in move:
        stops = range(len(cameras)) if move["path"] == "all" else json_list(move["path"], "camera.path")
        return _along([_pick(cameras, stop, "camera.path") for stop in stops], time)
    camera = _pick(cameras, move.get("view", 0), "camera.view")
    if "orbit" not in move:
        return camera
    orbit = json_map(move["orbit"], "camera.orbit")
    known_keys(orbit, {"center", "turns"}, "camera.orbit")
    center = array(orbit.get("center"), (3,), "camera.orbit.center")
    turns = float(array(orbit.get("turns", 1.0), (), "camera.orbit.turns"))
    turn = rotation(np.asarray(up, float) * 2 * np.pi * turns * time)
    c2w = np.array(camera.c2w, float)
    c2w[:3, :3] = turn @ c2w[:3, :3]
    c2w[:3, 3] = turn @ (c2w[:3, 3] - center) + center
    return replace(camera, c2w=c2w)


def _pick(cameras: Sequence[Camera], index: Any, where: str) -> Camera:
    if whole(index, where) >= len(cameras):
        raise BadInput(f"'{where}' names view {index}, there are {len(cameras)}", "count the views from 0")
    return cameras[index]


def _along(stops: Sequence[Camera], time: float) -> Camera:
    """Through ``stops`` at even times: a Catmull-Rom curve for the position, the shortest turn between orientations."""
    if not stops:
        raise BadInput("'camera.path' is empty", "name the views it goes through")
    if len(stops) == 1:
        return stops[0]
    at = min(max(time, 0.0), 1.0) * (len(stops) - 1)
    k = min(int(at), len(stops) - 2)
    s = at - k
    p0, p1, p2, p3 = (stops[min(max(i, 0), len(stops) - 1)].position for i in (k - 1, k, k + 1, k + 2))
    position = 0.5 * (
        2 * p1 + (p2 - p0) * s + (2 * p0 - 5 * p1 + 4 * p2 - p3) * s**2 + (3 * p1 - p0 - 3 * p2 + p3) * s**3
    )
    c2w = np.eye(4)
    first, second = stops[k].c2w[:3, :3], stops[k + 1].c2w[:3, :3]
    c2w[:3, :3], c2w[:3, 3] = rotation(s * rotation_vector(second @ first.T)) @ first, position
    lens = {
        name: (1 - s) * getattr(stops[k], name) + s * getattr(stops[k + 1], name) for name in ("fx", "fy", "cx", "cy")
    }
    # The size of the pictures must not change on the way.
    scale_x, scale_y = stops[0].width / stops[k].width, stops[0].height / stops[k].height
    return Camera(
        width=stops[0].width,
        height=stops[0].height,
        fx=lens["fx"] * scale_x,
        fy=lens["fy"] * scale_y,
        cx=lens["cx"] * scale_x,
        cy=lens["cy"] * scale_y,
        c2w=c2w,
    )
