"""Burley's diffuse lobe as Blender nodes: what Cycles renders, and that exports come without it."""

import json
import struct
from dataclasses import replace

import bpy
import numpy as np
import pytest

from iris_addon.blender.apply.scene_files import apply
from iris_addon.blender.camera import add_camera, look_through
from iris_addon.blender.render.cycles import render_linear, set_cycles
from iris_addon.blender.scene_out.build import build_scene
from iris_addon.brdf.diffuse import albedo_gain
from iris_addon.brdf.ggx import layered_factor
from iris_addon.model.capture import Mesh
from iris_addon.model.recovered import OutsideLight
from iris_addon.model.render_settings import RenderSettings
from tests.blender_room import camera, room

pytestmark = pytest.mark.bpy

BURLEY = {"model": {"diffuse": {"lobe": "burley"}}}
PLANE = Mesh(
    np.array([[-90, -90, 0], [90, -90, 0], [90, 90, 0], [-90, 90, 0]], float),
    np.array([[0, 1, 2], [0, 2, 3]]),
    np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]], np.float32),
)
WHITE_WORLD = OutsideLight(np.full((1, 3), 1 / 0.28209479177387814))


@pytest.fixture(autouse=True)
def empty_blender():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def radiance_along(cosine: float, roughness: float, albedo: float, report: dict) -> float:
    """What a plane under a sky of radiance 1 sends towards a camera at this angle."""
    result = replace(room(albedo, outside=WHITE_WORLD, mesh=PLANE, roughness=roughness), report=report)
    sine = np.sqrt(1 - cosine**2)
    view = camera(width=4, height=4, fx=400.0, fy=400.0)
    view.c2w[:3] = np.array([[1, 0, 0, 0], [0, cosine, -sine, -3 * sine], [0, sine, cosine, 3 * cosine]])
    built = build_scene(result)
    set_cycles(built.scene, RenderSettings(samples=1024, denoise=False, seed=0, max_bounces=2))
    look_through(built.scene, view, add_camera(view, "view", built.scene.collection))
    value = float(render_linear(built.scene).mean())
    built.free()
    return value


@pytest.mark.parametrize("roughness", [0.2, 1.0])
@pytest.mark.parametrize("cosine", [0.25, 0.9])
def test_burleys_lobe_is_added_to_the_specular_one(roughness: float, cosine: float) -> None:
    """What albedo adds under a sky of one is its albedo from there: no more head-on, no less at grazing angles."""
    black, grey = (radiance_along(cosine, roughness, albedo, BURLEY) for albedo in (0.0, 0.5))
    factor = albedo_gain("burley", np.array(roughness), np.array(cosine))
    assert (grey - black) / 0.5 == pytest.approx(factor, rel=0.015)


@pytest.mark.parametrize("cosine", [0.25, 0.9])
def test_without_the_group_the_dielectric_attenuates_the_base(cosine: float) -> None:
    black, grey = (radiance_along(cosine, 0.2, albedo, {}) for albedo in (0.0, 0.5))
    assert (grey - black) / 0.5 == pytest.approx(layered_factor(np.array(0.2), np.array(cosine)), rel=0.015)


def test_exports_keep_the_texture_and_leave_the_lobe_out(tmp_path) -> None:
    apply(replace(room(0.5), report=BURLEY), tmp_path / "scene.blend", glb=tmp_path / "room.glb")
    with bpy.data.libraries.load(str(tmp_path / "scene.blend")) as (inside, _):
        assert any(name.startswith("IRIS Burley") for name in inside.node_groups)
    data = (tmp_path / "room.glb").read_bytes()
    length = struct.unpack("<I", data[12:16])[0]
    materials = json.loads(data[20 : 20 + length])["materials"]
    assert any("baseColorTexture" in m.get("pbrMetallicRoughness", {}) for m in materials)
