"""Edits from JSON: relighting and insertion jobs, and the reference files of captures with ground truth.

A relighting job is one object; every key is optional::

    {
      "recovered": {"all": {"off": true}, "3": {"scale": 2.0, "color": [1.0, 0.8, 0.5]}},
      "lights":    [{"corners": [[x, y, z] x 4], "normal": [x, y, z], "radiance": [r, g, b]}],
      "outside":   0.5
    }

``recovered`` addresses lamps by the id in emitters.json, ``all`` first and single ids after it. ``off`` takes a lamp
out (its surface turns black), ``scale`` multiplies its radiance, ``color`` replaces its hue and keeps its luminance.
``lights`` are one-sided rectangles, ``outside`` a factor on the light from beyond the mesh.

The parts of a reference lights.json are accepted as they stand: ``new_lights`` (``original_emitters`` off, ``lights``
on) and ``one_emitter`` (``kept_faces_of_scene_ply``).

Everything here raises :class:`~iris_addon.errors.BadInput` for JSON that does not say what it should.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from .edits import ObjectFile, Quad, SceneEdit, Sphere
from .types import Result

Json = Mapping[str, Any]

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])

RELIGHT_KEYS = {"recovered", "lights", "outside"}
# Keys of the reference files that carry no instruction beyond their presence.
REFERENCE_KEYS = {"poses", "original_emitters", "kept_faces_of_scene_ply", "what", "note", "lighting"}


def new_lights_edit(result: Result, lights_json: Json) -> SceneEdit:
    """Every recovered lamp and the light from outside off, lamp surfaces black, the listed quads on.

    Args:
        lights_json: a reference lights.json or its ``new_lights`` part.
    """
    part = _object(lights_json.get("new_lights", lights_json), "new_lights")
    dark = _only_faces(result, np.empty(0, np.int64))
    return SceneEdit(dark.face_emission, dark.black_faces, _quads(part.get("lights"), "lights"), outside_scale=0.0)


def one_emitter_edit(result: Result, lights_json: Json) -> SceneEdit:
    """The listed faces keep their recovered radiance; every other lamp is off and black, and the light from outside is
    off.

    Args:
        lights_json: a reference lights.json or its ``one_emitter`` part.
    """
    part = _object(lights_json.get("one_emitter", lights_json), "one_emitter")
    faces = _array(part.get("kept_faces_of_scene_ply"), (None,), "kept_faces_of_scene_ply").astype(np.int64)
    if faces.size and not (faces.min() >= 0 and faces.max() < len(result.mesh.faces)):
        raise BadInput(
            f"'kept_faces_of_scene_ply' names faces beyond the {len(result.mesh.faces)} of the mesh",
            "use the file that belongs to this capture",
        )
    return _only_faces(result, faces)


def relight_edit(result: Result, spec: Json) -> SceneEdit:
    """The edit of a relighting job (see the module's docstring), or of one part of a reference lights.json."""
    spec = _object(spec, "the relighting job")
    parts = [key for key in ("new_lights", "one_emitter") if key in spec]
    if len(parts) > 1:
        raise BadInput("has both 'new_lights' and 'one_emitter'", "give one of the two parts alone")
    if parts == ["new_lights"] or "original_emitters" in spec:
        return new_lights_edit(result, spec)
    if parts == ["one_emitter"] or "kept_faces_of_scene_ply" in spec:
        return one_emitter_edit(result, spec)
    _known_keys(spec, RELIGHT_KEYS | REFERENCE_KEYS, "the relighting job")

    emission, off = _recovered(result, _object(spec.get("recovered", {}), "recovered"))
    outside = _number(spec.get("outside", 1.0), "outside")
    return SceneEdit(emission, off, _quads(spec.get("lights", []), "lights"), outside_scale=outside)


def insertion_edits(result: Result, objects_json: Json, folder: Path | None = None) -> list[tuple[int, SceneEdit]]:
    """(view index, edit) for each view of an insertion job or a reference objects.json.

    An object is a ball ``{"shape": "sphere", "center", "radius", "base_color", "roughness", "metallic", "specular"}``
    or a file ``{"file", "location", "scale", "rotation"}`` (rotation in degrees, +Z up, scale one number or three).
    Without ``views`` the job's ``objects`` go into the one edit of view 0.

    Args:
        folder: what relative ``file`` paths are relative to.
    """
    objects_json = _object(objects_json, "the insertion job")
    views = objects_json.get("views", [{"view": 0, "objects": objects_json.get("objects", [])}])
    edits = []
    for number, view in enumerate(_list(views, "views")):
        view = _object(view, f"views[{number}]")
        index = view.get("view")
        if not isinstance(index, int) or index < 0:
            raise BadInput(f"'views[{number}].view' is {index!r}", "give the index of the view, counted from 0")
        spheres, files = [], []
        for k, thing in enumerate(_list(view.get("objects", []), f"views[{number}].objects")):
            where = f"views[{number}].objects[{k}]"
            thing = _object(thing, where)
            if "file" in thing:
                files.append(_object_file(thing, where, folder))
            else:
                spheres.append(_sphere(thing, where))
        edits.append((index, SceneEdit(spheres=tuple(spheres), objects=tuple(files))))
    return edits


def _only_faces(result: Result, faces: NDArray[np.int64]) -> SceneEdit:
    recovered = result.face_emission()
    emission = np.zeros_like(recovered)
    emission[faces] = recovered[faces]
    black = (recovered.max(axis=1) > 0) & (emission.max(axis=1) == 0)
    return SceneEdit(emission, black, outside_scale=0.0)


def _recovered(result: Result, changes: Json) -> tuple[NDArray[np.float64] | None, NDArray[np.bool_] | None]:
    """Radiance per face after the changes and which faces turn black, or None twice if there are no changes."""
    ids = {str(emitter.id) for emitter in result.emitters}
    unknown = [key for key in changes if key != "all" and key not in ids]
    if unknown:
        known = ", ".join(sorted(ids, key=int)) or "none"
        raise BadInput(f"'recovered' names lamp {unknown[0]!r}", f"lamps of this result: {known}; or 'all'")
    if not changes:
        return None, None
    emission = result.face_emission()
    off = np.zeros(len(emission), bool)
    for emitter in result.emitters:
        radiance = np.array(emitter.radiance, float)
        for key in ("all", str(emitter.id)):
            if key in changes:
                radiance = _changed(radiance, _object(changes[key], f"recovered.{key}"), f"recovered.{key}")
        emission[emitter.faces] = radiance
        off[emitter.faces] = radiance.max() <= 0
    return emission, off


def _changed(radiance: NDArray[np.float64], change: Json, where: str) -> NDArray[np.float64]:
    _known_keys(change, {"off", "scale", "color"}, where)
    if "color" in change:
        color = _array(change["color"], (3,), f"{where}.color")
        if color.min() < 0 or color.max() <= 0:
            raise BadInput(f"'{where}.color' is {color.tolist()}", "give three numbers from 0 up, not all 0")
        radiance = color * (radiance @ LUMINANCE) / (color @ LUMINANCE)
    off = change.get("off", False)
    if not isinstance(off, bool):
        raise BadInput(f"'{where}.off' is {off!r}", "give true or false")
    return radiance * (0.0 if off else _number(change.get("scale", 1.0), f"{where}.scale"))


def _quads(lights: Any, where: str) -> tuple[Quad, ...]:
    quads = []
    for k, light in enumerate(_list(lights, where)):
        light = _object(light, f"{where}[{k}]")
        radiance = _array(light.get("radiance"), (3,), f"{where}[{k}].radiance")
        normal = _array(light.get("normal"), (3,), f"{where}[{k}].normal")
        if radiance.min() < 0 or not normal.any():
            raise BadInput(f"'{where}[{k}]' has a negative radiance or a zero normal", "correct the light")
        corners = _array(light.get("corners"), (4, 3), f"{where}[{k}].corners")
        quads.append(Quad(corners, normal / np.linalg.norm(normal), radiance))
    return tuple(quads)


def _sphere(thing: Json, where: str) -> Sphere:
    if thing.get("shape", "sphere") != "sphere":
        raise BadInput(f"'{where}.shape' is {thing['shape']!r}", "use a sphere, or 'file' for any other object")
    return Sphere(
        _array(thing.get("center"), (3,), f"{where}.center"),
        _number(thing.get("radius"), f"{where}.radius", above_zero=True),
        _array(thing.get("base_color", [0.8, 0.8, 0.8]), (3,), f"{where}.base_color"),
        _number(thing.get("roughness", 0.5), f"{where}.roughness"),
        _number(thing.get("metallic", 0.0), f"{where}.metallic"),
        _number(thing.get("specular", 0.5), f"{where}.specular"),
    )


def _object_file(thing: Json, where: str, folder: Path | None) -> ObjectFile:
    _known_keys(thing, {"file", "location", "scale", "rotation", "id"}, where)
    if not isinstance(thing["file"], str):
        raise BadInput(f"'{where}.file' is {thing['file']!r}", "give a path")
    scale = thing.get("scale", 1.0)
    scale = np.full(3, _number(scale, f"{where}.scale")) if not isinstance(scale, list) else scale
    return ObjectFile(
        (folder or Path()) / Path(thing["file"]).expanduser(),
        tuple(_array(thing.get("location"), (3,), f"{where}.location").tolist()),
        tuple(_array(scale, (3,), f"{where}.scale").tolist()),
        tuple(_array(thing.get("rotation", [0, 0, 0]), (3,), f"{where}.rotation").tolist()),
    )


def _object(value: Any, where: str) -> Json:
    if not isinstance(value, Mapping):
        raise BadInput(f"'{where}' is {type(value).__name__}", "make it a JSON object in braces")
    return value


def _list(value: Any, where: str) -> Sequence[Any]:
    if not isinstance(value, list | tuple):
        raise BadInput(f"'{where}' is {type(value).__name__}", "make it a JSON list in brackets")
    return value


def _number(value: Any, where: str, *, above_zero: bool = False) -> float:
    number = isinstance(value, int | float) and not isinstance(value, bool) and np.isfinite(value)
    if not number or value < 0 or (above_zero and value == 0):
        raise BadInput(f"'{where}' is {value!r}", f"give a number {'above 0' if above_zero else 'from 0 up'}")
    return float(value)


def _array(value: Any, shape: tuple[int | None, ...], where: str) -> NDArray[np.float64]:
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.array(np.nan)
    fits = array.ndim == len(shape) and all(want in (None, have) for want, have in zip(shape, array.shape, strict=True))
    if not fits or not np.isfinite(array).all():
        form = " x ".join("n" if side is None else str(side) for side in shape)
        raise BadInput(f"'{where}' is no list of {form} finite numbers", "correct it in the JSON file")
    return array


def _known_keys(value: Json, known: set[str], where: str) -> None:
    unknown = sorted(set(value) - known)
    if unknown:
        raise BadInput(f"'{where}' has the unknown key '{unknown[0]}'", f"known keys: {', '.join(sorted(known))}")
