"""Differential rendering onto photos: what must not change, what must, and what noise may do."""

from dataclasses import replace

import bpy
import numpy as np
import pytest

from iris_addon.blender.insert.differential import (
    Differential,
    change_photo,
    insert_onto_photo,
    render_change,
    render_differential,
    render_pair,
    shrunk_difference,
    unchanged_photo,
)
from iris_addon.blender.render import cycles as blender_render
from iris_addon.blender.render.cycles import aim, render_views
from iris_addon.blender.scene_out.build import build_scene
from iris_addon.edits.scene_edit import Material, Placement, Primitive, SceneEdit, Sphere
from iris_addon.model.render_settings import RenderSettings
from iris_addon.model.response import gamma
from tests.blender_room import camera, room

EXPOSURE = np.array([0.2, 0.2, 0.2])
SETTINGS = RenderSettings(samples=32, seed=0, max_bounces=4)


def blank(height=20, width=30, value=1.0):
    return np.full((height, width, 3), value)


# ---- without Blender -----------------------------------------------------------------------------------------------


def test_noise_is_shrunk_away_and_a_shadow_is_not():
    rng = np.random.default_rng(0)
    shadow = np.zeros((60, 80, 3))
    shadow[20:40, 20:50] = -0.2
    noise = [rng.normal(0, 0.02, shadow.shape) for _ in range(2)]
    found = shrunk_difference((shadow + noise[0], shadow + noise[1]))
    mean_noise = np.std(noise[0] + noise[1]) / 2
    assert np.std(found[50:, 60:]) < 0.35 * mean_noise
    assert found[25:35, 25:45].mean() == pytest.approx(-0.2, rel=0.01)
    assert np.abs(shrunk_difference((np.zeros_like(shadow),) * 2)).max() == 0.0


def changed(change, with_edit=None, covered=0.0, without=1.0):
    without = blank(value=without)
    with_edit = without + change if with_edit is None else blank(value=with_edit)
    return Differential(without, with_edit, blank(value=change), np.full(without.shape[:2], covered))


def test_a_photo_without_change_of_light_keeps_its_pixels():
    photo = np.random.default_rng(1).integers(0, 256, (20, 30, 3)) / 255
    same = change_photo(photo, changed(0.0), gamma(), EXPOSURE).display
    np.testing.assert_array_equal(same, photo)


def test_gained_light_gets_the_local_exposure_of_the_photo():
    """Of a photo whose corners a lens darkened to half, what a lamp adds is darkened there too."""
    photo = gamma().apply(blank(value=0.1))
    at_places = EXPOSURE * np.linspace(1.0, 0.5, 30)[:, None]
    lit = change_photo(photo, changed(1.0), gamma(), at_places)
    np.testing.assert_allclose(gamma().invert(lit.display)[0, [0, -1], 0], [0.1 + 0.2, 0.1 + 0.1], rtol=1e-3)
    np.testing.assert_allclose(lit.radiance[0, [0, -1], 0], [0.1 / 0.2 + 1, 0.1 / 0.1 + 1], rtol=1e-3)


def test_a_shadow_scales_what_the_photo_shows_and_never_goes_below_black():
    photo = gamma().apply(np.random.default_rng(1).uniform(0, 0.5, (20, 30, 3)))
    radiance = change_photo(photo, changed(-0.25), gamma(), EXPOSURE).radiance
    np.testing.assert_allclose(radiance * EXPOSURE, 0.75 * gamma().invert(photo), rtol=1e-9, atol=1e-12)
    black = change_photo(photo, changed(-3.0), gamma(), EXPOSURE).display
    np.testing.assert_allclose(black, 0.0, atol=1e-9)


def test_clipped_pixels_keep_the_light_of_the_render():
    """A wall four times as bright as white stays white in half a shadow; at saturation itself the shadow shows."""
    white = blank()
    kept = change_photo(white, changed(-10.0, without=20.0), gamma(), EXPOSURE).display
    np.testing.assert_array_equal(kept, 1.0)
    shaded = change_photo(white, changed(-2.5, without=5.0), gamma(), EXPOSURE).display
    np.testing.assert_allclose(shaded, gamma().apply(blank(value=0.5)), rtol=1e-9)


def test_the_edge_of_an_object_blends_render_and_photo():
    photo = gamma().apply(blank(value=0.3))
    half = change_photo(photo, changed(0.0, with_edit=0.8, covered=0.5), gamma(), EXPOSURE).display
    # Half of the pixel is the object (the render less half the wall), half is the wall of the photo.
    expected = (0.8 - 0.5 * 1.0) * 0.2 + 0.5 * 0.3
    np.testing.assert_allclose(half, gamma().apply(blank(value=expected)), rtol=1e-6)


def test_the_plate_is_the_photo_without_the_change():
    photo = gamma().apply(blank(value=0.3))
    lit, same = (change_photo(photo, changed(change), gamma(), EXPOSURE) for change in (1.0, 0.0))
    np.testing.assert_array_equal(lit.plate, same.radiance)
    np.testing.assert_array_equal(lit.plate, unchanged_photo(photo, gamma(), EXPOSURE).plate)
    assert (lit.radiance > lit.plate).all() and not lit.shows_added


def test_a_photo_of_radiance_keeps_its_unit():
    photo = blank(value=0.3)
    lit = change_photo(photo, changed(1.0), None, EXPOSURE)
    assert lit.display is None and lit.plate is photo
    np.testing.assert_allclose(lit.radiance, photo + EXPOSURE)


# ---- in Cycles -----------------------------------------------------------------------------------------------------


@pytest.fixture
def empty_blender():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def lit_room(roughness=1.0, metallic=0.0):
    """A box with a lamp in its ceiling (+y) and grey walls."""
    made = room(albedo=(0.5, 0.45, 0.4), emission={3: (12, 11, 10)}, roughness=roughness)
    flat = np.full((32, 32), metallic, np.float32)
    textures = replace(made.textures, metallic=flat) if metallic else made.textures
    return replace(made, textures=textures, response=gamma(), up=(0.0, 1.0, 0.0))


def photo_of(result, view, seed=100):
    """What a camera sees: a render of its own random numbers, in bytes."""
    (radiance,) = render_views(result, [view], settings=RenderSettings(samples=256, seed=seed, max_bounces=4))
    return np.round(gamma().apply(radiance * EXPOSURE) * 255) / 255


@pytest.mark.bpy
@pytest.mark.usefixtures("empty_blender")
def test_a_card_of_the_walls_albedo_flat_on_the_wall_is_invisible():
    result, view = lit_room(), camera(48, 36, fx=40.0, fy=40.0)
    photo = photo_of(result, view)
    material = Material(base_color=(0.5, 0.45, 0.4), roughness=1.0)
    card = Primitive("card", (0.5, 0.4, 1.0), Placement((0.1, 0.0, -0.95), snap="surface"), material)
    edit = SceneEdit(objects=(card,))
    without = render_pair(result, view, None, SETTINGS)
    change = render_change(result, view, edit, without, SETTINGS)
    assert 0.05 < change.covered.mean() < 0.5  # it is there
    seen = change_photo(photo, change, result.response, EXPOSURE).display
    assert np.abs(seen - photo).mean() * 255 < 2.0
    inside = change.covered >= 1.0
    assert abs((seen - photo)[inside].mean()) * 255 < 2.0


@pytest.mark.bpy
@pytest.mark.usefixtures("empty_blender")
def test_a_polished_wall_shows_the_object_and_far_pixels_keep_their_bytes():
    result, view = lit_room(roughness=0.05, metallic=1.0), camera(40, 30, fx=20.0, fy=20.0, position=(0, 0, 0.5))
    photo = photo_of(result, view)
    ball = Sphere(
        center=np.array([0.5, -0.2, -0.6]),
        radius=0.2,
        base_color=np.array([0.0, 0.9, 0.0]),
        roughness=1.0,
        metallic=0.0,
    )
    seen = insert_onto_photo(result, view, photo, EXPOSURE, SceneEdit(spheres=(ball,)), SETTINGS)
    greener = (seen - photo)[..., 1] - (seen - photo)[..., 0]
    # The wall z = -1 shows it as if it stood at z = -1.4; x / depth gives the columns, y / depth the rows.
    column, row = int(20 + 20 * 0.5 / 1.9), int(15 + 20 * 0.2 / 1.9)
    right_of_ball = greener[row, column]
    assert right_of_ball > 0.02
    matte = lit_room()
    photo = photo_of(matte, view)
    seen = insert_onto_photo(matte, view, photo, EXPOSURE, SceneEdit(spheres=(ball,)), SETTINGS)
    assert np.abs(seen - photo)[:, :8].mean() * 255 < 1.5


@pytest.mark.bpy
@pytest.mark.usefixtures("empty_blender")
def test_what_is_inserted_has_less_noise_than_the_room_and_the_scene_stays_as_it_was(monkeypatch):
    """A small ball has some six times the samples of the wall beside it, undenoised."""
    monkeypatch.setattr(blender_render, "can_denoise", lambda: False)
    result, view = lit_room(), camera(96, 72, fx=80.0, fy=80.0)
    ball = Sphere(
        center=np.array([0.0, 0.0, -0.8]),
        radius=0.1,
        base_color=np.array([0.5, 0.45, 0.4]),
        roughness=1.0,
        metallic=0.0,
    )
    built = build_scene(result, SceneEdit(spheres=(ball,)))
    try:
        aim(built, view)
        room = (built.room, *built.lamps)
        black = (np.zeros((72, 96, 3)),) * 2
        seen = [
            render_differential(built.scene, room, black, RenderSettings(samples=16, seed=seed, max_bounces=2))
            for seed in range(8)
        ]
        assert not built.scene.render.film_transparent and not built.scene.render.use_border
        assert not any(thing.is_holdout for thing in room)
    finally:
        built.free()
    inside = seen[0].covered >= 1.0
    assert 80 < inside.sum() < 72 * 96 / 16
    pixels = np.stack([change.with_edit for change in seen])
    relative = (pixels.std(axis=0) / pixels.mean(axis=0)).mean(axis=-1)
    beside = np.zeros_like(inside)
    beside[28:44, 66:80] = True
    assert np.median(relative[inside]) < 0.55 * np.median(relative[beside])


@pytest.mark.bpy
@pytest.mark.usefixtures("empty_blender")
def test_occluded_objects_stay_hidden():
    """The ball is behind the wall of the box: the photo is left alone."""
    result, view = lit_room(), camera(24, 18)
    photo = np.random.default_rng(0).integers(0, 256, (18, 24, 3)) / 255
    ball = Sphere(
        center=np.array([0.0, 0.0, -2.0]), radius=0.4, base_color=np.array([0.9, 0.9, 0.9]), roughness=1.0, metallic=0.0
    )
    seen = insert_onto_photo(result, view, photo, EXPOSURE, SceneEdit(spheres=(ball,)), SETTINGS)
    np.testing.assert_array_equal(np.round(seen * 255), np.round(photo * 255))
