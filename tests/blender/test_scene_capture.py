"""A Blender scene written as a capture: its cameras, photos, unit and meshes as the solver reads them."""

import bpy
import numpy as np
import pytest

from iris_addon.base.errors import BadInput
from iris_addon.blender.scene_in.scene_capture import read_face_runs, read_view_cameras, write_scene_capture
from iris_addon.capture.reader import read_capture
from tests.blender_room import box as box_mesh

pytestmark = pytest.mark.bpy


@pytest.fixture(autouse=True)
def empty_blender():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.types.Camera.iris_exposure = bpy.props.FloatProperty()  # as the extension does
    yield
    del bpy.types.Camera.iris_exposure


def box(name: str, **placed) -> None:
    """A cube of triangles from -1 to 1 with a transform."""
    data = bpy.data.meshes.new(name)
    data.from_pydata(box_mesh().vertices.tolist(), [], box_mesh().faces.tolist())
    thing = bpy.data.objects.new(name, data)
    for attribute, value in placed.items():
        setattr(thing, attribute, value)
    bpy.context.scene.collection.objects.link(thing)


def photo(path, width=40, height=30, level=0):
    image = bpy.data.images.new("photo", width, height)
    image.generated_color = (level / 255, level / 255, level / 255, 1.0)
    image.filepath_raw, image.file_format = str(path), "PNG"
    image.save()
    bpy.data.images.remove(image)
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
        eye.data.iris_exposure = 0.5 + number
        eye.rotation_euler, eye.location = (1.5, 0.0, 0.5 * number), (30.0 * number, 0, 0)
        scene.collection.objects.link(eye)
        behind = eye.data.background_images.new()
        behind.image = bpy.data.images.load(str(photo(tmp_path / f"photo {number}.png")))
    bpy.context.view_layer.update()
    assert write_scene_capture(scene, bpy.context.evaluated_depsgraph_get(), tmp_path / "job") == []
    capture = read_capture(tmp_path / "job" / "capture")
    assert [view.exposure for view in capture.views] == [0.5, 1.5, 2.5]
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
        path = photo(tmp_path / f"{number}.png", level=40 * number)
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


def test_objects_disabled_in_viewports_are_named(tmp_path):
    box("room")
    box("ceiling")
    scene = bpy.context.scene
    scene.objects["ceiling"].hide_viewport = True
    eye = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    scene.collection.objects.link(eye)
    scene.render.resolution_x, scene.render.resolution_y = 400, 300
    eye.data.background_images.new().image = bpy.data.images.load(str(photo(tmp_path / "a.png")))
    (warning,) = write_scene_capture(scene, bpy.context.evaluated_depsgraph_get(), tmp_path / "job")
    assert "ceiling" in warning


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
    for name in ("scene_map.json", "capture/mesh.obj", "capture/transforms.json"):
        (job / name).symlink_to(victim)
    write_scene_capture(bpy.context.scene, bpy.context.evaluated_depsgraph_get(), job)
    assert victim.read_text() == "precious"
    assert read_capture(job / "capture").views and read_face_runs(job)

    other = tmp_path / "other"
    other.mkdir()
    (other / "capture").symlink_to(job / "capture")
    with pytest.raises(BadInput, match="capture: is a link"):
        write_scene_capture(bpy.context.scene, bpy.context.evaluated_depsgraph_get(), other)
