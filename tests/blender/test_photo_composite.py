"""The artist's own scene onto the photo agrees with an insertion job, and is the photo where nothing was changed."""

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from iris_addon.base.errors import BadInput
from iris_addon.blender.apply.on_objects import apply_to_objects
from iris_addon.blender.camera import add_camera, look_through
from iris_addon.blender.images import image_from_array, read_image
from iris_addon.blender.insert.differential import insert_onto_photo
from iris_addon.blender.insert.photo_composite import composite, write_copy
from iris_addon.blender.render.cycles import render_views
from iris_addon.blender.scene_in.scene_capture import whole_object
from iris_addon.blender.scene_out.build import add_sphere, plain_mesh
from iris_addon.blender.scene_out.lights import lamp_materials, set_strength
from iris_addon.edits.scene_edit import SceneEdit, Sphere
from iris_addon.model.render_settings import RenderSettings
from iris_addon.model.response import gamma
from iris_addon.results.folder import save_result
from iris_addon.results.result import Result
from tests.blender_room import camera, room

pytestmark = pytest.mark.bpy

EXPOSURE = np.full(3, 0.2)
VIEW = camera(40, 30, fx=24.0, fy=24.0, position=(0, 0, 0.6))
BALL = Sphere(
    center=np.array([0.0, -0.5, -0.4]), radius=0.3, base_color=np.array([0.2, 0.6, 0.2]), roughness=0.3, metallic=0.0
)


@pytest.fixture(autouse=True)
def empty_blender():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def lit_room() -> Result:
    made = room(albedo=(0.5, 0.45, 0.4), emission={3: (12, 11, 10)})
    return replace(made, response=gamma(), up=(0.0, 1.0, 0.0), exposures={"photo": EXPOSURE})


def applied(result: Result) -> bpy.types.Scene:
    """The room in the open scene with ``result`` on it, and the camera of the photo."""
    scene = bpy.context.scene
    thing = bpy.data.objects.new("room", plain_mesh(replace(result.mesh, uv=None), "room"))
    scene.collection.objects.link(thing)
    apply_to_objects(result, whole_object(thing), scene, "key")
    look_through(scene, VIEW, add_camera(VIEW, "photo", scene.collection))
    bpy.context.view_layer.update()
    return scene


def photo_of(result: Result) -> np.ndarray:
    (radiance,) = render_views(result, [VIEW], settings=RenderSettings(samples=128, seed=9, max_bounces=8))
    return np.round(gamma().apply(radiance * EXPOSURE) * 255) / 255


def test_an_added_ball_is_that_of_an_insertion_job():
    result = lit_room()
    photo = photo_of(result)
    expected = insert_onto_photo(result, VIEW, photo, EXPOSURE, SceneEdit(spheres=(BALL,)), RenderSettings(samples=128))
    scene = applied(result)
    ball = add_sphere(BALL, "ball", scene.collection)
    ball.matrix_world = Matrix.Translation(tuple(BALL.center))
    seen = composite(scene, photo, gamma(), EXPOSURE, RenderSettings(samples=128))
    changed = np.abs(expected - photo).max(-1) > 0.05
    assert 0.02 < changed.mean() < 0.6
    assert np.abs(seen - expected)[changed].mean() < 0.012
    assert np.abs(seen - expected).mean() < 0.004
    assert not ball.hide_render


def test_without_additions_the_composite_is_the_photo():
    scene = applied(lit_room())
    photo = np.random.default_rng(0).integers(0, 256, (30, 40, 3)) / 255
    np.testing.assert_array_equal(composite(scene, photo, gamma(), EXPOSURE, RenderSettings(samples=4)), photo)


def test_dimming_the_lamp_darkens_the_photo_by_the_same_factor():
    result = lit_room()
    photo, scene = photo_of(result), applied(result)
    (lamp,) = lamp_materials(scene.objects)
    set_strength(lamp, 3.0)  # of 12: the only light there is
    seen = composite(scene, photo, gamma(), EXPOSURE, RenderSettings(samples=128))
    dark = (photo.max(-1) < 0.9) & (photo.min(-1) > 0.1)
    ratio = gamma().invert(seen[dark]) / gamma().invert(photo[dark])
    np.testing.assert_allclose(np.median(ratio), 0.25, rtol=0.03)


def test_a_scene_without_a_result_or_camera_is_refused():
    with pytest.raises(BadInput, match="no result is applied"):
        composite(bpy.context.scene, np.zeros((3, 4, 3)), gamma(), EXPOSURE, RenderSettings())
    scene = applied(lit_room())
    scene.camera = None
    with pytest.raises(BadInput, match="no active camera"):
        composite(scene, np.zeros((3, 4, 3)), gamma(), EXPOSURE, RenderSettings())


def test_the_command_opens_the_copy_and_leaves_a_picture(tmp_path: Path):
    from headless.cli import main

    result = lit_room()
    photo = photo_of(result)
    scene = applied(result)
    add_sphere(BALL, "ball", scene.collection)
    save_result(result, tmp_path / "result")
    image = image_from_array("photo", photo)
    image.filepath_raw, image.file_format = str(tmp_path / "photo.png"), "PNG"
    image.save()
    write_copy(scene, tmp_path / "copy.blend")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    where = ["--result", str(tmp_path / "result"), "--photo", str(tmp_path / "photo.png")]
    out = tmp_path / "out" / "photo.png"
    command = ["composite", str(tmp_path / "copy.blend"), *where, "--view", "photo", "--out", str(out)]
    assert main([*command, "--samples", "16"]) == 0
    seen = read_image(out)
    green = (seen - photo)[..., 1] - (seen - photo)[..., 0]
    assert seen.shape == photo.shape and green.max() > 0.1
    assert main(["composite", str(tmp_path / "photo.png"), *where, "--view", "photo", "--out", str(out)]) == 3
