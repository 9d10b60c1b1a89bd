"""A Blender scene written as a capture: its cameras, photos, unit and meshes as the solver reads them."""

import zlib

import bpy
import numpy as np
import pytest
from PIL import Image

from iris_addon.base.errors import BadInput
from iris_addon.blender.scene_in.scene_capture import read_face_runs, read_view_cameras, write_scene_capture
from iris_addon.capture.reader import read_capture
from tests.blender_room import box as box_mesh

pytestmark = pytest.mark.bpy


@pytest.fixture(autouse=True)
def empty_blender():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.types.Camera.iris_exposure = bpy.props.FloatProperty()  # as the extension does
    bpy.types.Camera.iris_light_state = bpy.props.StringProperty()
    yield
    del bpy.types.Camera.iris_exposure, bpy.types.Camera.iris_light_state


def box(name: str, **placed) -> None:
    """A cube of triangles from -1 to 1 with a transform."""
    data = bpy.data.meshes.new(name)
    data.from_pydata(box_mesh().vertices.tolist(), [], box_mesh().faces.tolist())
    thing = bpy.data.objects.new(name, data)
    for attribute, value in placed.items():
        setattr(thing, attribute, value)
    bpy.context.scene.collection.objects.link(thing)


def photo(path, width=40, height=30):
    """A picture of large soft shapes, other ones for each file name."""
    shapes = np.random.default_rng(zlib.crc32(path.name.encode())).uniform(20, 230, (3, 4, 3)).astype(np.uint8)
    Image.fromarray(shapes).resize((width, height), Image.Resampling.BICUBIC).save(path)
    return path


def test_a_scene_becomes_a_capture_in_metres_that_the_solver_reads(tmp_path):
    """Shift, sensor fit, a frame that is not square, centimetres as unit: rays through the photo's corners agree."""
    box("room", scale=(300, 200, 150))
    box("table", location=(50, 0, -120), scale=(40, 40, 30))
    scene = bpy.context.scene
    scene.unit_settings.scale_length = 0.01
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 200, 150, 40
    for number, fit in enumerate(("AUTO", "HORIZONTAL", "VERTICAL")):
        eye = bpy.data.objects.new(f"cam {number}", bpy.data.cameras.new("cam"))
        eye.data.sensor_fit, eye.data.lens, eye.data.shift_x, eye.data.shift_y = fit, 20, 0.1, -0.05
        eye.data.iris_exposure, eye.data.iris_light_state = 0.5 + number, ("all", "all ", "low")[number]
        eye.rotation_euler, eye.location = (1.5, 0.0, 0.5 * number), (30.0 * number, 0, 0)
        scene.collection.objects.link(eye)
        behind = eye.data.background_images.new()
        behind.image = bpy.data.images.load(str(photo(tmp_path / f"photo {number}.png")))
    bpy.context.view_layer.update()
    assert write_scene_capture(scene, bpy.context.evaluated_depsgraph_get(), tmp_path / "job") == []
    capture = read_capture(tmp_path / "job" / "capture")
    assert [view.exposure for view in capture.views] == [0.5, 1.5, 2.5]
    assert [view.light_state for view in capture.views] == ["all", "all", "low"]
    np.testing.assert_allclose(np.ptp(capture.mesh.vertices, axis=0), [6, 4, 3], atol=1e-5)
    assert len(np.unique(capture.mesh.regions)) == 2
    names = read_view_cameras(tmp_path / "job")
    assert sorted(names.values()) == ["cam 0", "cam 1", "cam 2"]
    for view in capture.views:
        eye = scene.objects[names[view.name]]
        frame = [eye.matrix_world @ corner for corner in eye.data.view_frame(scene=scene)]  # from the top right, on
        camera = view.camera
        for corner, (i, j) in zip(frame, ((40, 0), (40, 30), (0, 30), (0, 0)), strict=True):
            local = np.array([(i - camera.cx) / camera.fx, -(j - camera.cy) / camera.fy, -1.0])
            ours = camera.c2w[:3, :3] @ local
            theirs = np.array(corner - eye.matrix_world.translation)
            np.testing.assert_allclose(ours / np.linalg.norm(ours), theirs / np.linalg.norm(theirs), atol=1e-5)
    runs = read_face_runs(tmp_path / "job")
    assert [(run.object, run.stop - run.start) for run in runs] == [("room", 12), ("table", 12)]
    np.testing.assert_allclose(runs[0].to_capture[:3, :3], np.diag([3, 2, 1.5]), atol=1e-6)


def test_photos_of_cameras_with_similar_names_stay_apart_and_are_never_written_to(tmp_path):
    """Two names that are one once they are cleaned for the disk, written twice: links to the artist's own files."""
    box("room")
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = 400, 300
    own = {}
    for number, name in enumerate(("Camera", "Camera.001", "Camera_001")):
        eye = bpy.data.objects.new(name, bpy.data.cameras.new(name))
        scene.collection.objects.link(eye)
        path = photo(tmp_path / f"{number}.png")
        eye.data.background_images.new().image = bpy.data.images.load(str(path))
        own[name] = path.read_bytes()
    bpy.context.view_layer.update()
    for _ in range(2):
        write_scene_capture(scene, bpy.context.evaluated_depsgraph_get(), tmp_path / "job")
        names = read_view_cameras(tmp_path / "job")
        assert sorted(names.values()) == sorted(own)
        for view in read_capture(tmp_path / "job" / "capture").views:
            assert view.photo.read_bytes() == own[names[view.name]]
        assert [(tmp_path / f"{number}.png").read_bytes() for number in range(3)] == list(own.values())


def camera_with_photo(tmp_path):
    scene = bpy.context.scene
    eye = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    scene.collection.objects.link(eye)
    scene.render.resolution_x, scene.render.resolution_y = 40, 30
    behind = eye.data.background_images.new()
    behind.image = bpy.data.images.load(str(photo(tmp_path / "a.png")))
    return scene, eye, behind


def in_collection(name, things):
    collection = bpy.data.collections.new(name)
    bpy.context.scene.collection.children.link(collection)
    for thing in things:
        collection.objects.link(thing)
        bpy.context.scene.collection.objects.unlink(thing)
    return collection, bpy.context.view_layer.layer_collection.children[name]


def hidden_with_h(thing):
    thing.hide_set(True)


def disabled_in_viewports(thing):
    thing.hide_viewport = True


def in_a_hidden_collection(thing):
    in_collection("more", [thing])[1].hide_viewport = True


def in_a_collection_disabled_in_viewports(thing):
    in_collection("more", [thing])[0].hide_viewport = True


def written_faces(tmp_path):
    bpy.context.view_layer.update()
    warnings = write_scene_capture(bpy.context.scene, bpy.context.evaluated_depsgraph_get(), tmp_path / "job")
    return sum(run.stop - run.start for run in read_face_runs(tmp_path / "job")), warnings


@pytest.mark.parametrize(
    "hide", [hidden_with_h, disabled_in_viewports, in_a_hidden_collection, in_a_collection_disabled_in_viewports]
)
def test_what_renders_is_the_room_whatever_the_viewport_hides(hide, tmp_path):
    box("room")
    box("ceiling")
    camera_with_photo(tmp_path)
    bpy.context.view_layer.update()
    ceiling = bpy.data.objects["ceiling"]
    hide(ceiling)
    bpy.context.view_layer.update()
    before = ceiling.visible_get()
    assert written_faces(tmp_path) == (24, [])
    bpy.context.view_layer.update()
    assert ceiling.visible_get() == before, "the viewport is what it was"


def disabled_for_renders(thing):
    thing.hide_render = True


def in_a_collection_disabled_for_renders(thing):
    in_collection("more", [thing])[0].hide_render = True


def in_an_excluded_collection(thing):
    in_collection("more", [thing])[1].exclude = True


def as_a_holdout(thing):
    thing.is_holdout = True


@pytest.mark.parametrize(
    ("hide", "reason"),
    [
        (disabled_for_renders, "disabled for renders"),
        (in_a_collection_disabled_for_renders, "their collection is disabled for renders"),
        (in_an_excluded_collection, "their collection is excluded"),
        (as_a_holdout, "a holdout"),
    ],
)
def test_what_does_not_render_is_left_out_and_listed(hide, reason, tmp_path):
    box("room")
    box("ceiling")
    camera_with_photo(tmp_path)
    hide(bpy.data.objects["ceiling"])
    faces, (warning,) = written_faces(tmp_path)
    assert faces == 12 and reason in warning and "ceiling" in warning


def written_view(tmp_path):
    bpy.context.view_layer.update()
    write_scene_capture(bpy.context.scene, bpy.context.evaluated_depsgraph_get(), tmp_path / "job")
    (view,) = read_capture(tmp_path / "job" / "capture").views
    return view.camera


def test_a_photo_moved_and_scaled_behind_the_camera_has_its_own_principal_point_and_focal_length(tmp_path):
    """A point of the frame lies at offset + scale times its place in the photo, counted from the middle, in widths."""
    box("room")
    _, eye, behind = camera_with_photo(tmp_path)
    eye.data.shift_x = 0.05
    plain = written_view(tmp_path)
    behind.offset, behind.scale = (0.2, 0.1), 1.5
    moved = written_view(tmp_path)
    # The frame is 40 x 30 pixels as the photo is. Where the photo's pixel (7, 9) lies in the frame:
    in_frame = np.array([20 + 0.2 * 40 + 1.5 * (7 - 20), 15 - 0.1 * 40 + 1.5 * (9 - 15)])
    expected = (in_frame - (plain.cx, plain.cy)) / plain.fx
    np.testing.assert_allclose(([7, 9] - np.array([moved.cx, moved.cy])) / moved.fx, expected, atol=1e-6)


@pytest.mark.parametrize(("name", "value", "said"), [("rotation", 0.3, "rotated"), ("use_flip_x", True, "flipped")])
def test_a_photo_rotated_or_flipped_behind_the_camera_is_refused(name, value, said, tmp_path):
    box("room")
    _, _, behind = camera_with_photo(tmp_path)
    setattr(behind, name, value)
    with pytest.raises(BadInput, match=f"camera 'eye' is {said} behind it"):
        written_view(tmp_path)


def test_a_scene_without_usable_photos_is_refused(tmp_path):
    box("room")
    scene, graph = bpy.context.scene, bpy.context.evaluated_depsgraph_get
    with pytest.raises(BadInput, match="no camera of this scene has a photo"):
        write_scene_capture(scene, graph(), tmp_path)
    eye = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    scene.collection.objects.link(eye)
    eye.data.background_images.new().image = bpy.data.images.load(str(photo(tmp_path / "a.png")))
    with pytest.raises(BadInput, match="is 40x30, the frame of the scene 1920x1080"):
        write_scene_capture(scene, graph(), tmp_path)
    scene.render.resolution_x, scene.render.resolution_y = 400, 300
    (tmp_path / "a.png").unlink()
    with pytest.raises(BadInput, match="the photo of camera 'eye' is missing"):
        write_scene_capture(scene, graph(), tmp_path)


def test_links_in_an_untrusted_folder_are_not_followed(tmp_path):
    box("room")
    eye = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    bpy.context.scene.collection.objects.link(eye)
    eye.data.background_images.new().image = bpy.data.images.load(str(photo(tmp_path / "a.png", 192, 108)))
    bpy.context.view_layer.update()
    victim = tmp_path / "victim"
    victim.write_text("precious")
    job = tmp_path / "job"
    (job / "capture").mkdir(parents=True)
    for name in ("scene_map.json", "capture/mesh.ply", "capture/transforms.json"):
        (job / name).symlink_to(victim)
    write_scene_capture(bpy.context.scene, bpy.context.evaluated_depsgraph_get(), job)
    assert victim.read_text() == "precious"
    assert read_capture(job / "capture").views and read_face_runs(job)

    other = tmp_path / "other"
    other.mkdir()
    (other / "capture").symlink_to(job / "capture")
    with pytest.raises(BadInput, match="capture: is a link"):
        write_scene_capture(bpy.context.scene, bpy.context.evaluated_depsgraph_get(), other)
