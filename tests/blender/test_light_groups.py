"""A light group per lamp: the shares add up to the picture, and mixing them is relighting."""

from dataclasses import replace

import bpy
import numpy as np
import pytest

from iris_addon.base.errors import BadInput
from iris_addon.blender.apply.camera_look import add_compositing
from iris_addon.blender.render.cycles import render_linear, render_views, set_cycles
from iris_addon.blender.render.light_groups import MIX_GROUP, render_light_shares
from iris_addon.blender.scene_out.build import build_scene
from iris_addon.blender.version import can_denoise
from iris_addon.edits.jobs import relight_edit
from iris_addon.edits.light_shares import light_gains, mix_shares, read_shares, write_shares
from iris_addon.model.recovered import OutsideLight
from iris_addon.model.render_settings import RenderSettings
from iris_addon.model.response import identity
from tests.blender_room import box, camera, room

pytestmark = pytest.mark.bpy

LAMPS = ["IRIS Lamp 00", "IRIS Lamp 01"]
QUICK = RenderSettings(samples=64, denoise=False, max_bounces=6)
JOB = {"recovered": {"0": {"scale": 0.2, "color": [1, 0.2, 0.1]}, "1": {"scale": 3.0}}, "outside": 0.5}


@pytest.fixture(autouse=True)
def empty_blender():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def lit_room():
    """A box with one side open to a bright world and two lamps, seen from beside one of them."""
    mesh = box()
    open_mesh = replace(mesh, faces=mesh.faces[:-2], uv=mesh.uv[:-2])  # +z is gone
    sh = np.full((1, 3), 2.0)
    return room(albedo=(0.6, 0.5, 0.4), emission={3: (9, 8, 7), 0: (2, 3, 6)}, outside=OutsideLight(sh), mesh=open_mesh)


def view():
    return camera(20, 16, position=(0.2, 0.0, 0.9))


def rmse(a, b):
    return float(np.sqrt(np.mean((a - b) ** 2)))


def test_the_shares_of_all_lights_add_up_to_the_picture():
    light = render_light_shares(lit_room(), view(), settings=RenderSettings(samples=16, denoise=False))
    assert list(light.shares) == [*LAMPS, "IRIS Outside"]
    assert all(share.mean() > 0.01 for share in light.shares.values())
    np.testing.assert_allclose(mix_shares(light.shares, {}), light.combined, rtol=1e-4, atol=1e-5)
    off = relight_edit(lit_room(), {"recovered": {"1": {"off": True}}, "outside": 0})
    (alone,) = render_views(lit_room(), [view()], edit=off, settings=RenderSettings(samples=256, denoise=False))
    np.testing.assert_allclose(light.shares[LAMPS[0]].mean((0, 1)), alone.mean((0, 1)), rtol=0.05)


def test_mixing_is_rendering_again_with_the_lamps_changed():
    """The error of the mix is Monte-Carlo noise: no more than that between renders with other random numbers."""
    result, edit = lit_room(), relight_edit(lit_room(), JOB)
    light = render_light_shares(result, view(), settings=QUICK)
    mixed = mix_shares(light.shares, light_gains(result, JOB))
    again = [render_views(result, [view()], edit=edit, settings=replace(QUICK, seed=seed))[0] for seed in (1, 2, 3, 4)]
    truth = np.mean(again, axis=0)
    noise = np.mean([rmse(image, truth) for image in again]) * np.sqrt(4 / 3)  # of one render about the expected value
    # Lamps turned up bring their noise along; the mix samples them as they were.
    assert rmse(mixed, truth) < 1.5 * noise
    np.testing.assert_allclose(mixed.mean((0, 1)), truth.mean((0, 1)), rtol=0.02)


def test_denoised_shares_are_closer_to_the_light_of_each_lamp():
    result = lit_room()
    if not can_denoise():
        pytest.skip("this Blender was built without OpenImageDenoise")
    eye = camera(40, 32, fx=25.0, fy=25.0, position=(0.2, 0.0, 0.9))
    truth = render_light_shares(result, eye, settings=RenderSettings(samples=256, seed=5, denoise=False)).shares
    noisy = render_light_shares(result, eye, settings=RenderSettings(samples=8, denoise=False)).shares
    clean = render_light_shares(result, eye, settings=RenderSettings(samples=8)).shares
    for name, light in truth.items():
        wall = light.max(axis=-1) < 1.5  # not the rim of a lamp, where eight samples are all that counts
        assert rmse(clean[name][wall], light[wall]) < 0.7 * rmse(noisy[name][wall], light[wall])
        np.testing.assert_allclose(clean[name].mean((0, 1)), noisy[name].mean((0, 1)), rtol=0.05)


def test_new_lights_have_shares_too():
    spot = {"type": "spot", "position": [0, 0.5, 0], "direction": [0, -1, 0], "intensity": [0.5, 0, 0]}
    ball = {"type": "mesh", "shape": "sphere", "radius": 0.1, "location": [0, 0, -0.5], "radiance": [0, 4, 0]}
    edit = relight_edit(lit_room(), {"lights": [spot, ball]})
    light = render_light_shares(lit_room(), view(), edit=edit, settings=RenderSettings(samples=16, denoise=False))
    assert list(light.shares) == [*LAMPS, "IRIS Light 00", "IRIS Object 00", "IRIS Outside"]
    assert light.shares["IRIS Light 00"][..., 1:].max() == 0 < light.shares["IRIS Light 00"][..., 0].mean()
    assert light.shares["IRIS Object 00"][..., ::2].max() == 0 < light.shares["IRIS Object 00"][..., 1].mean()


def test_light_shares_survive_the_round_trip_to_disk(tmp_path):
    light = render_light_shares(lit_room(), view(), settings=RenderSettings(samples=1, denoise=False))
    write_shares(tmp_path / "a.exr", light)
    back = read_shares(tmp_path / "a.exr")
    np.testing.assert_array_equal(back.combined, light.combined)
    assert list(back.shares) == list(light.shares)
    for name in LAMPS:
        np.testing.assert_array_equal(back.shares[name], light.shares[name])
    (tmp_path / "b.exr").write_bytes(b"no")
    for name in ("b.exr", "c.exr"):
        with pytest.raises(BadInput, match=name):
            read_shares(tmp_path / name)


def test_what_shares_cannot_show_is_refused():
    lit = room(emission={4: (9, 0, 0)})
    with pytest.raises(BadInput, match="nothing to scale"):
        light_gains(lit, {"recovered": {"0": {"color": [0, 1, 0]}}})
    with pytest.raises(BadInput, match="adds 'lights'"):
        light_gains(lit, {"lights": [{"type": "sun"}]})
    assert light_gains(lit, {"recovered": {"all": {"off": True}}})["IRIS Lamp 00"].tolist() == [0, 0, 0]


def test_the_sliders_of_the_compositor_mix_the_same(monkeypatch):
    """Through the identity camera and without denoising the composited picture is the mix of the shares."""
    monkeypatch.setattr("iris_addon.blender.render.light_groups.can_denoise", lambda: False)
    result = lit_room()
    gains = light_gains(result, JOB)
    light = render_light_shares(result, view(), settings=RenderSettings(samples=8, max_bounces=4, denoise=False))

    from iris_addon.blender.camera import add_camera, look_through

    built = build_scene(result, lamps_apart=True)
    set_cycles(built.scene, RenderSettings(samples=8, denoise=False, seed=0, max_bounces=4))
    look_through(built.scene, view(), add_camera(view(), "view", built.scene.collection))
    exposure = np.full(3, 0.02)  # so that nothing clips
    add_compositing(built.scene, built.lamps, identity(), exposure)
    tree = built.scene.node_tree if bpy.app.version < (5, 0, 0) else built.scene.compositing_node_group
    sliders = tree.nodes[MIX_GROUP].inputs
    for name, gain in gains.items():
        strength = gain.max()
        sliders[f"{name} Strength"].default_value = strength
        sliders[f"{name} Color"].default_value = (*(gain / strength), 1.0)
    seen = render_linear(built.scene)  # decoded from sRGB: what the Standard view shows as the camera's values
    shown = np.where(seen <= 0.0031308, 12.92 * seen, 1.055 * np.maximum(seen, 1e-9) ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(shown, mix_shares(light.shares, gains) * 0.02, atol=2e-3)
