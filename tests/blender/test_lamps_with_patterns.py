"""Lamps with a pattern in Blender: rendered, changed, exported, and read as ground truth."""

from dataclasses import replace

import bpy
import numpy as np
import pytest

from iris_addon.base.errors import BadInput
from iris_addon.blender.apply.scene_files import apply, export_textures
from iris_addon.blender.render.cycles import render_views
from iris_addon.blender.scene_out.build import build_scene
from iris_addon.blender.scene_out.lights import as_recovered, color, lamp_materials, set_color, set_strength, switch
from iris_addon.blender.scene_out.materials import lamp_material
from iris_addon.blender.synth.scene import read_geometry
from iris_addon.edits.jobs import relight_edit
from iris_addon.model.render_settings import RenderSettings
from iris_addon.results.folder import save_result
from tests.blender_room import camera, room

pytestmark = pytest.mark.bpy

BACK, LEFT, RIGHT = 4, 1.5, 0.5
"""The side of the box that the camera looks at, and how bright the halves of its pattern are."""
RADIANCE = np.array([8.0, 4.0, 2.0])
EXACT = RenderSettings(samples=4, denoise=False, max_bounces=0)


@pytest.fixture(autouse=True)
def empty_blender():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def halves() -> np.ndarray:
    """(32, 32, 3) two halves, left and right by u."""
    pattern = np.full((32, 32, 3), LEFT, np.float32)
    pattern[:, 16:] = RIGHT
    return pattern


def solved():
    """A box whose back and floor shine, the back in two halves."""
    made = room(albedo=0.0, emission={BACK: RADIANCE, 2: (1.0, 1.0, 1.0)})
    first, second = made.emitters
    textures = replace(made.textures, lamp_pattern=halves())
    return replace(made, emitters=(replace(first, patterned=True), second), textures=textures)


def halves_of(image: np.ndarray) -> set[tuple[float, ...]]:
    """The colours at a few places of the back, far from the middle, where filters mix the halves."""
    image = np.asarray(image, np.float64)
    height, width = image.shape[:2]
    rows = slice(height // 2 - 1, height // 2 + 1)
    return {tuple(np.round(image[rows, x].mean(0), 2).tolist()) for x in (width // 4, 3 * width // 4)} | {
        tuple(np.round(image[y, width // 2 - 1 : width // 2 + 1].mean(0), 2).tolist())
        for y in (height // 4, 3 * height // 4)
    }


def expected(radiance) -> set[tuple[float, ...]]:
    return {tuple(np.round(np.asarray(radiance) * share, 2).tolist()) for share in (LEFT, RIGHT)}


def view():
    """Sees the middle half of the back alone."""
    return camera(width=16, height=16, fx=20.0, fy=20.0)


def test_a_lamp_is_rendered_with_its_pattern_and_so_are_its_maps():
    result = solved()
    (image,) = render_views(result, [view()], settings=EXACT)
    assert expected(RADIANCE) <= halves_of(image)
    assert expected(RADIANCE) <= halves_of(result.render_maps(view()).emission)
    tinted = relight_edit(result, {"recovered": {"0": {"color": [1, 1, 1], "scale": 0.5}}})
    luminance = 0.5 * RADIANCE @ [0.2126, 0.7152, 0.0722]
    (image,) = render_views(result, [view()], edit=tinted, settings=EXACT)
    assert expected([luminance] * 3) <= halves_of(image)


def test_a_pattern_is_dimmed_tinted_switched_and_put_back_like_any_lamp():
    built = build_scene(solved())
    back, floor = lamp_materials(built.scene.objects)
    shader = next(n for n in back.node_tree.nodes if n.bl_idname == "ShaderNodeBsdfPrincipled")
    assert shader.inputs["Emission Color"].is_linked and color(back) == pytest.approx((1, 0.5, 0.25))
    assert not any(n.bl_idname == "ShaderNodeTexImage" for n in floor.node_tree.nodes), "the floor has no pattern"
    set_color(back, (0.5, 1.0, 0.5))
    set_strength(back, 3.0)
    assert color(back) == pytest.approx((0.5, 1, 0.5))
    with as_recovered([back, floor]):
        assert color(back) == pytest.approx((1, 0.5, 0.25))
    assert color(back) == pytest.approx((0.5, 1, 0.5))
    switch(back, False)
    assert shader.inputs["Emission Strength"].default_value == 0
    built.free()


def test_the_glb_carries_the_pattern_though_it_exceeds_what_a_picture_holds(tmp_path):
    apply(solved(), None, glb=tmp_path / "scene.glb")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(tmp_path / "scene.glb"))
    lamp = bpy.data.materials["IRIS Lamp 00"].node_tree
    image = next(n.image for n in lamp.nodes if n.bl_idname == "ShaderNodeTexImage")
    mix = next(n for n in lamp.nodes if n.bl_idname == "ShaderNodeMix")
    tint = np.array(next(s for s in mix.inputs if s.identifier == "B_Color").default_value[:3])
    strength = next(n for n in lamp.nodes if n.bl_idname == "ShaderNodeBsdfPrincipled").inputs["Emission Strength"]
    stored = np.array(image.pixels[:]).reshape(image.size[1], image.size[0], -1)[image.size[1] // 2, :, :3]
    linear = np.where(stored <= 0.04045, stored / 12.92, ((stored + 0.055) / 1.055) ** 2.4)
    shown = linear[[2, -3]] * tint * strength.default_value
    np.testing.assert_allclose(shown, [RADIANCE * LEFT, RADIANCE * RIGHT], rtol=0.02)


def test_usd_gets_the_mean_because_its_exporter_drops_what_multiplies_a_picture(tmp_path):
    if not bpy.app.build_options.usd:
        pytest.skip("this Blender was built without USD")
    apply(solved(), None, usd=tmp_path / "scene.usdc", glb=tmp_path / "scene.glb")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.usd_import(filepath=str(tmp_path / "scene.usdc"))
    lamp = next(material for material in bpy.data.materials if "Lamp_00" in material.name.replace(" ", "_"))
    shader = next(n for n in lamp.node_tree.nodes if n.bl_idname == "ShaderNodeBsdfPrincipled")
    color, strength = (shader.inputs[f"Emission {name}"] for name in ("Color", "Strength"))
    assert not color.is_linked
    np.testing.assert_allclose(np.array(color.default_value[:3]) * strength.default_value, RADIANCE, rtol=1e-3)


def test_the_texture_set_has_the_pattern(tmp_path):
    save_result(solved(), tmp_path / "result")
    export_textures(tmp_path / "result", tmp_path / "textures")
    assert (tmp_path / "textures" / "lamp_pattern.exr").is_file()


def screen(*, half: bool = False) -> bpy.types.Material:
    """An upright rectangle that emits a picture, of which it shows the left half or all."""
    data = bpy.data.meshes.new("screen")
    data.from_pydata([(0, 0, 0), (2, 0, 0), (2, 0, 1), (0, 0, 1)], [], [(0, 1, 2, 3)])
    right = 0.5 if half else 1.0
    data.uv_layers.new(name="picture").uv.foreach_set("vector", [0, 0, right, 0, right, 1, 0, 1])
    image = bpy.data.images.new("picture", 32, 32, float_buffer=True)
    image.pixels.foreach_set(np.dstack([halves() * [1, 2, 3], np.ones((32, 32))]).astype(np.float32).ravel())
    image.pack()
    material = lamp_material("screen", (2.0, 2.0, 2.0))
    tree = material.node_tree
    shown = tree.nodes.new("ShaderNodeTexImage")
    shown.image = image
    shader = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeBsdfPrincipled")
    tree.links.new(shown.outputs["Color"], shader.inputs["Emission Color"])
    data.materials.append(material)
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("screen", data))
    return material


@pytest.mark.parametrize(("half", "mean"), [(False, 1.0), (True, LEFT)])
def test_the_true_radiance_of_a_picture_is_its_mean_over_the_lamp(half: bool, mean: float):
    screen(half=half)
    (emitter,) = read_geometry(bpy.context.scene).emitters
    np.testing.assert_allclose(emitter.radiance, 2 * mean * np.array([1, 2, 3]), rtol=0.02)


@pytest.mark.parametrize("driven", ["coordinates", "alpha", "no picture", "lost picture"])
def test_an_emission_that_other_nodes_drive_has_no_radiance_to_write_down(driven: str, tmp_path):
    tree = screen().node_tree
    node = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeTexImage")
    shader = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeBsdfPrincipled")
    if driven == "coordinates":
        tree.links.new(tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"], node.inputs["Vector"])
    elif driven == "alpha":
        tree.links.new(node.outputs["Alpha"], shader.inputs["Emission Color"])
    else:
        node.image = None
    if driven == "lost picture":
        node.image = bpy.data.images.new("lost", 4, 4)
        node.image.source, node.image.filepath = "FILE", str(tmp_path / "lost.png")
    with pytest.raises(BadInput, match="driven by nodes"):
        read_geometry(bpy.context.scene)
