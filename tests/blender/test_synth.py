"""synth: the capture it makes is complete, consistent with itself, and true to the scene it came from."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from scipy.ndimage import binary_erosion

from iris_addon.base.errors import BadInput
from iris_addon.base.images import read_exr, read_image, read_map
from iris_addon.blender.camera import read_camera
from iris_addon.blender.render.cycles import render_coverage, render_linear, set_cycles
from iris_addon.blender.scene_out.materials import layer_transmittance
from iris_addon.blender.synth.lamp_switches import LIGHT_STATE, ON_IN, UNLIT
from iris_addon.blender.synth.photos import GREY, exposures, film, read_response
from iris_addon.blender.synth.renders import add_outputs, render_maps
from iris_addon.blender.synth.run import TRUTH_RENDER, SynthConfig, synth
from iris_addon.capture.reader import read_capture
from iris_addon.model.capture import Capture
from iris_addon.model.render_settings import RenderSettings
from iris_addon.rays.tracer import Tracer

pytestmark = pytest.mark.bpy

DEMO = Path(__file__).resolve().parents[2] / "assets" / "demo_room"
WIDTH, HEIGHT = 40, 30
LAMP = (6.0, 5.0, 4.0)
PAINT = (0.2, 0.5, 0.7)


# ---- a room to render -----------------------------------------------------------------------------------------------


def material(name: str, color=(0.6, 0.6, 0.6), emission=None):
    made = bpy.data.materials.new(name)
    if made.node_tree is None:
        made.use_nodes = True
    shader = made.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*color, 1.0)
    shader.inputs["Roughness"].default_value = 1.0
    if emission:
        shader.inputs["Emission Color"].default_value = (*(c / 2 for c in emission), 1.0)
        shader.inputs["Emission Strength"].default_value = 2.0
    return made


def box(name: str, size, at, surface):
    x, y, z = (np.array([-1, 1]) * s / 2 for s in size)
    vertices = [(a, b, c) for a in x for b in y for c in z]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces)
    mesh.materials.append(surface)
    thing = bpy.data.objects.new(name, mesh)
    thing.location = at
    bpy.context.scene.collection.objects.link(thing)
    return thing


def photographer(name: str, at, rotation, angle=1.2):
    data = bpy.data.cameras.new(name)
    data.sensor_fit, data.angle, data.clip_start = "HORIZONTAL", angle, 0.01
    thing = bpy.data.objects.new(name, data)
    thing.location, thing.rotation_euler = at, rotation
    bpy.context.scene.collection.objects.link(thing)
    return thing


def build_room(path: Path) -> Path:
    """A room with a turned block, a ceiling lamp and a lower wall lamp, five photos and one validation view."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    box("room", (4, 3, 2.5), (0, 0, 1.25), material("plaster"))
    box("block", (0.6, 0.6, 0.8), (0.6, 0.5, 0.401), material("paint", PAINT)).rotation_euler = (0, 0, 0.4)
    box("lamp", (0.8, 0.8, 0.05), (0, 0, 2.4), material("lamp", emission=LAMP))
    box("wall lamp", (0.05, 0.4, 0.4), (1.9, -0.6, 1.5), material("wall lamp", emission=(1.0, 2.0, 3.0)))
    for k, (pitch, turn) in enumerate(((1.4, -1.7), (2.0, -0.85), (1.45, -0.7), (1.3, 0.1), (1.5, 0.6))):
        photographer(f"photo {k}", (-1.2 + 0.1 * k, -1.0, 1.3), (pitch, 0.05 * k, turn))
    photographer("val 0", (-1.4, -0.8, 1.6), (1.2, 0, -0.9))
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("synth")
    out = folder / "capture"
    render = replace(TRUTH_RENDER, samples=8)
    synth(build_room(folder / "room.blend"), out, SynthConfig(resolution=(WIDTH, HEIGHT), render=render))
    return out


@pytest.fixture(scope="module")
def read(capture: Path) -> Capture:
    return read_capture(capture)


def gt(capture: Path, name: str, k: int, split: str = "train") -> np.ndarray:
    stem = f"{k:03d}.exr" if name == "albedo" else f"{k:03d}_0001.exr"
    return read_exr(capture / "gt" / split / name / stem)


# ---- the capture ----------------------------------------------------------------------------------------------------


def test_layout_is_complete(capture: Path):
    names = ["Image", "DiffCol", "BaseCol", "Roughness", "Metallic", "Emit", "IndexMA", "albedo", "Depth", "Normal"]
    for name in names:
        assert gt(capture, name, 4).shape == (HEIGHT, WIDTH, 3)
        assert gt(capture, name, 0, "val").shape == (HEIGHT, WIDTH, 3)
    for kind in ("new_lights", "one_emitter"):
        assert read_exr(capture / "gt" / "relight" / kind / "000_0001.exr").shape == (HEIGHT, WIDTH, 3)
    assert np.load(capture / "gt" / "cam" / "crf_gt.npy").shape == (3, 1024)
    assert not list(capture.parent.glob(".*-partial"))
    assert (capture / "gt" / "val" / "Image" / "000_0001.png").is_file()
    assert not (capture / "val" / "Image").exists(), "photos of validation views are ground truth"


def test_photos_are_the_radiance_through_the_response(capture: Path, read: Capture):
    curve = np.load(capture / "gt" / "cam" / "crf_gt.npy")[0]
    for k, view in enumerate(read.views):
        x = np.clip(gt(capture, "Image", k).astype(np.float64) * view.exposure, 0, 1)
        assert (read_image(view.photo) == np.floor(255 * np.interp(x, np.linspace(0, 1, 1024), curve))).all()


def test_captured_camera_poses_are_those_of_blender(capture: Path, read: Capture):
    for view, name in zip((*read.views, *read.val_views), (*(f"photo {k}" for k in range(5)), "val 0"), strict=True):
        assert view.camera.c2w == pytest.approx(np.array(bpy.data.objects[name].matrix_world), abs=1e-6)
        assert 2 * np.arctan(WIDTH / 2 / view.camera.fx) == pytest.approx(1.2)
    assert read.up == pytest.approx((0, 0, 1))


def test_maps_agree_with_rays_against_the_mesh(capture: Path, read: Capture):
    per_face = np.load(capture / "gt" / "faces.npz", allow_pickle=False)
    tracer = Tracer(read.mesh)
    for k, view in enumerate(read.views):
        hits = tracer.closest(*view.camera.rays())
        material_hit = np.where(hits.face >= 0, per_face["material"][hits.face], 0).reshape(HEIGHT, WIDTH)
        depth = gt(capture, "Depth", k)[..., 0]
        same = material_hit == gt(capture, "IndexMA", k)[..., 0]
        assert same.mean() > 0.995
        assert np.median(np.abs(depth - hits.distance.reshape(HEIGHT, WIDTH)) / depth) < 1e-3  # half floats


def test_maps_hold_the_principled_inputs(capture: Path):
    materials = {m["name"]: m["index"] for m in json.loads((capture / "gt" / "materials.json").read_text())}
    found = False
    for k in range(5):
        on_block = gt(capture, "IndexMA", k)[..., 0] == materials["paint"]
        found |= on_block.any()
        assert np.abs(gt(capture, "BaseCol", k)[on_block] - PAINT).max(initial=0) < 1e-3
        left = np.array(PAINT) * layer_transmittance(1.0, "MULTI_GGX")
        assert np.abs(gt(capture, "BaseCol", k)[on_block] - PAINT).max(initial=0) < 1e-3
        assert np.abs(gt(capture, "DiffCol", k)[on_block] - left).max(initial=0) < 1e-3
        assert (gt(capture, "Roughness", k)[on_block] == 1).all()
        assert (gt(capture, "albedo", k)[on_block] > gt(capture, "DiffCol", k)[on_block]).all()
    assert found


def test_mixed_shaders_give_mixed_maps(tmp_path: Path):
    build_room(tmp_path / "room.blend")
    scene, paint = bpy.context.scene, bpy.data.materials["paint"]
    tree = paint.node_tree
    gloss, mix = tree.nodes.new("ShaderNodeBsdfAnisotropic"), tree.nodes.new("ShaderNodeMixShader")
    gloss.inputs["Color"].default_value, gloss.inputs["Roughness"].default_value = (0.8, 0.4, 0.0, 1.0), 0.2
    mix.inputs[0].default_value = 0.25
    tree.links.new(tree.nodes["Principled BSDF"].outputs[0], mix.inputs[1])
    tree.links.new(gloss.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], tree.nodes["Material Output"].inputs["Surface"])
    scene.render.resolution_x, scene.render.resolution_y = WIDTH, HEIGHT
    add_outputs(scene, [paint])
    thing = bpy.data.objects["photo 2"]
    maps = render_maps(scene, read_camera(scene, thing), thing)
    on_block = maps.material == 1
    assert on_block.any()
    assert maps.base_color[on_block] == pytest.approx(
        np.tile(0.75 * np.array(PAINT) + [0.2, 0.1, 0.0], (on_block.sum(), 1)), abs=1e-5
    )
    assert maps.roughness[on_block] == pytest.approx(0.8, abs=1e-5)
    assert maps.metallic[on_block] == pytest.approx(0.25, abs=1e-5)
    assert maps.layer[on_block] == pytest.approx(1, abs=1e-5)
    left = 0.25 + 0.75 * layer_transmittance(1.0, "MULTI_GGX")
    assert maps.diffuse_albedo[on_block] == pytest.approx(0.75 * left * maps.base_color[on_block], abs=1e-4)


@pytest.mark.parametrize("roughness", [0.2, 0.45, 1.0])
@pytest.mark.parametrize("surface", ["MULTI_GGX", "GGX", "textured", "no layer"])
def test_true_albedo_is_what_cycles_reflects(surface: str, roughness: float):
    """A ball in a white world is as bright as its directional albedo, over all angles together."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("white")
    if scene.world.node_tree is None:
        scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs[0].default_value = (1, 1, 1, 1)
    bpy.ops.mesh.primitive_uv_sphere_add(segments=128, ring_count=64)
    bpy.ops.object.shade_smooth()
    paint = material("paint", (0.7, 0.4, 0.1))
    bpy.context.object.data.materials.append(paint)
    shader = paint.node_tree.nodes["Principled BSDF"]
    shader.inputs["Roughness"].default_value = roughness
    if surface == "textured":
        value = paint.node_tree.nodes.new("ShaderNodeValue")
        value.outputs[0].default_value = roughness
        paint.node_tree.links.new(value.outputs[0], shader.inputs["Roughness"])
    elif surface == "no layer":
        shader.inputs["Specular IOR Level"].default_value = 0.0
    else:
        shader.distribution = surface
    thing = photographer("photo", (0, 0, 50), (0, 0, 0), 0.04)
    scene.render.resolution_x = scene.render.resolution_y = 48
    add_outputs(scene, [paint])
    maps = render_maps(scene, read_camera(scene, thing), thing)
    set_cycles(scene, RenderSettings(samples=256, denoise=False, seed=0, max_bounces=2))
    scene.cycles.pixel_filter_type, scene.render.film_transparent = "BOX", True
    seen = render_linear(scene).sum((0, 1)) / render_coverage(scene).sum()
    assert maps.albedo[maps.material == 1].mean(0) == pytest.approx(seen, rel=0.012, abs=0.004)


def test_emitter_faces_emit_the_radiance_that_is_rendered(capture: Path, read: Capture):
    emitters = {e["name"]: e for e in json.loads((capture / "gt" / "emitters.json").read_text())}
    assert emitters["lamp"]["radiance"] == pytest.approx(LAMP)
    assert emitters["lamp"]["area"] == pytest.approx(2 * 0.64 + 4 * 0.8 * 0.05, rel=1e-4)
    per_face = np.load(capture / "gt" / "faces.npz", allow_pickle=False)["emitter"]
    for e in emitters.values():
        assert (np.flatnonzero(per_face == e["emitter"]) == np.arange(*e["faces"])).all()
    seen = 0
    tracer = Tracer(read.mesh)
    for k, view in enumerate(read.views):
        face = tracer.closest(*view.camera.rays()).face
        on_lamp = (per_face[face] == emitters["lamp"]["emitter"]).reshape(HEIGHT, WIDTH)
        # Pixels on the rim average over what is behind.
        inside = binary_erosion(on_lamp)
        reflected = 0.1 * max(LAMP)  # the lamp is not black here
        assert (np.abs(gt(capture, "Image", k)[inside] - LAMP) < reflected + 0.6).all()
        assert np.abs(gt(capture, "Emit", k)[inside] - LAMP).max(initial=0) < 0.01
        seen += inside.sum()
    assert seen > 0


def test_references_change_the_listed_lights(capture: Path):
    lights = json.loads((capture / "relight" / "lights.json").read_text())
    emitters = json.loads((capture / "gt" / "emitters.json").read_text())
    strongest = next(e for e in emitters if e["name"] == "lamp")
    assert lights["one_emitter"]["kept_faces_of_scene_ply"] == list(range(*strongest["faces"]))
    original = gt(capture, "Image", 0, "val").mean()
    kept = read_exr(capture / "gt" / "relight" / "one_emitter" / "000_0001.exr").mean()
    assert 0.5 * original < kept < original


def test_balls_rest_on_surfaces_and_show_in_their_masks(capture: Path, read: Capture):
    views = json.loads((capture / "insert" / "objects.json").read_text())["views"]
    assert views
    for view in views:
        mask = read_map(capture / "gt" / "insert" / "mask" / f"{view['view']:03d}_0001.png")
        assert set(np.unique(mask)) == {0, *(o["id"] for o in view["objects"])}
        camera = read.val_views[view["view"]].camera
        for o in view["objects"]:
            centre, radius = np.array(o["center"]), o["radius"]
            distance = Tracer(read.mesh).closest(centre[None], np.array([[0.0, 0.0, -1.0]])).distance[0]
            assert 0 < distance - radius < 0.001
            i, j = camera.project(camera.local(centre))
            assert mask[int(j), int(i)] == o["id"]


# ---- photos ---------------------------------------------------------------------------------------------------------


def test_brightest_fifth_gets_the_lowest_level():
    brightness = np.random.default_rng(0).permutation(np.linspace(1, 2, 25))
    train, val, scale = exposures(brightness, [0.5, 3.0], (0.25, 0.5, 1, 2, 4))
    level = train / scale
    assert [(level == x).sum() for x in (0.25, 0.5, 1, 2, 4)] == [5] * 5
    assert brightness[level == 0.25].min() > brightness[level == 0.5].max()
    assert val / scale == pytest.approx([4.0, 0.25])
    assert np.median(brightness) * scale == pytest.approx(GREY)


def test_film_is_a_response_unlike_a_power():
    z, x = film().samples[0], np.linspace(0, 1, 1024)
    assert (z[0], z[-1]) == (0, 1)
    assert (np.diff(z) > 0).all()
    best = min(np.sqrt(np.mean((z - x**g) ** 2)) for g in np.linspace(0.2, 1, 81))
    assert best > 0.02


def test_a_decreasing_response_is_refused(tmp_path: Path):
    np.save(tmp_path / "curve.npy", np.linspace(1, 0, 1024))
    with pytest.raises(BadInput, match=r"curve\.npy.*monotone"):
        read_response(tmp_path / "curve.npy")


# ---- refusals -------------------------------------------------------------------------------------------------------


def test_lamps_are_switched_from_photo_to_photo(tmp_path: Path):
    blend = build_room(tmp_path / "room.blend")
    bpy.data.objects["wall lamp"][ON_IN] = "evening, all"
    bpy.data.objects["wall lamp"][UNLIT] = material("unlit", PAINT)
    bpy.data.objects["lamp"][ON_IN], bpy.data.objects["lamp"][UNLIT] = "all", material("unlit lamp", PAINT)
    cameras = [thing for thing in bpy.data.objects if thing.type == "CAMERA"]
    for thing in cameras:
        thing[LIGHT_STATE] = "all" if thing.name in ("photo 2", "val 0") else "evening"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    render = replace(TRUTH_RENDER, samples=8)
    synth(blend, tmp_path / "capture", SynthConfig(resolution=(WIDTH, HEIGHT), render=render))
    read = read_capture(tmp_path / "capture")
    states = [view.light_state for view in read.views]
    assert states == ["evening", "evening", "all", "evening", "evening"]
    assert [view.light_state for view in read.val_views] == ["all"]
    lamps = json.loads((tmp_path / "capture" / "gt" / "emitters.json").read_text())
    shown = {state: set() for state in states}
    for k, state in enumerate(states):
        emission = gt(tmp_path / "capture", "Emit", k)
        face = Tracer(read.mesh).closest(*read.views[k].camera.rays()).face.reshape(HEIGHT, WIDTH)
        for lamp in lamps:
            on = (face >= lamp["faces"][0]) & (face < lamp["faces"][1])
            if on.any():
                lit = bool((emission[on] > 0).all())
                assert lit == (lamp["name"] == "wall lamp" or state == "all")
                assert lit or np.abs(gt(tmp_path / "capture", "BaseCol", k)[on] - PAINT).max() < 0.01
                shown[state].add(lamp["name"])
    assert shown["evening"] == {"lamp", "wall lamp"}
    kept = json.loads((tmp_path / "capture" / "relight" / "lights.json").read_text())["one_emitter"]
    first = lamps[[lamp["faces"][0] for lamp in lamps].index(kept["kept_faces_of_scene_ply"][0])]["name"]
    assert kept["light_state"] == {"lamp": "all", "wall lamp": "evening"}[first]
    views = json.loads((tmp_path / "capture" / "insert" / "objects.json").read_text())["views"]
    assert [view["light_state"] for view in views] == ["all"] * len(views)


def test_balls_are_inserted_in_the_light_state_of_their_view(tmp_path: Path):
    """With the brighter lamp off the reference is as dark as the view."""
    mean = {}
    for state in ("all", "evening"):
        blend = build_room(tmp_path / f"{state}.blend")
        bpy.data.objects["lamp"][ON_IN], bpy.data.objects["lamp"][UNLIT] = "all", material("unlit lamp", PAINT)
        for thing in [thing for thing in bpy.data.objects if thing.type == "CAMERA"]:
            thing[LIGHT_STATE] = state if thing.name.startswith("val") else "all"
        bpy.ops.wm.save_as_mainfile(filepath=str(blend))
        root, render = tmp_path / state, replace(TRUTH_RENDER, samples=8)
        synth(blend, root, SynthConfig(resolution=(WIDTH, HEIGHT), render=render))
        (view, *_) = json.loads((root / "insert" / "objects.json").read_text())["views"]
        assert view["light_state"] == state
        picture = f"{view['view']:03d}_0001"
        outside = read_image(root / "gt" / "insert" / "mask" / f"{picture}.png").max(-1) == 0
        inserted = read_exr(root / "gt" / "insert" / "Image" / f"{picture}.exr")[outside].mean()
        without = read_exr(root / "gt" / "val" / "Image" / f"{picture}.exr")[outside].mean()
        assert inserted == pytest.approx(without, rel=0.25)
        mean[state] = inserted
    assert mean["evening"] < 0.5 * mean["all"]


def test_a_switched_lamp_needs_a_material_for_when_it_is_off(tmp_path: Path):
    blend = build_room(tmp_path / "room.blend")
    bpy.data.objects["lamp"][ON_IN] = "all"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    with pytest.raises(BadInput, match="'lamp' has states in which it is off"):
        synth(blend, tmp_path / "capture", SynthConfig(resolution=(WIDTH, HEIGHT)))


def test_a_folder_with_files_is_not_overwritten(tmp_path: Path):
    (tmp_path / "kept.txt").write_text("mine")
    with pytest.raises(BadInput, match="not empty"):
        synth(tmp_path / "room.blend", tmp_path)
    assert (tmp_path / "kept.txt").read_text() == "mine"


def test_a_surface_without_ground_truth_is_named(tmp_path: Path):
    build_room(tmp_path / "room.blend")
    tree = bpy.data.materials["paint"].node_tree
    glass = tree.nodes.new("ShaderNodeBsdfGlass")
    tree.links.new(glass.outputs[0], tree.nodes["Material Output"].inputs["Surface"])
    bpy.ops.wm.save_mainfile()
    with pytest.raises(BadInput, match=r"paint.*Glass"):
        synth(tmp_path / "room.blend", tmp_path / "out", SynthConfig(resolution=(WIDTH, HEIGHT)))
    assert not (tmp_path / "out").exists()


# ---- the bundled capture --------------------------------------------------------------------------------------------


def test_bundled_capture_is_small_and_complete():
    size = sum(path.stat().st_size for path in DEMO.rglob("*") if path.is_file())
    assert size < 8e6
    demo = read_capture(DEMO)
    assert len(demo.views) >= 24
    assert demo.exposures_known
    emitters = json.loads((DEMO / "gt" / "emitters.json").read_text())
    assert len(emitters) == 3
    saturated = [(read_image(view.photo) >= 253).all(-1).mean() > 0.002 for view in demo.views]
    assert np.mean(saturated) > 0.5
