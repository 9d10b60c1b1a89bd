"""A solved room as a .blend and .glb of its own, a photo with objects in it, a Blender scene read back."""

from dataclasses import replace

import bpy
import numpy as np
import pytest

from iris_addon.base.errors import BadInput, IrisError
from iris_addon.blender.apply.scene_files import apply
from iris_addon.blender.camera import read_camera
from iris_addon.blender.insert.differential import insert_onto_photo
from iris_addon.blender.render.cycles import render_linear, render_views
from iris_addon.blender.scene_in.scene_capture import read_scene_mesh
from iris_addon.blender.scene_out.build import build_scene
from iris_addon.edits.scene_edit import ObjectFile, Placement, SceneEdit, Sphere
from iris_addon.model.capture import View
from iris_addon.model.recovered import OutsideLight
from iris_addon.model.render_settings import RenderSettings
from iris_addon.model.response import gamma
from tests.blender_room import camera, room

pytestmark = pytest.mark.bpy


@pytest.fixture(autouse=True)
def empty_blender():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def solved(**changes):
    """A room whose up axis is +Y, with a lamp and photos taken at exposure 0.25."""
    sh = np.full((4, 3), 0.3)
    result = room(albedo=(0.5, 0.4, 0.3), emission={3: (12, 10, 8)}, outside=OutsideLight(sh))
    return replace(result, up=(0.0, 1.0, 0.0), exposures={"a": np.full(3, 0.25)}, response=gamma(), **changes)


def test_the_blend_opens_upright_and_renders_the_same_room(tmp_path):
    result, view = solved(), camera(fx=12.0, cx=9.0)
    path = tmp_path / "deep" / "scene.blend"
    scenes = len(bpy.data.scenes)
    apply(result, path, views=[View("a", view, None), View("b", camera(), None)])
    assert len(bpy.data.scenes) == scenes
    assert [file.name for file in path.parent.iterdir()] == ["scene.blend"]
    expected = render_views(result, [view], settings=RenderSettings(samples=64, denoise=False))[0]

    bpy.ops.wm.open_mainfile(filepath=str(path))
    scene = bpy.context.scene
    scene.cycles.use_denoising, scene.cycles.samples = False, 64
    lamp = bpy.data.materials["IRIS Lamp 00"].node_tree.nodes["Principled BSDF"]
    assert lamp.inputs["Emission Strength"].default_value == 12.0
    np.testing.assert_allclose(lamp.inputs["Emission Color"].default_value[:3], [1, 10 / 12, 8 / 12], rtol=1e-6)
    assert scene.view_settings.exposure == pytest.approx(-2)
    assert all(image.packed_file for image in bpy.data.images if image.name.startswith("IRIS"))
    ceiling = scene.objects["IRIS Lamp 00"].matrix_world @ bpy.data.meshes["IRIS Lamp 00"].vertices[0].co
    assert ceiling.z == pytest.approx(1)  # it was y = 1 in the capture
    assert {thing.name for thing in scene.objects if thing.type == "CAMERA"} == {"IRIS a", "IRIS b"}
    assert scene.render.use_compositing  # what F12 gives looks like a photo: see test_light_groups
    scene.render.use_compositing = False
    seen = render_linear(scene)
    np.testing.assert_allclose(seen.mean(axis=(0, 1)), expected.mean(axis=(0, 1)), rtol=0.02)


def test_a_blend_that_cannot_be_written_leaves_the_old_one(tmp_path):
    (tmp_path / "file").write_text("old")
    with pytest.raises((IrisError, OSError)):
        apply(solved(), tmp_path / "file" / "scene.blend")
    assert (tmp_path / "file").read_text() == "old"


def test_the_glb_carries_colours_gloss_and_emission_strength(tmp_path):
    result = room(albedo=(0.5, 0.25, 0.125), emission={3: (12, 10, 8)}, roughness=0.4)
    apply(result, tmp_path / "scene.blend", glb=tmp_path / "scene.glb")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(tmp_path / "scene.glb"))
    lamp = bpy.data.materials["IRIS Lamp 00"].node_tree.nodes["Principled BSDF"]
    np.testing.assert_allclose(emitted(lamp), [12, 10, 8], rtol=1e-3)
    lamp_object, surface = sorted((thing for thing in bpy.data.objects if thing.type == "MESH"), key=lambda t: t.name)
    assert (len(lamp_object.data.polygons), len(surface.data.polygons)) == (2, 10)
    images = {image.name: image for image in bpy.data.images}
    color = next(image for name, image in images.items() if "Base" in name)
    seen = srgb_to_linear(np.array(color.pixels[:3]))
    np.testing.assert_allclose(seen, np.array([0.5, 0.25, 0.125]) / 0.9235, atol=0.01)
    gloss = next(image for name, image in images.items() if "Rough" in name)
    np.testing.assert_allclose(gloss.pixels[1:3], [0.4, 0.0], atol=0.01)


def test_the_usd_has_its_textures_beside_it(tmp_path):
    if not bpy.app.build_options.usd:
        pytest.skip("this Blender was built without USD")
    apply(room(emission={3: (12, 10, 8)}), tmp_path / "scene.blend", usd=tmp_path / "scene.usdc")
    assert {path.name for path in tmp_path.iterdir()} == {"scene.blend", "scene.usdc", "textures"}
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.usd_import(filepath=str(tmp_path / "scene.usdc"))
    assert sum(len(thing.data.polygons) for thing in bpy.data.objects if thing.type == "MESH") == 12
    lamp = next(material for material in bpy.data.materials if "Lamp" in material.name)
    shader = next(node for node in lamp.node_tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")
    np.testing.assert_allclose(emitted(shader), [12, 10, 8], rtol=1e-3)


def emitted(shader):
    return (
        np.array(shader.inputs["Emission Color"].default_value[:3]) * shader.inputs["Emission Strength"].default_value
    )


def srgb_to_linear(value):
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def test_an_empty_edit_returns_the_photo_itself():
    photo = np.random.default_rng(0).random((12, 16, 3))
    np.testing.assert_array_equal(
        insert_onto_photo(solved(), camera(), photo, np.ones(3), SceneEdit(), RenderSettings()), photo
    )


def test_a_ball_in_a_photo_is_rendered_and_leaves_far_pixels_alone():
    """The photo is a render that is 20 % brighter than the model: the ball has the model's light, the wall the
    photo's."""
    result, view = solved(), camera(32, 24, fx=20.0, fy=20.0)
    (without,) = render_views(result, [view], settings=RenderSettings(samples=64))
    photo = result.response.apply(without * 1.2 * 0.1)
    sphere = Sphere(
        center=np.array([0.0, 0.0, -0.8]),
        radius=0.15,
        base_color=np.array([0.9, 0.0, 0.0]),
        roughness=1.0,
        metallic=0.0,
    )
    ball = SceneEdit(spheres=(sphere,))
    onto = insert_onto_photo(result, view, photo, np.full(3, 0.1), ball, RenderSettings(samples=64))
    (with_ball,) = render_views(result, [view], edit=ball, settings=RenderSettings(samples=64))
    np.testing.assert_allclose(onto[11:13, 15:17], result.response.apply(with_ball * 0.1)[11:13, 15:17], atol=0.01)
    assert np.abs(onto - photo)[:3, :3].max() < 0.02
    assert (onto - photo)[:, :, 1].min() < -0.1


def test_objects_from_files_stand_upright_in_the_room(tmp_path):
    cube = tmp_path / "cube.obj"
    cube.write_text("v 0 0 0\nv 1 0 0\nv 0 2 0\nf 1 2 3\n")  # 2 high, in the Y-up axes of .obj
    placed = ObjectFile(cube, Placement((0.1, -0.5, 0.2), scale=(0.5, 0.5, 0.5)))
    built = build_scene(solved(), SceneEdit(objects=(placed,)))
    built.scene.view_layers[0].update()
    thing = next(thing for thing in built.inserted if thing.type == "MESH")
    world = np.array([(thing.matrix_world @ vertex.co)[:] for vertex in thing.data.vertices])
    np.testing.assert_allclose(world[0], [0.1, -0.5, 0.2], atol=1e-6)
    np.testing.assert_allclose(world[2], [0.1, 0.5, 0.2], atol=1e-6)  # the capture's up is +Y
    with pytest.raises(BadInput, match=r"none\.glb: no such file"):
        build_scene(solved(), SceneEdit(objects=(replace(placed, file=tmp_path / "none.glb"),)))


def test_a_scene_is_read_as_cycles_sees_it():
    scene = bpy.context.scene
    data = bpy.data.meshes.new("tile")
    data.from_pydata([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [], [(0, 1, 2, 3)])
    data.materials.append(bpy.data.materials.new("oak"))
    tile = bpy.data.objects.new("tile", data)
    tile.location, tile.scale = (5, 0, 0), (2, 2, 2)
    tile.modifiers.new("copies", "ARRAY").count = 2
    hidden = bpy.data.objects.new("hidden", data.copy())
    hidden.hide_render = True
    for thing in (tile, hidden):
        scene.collection.objects.link(thing)
    room = read_scene_mesh(bpy.context.evaluated_depsgraph_get())
    mesh = room.mesh
    assert room.region_names == ["tile / oak"]
    assert len(mesh.faces) == 4
    assert mesh.vertices[:, 0].min() == 5
    assert mesh.vertices[:, 0].max() == pytest.approx(9)
    for kind, ortho in (("flat", "ORTHO"), ("round", "PANO")):
        eye = bpy.data.objects.new(kind, bpy.data.cameras.new(kind))
        eye.data.type = ortho
        scene.collection.objects.link(eye)
        with pytest.raises(BadInput, match=f"'{kind}' is of type {ortho}"):
            read_camera(scene, eye)
        bpy.data.objects.remove(eye)
