"""Sliders on the artist's own scene: the mix of a finished render is the render in that light, and off is as before."""

import bpy
import numpy as np
import pytest

from iris_addon.base.errors import BadInput
from iris_addon.blender.apply.camera_look import match_photo, stop_matching
from iris_addon.blender.apply.on_objects import apply_to_objects, restore
from iris_addon.blender.render import light_groups
from iris_addon.blender.render.cycles import render_linear, set_cycles
from iris_addon.blender.render.light_mixing import mixer, sliders, start_mixing, stop_mixing
from iris_addon.blender.scene_out.lights import lamp_materials, set_strength, strength, switch
from iris_addon.blender.version import compositor_output, compositor_tree
from iris_addon.model.render_settings import RenderSettings
from iris_addon.model.response import gamma
from tests.blender_room import camera
from tests.scene_snapshot import blurred, snapshot
from tests.solved_scene import cube, solve

pytestmark = pytest.mark.bpy


@pytest.fixture
def scene() -> bpy.types.Scene:
    """A box with a lamp for one side, seen from inside, in a bright world; a bulb has been added."""
    from iris_addon.blender.camera import add_camera, look_through

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    cube("box")
    result, runs = solve(lamp_faces=[2, 3])
    apply_to_objects(result, runs, scene, "key")
    look_through(scene, camera(), add_camera(camera(16, 12), "eye", scene.collection))
    lamp = bpy.data.lights.new("bulb", "POINT")
    lamp.energy = 5.0
    bulb = bpy.data.objects.new("bulb", lamp)
    bulb.location = (0.3, 0.2, -0.5)
    scene.collection.objects.link(bulb)
    bpy.context.view_layer.update()
    return scene


def render(scene: bpy.types.Scene, composited: bool) -> np.ndarray:
    set_cycles(scene, RenderSettings(samples=32, denoise=False, seed=0, max_bounces=4))
    scene.render.use_compositing = composited
    return render_linear(scene)


def test_a_slider_equals_a_render_with_the_lamp_changed(scene, monkeypatch):
    monkeypatch.setattr(light_groups, "can_denoise", lambda: False)
    plain = render(scene, composited=False)
    assert set(start_mixing(scene)) == {"IRIS Lamp 07", "bulb", "IRIS Outside"}
    np.testing.assert_allclose(render(scene, composited=True).mean((0, 1)), plain.mean((0, 1)), rtol=0.02)

    of_light = {name: (level, tint) for name, level, tint in sliders(mixer(scene))}
    assert list(of_light)[-1] == "IRIS Outside"
    of_light["bulb"][0].default_value = 0.0
    of_light["IRIS Outside"][0].default_value = 0.0
    of_light["IRIS Lamp 07"][0].default_value = 0.5
    of_light["IRIS Lamp 07"][1].default_value = (1.0, 0.2, 1.0, 1.0)
    mixed = render(scene, composited=True)

    stop_mixing(scene)
    (lamp,) = lamp_materials(scene.objects)
    set_strength(lamp, 0.5 * strength(lamp))
    bpy.data.objects["bulb"].hide_render = True
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.0
    expected = render(scene, composited=False) * (1.0, 0.2, 1.0)
    np.testing.assert_allclose(mixed.mean((0, 1)), expected.mean((0, 1)), rtol=0.05)


@pytest.mark.parametrize("matched_last", [False, True])
def test_stopping_leaves_the_scene_as_it_was(scene, matched_last):
    before = snapshot(scene)
    start_mixing(scene)
    assert len(scene.objects["box"].data.polygons) == 5 and len(scene.objects["IRIS Lamp 07"].data.polygons) == 1
    if matched_last:
        match_photo(scene, gamma(), {}, "")
        stop_matching(scene)
    stop_mixing(scene)
    assert snapshot(scene) == before


def test_restoring_the_originals_ends_mixing(scene):
    before_apply = {thing.name for thing in scene.objects}
    start_mixing(scene)
    restore(scene)
    assert {thing.name for thing in scene.objects} == before_apply
    assert len(scene.objects["box"].data.polygons) == 6 and mixer(scene) is None
    assert not scene.view_layers[0].lightgroups


def test_objects_in_edit_mode_are_refused(scene):
    """Blender takes no other mesh for it and says nothing: the original would be lost."""
    bpy.context.view_layer.objects.active = scene.objects["box"]

    def refused(change):
        before = snapshot(scene)
        bpy.ops.object.mode_set(mode="EDIT")
        with pytest.raises(BadInput, match=r"'box' is being edited — leave edit mode"):
            change(scene)
        bpy.ops.object.mode_set(mode="OBJECT")
        assert snapshot(scene) == before

    refused(start_mixing)
    refused(restore)
    start_mixing(scene)
    refused(stop_mixing)
    refused(restore)
    restore(scene)
    assert len(scene.objects["box"].data.polygons) == 6 and mixer(scene) is None


def test_an_existing_compositing_gets_the_mix(scene):
    blur = blurred(scene)
    layers = blur.inputs["Image"].links[0].from_node
    before = snapshot(scene)
    start_mixing(scene)
    source = blur.inputs["Image"].links[0].from_node
    assert source != layers and compositor_output(compositor_tree(scene)).links[0].from_node == blur
    stop_mixing(scene)
    assert snapshot(scene) == before


def test_a_dark_scene_is_refused_and_left_alone(scene):
    for material in lamp_materials(scene.objects):
        switch(material, False)
    bpy.data.objects.remove(bpy.data.objects["bulb"])
    scene.world = None
    before = snapshot(scene)
    with pytest.raises(BadInput, match="nothing in the scene emits light"):
        start_mixing(scene)
    assert snapshot(scene) == before
