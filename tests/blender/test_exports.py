"""What other programs get: .glb and .usd read back with the sizes, materials and lamps of the room, the texture set."""

from dataclasses import replace

import bpy
import numpy as np
import pytest

from iris_addon.base.errors import IrisError
from iris_addon.blender.apply.scene_files import apply
from iris_addon.blender.images import read_image
from iris_addon.blender.scene_out.placing import import_objects
from iris_addon.blender.version import usd_library
from iris_addon.edits.scene_edit import ObjectFile
from iris_addon.model.recovered import Textures
from iris_addon.results.folder import load_result, save_result
from tests.blender_room import box, room

pytestmark = pytest.mark.bpy

BASE_COLOR, ROUGHNESS, METALLIC = (0.5, 0.25, 0.125), 0.4, 1.0  # of a metal Cycles takes the base colour as it is
LAMPS = {3: (12.0, 10.0, 8.0), 0: (0.5, 0.25, 3.0)}


@pytest.fixture(autouse=True)
def empty_blender():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def solved():
    """A box of 2.5 m, up along +Y, of one metal, with two lamps."""
    made = room(emission=LAMPS, mesh=box(2.5))
    flat = np.ones((32, 32), np.float32)
    textures = Textures(np.broadcast_to(np.float32(BASE_COLOR), (32, 32, 3)).copy(), flat * ROUGHNESS, flat, flat)
    return replace(made, textures=textures, up=(0.0, 1.0, 0.0))


@pytest.fixture(params=["glb", "usdc"])
def exported(request, tmp_path):
    """The file's objects, imported into an empty scene."""
    kind = request.param
    if kind == "usdc" and not bpy.app.build_options.usd:
        pytest.skip("this Blender was built without USD")
    path = tmp_path / f"room.{kind}"
    apply(solved(), tmp_path / "room.blend", **{kind[:3]: path})
    bpy.ops.wm.read_factory_settings(use_empty=True)
    if kind == "glb":
        bpy.ops.import_scene.gltf(filepath=str(path))
    else:
        bpy.ops.wm.usd_import(filepath=str(path))
    bpy.context.view_layer.update()
    return [thing for thing in bpy.data.objects if thing.type == "MESH"]


def shader_of(material):
    return next(node for node in material.node_tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")


def pixel_behind(socket):
    """(4,) first pixel of the image that feeds ``socket``, and its colour space."""
    node = socket.links[0].from_node
    while node.bl_idname != "ShaderNodeTexImage":
        node = next(link.from_node for entry in node.inputs for link in entry.links)
    return np.array(node.image.pixels[:4]), node.image.colorspace_settings.name


def test_exports_keep_every_face_in_place(exported):
    world = np.concatenate(
        [[(thing.matrix_world @ vertex.co)[:] for vertex in thing.data.vertices] for thing in exported]
    )
    np.testing.assert_allclose([world.min(axis=0), world.max(axis=0)], [[-1.25] * 3, [1.25] * 3], atol=1e-5)
    assert sum(len(polygon.vertices) - 2 for thing in exported for polygon in thing.data.polygons) == 12
    lamp = next(thing for thing in exported if "Lamp_00" in thing.name.replace(" ", "_"))
    ceiling = np.array([(lamp.matrix_world @ vertex.co)[:] for vertex in lamp.data.vertices])
    np.testing.assert_allclose(ceiling[:, 2], 1.25, atol=1e-5)  # +Y of the capture is up


def test_exports_keep_the_strength_of_every_lamp(exported):
    emitted = {}
    for thing in exported:
        for material in thing.data.materials:
            if "Lamp" in material.name:
                shader = shader_of(material)
                color = np.array(shader.inputs["Emission Color"].default_value[:3])
                emitted[int(material.name[-2:])] = color * shader.inputs["Emission Strength"].default_value
    assert sorted(emitted) == [0, 1]
    np.testing.assert_allclose(emitted[0], LAMPS[3], rtol=1e-3)
    np.testing.assert_allclose(emitted[1], LAMPS[0], rtol=1e-3)


@pytest.mark.parametrize("kind", ["usda", "usdz"])
def test_lamps_in_usd_are_lights_that_shine_as_they_glow(tmp_path, kind):
    """MeshLightAPI whose light is the emission of the material: a renderer that knows UsdLux samples the lamps."""
    library = usd_library()
    if library is None:
        pytest.skip("this Blender comes without USD's Python modules")
    from pxr import Usd, UsdLux, UsdShade

    apply(solved(), None, usd=tmp_path / f"room.{kind}")
    stage = Usd.Stage.Open(str(tmp_path / f"room.{kind}"))
    lights = [prim for prim in stage.Traverse() if prim.HasAPI(UsdLux.MeshLightAPI)]
    glow = []
    for prim in lights:
        light = UsdLux.LightAPI(prim)
        assert light.GetMaterialSyncModeAttr().Get() == "materialGlowTintsLight"
        assert (light.GetIntensityAttr().Get(), light.GetExposureAttr().Get()) == (1.0, 0.0)
        assert tuple(light.GetColorAttr().Get()) == (1, 1, 1) and not light.GetNormalizeAttr().Get()
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
        glow.append(tuple(material.ComputeSurfaceSource()[0].GetInput("emissiveColor").Get()))
    np.testing.assert_allclose(sorted(glow), sorted(LAMPS.values()), rtol=1e-3)


def test_exports_keep_colour_and_gloss(exported):
    material = next(m for thing in exported for m in thing.data.materials if "Surface" in m.name)
    shader = shader_of(material)
    color, space = pixel_behind(shader.inputs["Base Color"])
    assert space == "sRGB"
    linear = np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(linear[:3], BASE_COLOR, atol=0.004)
    for socket, channels, expected in (("Roughness", (0, 1), ROUGHNESS), ("Metallic", (0, 2), METALLIC)):
        if not shader.inputs[socket].is_linked:
            assert shader.inputs[socket].default_value == pytest.approx(expected, abs=0.003)
            continue
        pixel, space = pixel_behind(shader.inputs[socket])
        assert space == "Non-Color"
        assert any(pixel[channel] == pytest.approx(expected, abs=0.003) for channel in channels)


def test_the_texture_set_is_the_result_again(tmp_path):
    result = solved()
    save_result(result, tmp_path / "result")
    back = load_result(tmp_path / "result", read_image)
    np.testing.assert_allclose(back.textures.base_color, result.textures.base_color, rtol=1e-3)
    np.testing.assert_allclose(back.textures.roughness, result.textures.roughness, atol=1e-4)
    np.testing.assert_allclose(back.textures.metallic, result.textures.metallic, atol=1e-4)
    np.testing.assert_allclose(back.face_emission(), result.face_emission(), rtol=1e-6)
    np.testing.assert_allclose(back.mesh.vertices, result.mesh.vertices, atol=1e-6)


def test_gltf_files_need_the_gltf_add_on(tmp_path):
    import addon_utils

    apply(solved(), glb=tmp_path / "room.glb", blend=None)
    source = ObjectFile(tmp_path / "room.glb")
    addon_utils.disable("io_scene_gltf2")
    try:
        with pytest.raises(IrisError, match="glTF"):
            apply(solved(), glb=tmp_path / "again.glb", blend=None)
        with pytest.raises(IrisError, match="glTF"):
            import_objects(source, bpy.context.scene.collection)
    finally:
        addon_utils.enable("io_scene_gltf2")
    assert import_objects(source, bpy.context.scene.collection) and not (tmp_path / "again.glb").exists()
