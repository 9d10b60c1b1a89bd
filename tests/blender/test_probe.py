"""HDRI probes: what a mirror ball at their place shows, laid out as environment textures read it."""

from dataclasses import replace

import bpy
import numpy as np
import pytest

from iris_addon.base.images import read_exr
from iris_addon.blender.insert.probe import probe_result
from iris_addon.blender.render.cycles import render_views
from iris_addon.edits.jobs import relight_edit
from iris_addon.edits.scene_edit import SceneEdit, Sphere
from iris_addon.model.capture import Camera
from iris_addon.model.recovered import Textures
from iris_addon.model.render_settings import RenderSettings
from iris_addon.model.response import srgb
from tests.blender_room import box, room

pytestmark = pytest.mark.bpy

AT, RADIUS = np.array([0.4, -0.3, 0.2]), 0.01
EYE = np.array([-0.9, 0.5, 0.6])
QUALITY = RenderSettings(samples=96, denoise=False, max_bounces=2)


@pytest.fixture(autouse=True)
def empty_blender():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def painted_room():
    """A box of 2 m with a wall of another colour to each side, and a lamp all over its ceiling."""
    mesh = box()
    cells = np.array([[(side + 0.5) / 8, 0.5] for side in range(6)], np.float32)
    mesh = replace(mesh, uv=np.repeat(cells, 2, axis=0)[:, None].repeat(3, axis=1))
    color = np.zeros((8, 8, 3), np.float32)
    color[:, :6] = [
        (0.8, 0.1, 0.1),
        (0.1, 0.7, 0.2),
        (0.1, 0.2, 0.8),
        (0.8, 0.7, 0.1),
        (0.3, 0.3, 0.3),
        (0.7, 0.2, 0.7),
    ]
    flat = np.ones((8, 8), np.float32)
    base = room(mesh=mesh, emission={5: (1.0, 0.9, 0.8)})
    return replace(base, textures=Textures(color, flat, 0 * flat, flat))


def looking(at: np.ndarray, eye: np.ndarray, size: int, focal: float) -> Camera:
    """A square picture with ``at`` in its middle."""
    z = (eye - at) / np.linalg.norm(eye - at)
    x = np.cross([0, 0, 1], z)
    x /= np.linalg.norm(x)
    c2w = np.eye(4)
    c2w[:3, :3], c2w[:3, 3] = np.stack([x, np.cross(z, x), z], 1), eye
    return Camera(width=size, height=size, fx=focal, fy=focal, cx=size / 2, cy=size / 2, c2w=c2w)


def looked_up(panorama: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(..., 3) of the texels that Blender's environment texture takes for unit ``directions``, without filter."""
    height, width = panorama.shape[:2]
    u = 0.5 - np.arctan2(directions[..., 1], directions[..., 0]) / (2 * np.pi)
    v = 0.5 - np.arcsin(np.clip(directions[..., 2], -1, 1)) / np.pi
    return panorama[np.clip(v * height, 0, height - 1).astype(int), (u * width).astype(int) % width]


def mirror_ball(panorama: np.ndarray, camera: Camera, fine: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """What a mirror ball at ``AT`` shows to ``camera``, from the probe alone, and (H, W) which pixels are all ball."""
    n = camera.width * fine
    pixel = (np.arange(n) + 0.5) / fine
    i, j = np.meshgrid(pixel, pixel)
    local = np.stack([(i - camera.cx) / camera.fx, -(j - camera.cy) / camera.fy, -np.ones_like(i)], -1)
    rays = local @ camera.c2w[:3, :3].T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    offset = camera.c2w[:3, 3] - AT
    along = rays @ offset
    room_ = along**2 - offset @ offset + RADIUS**2
    hit = room_ > 0
    distance = -along - np.sqrt(np.maximum(room_, 0))
    normal = (offset + distance[..., None] * rays) / RADIUS
    reflected = rays - 2 * (rays * normal).sum(-1, keepdims=True) * normal
    shown = looked_up(panorama, reflected).reshape(camera.height, fine, camera.width, fine, 3).mean((1, 3))
    return shown, hit.reshape(camera.height, fine, camera.width, fine).all((1, 3))


def decibels(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((a - b) ** 2)))


def test_a_mirror_ball_shows_what_the_probe_holds(tmp_path):
    """The ball has a hundredth of the room's size, so that parallax moves nothing by more than half a degree."""
    result = painted_room()
    probe_result(result, AT, tmp_path / "probe.exr", width=256, settings=QUALITY)
    panorama = read_exr(tmp_path / "probe.exr")
    assert panorama.shape == (128, 256, 3)
    camera = looking(AT, EYE, 32, 32 * np.linalg.norm(EYE - AT) / (2.4 * RADIUS))
    mirror = Sphere(center=AT, radius=RADIUS, base_color=np.ones(3), roughness=0.0, metallic=1.0)
    (seen,) = render_views(result, [camera], edit=SceneEdit(spheres=(mirror,)), settings=QUALITY)
    shown, ball = mirror_ball(panorama, camera)
    assert 0.4 < ball.mean() < 0.7
    assert decibels(srgb(np.clip(shown, 0, 1))[ball], srgb(np.clip(seen, 0, 1))[ball]) >= 35
    turned = mirror_ball(np.roll(panorama, 32, axis=1), camera)[0]
    assert decibels(srgb(np.clip(turned, 0, 1))[ball], srgb(np.clip(seen, 0, 1))[ball]) < 25


def test_a_probe_lights_as_the_room_it_was_taken_in(tmp_path):
    """Also of a capture whose up is +y: as a panorama of ``relight`` it shows what stood around the point."""
    result = replace(painted_room(), up=(0.0, 1.0, 0.0))
    probe_result(result, AT, tmp_path / "probe.exr", width=256, settings=QUALITY)
    view = looking(AT + [0.7, 0.7, 0.1], AT, 24, 12.0)
    (inside,) = render_views(result, [view], settings=QUALITY)
    far = replace(room(), mesh=replace(room().mesh, vertices=room().mesh.vertices + [0, 0, 1e4]), up=result.up)
    edit = relight_edit(far, {"lights": [{"type": "hdri", "file": "probe.exr"}]}, tmp_path)
    (around,) = render_views(far, [view], edit=edit, settings=QUALITY)
    assert decibels(srgb(np.clip(around, 0, 1)), srgb(np.clip(inside, 0, 1))) > 30
