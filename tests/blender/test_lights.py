"""New lights have the radiometry the job says; objects stand where the job puts them."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from mathutils import Vector

from iris_addon.base.errors import BadInput
from iris_addon.base.images import write_exr
from iris_addon.blender.render.cycles import render_views
from iris_addon.blender.scene_out import placing
from iris_addon.blender.scene_out.build import build_scene
from iris_addon.blender.scene_out.lights import as_recovered
from iris_addon.blender.scene_out.placing import Room
from iris_addon.edits.jobs import insertion_edits, relight_edit
from iris_addon.edits.scene_edit import Material, Placement, Primitive, SceneEdit
from iris_addon.model.capture import Mesh
from iris_addon.model.recovered import Sunlight
from iris_addon.model.render_settings import RenderSettings
from tests.blender_room import camera, room

pytestmark = pytest.mark.bpy

ALBEDO = 0.5
QUICK = RenderSettings(samples=64, denoise=False, max_bounces=0)


@pytest.fixture(autouse=True)
def empty_blender():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def floor() -> Mesh:
    """A square of 20 m at z = 0 that faces +z."""
    corners = np.array([[-10, -10, 0], [10, -10, 0], [10, 10, 0], [-10, 10, 0]], float)
    uv = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]], np.float32)
    return Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), uv)


def seen_from_above(light, folder=None, time=0.0, **view):
    """(H, W, 3) radiance of the floor right below (0, 0, 1)."""
    result = room(albedo=ALBEDO, mesh=floor())
    edit = relight_edit(result, {"lights": [light]}, folder, time)
    above = camera(fx=400.0, fy=400.0, position=(0, 0, 1), **view)
    (image,) = render_views(result, [above], edit=edit, settings=QUICK)
    return image


def reflected(irradiance):
    """Radiance of the floor straight up: Lambert, and a little of the rough dielectric that covers it."""
    return ALBEDO * np.asarray(irradiance) / np.pi


COLOR = np.array([3.0, 2.0, 1.0])


@pytest.mark.parametrize(
    ("light", "irradiance"),
    [
        ({"type": "point", "position": [0, 0, 2], "intensity": COLOR.tolist()}, COLOR / 4),
        (
            {"type": "spot", "position": [0, 0, 2], "target": [0, 0, 0], "intensity": COLOR.tolist(), "angle": 20},
            COLOR / 4,
        ),
        ({"type": "sun", "direction": [0, 0, -1], "irradiance": COLOR.tolist()}, COLOR),
        ({"type": "sun", "direction": [0.6, 0, -0.8], "irradiance": COLOR.tolist()}, 0.8 * COLOR),
        (
            {
                "type": "area",
                "center": [0, 0, 3],
                "direction": [0, 0, -1],
                "size": [0.2, 0.1],
                "radiance": COLOR.tolist(),
            },
            COLOR * 0.02 / 9,
        ),
        (
            {"type": "mesh", "shape": "sphere", "radius": 0.1, "location": [0, 0, 3], "radiance": COLOR.tolist()},
            COLOR * np.pi * 0.01 / 9,
        ),
    ],
)
def test_the_floor_receives_the_irradiance_of_the_light(light, irradiance):
    seen = seen_from_above(light).mean(axis=(0, 1))
    np.testing.assert_allclose(seen, reflected(irradiance), rtol=0.08)  # 4 % is the dielectric's lobe
    np.testing.assert_allclose(seen / seen[0], irradiance / irradiance[0], rtol=0.03)


def test_light_and_cameras_pass_a_pane_as_if_it_were_not_there():
    """Sun, camera and what it sees behind: the recovered light has lost already what glass takes."""
    ground = floor()
    above = replace(
        ground,
        vertices=np.concatenate([ground.vertices, ground.vertices + [0, 0, 0.5]]),
        faces=np.concatenate([ground.faces, ground.faces + 4]),
        uv=np.concatenate([ground.uv, ground.uv]),
    )
    view = camera(fx=400.0, fy=400.0, position=(0, 0, 1))

    def seen(mesh, panes):
        result = replace(room(albedo=ALBEDO, mesh=mesh), panes=np.array(panes, np.int64))
        edit = relight_edit(result, {"lights": [{"type": "sun", "direction": [0.6, 0, -0.8], "irradiance": [3, 2, 1]}]})
        (image,) = render_views(result, [view], edit=edit, settings=QUICK)
        return image.mean(axis=(0, 1))

    bare = seen(ground, [])
    np.testing.assert_allclose(seen(above, [2, 3]), bare, rtol=0.01)
    assert not np.allclose(seen(above, []), 0) and bare.min() > 0


def test_a_spot_is_dark_outside_its_cone():
    light = {"type": "spot", "position": [0, 0, 2], "direction": [1, 0, -1], "intensity": 5, "angle": 30, "radius": 0}
    assert seen_from_above(light).max() == 0.0


def test_a_panorama_lights_from_the_side_its_pixels_are_on(tmp_path):
    """A picture that is bright on one side only, seen by a floor and by a wall through a turn of 90 degrees."""
    pixels = np.zeros((32, 64, 3), np.float32)
    pixels[:16] = 2.0  # the upper half: a sky of radiance 2 gives the irradiance 2 π
    write_exr(tmp_path / "sky.exr", pixels)
    seen = seen_from_above({"type": "hdri", "file": "sky.exr", "scale": 0.5}, tmp_path)
    np.testing.assert_allclose(seen.mean(axis=(0, 1)), ALBEDO * 1.0, rtol=0.1)

    pixels[:] = 0.0
    pixels[:, 24:40] = 1.0  # a quarter of the horizon around +x
    write_exr(tmp_path / "side.exr", pixels)
    out = camera(fx=40.0, fy=40.0)
    out.c2w[:3, :3] = np.array([[0, 0, -1], [-1, 0, 0], [0, 1, 0]], float)  # looks along +x
    far = Mesh(floor().vertices - [0, 0, 50], floor().faces, floor().uv)
    result = room(mesh=far)
    for rotation, expected in ((0, 1.0), (90, 0.0), (180, 0.0), (270, 0.0)):
        light = {"type": "hdri", "file": "side.exr", "rotation": rotation}
        (image,) = render_views(result, [out], edit=relight_edit(result, {"lights": [light]}, tmp_path), settings=QUICK)
        np.testing.assert_allclose(image.mean(), expected, atol=0.01)


def test_a_panorama_that_is_no_image_is_named(tmp_path):
    """Blender itself would show black."""
    write_exr(tmp_path / "side.exr", np.ones((32, 64, 3)))
    result, whole = room(mesh=floor()), (tmp_path / "side.exr").read_bytes()
    for name, content in (("junk.exr", b"no picture"), ("cut.exr", whole[:200]), ("junk.hdr", b"#?RADIANCE\n")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(BadInput, match=name):
            build_scene(result, relight_edit(result, {"lights": [{"type": "hdri", "file": name}]}, tmp_path))
    with pytest.raises(BadInput, match=r"none\.exr"):
        build_scene(result, relight_edit(result, {"lights": [{"type": "hdri", "file": "none.exr"}]}, tmp_path))


def test_a_turntable_carries_a_light_around():
    spot = {"type": "point", "position": [0.5, 0, 1], "intensity": 1, "turntable": {"turns": 1}}
    result = room()
    for time, at in ((0.0, [0.5, 0, 1]), (0.25, [0, 0.5, 1]), (0.5, [-0.5, 0, 1])):
        (light,) = relight_edit(result, {"lights": [spot]}, time=time).lights
        np.testing.assert_allclose(light.position, at, atol=1e-12)


# ---- objects -------------------------------------------------------------------------------------------------------


def placed_vertices(placement, shape="box", size=(0.2, 0.2, 0.4)):
    """(n, 3) world positions of a shape in the box room, whose up vector is +z."""
    thing = Primitive(shape, size, placement, Material())
    built = build_scene(room(), SceneEdit(objects=(thing,)))
    built.scene.view_layers[0].update()
    (shape_object,) = (thing for thing in built.inserted if thing.type == "MESH")
    vertices = np.array([(shape_object.matrix_world @ vertex.co)[:] for vertex in shape_object.data.vertices])
    built.free()
    return vertices


def test_an_object_falls_onto_the_floor_and_has_its_height_in_metres():
    for rotation in ((0, 0, 0), (90, 0, 30), (20, 40, 0)):
        stands = placed_vertices(Placement((0.3, 0.2, 0.5), rotation=rotation, height=0.25, snap="down"))
        assert stands[:, 2].min() == pytest.approx(-1.0, abs=5e-4)
        assert np.ptp(stands[:, 2]) == pytest.approx(0.25, rel=1e-5)
        np.testing.assert_allclose((stands.min(0) + stands.max(0))[:2] / 2, [0.3, 0.2], atol=1e-5)


def test_an_object_hangs_on_the_nearest_wall_and_faces_away_from_it():
    card = placed_vertices(Placement((0.9, 0.1, 0.2), snap="surface"), "card", (0.3, 0.2, 1.0))
    np.testing.assert_allclose(card[:, 0], 1.0, atol=5e-4)
    assert (card[:, 0] < 1.0).all()
    np.testing.assert_allclose(card.mean(axis=0)[1:], [0.1, 0.2], atol=1e-6)


def test_the_surface_of_a_noisy_scan_is_levelled():
    """A floor of 1 cm triangles with 1 mm of noise: single faces lean by ten degrees, an object on it does not."""
    n = 61
    x, y = np.meshgrid(np.linspace(-0.3, 0.3, n), np.linspace(-0.3, 0.3, n))
    z = np.random.default_rng(0).normal(0, 1e-3, x.shape)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([np.c_[corner, corner + 1, corner + n], np.c_[corner + 1, corner + n + 1, corner + n]])
    scan = Mesh(np.stack([x, y, z], -1).reshape(-1, 3), faces)
    for at in ((0.0, 0.0, 0.05), (0.111, -0.07, 0.05)):
        _, normal = Room(scan, (0.0, 0.0, 1.0)).nearest(Vector(at))
        assert normal.z > np.cos(np.radians(3))


def test_a_large_room_is_searched_in_parts_as_if_it_were_one(monkeypatch):
    """Hits, nearest points and mean normals of a wavy floor do not depend on how many trees hold its faces."""
    n = 30
    x, y = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n))
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([np.c_[corner, corner + 1, corner + n], np.c_[corner + 1, corner + n + 1, corner + n]])
    faces = np.random.default_rng(0).permutation(faces)  # neighbours lie in different parts
    floor = Mesh(np.stack([x, y, 0.1 * np.sin(5 * x + 3 * y)], -1).reshape(-1, 3), faces)
    places = [Vector(at) for at in ((0.03, 0.02, 1.0), (-0.71, 0.4, 0.5), (0.9, -0.9, 0.2))]
    down = Vector((0.05, -0.02, -1.0)).normalized()

    def found(room: Room) -> list[tuple[Vector, Vector]]:
        hits = [room.along(at, down) for at in places]
        return [hit for hit in hits if hit is not None] + [room.nearest(at) for at in places]

    whole = found(Room(floor, (0.0, 0.0, 1.0)))
    monkeypatch.setattr(placing, "TREE_FACES", 100)
    parted = Room(floor, (0.0, 0.0, 1.0))
    assert len(list(parted.search_trees())) == -(-len(faces) // 100)
    assert len(whole) == 2 * len(places)
    np.testing.assert_allclose(found(parted), whole, atol=1e-6)
    assert parted.along(Vector((0.0, 0.0, 1.0)), Vector((0.0, 0.0, 1.0))) is None


def test_an_object_stands_where_the_pixel_points():
    view = camera(20, 20, fx=10.0, fy=10.0)
    view.c2w[:3, :3] = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], float)  # looks along +y, z up
    job = {"objects": [{"shape": "box", "size": 0.1, "pixel": [10, 18]}]}
    ((_, edit),) = insertion_edits(room(), job, cameras=[view])
    built = build_scene(room(), edit)
    at = np.array(built.inserted[0].matrix_world.translation)
    # The ray falls 0.8 m a metre, so it meets the wall y = 1 at z = -0.8; the box falls from there to the floor.
    np.testing.assert_allclose(at, [0, 1, -0.95], atol=0.02)
    job["objects"][0]["snap"] = "surface"
    ((_, edit),) = insertion_edits(room(), job, cameras=[view])
    at = np.array(build_scene(room(), edit).inserted[0].matrix_world.translation)
    np.testing.assert_allclose(at, [0, 0.95, -0.8], atol=0.001)


def test_an_object_without_support_is_refused():
    with pytest.raises(BadInput, match="to stand on"):
        placed_vertices(Placement((5.0, 0.0, 0.0), snap="down"))
    with pytest.raises(BadInput, match="without height"):
        placed_vertices(Placement(height=0.1), "card", (0.1, 0.1, 1.0))


def test_the_recovered_sun_lights_the_floor_until_a_job_turns_it_away():
    """Radiance is albedo E cosθ / π; the artist's changes do not count for what was photographed."""
    toward = np.array([0.6, 0.0, 0.8])
    result = replace(room(albedo=ALBEDO, mesh=floor()), sun=Sunlight(toward, COLOR))

    def middle(spec):
        above = camera(fx=400.0, fy=400.0, position=(0, 0, 1))
        return render_views(result, [above], edit=relight_edit(result, spec), settings=QUICK)[0].mean((0, 1))

    full = reflected(COLOR)
    assert middle({}) == pytest.approx(0.8 * full, rel=0.05)
    assert middle({"sun": 0.5}) == pytest.approx(0.4 * full, rel=0.05)
    assert middle({"sun": {"direction": [0, 0, -1]}}) == pytest.approx(full, rel=0.05)
    assert not middle({"sun": 0}).any()
    built = build_scene(result)
    assert built.sun is not None
    before = built.sun.matrix_basis.copy()
    built.sun.data.energy, built.sun.rotation_mode = 9.0, "XYZ"
    built.sun.rotation_euler = (1.0, 0.0, 0.0)
    with as_recovered([], built.scene.objects):
        assert built.sun.data.energy == pytest.approx(3.0)
        assert np.allclose(built.sun.matrix_basis, before, atol=1e-5)
    assert built.sun.data.energy == 9.0 and built.sun.rotation_euler.x == pytest.approx(1.0)


def test_a_job_cannot_change_a_sun_that_was_not_found():
    with pytest.raises(BadInput, match="no sun was found"):
        relight_edit(room(albedo=ALBEDO, mesh=floor()), {"sun": 0.5})
