"""The map of what was seen, and the cameras that are suggested, on objects of Blender."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from iris_addon.blender.apply.on_objects import apply_to_objects, restore
from iris_addon.blender.apply.review import show_confidence, shows_confidence
from iris_addon.blender.apply.suggested_photos import COLLECTION, forget_suggested, suggest_steps
from iris_addon.blender.camera import add_camera, read_camera
from iris_addon.blender.stepwise import finish
from iris_addon.model.capture import Camera
from iris_addon.model.seen_classes import SEEN_CLASSES, SEEN_NEVER, SEEN_OFTEN, seen_colors
from tests.scene_snapshot import snapshot
from tests.solved_scene import cube, solve

pytestmark = pytest.mark.bpy


@pytest.fixture(autouse=True)
def empty_blender():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def test_the_map_has_the_colors_of_its_legend_and_is_smooth():
    never, seldom, often = (np.array(seen.color) for seen in SEEN_CLASSES)
    middle = 0.5 * (SEEN_NEVER + SEEN_OFTEN)
    found = seen_colors(np.array([0.0, SEEN_NEVER, middle, SEEN_OFTEN, 1.0]))
    np.testing.assert_allclose(found, [never, never, seldom, often, often], atol=1e-6)
    assert np.abs(np.diff(seen_colors(np.linspace(0, 1, 256)), axis=0)).max() < 0.02


def test_the_image_that_solid_view_shows_is_the_coverage_and_not_the_confidence_of_texels():
    thing = cube("box")
    result, runs = solve()
    side = len(result.textures.confidence)
    coverage = np.zeros((side, side), np.float32)
    coverage[: side // 2] = 1
    textures = replace(result.textures, confidence=np.zeros((side, side), np.float32), coverage=coverage)
    apply_to_objects(replace(result, textures=textures), runs, bpy.context.scene, "key")
    assert not shows_confidence() and show_confidence([thing], True) and shows_confidence()
    image = thing.data.materials[0].node_tree.nodes.active.image
    assert image.colorspace_settings.name == "sRGB", "the colors of the legend, as they are on the screen"
    pixels = np.array(image.pixels[:]).reshape(side, side, 4)[::-1, :, :3]
    np.testing.assert_allclose(pixels[0, 0], SEEN_CLASSES[2].color, atol=0.003)
    np.testing.assert_allclose(pixels[-1, 0], SEEN_CLASSES[0].color, atol=0.003)
    show_confidence([thing], False)
    assert not shows_confidence()


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_cameras_look_at_the_wall_that_no_photo_shows_wherever_the_room_stands(scale):
    """A cube of four meters as the room, turned and moved; one of its sides was never seen."""
    scene = bpy.context.scene
    place = Matrix.Translation((7, -3, 2)) @ Matrix.Rotation(0.6, 4, "Z") @ Matrix.Scale(2, 4)
    room = cube("room", matrix_world=place)
    result, runs = solve(scale=scale)  # capture units per meter of the scene
    runs = [replace(run, to_capture=np.diag([scale, scale, scale, 1]) @ run.to_capture) for run in runs]
    uv = result.mesh.uv
    assert uv is not None
    size = len(result.textures.confidence)
    coverage = np.ones((size, size), np.float32)
    corner = uv[:2].reshape(-1, 2)  # the quad x = -1
    low, high = corner.min(0), corner.max(0)
    rows = slice(int((1 - high[1]) * size), max(int((1 - low[1]) * size), int((1 - high[1]) * size) + 1))
    coverage[rows, int(low[0] * size) : max(int(high[0] * size), int(low[0] * size) + 1)] = 0
    before = snapshot(scene)
    apply_to_objects(result, runs, scene, "key")
    scene.render.resolution_x, scene.render.resolution_y = 64, 48
    taken = []
    for x in (-0.3, 0.0, 0.3):
        pose = np.array(place) @ np.array(Matrix.Translation((x, x, 0)) @ Matrix.Rotation(1.57, 4, "Y"))
        pose[:3, :3] /= np.linalg.norm(pose[:3, :3], axis=0)
        camera = add_camera(Camera(64, 48, 32, 32, cx=32, cy=24, c2w=pose), "photo", scene.collection)
        bpy.context.view_layer.update()
        taken.append(read_camera(scene, camera))
    found = finish(suggest_steps((result.mesh, coverage, (0, 0, 1)), runs, scene, taken))
    group = bpy.data.collections[COLLECTION]
    assert len(found) == len(group.objects) >= 1
    bpy.context.view_layer.update()
    inside = room.matrix_world.inverted()
    first = group.objects[0]
    assert all(abs(value) < 1 for value in inside @ first.matrix_world.translation)
    look = inside.to_3x3() @ (first.matrix_world.to_3x3() @ Matrix.Identity(3).col[2])
    assert look.normalized()[0] > 0.7, "away from +x, at the side x = -1"
    assert first.hide_render and tuple(first.matrix_world.to_scale()) == pytest.approx((1, 1, 1), abs=1e-5)
    again = finish(suggest_steps((result.mesh, coverage, (0, 0, 1)), runs, scene, taken))
    assert len(again) == len(bpy.data.collections[COLLECTION].objects) == len(found)
    for camera in [thing for thing in scene.objects if thing.name.startswith("photo")]:
        bpy.data.objects.remove(camera)
    restore(scene)
    bpy.context.view_layer.update()
    after = snapshot(scene)
    for region in ("objects", "blocks", "meshes"):
        assert after[region] == before[region], region


def test_forgetting_leaves_what_the_artist_put_beside_them():
    scene = bpy.context.scene
    own = bpy.data.collections.new(COLLECTION)
    scene.collection.children.link(own)
    forget_suggested(scene)
    assert COLLECTION in bpy.data.collections
