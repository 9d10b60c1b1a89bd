"""Photometric files of the lamps of a scene, and what Cycles makes of them."""

import bpy
import numpy as np
import pytest
from mathutils import Vector

from iris_addon.base.errors import IrisError
from iris_addon.blender.apply.ies_files import IesLamp, write_ies_files
from iris_addon.blender.apply.on_objects import apply_to_objects
from iris_addon.blender.render.cycles import render_linear, set_cycles
from iris_addon.blender.scene_out.lights import lamp_materials
from iris_addon.blender.version import node_tree
from iris_addon.model.render_settings import RenderSettings
from tests.edits.test_ies import integral, read
from tests.solved_scene import cube, solve

pytestmark = pytest.mark.bpy


@pytest.fixture
def lit():
    """A room 4 m wide with a flat panel, 2 cm thick, 1 cm under its ceiling; its material as a lamp."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    cube("walls", scale=(2, 2, 2))
    cube("panel", scale=(0.4, 0.2, 0.01), location=(0, 0, 1.98))
    result, runs = solve(lamp_faces=range(12, 24))
    apply_to_objects(result, runs, bpy.context.scene, "key")
    bpy.context.view_layer.update()
    (lamp,) = lamp_materials(bpy.context.scene.objects)
    return bpy.context.scene, lamp


def test_a_panel_under_the_ceiling_becomes_a_downlight_of_its_lumens(lit, tmp_path):
    scene, lamp = lit
    (path,) = write_ies_files(scene, [IesLamp(lamp, 2.5)], tmp_path / "lamps", 400.0)
    assert path.name == "IRIS_Lamp_07.ies"
    vertical, horizontal, candela, facts = read(path.read_bytes().decode("ascii"))
    assert integral(vertical, horizontal, candela) == pytest.approx(1000, rel=0.01)
    down, up = candela[vertical < 80], candela[vertical > 100]
    assert up.max() < 0.08 * down.max(), "the ceiling has what the rim sends: 0.048 of 0.37 square meters"
    cosine = np.cos(np.radians(vertical[vertical < 80]))
    np.testing.assert_allclose(down.mean(1) / down[0, 0], cosine, atol=0.09)
    assert facts[7:10] == pytest.approx([0.8, 0.4, 0.02])


def test_without_known_lumens_the_brightest_has_a_thousand_and_dark_ones_no_file(lit, tmp_path):
    scene, lamp = lit
    dark, nowhere = bpy.data.materials.new("dark"), bpy.data.materials.new("no face")
    written = write_ies_files(scene, [IesLamp(dark, 0.0), IesLamp(nowhere, 1.0), IesLamp(lamp, 2.0)], tmp_path, 0.0)
    text = written[0].read_text()
    assert len(written) == 1 and "relative" in text
    assert integral(*read(written[0].read_bytes().decode("ascii"))[:3]) == pytest.approx(1000, rel=0.01)
    (tmp_path / "file").touch()
    with pytest.raises(IrisError, match="cannot be written"):
        write_ies_files(scene, [IesLamp(lamp, 2.0)], tmp_path / "file" / "lamps", 0.0)


def test_cycles_reads_the_file_and_lights_a_floor_with_it(lit, tmp_path):
    """A point light with the file, 1 m above a matte floor: intensity times cosine over squared distance."""
    scene, lamp = lit
    (path,) = write_ies_files(scene, [IesLamp(lamp, 2.5)], tmp_path, 400.0)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    data = bpy.data.meshes.new("floor")
    data.from_pydata([(-5, -5, 0), (5, -5, 0), (5, 5, 0), (-5, 5, 0)], [], [(0, 1, 2, 3)])
    matte = bpy.data.materials.new("matte")
    nodes = node_tree(matte).nodes
    diffuse = nodes.new("ShaderNodeBsdfDiffuse")
    output = nodes.new("ShaderNodeOutputMaterial")
    matte.node_tree.links.new(diffuse.outputs["BSDF"], output.inputs["Surface"])
    data.materials.append(matte)
    scene.collection.objects.link(bpy.data.objects.new("floor", data))
    light = bpy.data.lights.new("ies", "POINT")
    light.use_nodes, light.energy, light.shadow_soft_size = True, 1.0, 0.0
    tree = light.node_tree
    node = tree.nodes.new("ShaderNodeTexIES")
    node.mode, node.filepath = "EXTERNAL", str(path)
    emission = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeEmission")
    tree.links.new(node.outputs["Fac"], emission.inputs["Strength"])
    lamp_object = bpy.data.objects.new("ies", light)
    lamp_object.location = (0, 0, 1)
    scene.collection.objects.link(lamp_object)
    camera = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    camera.data.type, camera.data.ortho_scale, camera.location = "ORTHO", 4.0, Vector((0, 0, 3))
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.resolution_x = scene.render.resolution_y = 40
    set_cycles(scene, RenderSettings(samples=16, seed=1))
    seen = render_linear(scene)[..., 1]
    x = (np.arange(40) + 0.5) / 10 - 2
    away = np.hypot(*np.meshgrid(x, x))
    vertical, _, candela, _ = read(path.read_bytes().decode("ascii"))
    intensity = np.interp(np.degrees(np.arctan(away)), vertical, candela.mean(1))
    expected = intensity * (1 + away**2) ** -1.5
    near = away < 1.5  # farther off the four sides of the rim are told apart
    np.testing.assert_allclose(seen[near] / seen[near].sum(), expected[near] / expected[near].sum(), rtol=0.05)
