"""A result on the user's own objects: what renders, what is kept, and that taking it off leaves nothing behind."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from iris_addon.base.errors import BadInput
from iris_addon.base.images import read_exr
from iris_addon.blender.apply.camera_look import LOOK, kept_look
from iris_addon.blender.apply.on_objects import apply_steps, apply_to_objects, restore, triangles_of
from iris_addon.blender.apply.review import show_confidence
from iris_addon.blender.scene_in.scene_capture import read_scene_mesh, whole_object
from iris_addon.blender.scene_out.lights import color, is_on, lamp_materials, set_color, set_strength, strength, switch
from iris_addon.blender.stepwise import finish
from iris_addon.model.recovered import Backdrop, OutsideLight
from iris_addon.model.texture_size import blender_bytes
from iris_addon.results.result import Result
from tests.scene_snapshot import snapshot
from tests.solved_scene import cube, solve

pytestmark = pytest.mark.bpy


@pytest.fixture(autouse=True)
def empty_blender():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def evaluated_faces() -> np.ndarray:
    """(F, 3, 3) corners in world space of all that renders now, sorted."""
    bpy.context.view_layer.update()
    mesh = read_scene_mesh(bpy.context.evaluated_depsgraph_get()).mesh
    return np.sort(np.round(mesh.vertices[mesh.faces], 4).reshape(-1, 9), axis=0)


def test_a_plain_object_keeps_its_polygons_and_gets_the_materials():
    thing = cube("box", location=(1, 2, 3), scale=(2, 2, 2))
    original = thing.data
    result, runs = solve(lamp_faces=[2, 3])
    assert apply_to_objects(result, runs, bpy.context.scene, "key")
    assert thing.data is not original and len(thing.data.polygons) == 6
    assert [layer.name for layer in thing.data.uv_layers] == ["Own", "IRIS"]
    shining = [p.index for p in thing.data.polygons if "Lamp" in thing.data.materials[p.material_index].name]
    assert shining == [1]
    (lamp,) = lamp_materials([thing])
    np.testing.assert_allclose(np.array(color(lamp)) * strength(lamp), [3, 6, 1.5])
    for polygon in thing.data.polygons:
        uv = np.array([thing.data.uv_layers["IRIS"].uv[loop].vector for loop in polygon.loop_indices])
        assert len(np.unique(uv, axis=0)) == 4 and np.ptp(uv, axis=0) == pytest.approx([1 / 16, 1 / 16])
    scene = bpy.context.scene
    assert scene.view_settings.exposure == pytest.approx(-2)
    background = next(node for node in scene.world.node_tree.nodes if node.bl_idname == "ShaderNodeBackground")
    np.testing.assert_allclose(background.inputs["Color"].default_value[:3], 0.5 * 0.2820948, rtol=1e-5)


def test_a_scan_is_shaded_by_the_surface_that_was_solved():
    """Imported faces are flat; reflections in a scan's noise are not what was solved, nor what the photos show."""
    cube("straight", location=(1, 2, 3), rotation_euler=(0.3, 0.2, 0.1))
    cube("mirrored", location=(0, 5, 0), scale=(-1, 2, 1))
    changed = cube("changed", None, location=(0, 0, 5))
    changed.modifiers.new("copies", "ARRAY").count = 2
    result, runs = solve(lamp_faces=[])
    corners = result.mesh.vertices[result.mesh.faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = flat / np.linalg.norm(flat, axis=1, keepdims=True) + (0.2, 0.1, 0.3)
    normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
    apply_to_objects(replace(result, mesh=replace(result.mesh, normals=normals)), runs, bpy.context.scene, "key")
    for run in runs:
        thing = bpy.context.scene.objects[run.object]
        shown = np.array([normal.vector for normal in thing.data.corner_normals])
        _, loops = triangles_of(thing.data)
        to_world = np.linalg.inv(np.array(thing.matrix_world)[:3, :3]).T
        world = shown[loops] @ to_world.T
        world /= np.linalg.norm(world, axis=2, keepdims=True)
        np.testing.assert_allclose(world, np.repeat(normals[run.start : run.stop, None], 3, axis=1), atol=2e-3)
    restore(bpy.context.scene)
    assert not any(thing.data.has_custom_normals for thing in bpy.context.scene.objects)


def test_modelled_objects_beside_a_scan_keep_the_shading_that_the_artist_gave_them():
    thing = cube("smooth")
    thing.data.shade_smooth()
    before = np.array([normal.vector for normal in thing.data.corner_normals])
    result, runs = solve(lamp_faces=[])
    corners = result.mesh.vertices[result.mesh.faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = (flat / np.linalg.norm(flat, axis=1, keepdims=True)).astype(np.float32)
    apply_to_objects(replace(result, mesh=replace(result.mesh, normals=normals)), runs, bpy.context.scene, "key")
    np.testing.assert_allclose([normal.vector for normal in thing.data.corner_normals], before, atol=1e-3)


def test_an_object_that_goes_between_the_steps_leaves_the_scene_as_it_was():
    thing, other = cube("goes"), cube("stays", location=(3, 0, 0))
    result, runs = solve(lamp_faces=[])
    steps = apply_steps(result, runs, bpy.context.scene, "key")
    own = other.data
    for said in steps:
        if said == "packing the textures":
            break
    bpy.data.objects.remove(thing)
    with pytest.raises(BadInput):
        finish(steps)
    assert other.data == own and "iris_applied" not in bpy.context.scene


def test_the_images_of_the_textures_take_the_memory_that_is_said():
    cube("box")
    result, runs = solve(lamp_faces=[2, 3])
    side = 64
    maps = {name: np.full((side, side), 0.5, np.float32) for name in ("roughness", "metallic", "confidence")}
    textures = replace(result.textures, base_color=np.full((side, side, 3), 0.5, np.float32), **maps)
    apply_to_objects(replace(result, textures=textures, backdrop=None), runs, bpy.context.scene, "key")
    images = [image for image in bpy.data.images if image.users and tuple(image.size) == (side, side)]
    held = sum(len(image.pixels) * (4 if image.is_float else 1) for image in images)
    assert len(images) == 4 and held == blender_bytes(side)


def mixed_scene() -> None:
    """Everything that a result cannot simply be painted on, and some things that must survive."""
    plain = cube("plain", rotation_euler=(0.3, 0.2, 0.1))
    twin = bpy.data.objects.new("twin", plain.data)  # shares its mesh
    twin.location = (5, 0, 0)
    bpy.context.scene.collection.objects.link(twin)
    mirrored = cube("mirrored", "metal", location=(0, 5, 0), scale=(-1, 1, 1))
    mirrored.material_slots[0].link = "OBJECT"
    mirrored.material_slots[0].material = bpy.data.materials.new("own")
    modified = cube("modified", None, location=(0, 0, 5))
    modified.modifiers.new("copies", "ARRAY").count = 2
    child = cube("child", location=(2, 0, 0))
    child.parent = modified
    inside = bpy.data.collections.new("instanced")
    source = cube("source")
    bpy.context.scene.collection.objects.unlink(source)
    inside.objects.link(source)
    empty = bpy.data.objects.new("empty", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", inside
    empty.matrix_world = Matrix.Translation((0, -5, 0)) @ Matrix.Scale(0.5, 4)
    bpy.context.scene.collection.objects.link(empty)
    bpy.context.scene.world = bpy.data.worlds.new("mine")
    bpy.context.scene.view_settings.exposure = 0.5
    bpy.data.materials["paint"].use_fake_user = True


def test_what_renders_is_the_same_geometry_before_and_after():
    mixed_scene()
    result, runs = solve(lamp_faces=[0])
    assert {run.object for run in runs if run.instance} == {"empty"}
    before = evaluated_faces()
    apply_to_objects(result, runs, bpy.context.scene, "key")
    np.testing.assert_allclose(evaluated_faces(), before, atol=2e-4)


def test_restoring_leaves_no_trace():
    mixed_scene()
    result, runs = solve(lamp_faces=[0, 30])
    before = snapshot(bpy.context.scene)
    apply_to_objects(result, runs, bpy.context.scene, "key")
    assert snapshot(bpy.context.scene) != before
    restore(bpy.context.scene)
    bpy.context.view_layer.update()
    after = snapshot(bpy.context.scene)
    for region, expected in before.items():
        assert after[region] == expected, region


def test_applying_twice_changes_nothing_and_another_result_replaces_the_first():
    mixed_scene()
    result, runs = solve(lamp_faces=[0])
    before = snapshot(bpy.context.scene)
    scene = bpy.context.scene
    apply_to_objects(result, runs, scene, "key")
    applied = snapshot(scene)
    assert not apply_to_objects(result, runs, scene, "key")
    assert snapshot(scene) == applied
    assert apply_to_objects(result, runs, scene, "another key")
    assert {kind: len(names) for kind, names in snapshot(scene)["blocks"].items()} == {
        kind: len(names) for kind, names in applied["blocks"].items()
    }
    restore(scene)
    bpy.context.view_layer.update()
    assert snapshot(scene) == before


def test_originals_come_back_after_save_and_reload(tmp_path):
    mixed_scene()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "before.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "before.blend"))
    result, runs = solve(lamp_faces=[0])
    before = snapshot(bpy.context.scene)
    apply_to_objects(result, runs, bpy.context.scene, "key")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "applied.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "applied.blend"))
    assert all(image.packed_file for image in bpy.data.images if image.name.startswith("IRIS"))
    assert restore(bpy.context.scene) == 6
    bpy.context.view_layer.update()
    after = snapshot(bpy.context.scene)
    for region, expected in before.items():
        assert after[region] == expected, region


def with_backdrop(result: Result) -> Result:
    """``result`` with a sky that depends on direction and a backdrop that reflects: every image there can be."""
    random = np.random.default_rng(2)
    corners = np.array([[-9.0, -9, -9], [15, 0, 0], [0, 15, 0], [0, 0, 16]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    shell = Backdrop(corners, faces, *random.uniform(0.2, 0.9, (2, 8, 16, 3)).astype(np.float32))
    return replace(result, outside=OutsideLight(random.uniform(0.1, 0.5, (9, 3))), backdrop=shell)


def pixels() -> dict[str, np.ndarray]:
    """What every image of ours holds."""
    found = {}
    for image in bpy.data.images:
        if image.name.startswith("IRIS"):
            found[image.name] = np.empty(len(image.pixels), np.float32)
            image.pixels.foreach_get(found[image.name])
    return found


def same_pixels(expected: dict[str, np.ndarray]) -> None:
    """Every image of ours holds ``expected``, as exactly as half floats and 8 bits keep it."""
    found = pixels()
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, rtol=1e-3, atol=3e-3, err_msg=name)


IMAGES = {"IRIS Outside", "IRIS Backdrop", "IRIS Backdrop Albedo", "IRIS Base Color", "IRIS Confidence"}


def test_every_image_keeps_its_pixels_through_save_and_reload(tmp_path):
    cube("box")
    result, runs = solve(lamp_faces=[0])
    apply_to_objects(with_backdrop(result), runs, bpy.context.scene, "key")
    before = pixels()
    assert before.keys() >= IMAGES and all(before[name][:3].any() for name in IMAGES)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "applied.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "applied.blend"))
    same_pixels(before)


def test_every_image_keeps_its_pixels_through_undo_and_redo():
    bpy.context.preferences.edit.use_global_undo = True
    cube("box")
    result, runs = solve(lamp_faces=[0])
    bpy.ops.ed.undo_push(message="before")
    apply_to_objects(with_backdrop(result), runs, bpy.context.scene, "key")
    before = pixels()
    bpy.ops.ed.undo_push(message="Apply")
    bpy.context.scene.frame_current = 7
    bpy.ops.ed.undo_push(message="something after it")
    bpy.ops.ed.undo()
    assert bpy.context.scene.frame_current == 1
    same_pixels(before)
    bpy.ops.ed.undo()
    assert not pixels()
    bpy.ops.ed.redo()
    same_pixels(before)


def test_the_object_s_own_uv_map_is_used_where_the_result_is_on_it():
    thing = cube("box")
    runs_uv = np.random.default_rng(0).random((8, 2)).astype(np.float32)
    layer = thing.data.uv_layers["Own"]
    for loop in range(len(thing.data.loops)):
        layer.uv[loop].vector = runs_uv[loop % 8]
    bpy.context.view_layer.update()
    uv = read_scene_mesh(bpy.context.evaluated_depsgraph_get()).mesh.uv
    result, runs = solve(uv=uv)
    apply_to_objects(result, runs, bpy.context.scene, "key")
    assert [layer.name for layer in thing.data.uv_layers] == ["Own"]
    node = next(n for n in thing.data.materials[0].node_tree.nodes if n.bl_idname == "ShaderNodeUVMap")
    assert node.uv_map == "Own"


def test_an_n_gon_that_the_atlas_cuts_is_made_of_triangles():
    thing = cube("box")
    uv = np.random.default_rng(0).random((12, 3, 2)).astype(np.float32)
    result, runs = solve(uv=uv)
    apply_to_objects(result, runs, bpy.context.scene, "key")
    assert len(thing.data.polygons) == 12
    kept = np.array([[tuple(thing.data.uv_layers["IRIS"].uv[3 * f + c].vector) for c in range(3)] for f in range(12)])
    np.testing.assert_allclose(kept, uv, atol=1e-6)


def test_a_scene_that_changed_is_refused_before_anything_is_touched():
    thing = cube("box")
    result, runs = solve()
    thing.name = "renamed"
    before = snapshot(bpy.context.scene)
    with pytest.raises(BadInput, match="'box' is gone"):
        apply_to_objects(result, runs, bpy.context.scene, "key")
    assert snapshot(bpy.context.scene) == before
    with pytest.raises(BadInput, match="not in this scene"):
        whole_object(None)


def test_lamps_are_switched_dimmed_and_tinted_in_their_materials():
    thing = cube("box")
    result, runs = solve(lamp_faces=[4, 5])
    apply_to_objects(result, runs, bpy.context.scene, "key")
    (lamp,) = lamp_materials(bpy.context.scene.objects)
    socket = lamp.node_tree.nodes["Principled BSDF"].inputs
    assert is_on(lamp) and strength(lamp) == 6
    switch(lamp, False)
    assert not is_on(lamp) and socket["Emission Strength"].default_value == 0 and strength(lamp) == 6
    set_strength(lamp, 9)
    assert socket["Emission Strength"].default_value == 0
    switch(lamp, True)
    switch(lamp, True)
    assert socket["Emission Strength"].default_value == 9
    set_color(lamp, (1, 0, 0))
    assert tuple(socket["Emission Color"].default_value) == (1, 0, 0, 1)
    assert show_confidence([thing], True)
    assert thing.data.materials[0].node_tree.nodes.active.name == "IRIS Confidence"


def test_a_linked_object_is_refused_with_a_fix(tmp_path):
    cube("box")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, wanted):
        wanted.objects = ["box"]
    bpy.context.scene.collection.objects.link(wanted.objects[0])
    result, runs = solve()
    with pytest.raises(BadInput, match="linked from another file — make it local"):
        apply_to_objects(result, runs, bpy.context.scene, "key")


def test_what_openings_show_dims_with_the_light_through_them(tmp_path):
    """The picture of the backdrop, rendered, follows the strength of the world."""
    scene = bpy.context.scene
    cube("box")
    result, runs = solve()
    result = with_backdrop(result)
    assert result.backdrop is not None
    result = replace(
        result,
        outside=None,
        backdrop=replace(result.backdrop, picture=np.full((8, 16, 3), 2.0, np.float32), albedo=None),
    )
    apply_to_objects(result, runs, scene, "key")
    camera = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    camera.location, camera.rotation_euler = (-3, -3, -3), (0.5, 0, 0)  # inside the shell, away from the box
    scene.collection.objects.link(camera)
    scene.camera, scene.cycles.samples, scene.cycles.use_denoising = camera, 1, False
    scene.render.resolution_x = scene.render.resolution_y = 4
    scene.render.image_settings.file_format = "OPEN_EXR"

    def seen(strength: float) -> np.ndarray:
        scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = strength
        scene.render.filepath = str(tmp_path / f"{strength}.exr")
        bpy.ops.render.render(write_still=True)
        return read_exr(tmp_path / f"{strength}.exr")

    full = seen(1.0)[..., :3]
    np.testing.assert_allclose(full, 2.0, rtol=1e-2)
    np.testing.assert_allclose(seen(0.25)[..., :3], 0.25 * full, rtol=1e-2)
    assert not seen(0.0)[..., :3].any()


def test_a_scene_keeps_its_camera_when_the_result_is_gone():
    cube("box")
    result, runs = solve()
    scene = bpy.context.scene
    with pytest.raises(BadInput, match="no recovered camera"):
        kept_look(scene)
    apply_to_objects(result, runs, scene, "key")
    response, exposures = kept_look(scene)
    np.testing.assert_array_equal(response.samples, result.response.samples)
    assert exposures.keys() == result.exposures.keys()
    restore(scene)
    assert LOOK not in scene


def scatter(thing: bpy.types.Object, leaf: bpy.types.Object) -> None:
    """Geometry nodes that put an instance of ``leaf`` on every vertex of ``thing`` and keep its own mesh."""
    tree = bpy.data.node_groups.new("scatter", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    own, out = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    points, join = tree.nodes.new("GeometryNodeInstanceOnPoints"), tree.nodes.new("GeometryNodeJoinGeometry")
    source = tree.nodes.new("GeometryNodeObjectInfo")
    source.inputs["Object"].default_value, source.inputs["As Instance"].default_value = leaf, True
    for a, b in (
        (own.outputs[0], points.inputs["Points"]),
        (source.outputs["Geometry"], points.inputs["Instance"]),
        (points.outputs[0], join.inputs[0]),
        (own.outputs[0], join.inputs[0]),
        (join.outputs[0], out.inputs[0]),
    ):
        tree.links.new(a, b)
    thing.modifiers.new("scatter", "NODES").node_group = tree


def test_instances_of_geometry_nodes_get_the_result_too():
    thing, leaf = cube("host"), cube("leaf", location=(50, 0, 0), scale=(0.1, 0.1, 0.1))
    scatter(thing, leaf)
    geometry = evaluated_faces()
    result, runs = solve(lamp_faces=[0])
    assert [(run.object, run.instance) for run in runs] == [("host", False), *[("host", True)] * 8, ("leaf", False)]
    before = snapshot(bpy.context.scene)
    apply_to_objects(result, runs, bpy.context.scene, "key")
    np.testing.assert_allclose(evaluated_faces(), geometry, atol=2e-4)
    restore(bpy.context.scene)
    bpy.context.view_layer.update()
    assert snapshot(bpy.context.scene) == before
