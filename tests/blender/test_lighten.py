"""A room with fewer faces: where it was, in its colors, as a file that reads back."""

from dataclasses import replace

import bpy
import numpy as np
import pytest

from iris_addon.blender.apply.lighten import Limits, decimate, on_borders
from iris_addon.blender.apply.scene_files import apply
from iris_addon.blender.scene_out.build import plain_mesh
from iris_addon.model.capture import Mesh
from iris_addon.model.recovered import Emitter
from tests.blender_room import room

pytestmark = pytest.mark.bpy

CELLS, CHARTS, SIDE = 120, 4, 512


@pytest.fixture(autouse=True)
def empty_blender():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def height(x, y):
    """Of a floor with dents of 2 cm that is 2 m wide."""
    return 0.02 * np.sin(3 * x) * np.cos(4 * y)


def floor() -> Mesh:
    """The floor in squares of triangles; 16 charts whose places on the atlas are those of others on the floor."""
    line = np.linspace(-1, 1, CELLS + 1)
    x, y = np.meshgrid(line, line, indexing="ij")
    vertices = np.stack([x, y, height(x, y)], -1).reshape(-1, 3)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(CELLS), np.arange(CELLS), indexing="ij"))
    a, b, c, d = (((i + di) * (CELLS + 1) + j + dj) for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1)))
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
    wide = CELLS // CHARTS
    chart = np.stack([np.tile(i, 2) // wide, np.tile(j, 2) // wide], -1)
    at = (vertices[faces][..., :2] + 1) / 2
    within = at * CHARTS - chart[:, None]  # 0 to 1 in its chart
    moved = np.stack([(chart[:, 0] + 1) % CHARTS, (3 * chart[:, 1] + chart[:, 0]) % CHARTS], -1)
    uv = (moved[:, None] + 0.05 + 0.9 * within) / CHARTS
    return Mesh(vertices, faces, uv.astype(np.float32))


def color_at(uv: np.ndarray) -> np.ndarray:
    """Where on the floor (x, y) the texel at ``uv`` belongs: the color that it ought to have."""
    cell = np.floor(uv * CHARTS).clip(0, CHARTS - 1)
    within = (uv * CHARTS - cell - 0.05) / 0.9
    first = (cell[..., 0] - 1) % CHARTS
    inverse = np.array(
        [[j for v in range(CHARTS) for j in range(CHARTS) if (3 * j + i) % CHARTS == v] for i in range(CHARTS)]
    )
    second = inverse[first.astype(int), cell[..., 1].astype(int)]
    return (np.stack([first, second], -1) + within) / CHARTS * 2 - 1


def triangles(data) -> tuple[np.ndarray, np.ndarray]:
    """Corners (F, 3, 3) and texture coordinates (F, 3, 2)."""
    data.calc_loop_triangles()
    n = len(data.loop_triangles)
    loops, corners = np.empty(3 * n, np.int32), np.empty(3 * n, np.int32)
    data.loop_triangles.foreach_get("loops", loops)
    data.loop_triangles.foreach_get("vertices", corners)
    points, uv = np.empty(3 * len(data.vertices), np.float32), np.empty(2 * len(data.loops), np.float32)
    data.vertices.foreach_get("co", points)
    data.uv_layers[0].uv.foreach_get("vector", uv)
    return points.reshape(-1, 3)[corners].reshape(n, 3, 3), uv.reshape(-1, 2)[loops].reshape(n, 3, 2)


@pytest.mark.parametrize("faces", [6000, 3000])
def test_fewer_faces_lie_where_the_surface_was_and_have_its_texture(faces):
    thing = bpy.data.objects.new("floor", plain_mesh(floor(), "floor"))
    bpy.context.scene.collection.objects.link(thing)
    assert len(thing.data.polygons) == 2 * CELLS**2 == 28_800
    assert 0.04 < on_borders(thing.data).mean() < 0.06
    decimate(bpy.context.scene, thing, faces)
    assert 0.5 * faces < len(thing.data.polygons) <= 1.02 * faces
    assert len(thing.modifiers) == len(thing.vertex_groups) == 0
    corners, uv = triangles(thing.data)
    weights = np.random.default_rng(0).dirichlet(np.ones(3), (len(corners), 4))
    point = np.einsum("fkc,fcd->fkd", weights, corners)
    texel = np.einsum("fkc,fcd->fkd", weights, uv)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    assert area.sum() == pytest.approx(4.0, rel=0.01)
    assert np.abs(point[..., 2] - height(point[..., 0], point[..., 1])).max() < 0.004
    off = np.linalg.norm(color_at(texel) - point[..., :2], axis=-1)
    wrong = (off > 0.05).mean(1) @ area / area.sum()
    assert wrong < 0.02, "share of the floor whose texture belongs more than 5 cm away"
    assert np.median(off) < 0.002


def test_a_room_that_is_light_stays_as_it_is():
    thing = bpy.data.objects.new("floor", plain_mesh(floor(), "floor"))
    bpy.context.scene.collection.objects.link(thing)
    data = thing.data
    decimate(bpy.context.scene, thing, 30_000)
    assert thing.data == data


def test_the_file_has_the_limits_and_keeps_lamps(tmp_path):
    lamp = np.arange(2 * CELLS**2 - 40, 2 * CELLS**2)
    made = room(mesh=floor())
    flat = np.ones((SIDE, SIDE), np.float32)
    textures = replace(
        made.textures,
        base_color=np.full((SIDE, SIDE, 3), 0.4, np.float32),
        roughness=flat,
        metallic=0 * flat,
        confidence=flat,
    )
    emitters = (Emitter(id=0, faces=lamp, radiance=np.array([9.0, 8, 7]), area=0.01, confidence=1.0),)
    result = replace(made, regions=np.zeros(2 * CELLS**2, np.int32), textures=textures, emitters=emitters)
    apply(result, None, glb=tmp_path / "whole.glb")
    apply(result, None, glb=tmp_path / "light.glb", light=Limits(faces=4000, side=128))
    sizes = [(tmp_path / f"{name}.glb").stat().st_size for name in ("whole", "light")]
    assert sizes[1] < 0.4 * sizes[0]
    bpy.ops.import_scene.gltf(filepath=str(tmp_path / "light.glb"))
    rooms = [thing for thing in bpy.data.objects if thing.type == "MESH"]
    assert 2000 < sum(len(thing.data.polygons) for thing in rooms) <= 4080
    shone = next(thing for thing in rooms if "Lamp" in thing.name)
    assert len(shone.data.polygons) == 40
    used = [image for image in bpy.data.images if image.size[0]]
    assert used and all(tuple(image.size) == (128, 128) for image in used)
    base = next(image for image in used if "Base Color" in image.name)
    from iris_addon.blender.scene_out.materials import layer_transmittance
    from iris_addon.model.response import srgb

    expected = srgb(np.array(0.4 / layer_transmittance(1.0)))
    assert np.array(base.pixels[:3]) == pytest.approx(np.full(3, expected), abs=0.02)
