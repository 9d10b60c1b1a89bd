"""Cameras of an imported capture go where the solve found its photos, and back again exactly."""

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from iris_addon.base.images import write_png
from iris_addon.blender.apply.on_objects import FaceRun, apply_to_objects, restore
from iris_addon.blender.apply.photo_cameras import move_to_solved_poses
from iris_addon.blender.camera import read_camera
from iris_addon.blender.scene_in.capture_objects import (
    PHOTO,
    Inspected,
    InspectedView,
    add_capture,
    fade_photo,
    has_photo_to_fade,
    photo_of,
    refresh_capture,
    show_instead,
)
from iris_addon.blender.scene_out.build import plain_mesh
from iris_addon.model.corrections import CameraCorrection, PoseCorrections, rigid
from tests.blender_room import camera, room

pytestmark = pytest.mark.bpy

TWISTS = np.array([[0.02, -0.01, 0.03, 0.04, -0.02, 0.01], [-0.01, 0.02, 0.0, 0.01, 0.03, -0.05]])
TOGETHER = CameraCorrection(10 / 16, 0.9, (0.01, -0.02), (0.0, 0.0))


@pytest.fixture
def imported(tmp_path: Path):
    """A capture with two photos, Y up, as objects of an otherwise empty scene; and their names and cameras as read."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.types.Camera.iris_exposure = bpy.props.FloatProperty()  # of the add-on, which is not enabled here
    bpy.types.Camera.iris_light_state = bpy.props.StringProperty()
    write_png(tmp_path / "photo.png", np.zeros((12, 16, 3), np.uint8))
    views = tuple(
        InspectedView(
            name=name,
            photo=tmp_path / "photo.png",
            camera=camera(position=(x, 0.1, 0.5)),
            exposure=None,
            saturated=0,
            histogram=(1.0,),
            seen=1,
            score=1,
            shift=0,
            verdict="aligned",
            problem="",
        )
        for name, x in (("a", 0.0), ("b", 0.4))
    )
    inspected = Inspected(name="room", up=(0.0, 1.0, 0.0), warnings=(), views=views, mesh=room().mesh)
    scene = bpy.context.scene
    thing, cameras = add_capture(inspected, plain_mesh(inspected.mesh, "room"), scene)
    yield inspected, scene, thing, dict(zip("ab", cameras, strict=True))
    del bpy.types.Camera.iris_exposure, bpy.types.Camera.iris_light_state


def corrected(inspected: Inspected):
    """A result that found all cameras too long and each pose off in its own way; the cameras as it found them."""
    longer = [TOGETHER.camera(view.camera) for view in inspected.views]
    found = [replace(c, c2w=c.c2w @ rigid(t)) for c, t in zip(longer, TWISTS, strict=True)]
    poses = PoseCorrections.between(longer, found)
    report = {"model": {"camera": {"correction": TOGETHER.content(), "poses": poses.content()}}}
    return replace(room(), report=report), found


def test_cameras_move_to_solved_poses_and_are_restored_exactly(imported):
    inspected, scene, thing, cameras = imported
    result, found = corrected(inspected)
    before = {name: (c.matrix_basis.copy(), c.data.lens, c.data.shift_x, c.data.shift_y) for name, c in cameras.items()}
    apply_to_objects(
        result, [FaceRun(object=thing.name, start=0, stop=12, instance=False, to_capture=np.eye(4))], scene, "key"
    )
    assert move_to_solved_poses(result, cameras, scene) == 2
    bpy.context.view_layer.update()
    upright = np.array(thing.parent.matrix_world)
    for moved, expected in zip(cameras.values(), found, strict=True):
        seen = read_camera(scene, moved)
        assert np.allclose(seen.c2w, upright @ expected.c2w, atol=1e-5)
        assert np.allclose([seen.fx, seen.fy, seen.cx, seen.cy], [9.0, 9.0, 8.16, 5.68], atol=1e-4)
    restore(scene)
    for name, (place, *lens) in before.items():
        data = cameras[name].data
        assert cameras[name].matrix_basis == place and [data.lens, data.shift_x, data.shift_y] == lens
        assert not [key for key in cameras[name].keys() if key.startswith("iris")]  # noqa: SIM118 - no mapping


def test_a_result_without_corrected_poses_moves_no_camera(imported):
    _, scene, _, cameras = imported
    places = [thing.matrix_basis.copy() for thing in cameras.values()]
    assert move_to_solved_poses(room(), cameras, scene) == 0
    assert [thing.matrix_basis for thing in cameras.values()] == places


def test_backgrounds_of_the_artist_stay_whatever_is_shown_in_place_of_the_photo(imported):
    camera = imported[3]["a"]
    photo, backgrounds = photo_of(camera), camera.data.background_images
    own = backgrounds.new()
    own.image, own.alpha = bpy.data.images.new("a sketch", 4, 4), 0.25
    render, error = (bpy.data.images.new(name, 4, 4) for name in ("render", "error"))
    for image in (render, error):
        show_instead(camera, image)
        assert [behind.image for behind in backgrounds] == [photo, own.image, image]
        assert [behind.show_background_image for behind in backgrounds] == [False, True, True]
    for _ in range(2):
        show_instead(camera, None)
        assert [(behind.image, behind.show_background_image) for behind in backgrounds] == [
            (photo, True),
            (own.image, True),
        ]
    assert own.alpha == 0.25
    show_instead(camera, render)
    fade_photo(camera, 0.75)
    assert [behind.alpha for behind in backgrounds] == [0.75, 0.25, 0.75]


def test_what_is_shown_in_place_of_a_photo_is_known_again_after_the_file_was_saved(imported, tmp_path):
    """Also where the artist has a picture of the same name behind the camera."""
    camera = imported[3]["a"]
    sketch, render = (bpy.data.images.new(name, 4, 4) for name in ("sketch", "render"))
    for image, folder in ((sketch, "sketches"), (render, "result")):
        image.source, image.filepath = "FILE", f"/{folder}/report/a-render.png"
    own = camera.data.background_images.new()
    own.image, own.alpha = sketch, 0.25
    show_instead(camera, render)
    name, photo = camera.name, photo_of(camera).name
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    camera = bpy.data.objects[name]
    fade_photo(camera, 0.75)
    assert [behind.alpha for behind in camera.data.background_images] == [0.75, 0.25, 0.75]
    for _ in range(2):
        show_instead(camera, None)
        assert [behind.image.name for behind in camera.data.background_images] == [photo, "sketch"]


def test_backgrounds_of_a_camera_of_the_artist_do_not_fade():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    own = bpy.data.objects.new("own", bpy.data.cameras.new("own"))
    photo = own.data.background_images.new()
    photo.image, photo.alpha = bpy.data.images.new("photo", 4, 4), 0.25
    assert not has_photo_to_fade(own)
    show_instead(own, bpy.data.images.new("render", 4, 4))
    fade_photo(own, 0.75)
    assert has_photo_to_fade(own)
    assert [behind.alpha for behind in own.data.background_images] == [0.25, 0.75]


def test_a_hidden_photo_and_a_background_of_the_artist_stay_as_they_are():
    """Even where the file of the background is named as one of ours."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    own = bpy.data.objects.new("own", bpy.data.cameras.new("own"))
    photo, sketch = (bpy.data.images.new(name, 4, 4) for name in ("photo", "sketch"))
    sketch.source, sketch.filepath = "FILE", "/mine/report/own-render.png"
    for image in (photo, sketch):
        own.data.background_images.new().image = image
    own.data.background_images[0].show_background_image = False
    show_instead(own, None)
    shown = [(behind.image, behind.show_background_image) for behind in own.data.background_images]
    assert shown == [(photo, False), (sketch, True)]


def test_what_is_shown_in_place_of_a_photo_is_none_once_that_is_gone(imported):
    camera = imported[3]["a"]
    render, backgrounds = bpy.data.images.new("render", 4, 4), camera.data.background_images
    show_instead(camera, render)
    backgrounds.remove(backgrounds[0])
    assert photo_of(camera) is None
    show_instead(camera, render)
    assert [behind.image for behind in backgrounds] == [render]
    show_instead(camera, None)
    assert not backgrounds


def test_what_the_artist_chose_for_the_imported_photo_does_not_fade(imported):
    camera = imported[3]["a"]
    behind = camera.data.background_images[0]
    behind.image, behind.alpha = bpy.data.images.new("a sketch", 4, 4), 0.25
    fade_photo(camera, 0.75)
    assert behind.alpha == 0.25 and photo_of(camera) == behind.image


@pytest.mark.parametrize("name", ["report/a-render.png", "report/a-error.png", "onto-photos/a.png"])
def test_a_picture_of_a_file_that_an_earlier_version_saved_goes_too(imported, name) -> None:
    """Those did not remember what they had put over the photo, nor which photo they had imported."""
    camera = imported[3]["a"]
    del camera.data[PHOTO]
    photo, backgrounds = photo_of(camera), camera.data.background_images
    old, own = backgrounds.new(), backgrounds.new()
    old.image, own.image = (bpy.data.images.new(each, 4, 4) for each in ("shown", "a sketch"))
    old.image.source, old.image.filepath = "FILE", f"/result/{name}"
    own.image.source, own.image.filepath = "FILE", "/result/sketch.png"
    backgrounds[0].show_background_image = False
    show_instead(camera, None)
    assert [behind.image for behind in backgrounds] == [photo, own.image]
    assert backgrounds[0].show_background_image
    fade_photo(camera, 0.75)
    assert [behind.alpha for behind in backgrounds] == [0.75, 0.5]  # a new one has 0.5


def test_cameras_read_again_forget_their_given_poses(imported):
    inspected, scene, thing, cameras = imported
    move_to_solved_poses(corrected(inspected)[0], cameras, scene)
    elsewhere = replace(inspected.views[0], camera=camera(position=(0.0, 0.2, 0.9)))
    refresh_capture(
        replace(inspected, views=(elsewhere, inspected.views[1])), plain_mesh(inspected.mesh, "room"), scene, thing
    )
    restore(scene)
    assert np.allclose(np.array(cameras["a"].matrix_basis)[:3, 3], (0.0, 0.2, 0.9))


def test_cameras_that_were_read_in_metres_are_not_scaled_again(imported) -> None:
    """Both the check and the solve had ``--metres-per-unit 2``."""
    inspected, scene, thing, cameras = imported
    refresh_capture(replace(inspected, metres_per_unit=2.0), plain_mesh(inspected.mesh, "room"), scene, thing)
    result = replace(room(), report={"metres_per_unit": 2.0})
    before = [np.array(thing.matrix_basis) for thing in cameras.values()]
    assert move_to_solved_poses(result, cameras, scene) == 0
    for pose, thing in zip(before, cameras.values(), strict=True):
        np.testing.assert_allclose(np.array(thing.matrix_basis), pose)


def test_drawn_sizes_fit_the_room_and_those_of_the_artist_stay_until_it_changes(imported) -> None:
    inspected, scene, thing, cameras = imported
    sizes = [each.data.display_size for each in cameras.values()]
    extent = np.ptp(inspected.mesh.vertices, axis=0).max()
    assert sizes == pytest.approx([0.02 * extent] * 2)
    assert thing.parent.empty_display_size == pytest.approx(0.05 * extent)
    cameras["a"].data.display_size = thing.parent.empty_display_size = 0.7
    bpy.data.objects.remove(cameras["b"])
    _, again = refresh_capture(inspected, plain_mesh(inspected.mesh, "room"), scene, thing)
    assert [cameras["a"].data.display_size, again.data.display_size] == pytest.approx([0.7, 0.02 * extent])
    assert thing.parent.empty_display_size == pytest.approx(0.7)
    larger = replace(inspected.mesh, vertices=inspected.mesh.vertices * 10)
    both = refresh_capture(replace(inspected, mesh=larger), plain_mesh(larger, "room"), scene, thing)
    assert [each.data.display_size for each in both] == pytest.approx([0.2 * extent] * 2)
    assert thing.parent.empty_display_size == pytest.approx(0.5 * extent)


def test_points_far_outside_do_not_blow_up_the_cameras(imported) -> None:
    inspected, scene, thing, cameras = imported
    many = np.concatenate([np.tile(inspected.mesh.vertices, (100, 1)), [[1e3, 1e3, 1e3]]])
    stray = replace(inspected.mesh, vertices=many)
    refresh_capture(replace(inspected, mesh=stray), plain_mesh(stray, "room"), scene, thing)
    assert cameras["a"].data.display_size == pytest.approx(0.02 * np.ptp(inspected.mesh.vertices, axis=0).max())
