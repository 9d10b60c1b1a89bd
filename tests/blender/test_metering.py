"""The light meter at the 3D cursor: where it lies, what it reads, and that lumens follow its lux and EXIF."""

import math
import sys
from dataclasses import replace

import bpy
import numpy as np
import pytest
from mathutils import Vector

from iris_addon.base.errors import BadInput
from iris_addon.base.images import read_exr
from iris_addon.blender.apply.on_objects import apply_to_objects
from iris_addon.blender.insert.metering import meter_at, sunlight_at
from iris_addon.blender.insert.photo_composite import write_room_copy
from iris_addon.blender.insert.probe import probe_file
from iris_addon.blender.scene_out.lights import add_sun, lamp_materials, set_strength, set_sun
from iris_addon.edits.light_units import METERED_VALUE, illuminance
from iris_addon.model.recovered import Sunlight
from iris_addon.model.render_settings import RenderSettings
from iris_addon.model.response import LUMINANCE
from iris_addon.results.records import read_response
from tests.blender_home import ROOT, build_package, in_blender
from tests.solved_scene import cube, solve

pytestmark = pytest.mark.bpy

RADIANCE = np.array([3.0, 6.0, 1.5])
HALF, HEIGHT = 0.25, 1.5
"""Metres: half a side of the lamp, and how high it hangs over the floor."""


@pytest.fixture
def black_room():
    """A black room 4 m wide under a lamp of half a metre, 1.5 m over its floor, without light from outside."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    cube("walls", scale=(2, 2, 2))
    cube("lamp", scale=(HALF, HALF, 1e-3), location=(0, 0, HEIGHT - 2 + 1e-3))
    result, runs = solve(lamp_faces=range(12, 24))
    black = replace(result.textures, base_color=np.zeros_like(result.textures.base_color))
    apply_to_objects(replace(result, textures=black, outside=None), runs, bpy.context.scene, "key")
    bpy.context.view_layer.update()
    return bpy.context.scene


def under_a_square(half: float, height: float) -> float:
    """Illuminance on the axis of a square of radiance 1: 4 ∫∫ h² / r⁴ over a quarter, by its closed form."""
    a = half / height
    return 4 * a / math.hypot(1, a) * math.atan(a / math.hypot(1, a))


def test_a_meter_lies_on_the_surface_at_the_cursor_or_on_the_first_one_below_it(black_room):
    eyes = [Vector((1, 1, -1))]
    for at, where, normal in (
        ((0.5, 0.3, -1.2), (0.5, 0.3, -2), (0, 0, 1)),  # in mid-air
        ((0.5, 0.3, -2), (0.5, 0.3, -2), (0, 0, 1)),  # on the floor, by the side that photos see
        ((2.0, 0.3, 0.4), (2, 0.3, 0.4), (-1, 0, 0)),  # on a wall
        ((1.98, 0.3, 0.4), (2, 0.3, 0.4), (-1, 0, 0)),
    ):
        place, found = meter_at(black_room, Vector(at), eyes)
        assert (place - Vector(where)).length < 0.02 and (found - Vector(normal)).length < 1e-4
        assert (place - Vector(where)) @ found > 0, "just off the surface"
    with pytest.raises(BadInput, match="no surface"):
        meter_at(black_room, Vector((9, 9, 0)), eyes)


def test_the_reading_is_that_of_the_recovered_light_whatever_was_changed_or_added(black_room, tmp_path):
    (lamp,) = lamp_materials(black_room.objects)
    set_strength(lamp, 40.0)
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    black_room.collection.objects.link(sun)
    place, normal = meter_at(black_room, Vector((0, 0, -1.9)), [])
    write_room_copy(black_room, tmp_path / "copy.blend")
    settings = RenderSettings(samples=64)
    probe_file(tmp_path / "copy.blend", tuple(place), tmp_path / "p.exr", width=256, settings=settings)
    read = illuminance(read_exr(tmp_path / "p.exr"), tuple(normal))
    assert read == pytest.approx(LUMINANCE @ RADIANCE * under_a_square(HALF, HEIGHT - 2 - place.z), rel=0.02)


def test_sunlight_counts_where_nothing_of_the_room_is_in_its_way(black_room):
    """Under the walls' roof there is none; with the walls disabled it falls on the lamp's top by Lambert's law."""
    toward, irradiance = np.array([0.6, 0.0, 0.8]), np.array([4.0, 3.0, 2.0])
    sun = add_sun(Sunlight(toward, irradiance), black_room.collection)
    set_sun(sun, 0.0)  # however the artist has set it since
    place, normal = meter_at(black_room, Vector((0, 0, 0)), [])
    assert sunlight_at(black_room, place, normal) == 0
    black_room.objects["walls"].hide_viewport = True
    bpy.context.view_layer.update()
    place, normal = meter_at(black_room, Vector((0, 0, 0)), [])
    assert normal.z == pytest.approx(1) and abs(place.z - (HEIGHT - 2)) < 0.02
    assert sunlight_at(black_room, place, normal) == pytest.approx(0.8 * LUMINANCE @ irradiance, rel=1e-5)
    assert sunlight_at(black_room, place, -normal) == 0


def test_a_meter_lies_on_what_stands_in_for_an_object_that_cannot_carry_the_result():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    cube("floor", scale=(3, 3, 0.1), location=(0, 0, -2))
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("table", bpy.data.curves.new("table", "CURVE")))
    curve = bpy.data.objects["table"].data
    curve.dimensions, curve.fill_mode = "2D", "BOTH"
    spline = curve.splines.new("POLY")
    spline.points.add(3)
    for point, (x, y) in zip(spline.points, ((-1, -1), (1, -1), (1, 1), (-1, 1)), strict=True):
        point.co = (x, y, 0, 1)
    spline.use_cyclic_u = True
    result, runs = solve()
    apply_to_objects(result, runs, bpy.context.scene, "key")
    bpy.context.view_layer.update()
    place, normal = meter_at(bpy.context.scene, Vector((0.3, 0.2, 0.5)), [])
    assert abs(place.z) < 0.02 and abs(normal.z) == pytest.approx(1)


@pytest.mark.skipif(sys.platform == "win32", reason="as the other tests of the package")
def test_lux_and_exif_set_the_scale_and_the_panel_says_so(tmp_path):
    """In the solved demo: twice the lux are twice the lumens, and EXIF gives a gray card its luminance."""
    camera = read_response(ROOT / "assets" / "demo_solved")
    name, exposure = sorted(camera.exposures.items())[0]
    gray = camera.device_of(name).response.invert(np.full(3, METERED_VALUE)) / exposure
    expected = 50.0 / float(LUMINANCE @ gray)
    body = f"""
    assert bpy.ops.iris.open_demo() == {{"FINISHED"}}
    settings = scene.iris
    corners = [settings.room.matrix_world @ __import__("mathutils").Vector(c) for c in settings.room.bound_box]
    scene.cursor.location = sum(corners, __import__("mathutils").Vector()) / 8
    scales = []
    for lux in (150.0, 300.0):
        assert bpy.ops.iris.meter(lux=lux, samples=16) == {{"FINISHED"}}
        scales.append(settings.lumens_per_unit)
        assert settings.scale_anchor == f"{{lux:.0f}} lx at the cursor", settings.scale_anchor
    assert scales[0] > 0 and abs(scales[1] / scales[0] - 2) < 1e-4, scales
    folder = Path(bpy.path.abspath(settings.result))
    assert not list(folder.glob("meter.*blend")) and not list(folder.glob("meter.exr"))
    kept = settings.lumens_per_unit
    scene.cursor.location = min(corners, key=sum)  # where two walls and the floor meet
    fails(bpy.ops.iris.meter, "hardly any light", lux=300.0, samples=4)
    assert settings.lumens_per_unit == kept
    scene.cursor.location = (1e4, 0, 0)
    fails(bpy.ops.iris.meter, "no surface")
    assert not bpy.ops.iris.exif_scale.poll()
    checked = folder / "inspection" / "capture.json"
    content = json.loads(checked.read_text())
    next(row for row in content["views"] if row["name"] == {name!r})["metered"] = 50.0  # as inspect found it
    checked.write_text(json.dumps(content))
    bpy.ops.iris.add_capture()
    assert bpy.ops.iris.exif_scale() == {{"FINISHED"}}
    assert settings.scale_anchor == "EXIF of 1 photo, ±41%", settings.scale_anchor
    assert abs(settings.lumens_per_unit / {expected!r} - 1) < 1e-4, settings.lumens_per_unit
    """
    in_blender(build_package(tmp_path / "iris.zip"), tmp_path, body)
