"""A Blender scene written as a capture: mesh objects are the room, cameras with a photo are the views.

::

    capture/transforms.json   nerfstudio's format: pinholes, poses in metres
    capture/mesh.ply          the triangles, one material index per object and slot
    capture/photos/           the photos, as links where the file system can
    scene_map.json            which faces came from which object

The face runs of scene_map.json assign the result to the same objects.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...base.errors import BadInput, IrisError
from ...base.files import require_own_folder, write_json
from ...base.untrusted import decoding, json_object, numbers, read_json
from ...model.capture import Camera, Mesh
from ..apply.on_objects import ORIGINAL_MESH, FaceRun, triangles_of
from ..camera import read_camera
from ..ply_writer import write_ply
from ..scene_out.backdrop import is_backdrop
from ..scene_out.build import corner_vertices, material_slots, used_slots
from ..version import compositor_tree
from .capture_objects import background_of, photo_of
from .rendered import as_rendered


@dataclass(frozen=True)
class SceneMesh:
    """The geometry of a scene as one mesh.

    Attributes:
        mesh: in Blender's units and axes; ``regions`` is set.
        region_names: "object / material" per region.
        runs: the faces of each object, in order.
    """

    mesh: Mesh
    region_names: list[str]
    runs: list[FaceRun]


def read_scene_mesh(depsgraph: bpy.types.Depsgraph, objects: Iterable[bpy.types.Object] | None = None) -> SceneMesh:
    """The geometry of the scene as Cycles renders it: modifiers applied, instances made real, in world space.

    Each pair of object and material slot is a region. Faces follow the order of the depsgraph's instances; UVs are
    those of the active render layer, kept only if every object has them.

    Args:
        objects: only these and their instances; None for all that render.

    Raises:
        BadInput: there is no face.
    """
    wanted = None if objects is None else {thing.original for thing in objects}
    vertices, faces, uvs, regions, names, runs = [], [], [], [], [], []
    n_vertices = n_faces = 0
    for instance in depsgraph.object_instances:
        source = instance.parent if instance.is_instance else instance.object
        if not instance.show_self or (wanted is not None and source.original not in wanted):
            continue
        if is_backdrop(source.original):
            continue
        if instance.object.type not in {"MESH", "CURVE", "SURFACE", "META", "FONT"} or source.original.hide_render:
            continue
        evaluated = instance.object
        data = evaluated.to_mesh()
        if data is not None and len(data.loop_triangles):
            points, corners, uv, slot = read_triangles(data)
            matrix = np.array(instance.matrix_world)
            points = points @ matrix[:3, :3].T + matrix[:3, 3]
            if np.linalg.det(matrix[:3, :3]) < 0:  # keeps the outside of mirrored instances
                corners, uv = corners[:, ::-1], None if uv is None else uv[:, ::-1]
            used, region = used_slots(slot)
            vertices.append(points)
            faces.append(corners + n_vertices)
            uvs.append(uv)
            regions.append(region + len(names))
            names += [f"{source.name} / {_slot_name(evaluated, index)}" for index in used]
            runs.append(
                FaceRun(
                    object=source.name,
                    start=n_faces,
                    stop=n_faces + len(corners),
                    instance=instance.is_instance,
                    to_capture=matrix,
                )
            )
            n_vertices += len(points)
            n_faces += len(corners)
        evaluated.to_mesh_clear()
    if not faces:
        raise BadInput("the scene has no mesh that renders", "add the room's mesh, or enable it for renders")
    uv = None if any(layer is None for layer in uvs) else np.concatenate(uvs).astype(np.float32)
    mesh = Mesh(np.concatenate(vertices), np.concatenate(faces), uv, np.concatenate(regions).astype(np.int32))
    return SceneMesh(mesh, names, runs)


def read_triangles(data: bpy.types.Mesh) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray]:
    """Vertices (V, 3), triangles (F, 3), UV per corner (F, 3, 2) or None, and material slot (F,), in object space."""
    points = np.empty(3 * len(data.vertices), np.float32)
    data.vertices.foreach_get("co", points)
    polygon, loops = triangles_of(data)
    corners, slot = corner_vertices(data)[loops], material_slots(data)[polygon]
    layer = next((layer for layer in data.uv_layers if layer.active_render), None)
    uv = None
    if layer is not None:
        flat = np.empty(2 * len(data.loops), np.float32)
        layer.uv.foreach_get("vector", flat)
        uv = flat.reshape(-1, 2)[loops]
    return points.reshape(-1, 3).astype(np.float64), corners.astype(np.int64), uv, slot


def _slot_name(thing: bpy.types.Object, index: int) -> str:
    slots = thing.material_slots
    material = slots[index].material if index < len(slots) else None
    return material.name if material else "no material"


# ---- writing and reading the capture -------------------------------------------------------------------------------

PHOTO_SUFFIXES = (".png", ".jpg", ".jpeg", ".exr")
ASPECT_PIXELS = 1.0
"""Maximum difference in height between a photo and the frame of the scene at the photo's width, pixels."""


def write_scene_capture(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph, folder: Path) -> list[str]:
    """Write the capture of ``scene`` into ``folder`` and return warnings.

    Raises:
        BadInput: no mesh, no camera with a photo, a photo of another aspect than the frame, a missing file, or
            ``folder/capture`` is a link.
        IrisError: the folder cannot be written.
    """
    scale = float(scene.unit_settings.scale_length)
    with as_rendered(scene, depsgraph) as left_out:
        room = read_scene_mesh(depsgraph, [thing for thing in scene.objects if thing.name not in left_out])
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
            stem = f"{number:04d}_{bpy.path.clean_name(view[0])}"  # cleaned names may coincide
            frames.append(_frame(target / "photos" / stem, *view))
            cameras[stem] = view[0]
        # A binary PLY: the text of a million triangles takes a minute.
        write_ply(target / "mesh.ply", replace(room.mesh, vertices=room.mesh.vertices * scale))
        write_json(folder / "scene_map.json", {"runs": [_run_json(run) for run in runs], "cameras": cameras})
        write_json(target / "transforms.json", {"mesh": "mesh.ply", "one_frame": True, "frames": frames})
    except OSError as error:
        raise IrisError(
            f"cannot be written ({error.strerror})", "free some disk space, or choose another folder", folder
        ) from error
    return _warnings(scene, left_out)


def read_face_runs(folder: Path) -> list[FaceRun]:
    """The face runs that :func:`write_scene_capture` wrote; raises BadInput."""
    path = folder / "scene_map.json"
    listed = read_json(path).get("runs")
    if not isinstance(listed, list):
        raise BadInput("lists no objects", "check this scene again", path)
    runs = []
    for row in listed:
        row = json_object(row, "runs", path)
        with decoding(path, mend="check this scene again"):
            matrix = numbers(row["to_capture"], (4, 4), "to_capture", path)
            runs.append(
                FaceRun(
                    object=str(row["object"]),
                    start=int(row["start"]),
                    stop=int(row["stop"]),
                    instance=bool(row["instance"]),
                    to_capture=matrix,
                )
            )
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
    return [
        FaceRun(object=room.name, start=0, stop=len(triangles_of(original)[0]), instance=False, to_capture=np.eye(4))
    ]


# ---- cameras -------------------------------------------------------------------------------------------------------


def _photo_cameras(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    return [thing for thing in scene.objects if thing.type == "CAMERA" and photo_of(thing) is not None]


def _view(
    scene: bpy.types.Scene, thing: bpy.types.Object, scale: float
) -> tuple[str, bpy.types.Image, Camera, dict[str, Any]]:
    """Name, photo and camera of a view, and what else its frame of transforms.json tells."""
    image = photo_of(thing)
    assert image is not None
    frame = read_camera(scene, thing)
    width, height = image.size
    if not width:
        raise BadInput(f"the photo of camera '{thing.name}' cannot be read", "find the missing file", image.filepath)
    frame = _behind(frame, thing)
    grow = width / frame.width
    # The camera is that of the frame; a photo of the same aspect has the same field of view.
    if abs(frame.height * grow * frame.fx / frame.fy - height) > ASPECT_PIXELS:
        raise BadInput(
            f"the photo of camera '{thing.name}' is {width}x{height}, the frame of the scene "
            f"{frame.width}x{frame.height}: another shape",
            "give the scene the resolution of its photos",
        )
    c2w = frame.c2w.copy()
    c2w[:3, 3] *= scale
    camera = replace(frame.resized(width, height), c2w=c2w)
    exposure = float(getattr(thing.data, "iris_exposure", 0.0))
    state = str(getattr(thing.data, "iris_light_state", "")).strip()
    told = {**({"exposure": exposure} if exposure > 0 else {}), **({"light_state": state} if state else {})}
    return thing.name, image, camera, told


def _behind(frame: Camera, thing: bpy.types.Object) -> Camera:
    """The camera of the photo that was moved and scaled behind the frame of ``thing``, in the pixels of the frame.

    A point q of the photo, counted from its middle, lies at offset + scale · q in the frame; the offset is counted in
    longer sides of the frame.

    Raises:
        BadInput: the photo is rotated or mirrored.
    """
    behind = background_of(thing)
    assert behind is not None
    if behind.rotation or behind.use_flip_x or behind.use_flip_y:
        raise BadInput(
            f"the photo of camera '{thing.name}' is {'rotated' if behind.rotation else 'flipped'} behind it",
            "set Rotation and Flip of the background image to none, and turn the camera instead",
        )
    # A pixel of the frame is as high as fx / fy of its width.
    side = max(frame.width, frame.height * frame.fx / frame.fy)
    right, up = (value * side for value in behind.offset)
    s = float(behind.scale)
    return replace(
        frame,
        fx=frame.fx / s,
        fy=frame.fy / s,
        cx=0.5 * frame.width + (frame.cx - 0.5 * frame.width - right) / s,
        cy=0.5 * frame.height + (frame.cy - 0.5 * frame.height + up * frame.fy / frame.fx) / s,
    )


def _frame(stem: Path, name: str, image: bpy.types.Image, camera: Camera, told: Mapping[str, Any]) -> dict[str, Any]:
    """The entry of transforms.json; the photo is linked or copied to ``stem`` plus its suffix."""
    source = Path(bpy.path.abspath(image.filepath_raw or image.filepath))
    suffix = source.suffix.lower()
    if suffix not in PHOTO_SUFFIXES:
        raise BadInput(f"the photo of camera '{name}' is no PNG, JPEG or EXR", "save it as one of them", source)
    target = stem.with_name(stem.name + suffix)
    target.unlink(missing_ok=True)  # a link to the artist's own file must not be written to
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
        **told,
    }


def _link(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except OSError:  # another disk, or a file system without links
        shutil.copyfile(source, target)


def _warnings(scene: bpy.types.Scene, left_out: Mapping[str, str]) -> list[str]:
    warnings = []
    for reason in dict.fromkeys(left_out.values()):
        names = [name for name, own in left_out.items() if own == reason]
        warnings.append(f"left out of the room, {reason}: {', '.join(names[:5])}{' …' if len(names) > 5 else ''}")
    tree = compositor_tree(scene)
    if tree is not None and any(node.bl_idname == "CompositorNodeLensdist" for node in tree.nodes):
        warnings.append("the compositor's Lens Distortion is ignored: the photos must be undistorted")
    return warnings


# ---- files ---------------------------------------------------------------------------------------------------------


def _scaled(run: FaceRun, scale: float) -> FaceRun:
    to_capture = run.to_capture.copy()
    to_capture[:3] *= scale
    return FaceRun(object=run.object, start=run.start, stop=run.stop, instance=run.instance, to_capture=to_capture)


def _run_json(run: FaceRun) -> dict[str, Any]:
    return {
        "object": run.object,
        "start": run.start,
        "stop": run.stop,
        "instance": run.instance,
        "to_capture": run.to_capture.tolist(),
    }
