"""A capture as Blender objects, upright: the room's mesh, and a camera per photo with the photo in front of it.

Read from the folder that ``inspect`` wrote (:mod:`iris_addon.capture.inspection`), so that every format the solver
knows is imported in the same way, with only Blender's own Python and numpy.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...base.errors import BadInput
from ...base.untrusted import decoding, finite, json_object, numbers, read_arrays, read_json
from ...model.capture import Camera, Mesh
from ..apply.on_objects import APPLIED, ORIGINAL_MESH, restore
from ..apply.photo_cameras import METRES_PER_UNIT, forget_given_pose
from ..camera import add_camera, look_through, set_lens
from ..scene_out.build import corner_vertices, mesh_steps
from ..scene_out.scene_state import require_object_mode
from ..stepwise import Steps, in_thread

FIX = "check the capture again"
COLLECTION = "IRIS Capture"
VIEW, PHOTO, INSTEAD = "iris_view", "iris_photo", "iris_instead"
"""Custom properties of the camera data of a photo: its name, which Blender may have numbered in that of the object, its
image where IRIS put it there, and the image that is shown in its place."""

UNMARKED = re.compile(r"[\\/](report[\\/][^\\/]+-(photo|render|error)|onto-photos[\\/][^\\/]+)\.png$")
"""Files of pictures that earlier versions showed in place of a photo without INSTEAD."""

CAMERA_SHARE, ANCHOR_SHARE = 0.02, 0.05
"""Size of a drawn camera, and of the axes of the capture, as shares of the room's longest side: of five metres, 0.1 and
0.25 m."""


@dataclass(frozen=True)
class InspectedView:
    """The measurements of one photo; see :mod:`iris_addon.capture.inspection`.

    Attributes:
        shift: offset of the photo's edges from those of the mesh, pixels, where ``verdict`` is "shifted".
        problem: why the photo should be looked at, empty where it need not be.
        metered: luminance that it was exposed for by its EXIF, cd/m²; None where that does not say.
    """

    name: str
    photo: Path
    camera: Camera
    exposure: float | None
    saturated: float
    histogram: tuple[float, ...]
    seen: float
    score: float
    shift: float
    verdict: str
    problem: str
    light_state: str = ""
    metered: float | None = None


@dataclass(frozen=True)
class Inspected:
    """The content of an inspection folder.

    Attributes:
        metres_per_unit: what poses and mesh of the files were multiplied by.
    """

    name: str
    up: tuple[float, float, float]
    warnings: tuple[str, ...]
    views: tuple[InspectedView, ...]
    mesh: Mesh
    metres_per_unit: float = 1.0


def read_inspected(folder: Path) -> Inspected:
    """Read what ``inspect`` wrote; does not use bpy, so that a thread may call it. Raises BadInput."""
    path = folder / "capture.json"
    content = read_json(path)
    listed = content.get("views")
    if not isinstance(listed, list) or not listed:
        raise BadInput("lists no photos", FIX, path)
    views = tuple(_view(json_object(row, "views", path), path) for row in listed)
    x, y, z = numbers(content.get("up"), (3,), "up", path).tolist()
    with decoding(path, "'warnings' is no list", FIX):
        warnings = tuple(str(warning) for warning in content.get("warnings", []))
    return Inspected(
        name=str(content.get("name")),
        up=(x, y, z),
        warnings=warnings,
        views=views,
        mesh=_mesh(folder / "mesh.npz"),
        metres_per_unit=float(numbers(content.get("metres_per_unit", 1.0), (), "metres_per_unit", path)),
    )


def _view(row: dict[str, Any], path: Path) -> InspectedView:
    with decoding(path, "a photo is described wrongly", FIX):
        lens, alignment = row["camera"], row["alignment"]
        camera = Camera(
            int(lens["width"]),
            int(lens["height"]),
            *(float(lens[key]) for key in ("fx", "fy", "cx", "cy")),
            c2w=numbers(lens["c2w"], (4, 4), "c2w", path),
        )
        return InspectedView(
            name=str(row["name"]),
            photo=Path(row["photo"]),
            camera=camera,
            exposure=None if row["exposure"] is None else float(row["exposure"]),
            saturated=float(row["saturated"]),
            histogram=tuple(float(value) for value in row["histogram"]),
            seen=float(row["seen"]),
            score=float(alignment["score"]),
            shift=float(alignment["shift"]),
            verdict=str(alignment["verdict"]),
            problem=str(row.get("problem", "")),  # missing in checks of older versions, as is "light_state"
            light_state=str(row.get("light_state", "")),
            metered=None if row.get("metered") is None else float(row["metered"]),
        )


def _mesh(path: Path) -> Mesh:
    arrays = read_arrays(path) or {}
    vertices, corners = finite(arrays.get("vertices"), (None, 3)), finite(arrays.get("faces"), (None, 3))
    if vertices is None or corners is None:
        raise BadInput("is missing or damaged", FIX, path)
    faces = corners.astype(np.int64)
    if faces.size and not 0 <= faces.min() <= faces.max() < len(vertices):
        raise BadInput("names vertices it does not have", FIX, path)
    uv, regions = finite(arrays.get("uv"), (len(faces), 3, 2)), finite(arrays.get("regions"), (len(faces),))
    return Mesh(
        vertices,
        faces,
        None if uv is None else uv.astype(np.float32),
        None if regions is None else regions.astype(np.int32),
    )


def inspected_steps(folder: Path, *, with_mesh: bool) -> Steps[tuple[Inspected, bpy.types.Mesh | None]]:
    """What ``inspect`` wrote into ``folder``, and ``with_mesh`` the mesh of its room; raises BadInput."""
    inspected = yield from in_thread(lambda: read_inspected(folder), "reading the files")
    return inspected, (yield from mesh_steps(inspected.mesh, f"{inspected.name} mesh")) if with_mesh else None


def add_capture(
    inspected: Inspected, mesh: bpy.types.Mesh, scene: bpy.types.Scene
) -> tuple[bpy.types.Object, list[bpy.types.Object]]:
    """Add ``mesh`` and cameras to ``scene``, children of an empty that turns the capture's up axis to +Z.

    Returns:
        The mesh object, and the camera of each photo.
    """
    collection = bpy.data.collections.new(COLLECTION)
    scene.collection.children.link(collection)
    anchor = bpy.data.objects.new(inspected.name, None)
    anchor.matrix_world = Vector(inspected.up).rotation_difference(Vector((0.0, 0.0, 1.0))).to_matrix().to_4x4()
    collection.objects.link(anchor)
    room = bpy.data.objects.new(f"{inspected.name} mesh", mesh)
    room.parent = anchor
    collection.objects.link(room)
    photos = bpy.data.collections.new("IRIS Photos")
    collection.children.link(photos)
    cameras = [_add_view(view, anchor, photos) for view in inspected.views]
    for camera in cameras:
        camera.data[METRES_PER_UNIT] = inspected.metres_per_unit
    _fit_sizes(inspected.mesh, anchor, cameras)
    look_through(scene, inspected.views[0].camera, cameras[0])
    return room, cameras


def _fit_sizes(mesh: Mesh, anchor: bpy.types.Object | None, cameras: Sequence[bpy.types.Object]) -> None:
    """Draw cameras and axes in sizes that fit the room ``mesh``, whose stray points do not count."""
    low, high = np.percentile(mesh.vertices, (1, 99), axis=0) if len(mesh.vertices) else np.zeros((2, 3))
    extent = max(float((high - low).max()), 1e-3)
    if anchor is not None:
        anchor.empty_display_size = ANCHOR_SHARE * extent
    for camera in cameras:
        camera.data.display_size = CAMERA_SHARE * extent


STARTUP_LIGHT = (4.076245, 1.005454, 5.903862)


def hide_startup_objects(scene: bpy.types.Scene) -> list[str]:
    """Hide the cube and the light of Blender's start-up file where nobody has touched them; returns their names."""
    hidden = []
    for thing in (scene.objects.get("Cube"), scene.objects.get("Light")):
        if thing is not None and not thing.hide_render and _as_at_startup(thing):
            thing.hide_viewport = thing.hide_render = True
            hidden.append(thing.name)
    return hidden


def _as_at_startup(thing: bpy.types.Object) -> bool:
    if thing.type == "LIGHT":
        place = np.abs(np.subtract(thing.location, STARTUP_LIGHT)).max()
        return bool(thing.data.type == "POINT" and thing.data.energy == 1000.0 and place < 1e-4)
    if thing.type != "MESH" or not thing.matrix_world.is_identity or len(thing.modifiers):
        return False
    corners = [abs(coordinate) for vertex in thing.data.vertices for coordinate in vertex.co]
    return len(thing.data.vertices) == 8 and np.allclose(corners, 1.0)


def refresh_capture(
    inspected: Inspected, mesh: bpy.types.Mesh, scene: bpy.types.Scene, room: bpy.types.Object
) -> list[bpy.types.Object]:
    """Update the objects of :func:`add_capture` from a capture that was read again; returns the camera of each photo.

    Of its ``mesh`` and that of ``room`` the one that is not needed is removed. An applied result is removed if it
    belongs to another mesh. Missing cameras are created; that of a photo that is left out stays until it comes back.

    Raises:
        BadInput: the room is in edit mode.
    """
    require_object_mode([room])
    changed = _content(room.get(ORIGINAL_MESH, room.data)) != _content(mesh)
    if changed:
        if APPLIED in scene:
            restore(scene)
        room.data, mesh = mesh, room.data
    if not mesh.users:
        bpy.data.meshes.remove(mesh)
    ours = [thing for thing in scene.objects if thing.type == "CAMERA" and thing.parent == room.parent]
    present = {thing.data[VIEW]: thing for thing in reversed(ours) if VIEW in thing.data}
    cameras, added = [], []
    for view in inspected.views:
        camera = present.get(view.name)
        if camera is None:
            camera = _add_view(view, room.parent, room.users_collection[0])
            added.append(camera)
        forget_given_pose(camera)
        set_lens(camera.data, view.camera)
        camera.matrix_basis = Matrix(view.camera.c2w.tolist())
        camera.data.iris_exposure = view.exposure or 0.0
        camera.data.iris_light_state = view.light_state
        camera.data[METRES_PER_UNIT] = inspected.metres_per_unit
        cameras.append(camera)
    # The artist may have chosen sizes; those of the cameras that were there change with the room alone.
    _fit_sizes(inspected.mesh, room.parent if changed else None, cameras if changed else added)
    return cameras


def _content(data: bpy.types.Mesh) -> tuple[bytes, bytes]:
    points = np.empty(3 * len(data.vertices), np.float32)
    data.vertices.foreach_get("co", points)
    return points.tobytes(), corner_vertices(data).tobytes()


def _add_view(
    view: InspectedView, anchor: bpy.types.Object | None, collection: bpy.types.Collection
) -> bpy.types.Object:
    camera = add_camera(view.camera, view.name, collection)
    camera.parent = anchor
    camera.data[VIEW] = view.name
    show_photo(camera, view.photo)
    camera.data.iris_exposure = view.exposure or 0.0
    camera.data.iris_light_state = view.light_state
    return camera


def show_photo(camera: bpy.types.Object, photo: Path, alpha: float = 0.5) -> None:
    """Show ``photo`` over the view of ``camera``; the file is read when it is first drawn."""
    image = bpy.data.images.load(str(photo), check_existing=True)
    behind = camera.data.background_images.new()
    behind.image, behind.alpha = image, alpha
    behind.display_depth, behind.frame_method = "FRONT", "STRETCH"
    camera.data.show_background_images = True
    camera.data[PHOTO] = image


def show_instead(camera: bpy.types.Object, image: bpy.types.Image | None) -> None:
    """Show ``image`` in place of the photo of ``camera``; None shows the photo again; other pictures stay."""
    photo, shown = background_of(camera), camera.data.background_images
    before = _instead(camera)
    changes = image is not None or bool(before) or INSTEAD in camera.data
    for behind in before:
        shown.remove(behind)
    camera.data.pop(INSTEAD, None)
    if image is not None:
        instead = shown.new()
        instead.image, instead.alpha = image, 1.0
        instead.display_depth, instead.frame_method = "FRONT", "STRETCH"
        camera.data[INSTEAD] = image
    if photo is not None and changes:
        photo.show_background_image = image is None


def _instead(camera: bpy.types.Object) -> list[bpy.types.CameraBackgroundImage]:
    """The pictures of ours that ``camera`` shows in place of its photo."""
    photo, known = background_of(camera), camera.data.get(INSTEAD)
    shown = [behind for behind in camera.data.background_images if behind.image is not None and behind != photo]
    if known is not None:
        return [behind for behind in shown if behind.image == known]
    # A file of an earlier version: that hid the imported photo, and had no mark but the names of its files.
    hidden = photo is None or not photo.show_background_image
    earlier = hidden and VIEW in camera.data and PHOTO not in camera.data
    return [behind for behind in shown if earlier and UNMARKED.search(behind.image.filepath)]


def fade_photo(camera: bpy.types.Object, alpha: float) -> None:
    """Set the opacity of what IRIS put over the view of ``camera``; pictures of the artist stay as they are."""
    for behind in _put_there(camera):
        behind.alpha = alpha


def has_photo_to_fade(camera: bpy.types.Object) -> bool:
    """Whether :func:`fade_photo` would change anything."""
    return bool(_put_there(camera))


def _put_there(camera: bpy.types.Object) -> list[bpy.types.CameraBackgroundImage]:
    """The photo of an imported capture, and what is shown in place of any photo."""
    if camera.type != "CAMERA":
        return []
    photo, imported = background_of(camera), VIEW in camera.data
    ours = imported and photo is not None and photo.image == camera.data.get(PHOTO, photo.image)
    return [*_instead(camera), *([photo] if ours else [])]


def photo_of(camera: bpy.types.Object) -> bpy.types.Image | None:
    """The photo that ``camera`` shows, if it shows one."""
    behind = background_of(camera)
    return None if behind is None else behind.image


def background_of(camera: bpy.types.Object) -> bpy.types.CameraBackgroundImage | None:
    """The background image of ``camera`` that is its photo: the one that was imported, else the first that is not shown
    in place of one."""
    if camera.type != "CAMERA":
        return None
    backgrounds: Sequence[Any] = camera.data.background_images
    imported, instead = camera.data.get(PHOTO), camera.data.get(INSTEAD)
    shown = [behind for behind in backgrounds if behind.source == "IMAGE" and behind.image not in (None, instead)]
    return next((behind for behind in shown if behind.image == imported), shown[0] if shown else None)
