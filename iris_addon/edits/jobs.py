"""Edits from JSON: relighting and insertion jobs, and the reference files of captures with ground truth.

A relighting job is one object; every key is optional::

    {
      "recovered": {"all": {"off": true}, "3": {"scale": 2.0, "color": [1.0, 0.8, 0.5]}},
      "lights":    [{"type": "spot", "position": [x, y, z], "target": [x, y, z], "intensity": [r, g, b], "angle": 40}],
      "outside":   0.5,
      "sun":       {"scale": 0.8, "direction": [x, y, z]}
    }

``recovered`` addresses lamps by the id in emitters.json. For each of ``off``, ``scale`` and ``color`` the lamp's own
entry wins over that of ``all``, and a lamp that has an entry is on unless that says ``off``. ``off`` takes a lamp out
(its surface turns black), ``scale`` multiplies its radiance, ``color`` replaces its hue and keeps its luminance.
``outside`` is a factor on the light from outside the mesh, ``sun`` one on the recovered sun or an object with ``off``,
``scale``, ``color`` and the ``direction`` in which it shines. docs/relighting.md lists the kinds of lights and objects.

Any value may be animated: ``{"keys": [[0, a], [1, b]]}`` stands for a value that goes from a to b
(:mod:`iris_addon.edits.motion`).

The parts of a reference lights.json are accepted as they stand: ``new_lights`` (``original_emitters`` off, ``lights``
on) and ``one_emitter`` (``kept_faces_of_scene_ply``).

Every function raises :class:`~iris_addon.base.errors.BadInput` for JSON that is not such a job.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput
from ..model.capture import Camera
from ..model.response import LUMINANCE
from ..results.result import Result
from .motion import at_time
from .parsing import (
    Json,
    array,
    color,
    direction,
    flag,
    json_list,
    json_map,
    known_keys,
    number,
    read_lights,
    read_object,
    whole,
)
from .scene_edit import SceneEdit, Sphere, SunLight

RELIGHT_KEYS = {"recovered", "lights", "outside", "sun", "camera", "length"}
REFERENCE_KEYS = {"poses", "original_emitters", "kept_faces_of_scene_ply", "what", "note", "lighting"}
"""Keys of reference files that are accepted and not read."""
INSERTION_KEYS = {"objects", "lights", "views", "camera", "length", "poses", "note", "lighting"}
VIEW_KEYS = {"view", "objects", "lights", "light_state"}
"""Of a view of an insertion job; the light state of a reference is for :mod:`iris_addon.evaluate` to read."""


def new_lights_edit(result: Result, lights_json: Json) -> SceneEdit:
    """Every recovered lamp and the light from outside off, lamp surfaces black, the listed quads on.

    Args:
        lights_json: a reference lights.json or its ``new_lights`` part.
    """
    part = json_map(lights_json.get("new_lights", lights_json), "new_lights")
    dark = _only_faces(result, np.empty(0, np.int64))
    return replace(dark, lights=read_lights(part.get("lights"), "lights").lights)


def one_emitter_edit(result: Result, lights_json: Json) -> SceneEdit:
    """The listed faces keep their recovered radiance; every other lamp is off and black, and the light from outside is
    off.

    Args:
        lights_json: a reference lights.json or its ``one_emitter`` part.
    """
    part = json_map(lights_json.get("one_emitter", lights_json), "one_emitter")
    faces = array(part.get("kept_faces_of_scene_ply"), (None,), "kept_faces_of_scene_ply").astype(np.int64)
    if faces.size and not (faces.min() >= 0 and faces.max() < len(result.mesh.faces)):
        raise BadInput(
            f"'kept_faces_of_scene_ply' names faces beyond the {len(result.mesh.faces)} of the mesh",
            "use the file that belongs to this capture",
        )
    return _only_faces(result, faces)


def relight_edit(result: Result, spec: Json, folder: Path | None = None, time: float = 0.0) -> SceneEdit:
    """The edit of a relighting job (see the module's docstring), or of one part of a reference lights.json.

    Args:
        folder: what relative paths are relative to.
        time: of an animation, 0 ... 1.
    """
    spec = json_map(at_time(json_map(spec, "the relighting job"), time), "the relighting job")
    parts = [key for key in ("new_lights", "one_emitter") if key in spec]
    if len(parts) > 1:
        raise BadInput("has both 'new_lights' and 'one_emitter'", "give one of the two parts alone")
    if parts == ["new_lights"] or "original_emitters" in spec:
        return new_lights_edit(result, spec)
    if parts == ["one_emitter"] or "kept_faces_of_scene_ply" in spec:
        return one_emitter_edit(result, spec)
    known_keys(spec, RELIGHT_KEYS | REFERENCE_KEYS, "the relighting job")

    emission, off = _recovered(result, json_map(spec.get("recovered", {}), "recovered"))
    added = read_lights(spec.get("lights", []), "lights", folder=folder, up=result.up, time=time)
    return SceneEdit(
        emission,
        off,
        added.lights,
        objects=added.objects,
        panoramas=added.panoramas,
        outside_scale=number(spec.get("outside", 1.0), "outside"),
        sun=changed_sun(result, spec["sun"]) if "sun" in spec else None,
    )


def insertion_edits(
    result: Result,
    objects_json: Json,
    folder: Path | None = None,
    cameras: Sequence[Camera] = (),
    time: float = 0.0,
) -> list[tuple[int, SceneEdit]]:
    """(view index, edit) for each view of an insertion job or a reference objects.json.

    Objects are those of :func:`iris_addon.edits.parsing.read_object`; ``lights`` beside them are those of a
    relighting job. Without ``views`` the job's ``objects`` go into the one edit of view 0.

    Args:
        folder: what relative ``file`` paths are relative to.
        cameras: of the views, for objects placed at a pixel.
        time: of an animation, 0 ... 1.
    """
    objects_json = json_map(at_time(json_map(objects_json, "the insertion job"), time), "the insertion job")
    known_keys(objects_json, INSERTION_KEYS, "the insertion job")
    single = {"view": 0, "objects": objects_json.get("objects", []), "lights": objects_json.get("lights", [])}
    edits = []
    for k, view in enumerate(json_list(objects_json.get("views", [single]), "views")):
        view = json_map(view, f"views[{k}]")
        known_keys(view, VIEW_KEYS, f"views[{k}]")
        index = whole(view.get("view"), f"views[{k}].view")
        camera = cameras[index] if index < len(cameras) else None
        things = [
            read_object(thing, f"views[{k}].objects[{n}]", folder, camera, time)
            for n, thing in enumerate(json_list(view.get("objects", []), f"views[{k}].objects"))
        ]
        where = f"views[{k}].lights"
        added = read_lights(view.get("lights", []), where, folder=folder, up=result.up, time=time)
        balls = tuple(thing for thing in things if isinstance(thing, Sphere))
        others = tuple(thing for thing in things if not isinstance(thing, Sphere))
        edit = SceneEdit(lights=added.lights, spheres=balls, objects=others + added.objects, panoramas=added.panoramas)
        edits.append((index, edit))
    return edits


def _only_faces(result: Result, faces: NDArray[np.int64]) -> SceneEdit:
    recovered = result.face_emission()
    emission = np.zeros_like(recovered)
    emission[faces] = recovered[faces]
    lamp = np.zeros(len(emission), bool)  # also of a lamp that is off in this light state
    lamp[[face for emitter in result.emitters for face in emitter.faces]] = True
    black = lamp & (emission.max(axis=1) == 0)
    sun = None if result.sun is None else changed_sun(result, 0.0)
    return SceneEdit(emission, black, outside_scale=0.0, sun=sun)


def _recovered(result: Result, changes: Json) -> tuple[NDArray[np.float64] | None, NDArray[np.bool_] | None]:
    """Radiance per face after the changes and which faces turn black, or None twice if there are no changes."""
    if not changes:
        return None, None
    emission = result.face_emission()
    off = np.zeros(len(emission), bool)
    for emitter, radiance in zip(result.emitters, lamp_radiance(result, changes), strict=True):
        emission[emitter.faces] = radiance
        off[emitter.faces] = radiance.max() <= 0
    return emission, off


def lamp_radiance(result: Result, changes: Json) -> list[NDArray[np.float64]]:
    """(3,) radiance of each recovered lamp after the ``recovered`` part of a relighting job."""
    ids = {str(emitter.id) for emitter in result.emitters}
    unknown = [key for key in changes if key != "all" and key not in ids]
    if unknown:
        known = ", ".join(sorted(ids, key=int)) or "none"
        raise BadInput(f"'recovered' names lamp {unknown[0]!r}", f"lamps of this result: {known}; or 'all'")
    for key, change in changes.items():
        known_keys(json_map(change, f"recovered.{key}"), {"off", "scale", "color"}, f"recovered.{key}")
    changed = []
    for emitter in result.emitters:
        own = str(emitter.id)
        # The most specific entry wins, key by key; naming a lamp turns it on.
        change = {**changes.get("all", {}), **({"off": False, **changes[own]} if own in changes else {})}
        changed.append(
            _changed(np.array(emitter.radiance, float), change, f"recovered.{own if own in changes else 'all'}")
        )
    return changed


def changed_sun(result: Result, change: object) -> SunLight:
    """The sun after the ``sun`` part of a relighting job: a factor, or an object.

    Raises:
        BadInput: the result has no sun.
    """
    if result.sun is None:
        raise BadInput("'sun' is given, but no sun was found in this room", "add one to 'lights', of type sun")
    change = {"scale": change} if isinstance(change, int | float) else json_map(change, "sun")
    known_keys(change, {"off", "scale", "color", "direction"}, "sun")
    along = direction(change["direction"], "sun.direction") if "direction" in change else -result.sun.direction
    return SunLight(along, _changed(result.sun.irradiance, change, "sun"))


def _changed(radiance: NDArray[np.float64], change: Json, where: str) -> NDArray[np.float64]:
    if "color" in change:
        hue = color(change["color"], f"{where}.color")
        if hue.max() <= 0:
            raise BadInput(f"'{where}.color' is {hue.tolist()}", "give three numbers from 0 up, not all 0")
        radiance = hue * (radiance @ LUMINANCE) / (hue @ LUMINANCE)
    off = flag(change.get("off", False), f"{where}.off")
    return radiance * (0.0 if off else number(change.get("scale", 1.0), f"{where}.scale"))
