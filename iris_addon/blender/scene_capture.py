"""A Blender scene written as a capture that the solver reads: mesh objects as the room, cameras with a photo as views.

::

    capture/transforms.json   nerfstudio's format: pinholes, poses in metres
    capture/mesh.obj          the triangles, one material per object and slot
    capture/photos/           the photos, as links where the file system can
    scene_map.json            which faces came from which object

What comes back is put onto the same objects by the face runs of scene_map.json.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..atomic_files import atomic_write
from ..capture.types import Camera, Mesh
from ..errors import BadInput, IrisError
from ..json_files import json_object, numbers, read_json, write_json
from ..own_folders import require_own_folder
from .camera import read_camera
from .capture_in import photo_of
from .onto_objects import ORIGINAL_MESH, FaceRun, triangles_of
from .scene_in import SceneMesh, read_scene_mesh
from .version import compositor_tree

PHOTO_SUFFIXES = (".png", ".jpg", ".jpeg", ".exr")
ASPECT_PIXELS = 1.0
"""By how many pixels the frame of the scene, scaled to a photo's width, may miss its height."""


def write_scene_capture(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph, folder: Path) -> list[str]:
    """Write the capture of ``scene`` into ``folder`` and return warnings.

    Raises:
        BadInput: no mesh, no camera with a photo, a photo of another shape than the frame, a file that is missing, or
            ``folder/capture`` is a link.
        IrisError: the folder cannot be written.
    """
    scale = float(scene.unit_settings.scale_length)
    room = read_scene_mesh(depsgraph)
    views = [_view(scene, camera, scale) for camera in _photo_cameras(scene)]
    if not views:
        raise BadInput(
            "no camera of this scene has a photo",
            "give each camera its photo as a background image (Camera > Background)",
        )
    runs = [_scaled(run, scale) for run in room.runs]
    try:
        target = folder / "capture"
        require_own_folder(target)
        target.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(target / "photos", ignore_errors=True)
        (target / "photos").mkdir()
        frames, cameras = [], {}
        for number, view in enumerate(views):
            stem = f"{number:04d}_{bpy.path.clean_name(view[0])}"  # two names may be the same once they are cleaned
            frames.append(_frame(target / "photos" / stem, *view))
            cameras[stem] = view[0]
        atomic_write(target / "mesh.obj", lambda path: _write_obj(path, room, scale))
        write_json(folder / "scene_map.json", {"runs": [_run_json(run) for run in runs], "cameras": cameras})
        write_json(target / "transforms.json", {"mesh": "mesh.obj", "frames": frames})
    except OSError as error:
        raise IrisError(
            f"cannot be written ({error.strerror})", "free some disk space, or choose another folder", folder
        ) from error
    return _warnings(scene)


def read_face_runs(folder: Path) -> list[FaceRun]:
    """The face runs that :func:`write_scene_capture` wrote; raises BadInput."""
    path = folder / "scene_map.json"
    listed = read_json(path).get("runs")
    if not isinstance(listed, list):
        raise BadInput("lists no objects", "check this scene again", path)
    runs = []
    for row in listed:
        row = json_object(row, "runs", path)
        try:
            matrix = numbers(row["to_capture"], (4, 4), "to_capture", path)
            runs.append(FaceRun(str(row["object"]), int(row["start"]), int(row["stop"]), bool(row["instance"]), matrix))
        except (KeyError, TypeError, ValueError) as error:
            raise BadInput(f"is damaged ({error!r})", "check this scene again", path) from error
    return runs


def read_view_cameras(folder: Path) -> dict[str, str]:
    """The camera object behind each view that :func:`write_scene_capture` wrote; raises BadInput."""
    path = folder / "scene_map.json"
    listed = json_object(read_json(path).get("cameras"), "cameras", path)
    return {str(view): str(name) for view, name in listed.items()}


def whole_object(room: bpy.types.Object | None) -> list[FaceRun]:
    """The face run of an imported capture, whose mesh is one object in the capture's own space; raises BadInput."""
    if room is None or room.type != "MESH":
        raise BadInput("the mesh of the capture is not in this scene any more", "import the capture again")
    original = room.get(ORIGINAL_MESH, room.data)
    return [FaceRun(room.name, 0, len(triangles_of(original)[0]), False, np.eye(4))]


# ---- cameras -------------------------------------------------------------------------------------------------------


def _photo_cameras(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    return [thing for thing in scene.objects if thing.type == "CAMERA" and photo_of(thing) is not None]


def _view(scene: bpy.types.Scene, thing: bpy.types.Object, scale: float) -> tuple[str, bpy.types.Image, Camera, float]:
    image = photo_of(thing)
    assert image is not None
    frame = read_camera(scene, thing)
    width, height = image.size
    if not width:
        raise BadInput(f"the photo of camera '{thing.name}' cannot be read", "find the missing file", image.filepath)
    grow = width / frame.width
    # Camera space is that of the frame; a photo of the same shape has the same field of view.
    if abs(frame.height * grow * frame.fx / frame.fy - height) > ASPECT_PIXELS:
        raise BadInput(
            f"the photo of camera '{thing.name}' is {width}x{height}, the frame of the scene "
            f"{frame.width}x{frame.height}: another shape",
            "give the scene the resolution of its photos",
        )
    c2w = frame.c2w.copy()
    c2w[:3, 3] *= scale
    down = height / frame.height
    camera = Camera(width, height, frame.fx * grow, frame.fy * down, frame.cx * grow, frame.cy * down, c2w)
    return thing.name, image, camera, float(getattr(thing.data, "iris_exposure", 0.0))


def _frame(stem: Path, name: str, image: bpy.types.Image, camera: Camera, exposure: float) -> dict[str, Any]:
    """The entry of transforms.json, with the photo brought to ``stem`` and its suffix."""
    source = Path(bpy.path.abspath(image.filepath_raw or image.filepath))
    suffix = source.suffix.lower()
    if suffix not in PHOTO_SUFFIXES:
        raise BadInput(f"the photo of camera '{name}' is no PNG, JPEG or EXR", "save it as one of them", source)
    target = stem.with_name(stem.name + suffix)
    target.unlink(missing_ok=True)  # it may be a link to the artist's own file, which must not be written to
    if image.packed_file is not None:
        target.write_bytes(image.packed_file.data)
    elif not source.is_file():
        raise BadInput(f"the photo of camera '{name}' is missing", "restore the file or choose another", source)
    else:
        _link(source, target)
    return {
        "file_path": f"photos/{target.name}",
        **{"w": camera.width, "h": camera.height, "cx": camera.cx, "cy": camera.cy},
        **{"fl_x": camera.fx, "fl_y": camera.fy},
        "transform_matrix": camera.c2w.tolist(),
        **({"exposure": exposure} if exposure > 0 else {}),
    }


def _link(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except OSError:  # another disk, or a file system without links
        shutil.copyfile(source, target)


def _warnings(scene: bpy.types.Scene) -> list[str]:
    warnings = []
    hidden = [thing.name for thing in scene.objects if thing.type == "MESH" and thing.hide_viewport > thing.hide_render]
    if hidden:
        warnings.append(f"disabled in viewports, and so left out of the room: {', '.join(hidden[:5])}")
    tree = compositor_tree(scene)
    if tree is not None and any(node.bl_idname == "CompositorNodeLensdist" for node in tree.nodes):
        warnings.append("the compositor's Lens Distortion is ignored: the photos must be undistorted")
    return warnings


# ---- files ---------------------------------------------------------------------------------------------------------


def _scaled(run: FaceRun, scale: float) -> FaceRun:
    to_capture = run.to_capture.copy()
    to_capture[:3] *= scale
    return FaceRun(run.object, run.start, run.stop, run.instance, to_capture)


def _run_json(run: FaceRun) -> dict[str, Any]:
    return {
        "object": run.object,
        "start": run.start,
        "stop": run.stop,
        "instance": run.instance,
        "to_capture": run.to_capture.tolist(),
    }


def _write_obj(path: Path, room: SceneMesh, scale: float) -> None:
    mesh: Mesh = room.mesh
    assert mesh.parts is not None
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in (mesh.vertices * scale).tolist()]
    corner = "{0}"
    if mesh.uv is not None:
        lines += [f"vt {u:.9g} {v:.9g}" for u, v in mesh.uv.reshape(-1, 2).tolist()]
        corner = "{0}/{1}"
    breaks = np.flatnonzero(np.diff(mesh.parts, prepend=-1))
    for start, stop in zip(breaks, [*breaks[1:], len(mesh.faces)], strict=True):
        lines.append(f"usemtl part{mesh.parts[start]}")
        for face, (a, b, c) in enumerate((mesh.faces[start:stop] + 1).tolist(), int(start)):
            at = 3 * face + 1
            lines.append(f"f {corner.format(a, at)} {corner.format(b, at + 1)} {corner.format(c, at + 2)}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
