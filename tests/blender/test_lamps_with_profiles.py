"""Lamps with a profile in Blender: rendered, changed, exported, and read as ground truth."""

from dataclasses import replace

import bpy
import numpy as np
import pytest

from iris_addon.blender.apply.scene_files import apply
from iris_addon.blender.render.cycles import render_views
from iris_addon.blender.scene_out.build import build_scene
from iris_addon.blender.scene_out.lamp_profile_nodes import profile_of
from iris_addon.blender.scene_out.lights import as_recovered, color, lamp_materials, set_color, set_strength
from iris_addon.blender.scene_out.materials import lamp_material
from iris_addon.blender.synth.scene import read_geometry
from iris_addon.model.lamp_profile import LampProfile
from iris_addon.model.render_settings import RenderSettings
from iris_addon.results.folder import load_result, save_result
from tests.blender_room import camera, room

pytestmark = pytest.mark.bpy

BACK = 4
"""The side of the box that the camera looks at."""
RADIANCE = np.array([8.0, 4.0, 2.0])
SPOT = LampProfile.of(np.array([1.0, 0.85, 0.45, 0.12, 0.03, 0.01]))
EXACT = RenderSettings(samples=4, denoise=False, max_bounces=0)


@pytest.fixture(autouse=True)
def empty_blender():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def solved():
    """A box whose back and floor shine, the back as a spot."""
    made = room(albedo=0.0, emission={BACK: RADIANCE, 2: (1.0, 1.0, 1.0)})
    first, second = made.emitters
    return replace(made, emitters=(replace(first, profile=SPOT), second))


def view():
    """Sees a part of the back alone, at up to 50 degrees off its normal."""
    return camera(width=24, height=24, fx=16.0, fy=16.0)


def test_a_spot_is_rendered_by_the_angle_at_which_one_looks_and_so_are_its_maps():
    result, seen = solved(), view()
    maps = result.render_maps(seen)
    (image,) = render_views(result, [seen], settings=EXACT)
    on_back = np.isclose(maps.emission[..., 0] / np.maximum(maps.emission[..., 1], 1e-9), 2) & (
        maps.emission[..., 0] > 0
    )
    assert on_back.mean() > 0.3
    _, directions = seen.rays()
    forward = -seen.c2w[:3, 2]
    expected = RADIANCE * SPOT.at(directions @ forward).reshape(seen.height, seen.width, 1)
    np.testing.assert_allclose(maps.emission[on_back], expected[on_back], rtol=1e-5)
    # Cycles reads a ramp in 256 steps and averages over a pixel.
    np.testing.assert_allclose(np.asarray(image)[on_back], expected[on_back], rtol=0.06, atol=0.02)
    assert np.ptp(expected[on_back][:, 0]) > 15, "the profile shows"


def test_a_spot_is_dimmed_tinted_and_put_back_like_any_lamp():
    built = build_scene(solved())
    back, floor = lamp_materials(built.scene.objects)
    assert color(back) == pytest.approx((1, 0.5, 0.25))
    np.testing.assert_allclose(profile_of(back).values, SPOT.values, rtol=1e-4)
    assert profile_of(floor) is None
    set_color(back, (0.5, 1.0, 0.5))
    set_strength(back, 3.0)
    with as_recovered([back, floor]):
        assert color(back) == pytest.approx((1, 0.5, 0.25))
    assert color(back) == pytest.approx((0.5, 1, 0.5))
    built.free()


def test_a_lamp_may_have_a_pattern_and_a_profile():
    image = bpy.data.images.new("pattern", 4, 4, float_buffer=True)
    material = lamp_material("both", RADIANCE, image, profile=SPOT)
    shader = next(n for n in material.node_tree.nodes if n.bl_idname == "ShaderNodeBsdfPrincipled")
    kinds, socket = [], shader.inputs["Emission Color"]
    while socket.is_linked:
        mix = socket.links[0].from_node
        inputs = {each.identifier: each for each in mix.inputs}
        kinds.append(inputs["A_Color"].links[0].from_node.bl_idname)
        socket = inputs["B_Color"]
    assert sorted(kinds) == ["ShaderNodeGroup", "ShaderNodeTexImage"]
    assert color(material) == pytest.approx((1, 0.5, 0.25))


def test_a_result_keeps_the_profile(tmp_path):
    save_result(solved(), tmp_path / "result")
    first, second = load_result(tmp_path / "result").emitters
    np.testing.assert_allclose(first.profile.values, SPOT.values, rtol=1e-12)
    assert second.profile is None


@pytest.mark.parametrize("form", ["glb", "usd"])
def test_formats_without_profiles_get_an_even_lamp_of_the_same_flux(form: str, tmp_path):
    if form == "usd" and not bpy.app.build_options.usd:
        pytest.skip("this Blender was built without USD")
    path = tmp_path / {"glb": "scene.glb", "usd": "scene.usdc"}[form]
    apply(solved(), None, **{form: path})
    bpy.ops.wm.read_factory_settings(use_empty=True)
    read = {"glb": bpy.ops.import_scene.gltf, "usd": bpy.ops.wm.usd_import}[form]
    read(filepath=str(path))
    lamp = next(material for material in bpy.data.materials if "Lamp_00" in material.name.replace(" ", "_"))
    shader = next(n for n in lamp.node_tree.nodes if n.bl_idname == "ShaderNodeBsdfPrincipled")
    tint, strength = (shader.inputs[f"Emission {name}"] for name in ("Color", "Strength"))
    assert not tint.is_linked
    np.testing.assert_allclose(np.array(tint.default_value[:3]) * strength.default_value, RADIANCE, rtol=1e-3)


def test_the_true_radiance_of_a_spot_is_that_of_an_even_lamp():
    data = bpy.data.meshes.new("spot")
    data.from_pydata([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [], [(0, 1, 2, 3)])
    data.materials.append(lamp_material("spot", RADIANCE, profile=SPOT))
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("spot", data))
    (emitter,) = read_geometry(bpy.context.scene).emitters
    np.testing.assert_allclose(emitter.radiance, RADIANCE, rtol=1e-6)
