"""Looks set lamps, sun and sky together; a saved look brings back the same light."""

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from iris_addon.base.errors import BadInput
from iris_addon.blender.apply.farm_frames import relit_frames
from iris_addon.blender.apply.looks import (
    forget_look,
    forget_states,
    is_solo,
    keep_states,
    offered_looks,
    own_looks,
    save_look,
    set_look,
    set_own_look,
    solo,
)
from iris_addon.blender.apply.on_objects import MADE
from iris_addon.blender.apply.saved_looks import preset_names, read_preset, remove_preset, show_look, write_preset
from iris_addon.blender.apply.scene_files import apply_to_scene
from iris_addon.blender.camera import add_camera, look_through
from iris_addon.blender.insert.photo_composite import as_photographed
from iris_addon.blender.render.cycles import render_camera, set_cycles
from iris_addon.blender.scene_out.build import BuiltScene, build_scene
from iris_addon.blender.scene_out.lights import (
    as_recovered,
    is_on,
    lamp_materials,
    lamp_setting,
    set_color,
    set_strength,
    strength,
    switch,
)
from iris_addon.blender.scene_out.world import outside_light, sky_strength
from iris_addon.model.recovered import LightState, OutsideLight, Sunlight
from iris_addon.model.render_settings import RenderSettings
from iris_addon.model.response import LUMINANCE
from tests.blender_room import camera, room, sides_of_box

pytestmark = pytest.mark.bpy

QUICK = RenderSettings(samples=64, denoise=False, max_bounces=0)
LAMP, SUN, SKY = np.array([0.0, 0.0, 4.0]), np.array([2.0, 0.0, 0.0]), 1.0


@pytest.fixture(autouse=True)
def empty_blender():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def lit() -> BuiltScene:
    """A floor under a green sky and a red sun, beside a wall that is a blue lamp."""
    sky = OutsideLight(np.array([[0.0, SKY, 0.0]]) / 0.28209479)
    result = room(mesh=sides_of_box(4, 0), emission={1: LAMP}, outside=sky)
    return build_scene(replace(result, sun=Sunlight(np.array([0.0, 0.0, 1.0]), SUN)))


def floor(built: BuiltScene) -> np.ndarray:
    """(3,) mean radiance of the floor."""
    set_cycles(built.scene, QUICK)
    return render_camera(built, camera(fx=40.0, fy=40.0, position=(0, 0, 0.5))).mean((0, 1))


def test_every_look_sets_lamps_sun_and_sky():
    built = lit()
    photographed = floor(built)
    gray = photographed[1] * 0.7152  # the luminance of a green sky, in every channel
    assert (photographed > 0.01).all()  # red by the sun, green by the sky, blue by the lamp
    for look, shares in (
        ("LAMPS", (0, 0, 1)),
        ("EVENING", (0.05, 0.05, 1)),
        ("DAY", (1, 1, 0)),
        ("OVERCAST", gray / photographed),
        ("BLACKOUT", (0, 0, 0)),
        ("OVERCAST", gray / photographed),
        ("PHOTOGRAPHED", (1, 1, 1)),
    ):
        set_look(built.scene, look)
        np.testing.assert_allclose(floor(built), photographed * shares, rtol=0.05, atol=1e-4, err_msg=look)


def test_without_light_from_outside_only_looks_that_differ_are_offered():
    built = lit()
    assert list(offered_looks(built.scene)) == ["PHOTOGRAPHED", "LAMPS", "EVENING", "DAY", "OVERCAST", "BLACKOUT"]
    for thing in [thing for thing in built.scene.objects if thing.type == "LIGHT"]:
        bpy.data.objects.remove(thing)
    assert len(offered_looks(built.scene)) == 6, "the sky shines"
    color = outside_light(built.scene.world).inputs["Color"]
    color.default_value = (0, 0, 0, 1)
    assert list(offered_looks(built.scene)) == ["PHOTOGRAPHED", "BLACKOUT"]


def test_without_lamps_only_looks_that_differ_are_offered():
    built = lit()
    for material in lamp_materials(built.scene.objects):
        bpy.data.materials.remove(material)
    assert list(offered_looks(built.scene)) == ["PHOTOGRAPHED", "EVENING", "OVERCAST", "BLACKOUT"]


def test_the_colors_of_the_sky_come_back_after_overcast():
    """Of a sky that is the same in all directions and of one that is not."""
    for sh in ([[0.0, 1.0, 0.0]], [[0.0, 1.0, 0.0], [0, 0, 0], [0, 0, 0.3], [0, 0, 0]]):
        result = room(mesh=sides_of_box(4), outside=OutsideLight(np.array(sh) / 0.28209479))
        built = build_scene(result)
        photographed = floor(built)
        set_look(built.scene, "OVERCAST")
        overcast = floor(built)
        np.testing.assert_allclose(overcast, photographed @ LUMINANCE, rtol=0.02)
        for made in (built.scene.world, *built.scene.objects):
            made[MADE] = True
        with as_photographed(built.scene):
            np.testing.assert_allclose(floor(built), photographed, rtol=0.02, atol=1e-5)
        np.testing.assert_allclose(floor(built), overcast, rtol=0.02)
        set_look(built.scene, "EVENING")
        np.testing.assert_allclose(floor(built), photographed * 0.05, rtol=0.02, atol=1e-5)


def test_a_gray_sky_is_not_exported_to_a_farm_as_if_it_had_its_colors():
    built = lit()
    view = camera(fx=40.0, fy=40.0)
    look_through(built.scene, view, add_camera(view, "photo", built.scene.collection))
    assert relit_frames(built.scene, np.eye(4))[1]["outside"] == 1.0
    set_look(built.scene, "OVERCAST")
    with pytest.raises(BadInput, match="is gray"):
        relit_frames(built.scene, np.eye(4))


def test_what_was_photographed_has_the_sun_even_while_a_look_hides_it():
    built = lit()
    photographed = floor(built)
    set_look(built.scene, "BLACKOUT")
    with as_recovered([], built.scene.objects):
        assert floor(built)[0] == pytest.approx(photographed[0], rel=0.05)
    assert floor(built).max() < 1e-4


def test_a_saved_look_brings_back_the_same_light():
    built = lit()
    scene, (lamp,) = built.scene, lamp_materials(built.scene.objects)
    assert not own_looks(scene)
    set_strength(lamp, 2.0)
    set_color(lamp, (1.0, 0.5, 0.25))
    background = outside_light(scene.world)
    assert background is not None and built.sun is not None
    background.inputs["Strength"].default_value = 0.3
    built.sun.rotation_mode, built.sun.rotation_euler, built.sun.data.energy = "XYZ", (0.8, 0.1, 0.2), 3.0
    mine = floor(built)
    save_look(scene, "Dusk")
    switch(lamp, False)
    save_look(scene, "Dusk, lamp off")
    assert own_looks(scene) == ["Dusk", "Dusk, lamp off"]
    for look in ("BLACKOUT", "PHOTOGRAPHED"):
        set_look(scene, look)
        set_own_look(scene, "Dusk")
        np.testing.assert_allclose(floor(built), mine, rtol=0.02)
    set_own_look(scene, "Dusk, lamp off")
    assert floor(built)[2] < 1e-4 < mine[2]
    switch(lamp, True)
    np.testing.assert_allclose(floor(built), mine, rtol=0.02)  # a lamp that is off keeps its strength and colour
    forget_look(scene, "Dusk")
    assert own_looks(scene) == ["Dusk, lamp off"]


def two_lamps(first: np.ndarray, second: np.ndarray, sky: float = SKY) -> BuiltScene:
    """A floor under a green sky and a red sun, between two walls that are lamps."""
    outside = OutsideLight(np.array([[0.0, sky, 0.0]]) / 0.28209479)
    result = room(mesh=sides_of_box(4, 0, 1), emission={1: first, 2: second}, outside=outside)
    return build_scene(replace(result, sun=Sunlight(np.array([0.0, 0.0, 1.0]), SUN)))


def test_a_look_is_a_share_of_what_another_result_recovered(tmp_path: Path):
    built = two_lamps(LAMP, LAMP / 2)
    first, second = lamp_materials(built.scene.objects)
    set_strength(first, 2.0)  # of 4
    switch(second, False)
    sky_strength(built.scene.world).default_value = 0.25
    built.sun.data.energy = 1.0  # of 2
    dim = floor(built)
    write_preset(tmp_path, "Dim", save_look(built.scene, "Dim"))
    kept = built.scene["iris_own_looks"]["Dim"]
    brighter = two_lamps(LAMP * 3, LAMP)
    brighter.scene["iris_own_looks"] = {"Dim": kept}
    for name, material in zip("ab", lamp_materials(brighter.scene.objects), strict=True):
        material.name = name  # as of a result that names its lamps in another way: the ids tell
    set_own_look(brighter.scene, "Dim")
    np.testing.assert_allclose(floor(brighter), dim * (1, 1, 3), rtol=0.02, atol=1e-4)


def test_a_preset_sets_the_lamps_that_it_names_and_others_as_most_were(tmp_path: Path):
    built = two_lamps(LAMP, LAMP)
    first, second = lamp_materials(built.scene.objects)
    first.name = "Desk Lamp"
    switch(first, False)
    set_strength(second, 1.0)  # of 4
    set_color(second, (1.0, 0.5, 0.25))
    sky_strength(built.scene.world).default_value = 0.0
    built.sun.rotation_mode, built.sun.rotation_euler, built.sun.hide_render = "XYZ", (0.8, 0.1, 0.2), True
    write_preset(tmp_path, "Late", save_look(built.scene, "Late"))
    other = two_lamps(LAMP * 2, LAMP * 2)
    where = other.sun.matrix_basis.copy()
    third, fourth = lamp_materials(other.scene.objects)
    third.name, fourth.name = "Ceiling", "Reading Lamp"
    show_look(other.scene, read_preset(tmp_path, "Late"))
    for lamp in (third, fourth):  # nothing here is called as the lamps there
        assert lamp_setting(lamp) == (True, pytest.approx(2.0), pytest.approx((1.0, 0.5, 0.25)))
    assert sky_strength(other.scene.world).default_value == 0.0 and other.sun.hide_render
    np.testing.assert_allclose(np.array(other.sun.matrix_basis), np.array(where), atol=1e-6)
    third.name = "Desk Lamp.001"
    first.name, third.name = "Gone", "Desk Lamp"
    show_look(other.scene, read_preset(tmp_path, "Late"))
    assert not is_on(third) and is_on(fourth)


def test_presets_have_any_name_and_stay_in_their_folder(tmp_path: Path):
    folder = tmp_path / "presets"
    assert preset_names(folder) == []
    names = ["..", ".", "../out", "50 %", "Dämmerung", "a/b", "a.b"]
    for name in names:
        write_preset(folder, name, {"named": [], "outside": 0.5})
    assert preset_names(folder) == sorted(names) and list(tmp_path.iterdir()) == [folder]
    for name in names:
        assert read_preset(folder, name) == {"named": [], "outside": 0.5}
        remove_preset(folder, name)
    assert preset_names(folder) == []


@pytest.mark.parametrize(
    "content",
    [
        "[]",
        '{"outside": -1}',
        '{"outside": "__import__(1)"}',
        '{"lamps": {"on": 1}}',
        '{"sun": {"strength": 1e99}}',
        '{"lamps": {"color": [1, 2]}}',
        '{"named": [{"on": true}]}',
        '{"named": 3}',
        '{"script": "x"}',
    ],
)
def test_a_preset_that_is_no_look_is_refused(tmp_path: Path, content: str):
    (tmp_path / "x.json").write_text(content)
    with pytest.raises(BadInput):
        read_preset(tmp_path, "x")


def test_solo_leaves_one_of_two_lamps_on_and_pressed_again_both():
    built = two_lamps(LAMP, LAMP)
    first, second = lamp_materials(built.scene.objects)
    for pressed, shining in ((first, [first]), (second, [second]), (second, [first, second]), (second, [second])):
        solo(built.scene, pressed)
        assert [lamp for lamp in (first, second) if is_on(lamp)] == shining
        assert [is_solo(built.scene, lamp) for lamp in (first, second)] == [shining == [first], shining == [second]]
    assert (strength(first), strength(second)) == (4.0, 4.0)


def test_each_light_state_of_the_photos_is_a_look():
    red, blue, dim = np.array([2.0, 0.0, 0.0]), LAMP, LAMP / 4
    sky = OutsideLight(np.array([[0.0, SKY, 0.0]]) / 0.28209479)
    plain = room(mesh=sides_of_box(4, 0, 1), emission={1: blue, 2: np.zeros(3)}, outside=sky)
    states = (
        LightState("blue", (), np.array([blue, np.zeros(3)]), sky),
        LightState("red", (), np.array([np.zeros(3), red]), None),
        LightState("dim", (), np.array([dim, red]), OutsideLight(sky.sh / 2)),
    )
    built = build_scene(replace(plain, light_states=states))
    keep_states(built.scene, replace(plain, light_states=states))
    assert own_looks(built.scene) == ["blue", "red", "dim"]
    light = {}
    for state in ("red", "dim", "blue"):
        set_own_look(built.scene, state)
        light[state] = floor(built)
    set_look(built.scene, "BLACKOUT")
    save_look(built.scene, "mine")
    assert own_looks(built.scene) == ["blue", "red", "dim", "mine"]
    forget_states(built.scene)  # as another result does
    assert own_looks(built.scene) == ["mine"]
    assert light["blue"][0] < 1e-4 < min(light["blue"][1:])
    assert light["red"][0] > 1e-2 and max(light["red"][1:]) < 1e-4
    np.testing.assert_allclose(light["dim"], light["red"] + light["blue"] * (0, 0.5, 0.25), rtol=0.05, atol=1e-4)


def test_a_lamp_that_is_off_in_the_first_state_can_be_switched_on():
    plain = room(emission={1: np.zeros(3), 2: LAMP})
    states = tuple(LightState(name, (), np.array(each)) for name, each in (("a", [[0, 0, 0], LAMP]), ("b", [LAMP] * 2)))
    scene = bpy.context.scene
    apply_to_scene(replace(plain, light_states=states), scene)
    first, second = lamp_materials(scene.objects)
    assert (strength(first), strength(second)) == (0.0, 4.0)
    set_own_look(scene, "b")
    assert (strength(first), strength(second)) == (4.0, 4.0)
    set_own_look(scene, "a")
    assert not is_on(first) and is_on(second)
