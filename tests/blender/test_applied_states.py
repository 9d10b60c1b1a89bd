"""The lights of an applied room in each of its light states are those of the result in that state."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from iris_addon.blender.apply.applied_states import forget_light_states, in_light_state
from iris_addon.blender.apply.looks import keep_states, set_look, set_own_look
from iris_addon.blender.apply.on_objects import apply_to_objects
from iris_addon.blender.camera import add_camera, look_through
from iris_addon.blender.insert.photo_composite import as_photographed
from iris_addon.blender.render.cycles import render_linear, render_views, set_cycles
from iris_addon.blender.scene_in.scene_capture import whole_object
from iris_addon.blender.scene_out.build import plain_mesh
from iris_addon.model.recovered import LightState, OutsideLight, Sunlight
from iris_addon.model.render_settings import RenderSettings
from iris_addon.results.result import Result
from tests.blender_room import camera, room, sides_of_box

pytestmark = pytest.mark.bpy

QUICK = RenderSettings(samples=256, denoise=False, max_bounces=2)
EYE = camera(fx=14.0, fy=14.0, position=(0, 0, 0.5))
TURN = Matrix.Rotation(0.7, 4, (1.0, 0.4, -0.2))
SKY = OutsideLight(np.array([[0.0, 3.0, 0.0], [0.0, 0.0, 0.0], [0.0, 1.5, 0.0], [0.0, 0.0, 0.0]]))
LOW_SKY = OutsideLight(np.array([[0.3, 0.1, 0.6], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.2, 0.0, 0.4]]))
HIGH, LOW = (np.array(toward) / np.linalg.norm(toward) for toward in ((0.1, 0.2, 1.0), (-1.0, 0.3, 0.5)))


@pytest.fixture(autouse=True)
def empty_blender():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def house() -> Result:
    """A floor beside a wall that is a lamp, by day, at dusk and at night; the first has the sun, or not."""
    off, on = np.zeros((1, 3)), np.array([[0.0, 0.0, 4.0]])
    states = (
        LightState("day", (), off, outside=SKY, sun=Sunlight(HIGH, np.array([2.0, 1.5, 1.0]))),
        LightState("dusk", (), on, outside=LOW_SKY, sun=Sunlight(LOW, np.array([1.0, 0.3, 0.1]))),
        LightState("night", (), on),
    )
    first = states[0]
    made = room(mesh=sides_of_box(4, 0), emission={1: off[0]}, outside=first.outside)
    return replace(made, sun=first.sun, light_states=states)


def applied(result: Result) -> bpy.types.Scene:
    """``result`` on an object that was turned since."""
    scene = bpy.context.scene
    thing = bpy.data.objects.new("room", plain_mesh(replace(result.mesh, uv=None), "room"))
    scene.collection.objects.link(thing)
    runs = whole_object(thing)
    thing.matrix_world = TURN
    bpy.context.view_layer.update()
    apply_to_objects(result, runs, scene, "key")
    keep_states(scene, result)
    turned = replace(EYE, c2w=np.array(TURN) @ EYE.c2w)
    look_through(scene, turned, add_camera(turned, "eye", scene.collection))
    set_cycles(scene, QUICK)
    return scene


def light(scene: bpy.types.Scene) -> np.ndarray:
    """(3,) mean radiance that the camera sees."""
    bpy.context.view_layer.update()
    return render_linear(scene).mean((0, 1))


@pytest.mark.parametrize("first", ["day", "night"])
def test_sky_sun_and_lamps_are_those_of_the_state(first: str):
    result = house()
    own = next(state for state in result.light_states if state.name == first)
    rest = tuple(state for state in result.light_states if state.name != first)
    result = replace(result.in_state(first), light_states=(own, *rest))
    scene = applied(result)
    truth = {
        state.name: render_views(result.in_state(state.name), [EYE], settings=QUICK)[0].mean((0, 1))
        for state in result.light_states
    }
    for shown in (None, "dusk", first):
        if shown is not None:
            set_own_look(scene, shown)
        before = light(scene)
        for name, expected in truth.items():
            with in_light_state(scene, name):
                np.testing.assert_allclose(light(scene), expected, rtol=0.04, atol=2e-3, err_msg=f"{name} in {shown}")
            with in_light_state(scene, name, everything=True), as_photographed(scene):
                np.testing.assert_allclose(light(scene), expected, rtol=0.04, atol=2e-3, err_msg=f"{name} alone")
        np.testing.assert_allclose(light(scene), before, rtol=1e-3, atol=1e-6)


def test_lights_that_were_changed_stay_and_the_photographed_room_has_none_of_it():
    result = house()
    scene = applied(result)
    set_look(scene, "BLACKOUT")
    (dusk,) = render_views(result.in_state("dusk"), [EYE], settings=QUICK)
    with in_light_state(scene, "dusk"):
        seen = light(scene)
    assert seen.max() < 1e-3  # also the lamp, which is dark by day
    with in_light_state(scene, "dusk", everything=True), as_photographed(scene):
        np.testing.assert_allclose(light(scene), dusk.mean((0, 1)), rtol=0.04, atol=2e-3)
    assert light(scene).max() < 1e-3


@pytest.mark.parametrize("look", ["BLACKOUT", "LAMPS"])
def test_a_look_without_light_from_outside_keeps_the_sun_of_another_state_out(look: str):
    result = house()
    day, dusk, night = result.light_states
    scene = applied(replace(result.in_state("night"), light_states=(night, day, dusk)))
    with in_light_state(scene, "day"):
        assert light(scene)[0] > 0.1
    set_look(scene, look)
    with in_light_state(scene, "day"):
        assert light(scene).max() < 1e-3
    with in_light_state(scene, "day", everything=True), as_photographed(scene):
        assert light(scene)[0] > 0.1


def test_a_gray_sky_stays_in_another_state_and_the_photographed_room_has_its_colors():
    result = house()
    scene = applied(result)
    set_look(scene, "OVERCAST")
    overcast = light(scene)
    (dusk,) = render_views(result.in_state("dusk"), [EYE], settings=QUICK)
    with in_light_state(scene, "dusk"):
        np.testing.assert_allclose(light(scene), overcast, rtol=0.04, atol=2e-3)
    with in_light_state(scene, "dusk", everything=True), as_photographed(scene):
        np.testing.assert_allclose(light(scene), dusk.mean((0, 1)), rtol=0.04, atol=2e-3)
    np.testing.assert_allclose(light(scene), overcast, rtol=1e-3, atol=1e-6)


def test_a_sun_that_was_removed_does_not_rise_again():
    scene = applied(house())
    set_look(scene, "LAMPS")
    (sun,) = (thing for thing in scene.objects if thing.type == "LIGHT")
    bpy.data.objects.remove(sun)
    assert light(scene).max() < 1e-3
    with in_light_state(scene, "day"):
        assert light(scene).max() < 1e-3
    with in_light_state(scene, "day", everything=True), as_photographed(scene):
        assert light(scene)[0] > 0.1


def test_a_scene_applied_before_states_were_kept_is_applied_again():
    result = house()
    scene = applied(result)
    runs = whole_object(scene.objects["room"])
    assert not apply_to_objects(result, runs, scene, "key")
    forget_light_states(scene)
    assert apply_to_objects(result, runs, scene, "key")
    with in_light_state(scene, "night"):
        assert light(scene)[2] > 0.01
