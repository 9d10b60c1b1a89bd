"""A recovered lamp whose light Blender's own light gives: the room is lit as before, cameras see it, it goes back."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix, Vector

from iris_addon.base.errors import BadInput
from iris_addon.blender.apply.area_lamps import put_lamp_back, replace_lamp
from iris_addon.blender.apply.looks import set_look
from iris_addon.blender.apply.on_objects import apply_to_objects, restore
from iris_addon.blender.insert.photo_composite import as_photographed
from iris_addon.blender.render.cycles import render_linear, set_cycles
from iris_addon.blender.render.light_mixing import start_mixing
from iris_addon.blender.scene_out.lights import color, lamp_materials, set_color, set_strength, strength, switch
from iris_addon.blender.version import node_tree, set_panoramic
from iris_addon.model.render_settings import RenderSettings
from tests.solved_scene import cube, solve

pytestmark = pytest.mark.bpy

HALF = 2.0
"""Metres from the middle of the room to its walls."""
EYE = Vector((-1.7, -1.7, 0.0))


@pytest.fixture(autouse=True)
def empty_blender():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def lamp(shape: str, at=(0.3, 0.2, 1.5), turn=(0.3, 0.2, 0.5)) -> bpy.types.Object:
    """A lamp of ``shape`` that hangs obliquely in the room."""
    import bmesh  # exists once bpy has been imported

    mesh = bmesh.new()
    if shape == "disc":
        bmesh.ops.create_circle(mesh, cap_ends=True, cap_tris=True, segments=48, radius=0.3)
    elif shape == "ball":
        bmesh.ops.create_icosphere(mesh, subdivisions=4, radius=0.2)
    else:
        bmesh.ops.create_cube(mesh, size=1.0, matrix=Matrix.Diagonal((0.8, 0.5, 0.02 if shape == "slab" else 0.5, 1)))
        if shape == "sheet":
            bmesh.ops.delete(mesh, geom=[f for f in mesh.faces if f.normal.z > -0.5], context="FACES")
    data = bpy.data.meshes.new(shape)
    mesh.to_mesh(data)
    mesh.free()
    data.uv_layers.new(name="Own")
    thing = bpy.data.objects.new(shape, data)
    thing.matrix_world = Matrix.Translation(at) @ Euler(turn).to_matrix().to_4x4()
    bpy.context.scene.collection.objects.link(thing)
    return thing


def lit_by(*shapes: bpy.types.Object) -> bpy.types.Scene:
    """A room of grey walls with these lamps, and a result applied to it in which they shine."""
    scene = bpy.context.scene
    cube("walls", scale=(HALF,) * 3)
    bpy.context.view_layer.update()
    _, runs = solve()
    faces = [np.arange(run.start, run.stop) for run in runs if run.object != "walls"]
    result, runs = solve(lamp_faces=np.concatenate(faces), uv=np.zeros((runs[-1].stop, 3, 2), np.float32))
    black = replace(result, outside=None, backdrop=None)
    assert apply_to_objects(black, runs, scene, "key") and len(shapes) == len(faces)
    return scene


def camera(towards: Vector, at: Vector = EYE) -> bpy.types.Object:
    eye = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    eye.matrix_world = Matrix.Translation(at) @ (towards - at).to_track_quat("-Z", "Y").to_matrix().to_4x4()
    eye.data.angle = 1.2
    bpy.context.scene.collection.objects.link(eye)
    return eye


def picture(scene: bpy.types.Scene, eye: bpy.types.Object, size=32, samples=256, bounces=0) -> np.ndarray:
    scene.camera = eye
    scene.render.resolution_x = scene.render.resolution_y = size
    set_cycles(scene, RenderSettings(samples=samples, denoise=False, max_bounces=bounces))
    return render_linear(scene)


@pytest.mark.parametrize("shape", ["sheet", "disc", "slab", "ball"])
def test_walls_receive_the_light_that_they_received_of_the_mesh(shape):
    """A sheet and a disc shine to both sides, a slab from its six faces, a ball to everywhere."""
    scene = lit_by(lamp(shape))
    (material,) = lamp_materials(scene.objects)
    walls = [camera(Vector(d)) for d in ((2, 2, -2), (2, -0.5, 0), (0.5, 2, 1))]
    walls.append(camera(Vector((0, 0, 2)), Vector((1.2, 1.2, -1.2))))
    before = [picture(scene, eye) for eye in walls]
    lights, faithful = replace_lamp(scene, material, [EYE, Vector((1.2, 1.2, 1.9))])
    kinds = {"sheet": ["RECTANGLE"] * 2, "disc": ["ELLIPSE"] * 2, "slab": ["RECTANGLE"] * 2, "ball": ["POINT"]}
    assert [getattr(thing.data, "shape", thing.data.type) for thing in lights] == kinds[shape] and faithful
    after = [picture(scene, eye) for eye in walls]
    for old, new in zip(before, after, strict=True):
        np.testing.assert_allclose(new.mean((0, 1)), old.mean((0, 1)), rtol=0.05)


def sent(lights: list[bpy.types.Object]) -> np.ndarray:
    """(3,) watts that ``lights`` send in all, by the even radiance in a white matte sphere of 50 m around them: each
    watt that arrives leaves in all directions, and from the middle one sees all of it alike."""
    import bmesh

    scene = bpy.data.scenes.new("sphere")
    mesh = bmesh.new()
    bmesh.ops.create_icosphere(mesh, subdivisions=5, radius=50.0)
    data = bpy.data.meshes.new("sphere")
    mesh.to_mesh(data)
    mesh.free()
    matte = bpy.data.materials.new("matte")
    nodes = node_tree(matte).nodes
    diffuse, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
    diffuse.inputs["Color"].default_value = (1, 1, 1, 1)
    matte.node_tree.links.new(diffuse.outputs["BSDF"], output.inputs["Surface"])
    data.materials.append(matte)
    around = bpy.data.objects.new("sphere", data)
    scene.collection.objects.link(around)
    middle = sum((thing.matrix_world.translation for thing in lights), Vector()) / len(lights)
    for thing in lights:
        copy = thing.copy()
        copy.matrix_world = Matrix.Translation(-middle) @ thing.matrix_world
        scene.collection.objects.link(copy)
    eye = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    set_panoramic(eye.data)
    scene.collection.objects.link(eye)
    scene.camera = eye
    scene.render.resolution_x, scene.render.resolution_y = 128, 64
    set_cycles(scene, RenderSettings(samples=64, denoise=False, max_bounces=0))
    seen = render_linear(scene)
    edges = np.cos(np.linspace(0, np.pi, 65))
    weight = (edges[:-1] - edges[1:]) / 2
    mean = (seen.mean(1) * weight[:, None]).sum(0)
    bpy.data.batch_remove([*scene.objects, scene])
    return mean * np.pi * 4 * np.pi * 50.0**2


@pytest.mark.parametrize("shape", ["sheet", "slab", "ball"])
@pytest.mark.parametrize("kind", ["AREA", "POINT", "IES"])
def test_what_stands_for_a_lamp_sends_its_flux(shape, kind):
    """Pi times radiance times area of the sides that shine, within a percent, by a render."""
    scene = lit_by(lamp(shape))
    (material,) = lamp_materials(scene.objects)
    area = {"sheet": 2 * 0.8 * 0.5, "slab": 2 * 0.8 * 0.5 + 2 * 0.02 * 1.3, "ball": 4 * np.pi * 0.2**2}[shape]
    lights, faithful = replace_lamp(scene, material, [EYE, Vector((1.2, 1.2, 1.9))], kind)
    assert len(lights) == (2 if kind == "AREA" and shape != "ball" else 1)
    assert faithful == (kind != "POINT" or shape == "ball")
    expected = np.pi * area * np.array([3.0, 6.0, 1.5])
    np.testing.assert_allclose(sent(lights), expected, rtol=0.01)
    put_lamp_back(scene, material)
    assert not bpy.data.lights and not bpy.data.texts


def test_an_ies_light_shines_in_every_direction_as_the_lamp_does():
    """A sheet that hangs obliquely, one side covered: each wall has the share of the light that it had of the sheet."""
    scene = lit_by(lamp("sheet", at=(0.1, 0.2, 0.1), turn=(0.9, 0.3, 0.4)))
    (material,) = lamp_materials(scene.objects)
    (sheet,) = [thing for thing in scene.objects if thing.name == "sheet"]
    sheet.scale = (0.3, 0.3, 0.3)  # a point from where the walls are
    cover = cube("cover", scale=(0.2, 0.2, 0.001))
    bpy.context.view_layer.update()
    normal = sheet.matrix_world.to_3x3() @ Vector((0, 0, 1))
    behind = Matrix.Translation(-0.065 * normal.normalized())  # a centimeter from the sheet
    cover.matrix_world = behind @ sheet.matrix_world @ Matrix.Diagonal((2, 2, 1e-3, 1))
    bpy.context.view_layer.update()
    walls = [camera(Vector(d), Vector(d) * 0.3) for d in ((2, 0, 0), (-2, 0, 0), (0, 2, 0), (0, -2, 0))]
    before = [picture(scene, eye, size=24).mean() for eye in walls]
    replace_lamp(scene, material, [], "IES")
    after = [picture(scene, eye, size=24).mean() for eye in walls]
    assert max(before) > 2 * min(before)
    np.testing.assert_allclose(np.array(after) / sum(after), np.array(before) / sum(before), atol=0.03)


def test_a_bulb_hangs_before_a_lamp_in_the_ceiling_and_an_ies_light_survives_in_the_file(tmp_path):
    scene = lit_by(lamp("sheet", at=(0.4, -0.3, HALF + 0.248), turn=(0, 0, 0.4)))
    (material,) = lamp_materials(scene.objects)
    (bulb,), faithful = replace_lamp(scene, material, [EYE], "POINT")
    assert not faithful and bulb.data.type == "POINT" and bulb.data.shadow_soft_size == pytest.approx(0.03)
    assert (bulb.matrix_world.translation - Vector((0.4, -0.3, HALF - 0.033))).length < 0.002
    assert bulb.data.energy * bulb.data.color[0] == pytest.approx(np.pi * 0.4 * 3.0, rel=1e-4)
    put_lamp_back(scene, material)
    (light,), _ = replace_lamp(scene, material, [EYE], "IES")
    set_strength(material, 12.0)
    assert light.data.energy == pytest.approx(np.pi * 0.4 * 12.0, rel=1e-4), "the row leads it"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
    (text,) = bpy.data.texts
    assert text.as_string().startswith("IESNA") and len(bpy.data.lights) == 1
    restore(bpy.context.scene)
    assert not bpy.data.lights and not bpy.data.texts


def test_a_lamp_in_the_ceiling_becomes_one_light_that_faces_the_room():
    """Nothing stands behind the sheet, but only its lower side is seen; without photos the room decides."""
    for eyes in ([EYE], []):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        scene = lit_by(lamp("sheet", at=(0.4, -0.3, HALF + 0.248), turn=(0, 0, 0.4)))
        (material,) = lamp_materials(scene.objects)
        (light,), faithful = replace_lamp(scene, material, eyes)
        assert faithful and (light.matrix_world.to_3x3() @ Vector((0, 0, -1))).z == pytest.approx(-1)
        assert sorted((light.data.size, light.data.size_y)) == pytest.approx([0.5, 0.8], abs=1e-3)
        assert (light.matrix_world.translation - Vector((0.4, -0.3, HALF - 0.002))).length < 0.002
        along = light.matrix_world.to_3x3() @ Vector((light.data.size, 0, 0))
        assert (
            abs(along.angle(Vector((np.cos(0.4), np.sin(0.4), 0))) - (0 if light.data.size > 0.6 else np.pi / 2)) < 0.01
        )
        # radiance times pi is what leaves a square metre
        assert light.data.energy * light.data.color[0] == pytest.approx(np.pi * 0.4 * 3.0, rel=1e-4)


def test_a_window_behind_a_bar_keeps_its_light():
    """What stands close before a single layer takes as much from the area light as from the mesh."""
    cube("bar", location=(0, 0, HALF - 0.03), scale=(0.1, 0.1, 0.01))
    scene = bpy.context.scene
    thing = lamp("sheet", at=(0, 0, HALF + 0.248), turn=(0, 0, 0))
    cube("walls", scale=(HALF,) * 3)
    bpy.context.view_layer.update()
    _, runs = solve()
    faces = next(np.arange(run.start, run.stop) for run in runs if run.object == thing.name)
    result, runs = solve(lamp_faces=faces, uv=np.zeros((runs[-1].stop, 3, 2), np.float32))
    apply_to_objects(replace(result, outside=None), runs, scene, "key")
    (material,) = lamp_materials(scene.objects)
    (light,), _ = replace_lamp(scene, material, [EYE])
    assert light.data.energy == pytest.approx(np.pi * 0.4 * 6.0, rel=1e-4)


def test_cameras_see_the_lamp_as_before_and_the_room_does_not_shine_twice():
    scene = lit_by(lamp("slab"))
    (material,) = lamp_materials(scene.objects)
    eye = camera(Vector((0.3, 0.2, 1.5)))
    before = picture(scene, eye, samples=64, bounces=1)
    replace_lamp(scene, material, [EYE])
    after = picture(scene, eye, samples=64, bounces=1)
    shown = before[..., 1] > 5.9
    assert shown.any()
    np.testing.assert_allclose(after[shown], before[shown], rtol=1e-3)
    assert after[~shown].mean() == pytest.approx(before[~shown].mean(), rel=0.1)


def test_the_row_of_the_lamp_leads_its_light_and_hears_of_changes():
    scene = lit_by(lamp("sheet", at=(0, 0, HALF + 0.248), turn=(0, 0, 0)))
    (material,) = lamp_materials(scene.objects)
    (light,), _ = replace_lamp(scene, material, [])
    full = light.data.energy
    set_strength(material, 3.0)
    set_color(material, (0.0, 0.5, 1.0))
    assert light.data.energy == pytest.approx(full / 2) and tuple(light.data.color) == pytest.approx((0, 0.5, 1))
    light.data.energy, light.data.color = 2 * full, (1, 0, 0)  # by hand, at the light
    assert strength(material) == pytest.approx(12.0) and color(material) == pytest.approx((1, 0, 0))
    switch(material, False)
    assert light.data.energy == 0 and strength(material) == pytest.approx(12.0)
    switch(material, True)
    assert light.data.energy == pytest.approx(2 * full) and tuple(light.data.color) == pytest.approx((1, 0, 0))
    set_look(scene, "PHOTOGRAPHED")
    assert light.data.energy == pytest.approx(full) and tuple(light.data.color) == pytest.approx((0.5, 1, 0.25))
    set_look(scene, "BLACKOUT")
    assert light.data.energy == 0


def test_what_was_photographed_is_the_lamp_and_not_its_light():
    """The light may be moved, resized or deleted since: a photo is compared with the room as it was."""
    scene = lit_by(lamp("sheet", at=(0, 0, HALF + 0.248), turn=(0, 0, 0)))
    (material,) = lamp_materials(scene.objects)
    floor = camera(Vector((0.5, 0.5, -2)))
    before = picture(scene, floor)
    (light,), _ = replace_lamp(scene, material, [])
    light.location.x += 1.0
    light.data.energy *= 3
    with as_photographed(scene):
        np.testing.assert_allclose(picture(scene, floor).mean(), before.mean(), rtol=0.02)
    assert not light.hide_render and picture(scene, floor).mean() > 1.5 * before.mean()


def test_the_lamp_is_put_back_with_what_was_set_since():
    scene = lit_by(lamp("sheet", at=(0, 0, HALF + 0.248), turn=(0, 0, 0)))
    (material,) = lamp_materials(scene.objects)
    floor = camera(Vector((0.5, 0.5, -2)))
    before, nodes = picture(scene, floor), len(material.node_tree.nodes)
    replace_lamp(scene, material, [])
    with pytest.raises(BadInput, match="already"):
        replace_lamp(scene, material, [])
    set_strength(material, 12.0)
    put_lamp_back(scene, material)
    assert not bpy.data.lights and len(material.node_tree.nodes) == nodes and strength(material) == 12.0
    np.testing.assert_allclose(picture(scene, floor).mean(), 2 * before.mean(), rtol=0.02)

    switch(material, False)
    with pytest.raises(BadInput, match="is off"):
        replace_lamp(scene, material, [])
    switch(material, True)
    start_mixing(scene)
    with pytest.raises(BadInput, match="Mix Lights"):
        replace_lamp(scene, material, [])


def test_lights_are_mixed_as_the_lamp_and_restoring_removes_them():
    scene = lit_by(lamp("sheet", at=(0, 0, HALF + 0.248), turn=(0, 0, 0)))
    (material,) = lamp_materials(scene.objects)
    replace_lamp(scene, material, [])
    assert [name for name in start_mixing(scene) if "Lamp" in name] == [material.name]
    restore(scene)
    assert not bpy.data.lights and not [m for m in bpy.data.materials if m.name.startswith("IRIS")]
