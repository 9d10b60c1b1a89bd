"""The panel's farm job is the bundle that the command line writes, and its frames show the scene as it is animated."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from headless import cli
from headless.job_file import Frames, read_jobs
from iris_addon.base.images import read_image, write_png
from iris_addon.capture.reader import read_views
from iris_addon.edits.jobs import lamp_radiance
from iris_addon.edits.motion import at_time, camera_at
from iris_addon.results.folder import load_result
from tests.blender_home import ROOT, build_package, in_blender

pytestmark = [pytest.mark.bpy, pytest.mark.skipif(sys.platform == "win32", reason="as the other tests of the package")]

BODY = """
assert not bpy.ops.iris.export_farm.poll()
assert bpy.ops.iris.open_demo() == {{"FINISHED"}}
settings, camera = scene.iris, scene.camera
settings.atlas_size, settings.texels_per_metre = "4096", 75
scene.frame_start, scene.frame_end, scene.frame_step = 11, 17, 2
for frame, shift in ((11, 0.0), (17, 0.3)):
    camera.location.x += shift
    camera.keyframe_insert("location", frame=frame)
first, second, third = settings.lamps
first.on = False
second.strength *= 0.5
shader = next(n for n in third.material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
level = shader.inputs["Emission Strength"]
level.default_value = 4.0
level.keyframe_insert("default_value", frame=11)
level.default_value = 1.0
level.keyframe_insert("default_value", frame=17)
scene.render.resolution_percentage = 15
scene.frame_set(13)
assert bpy.ops.iris.export_farm(directory={bundle!r}, samples=2, chunk=3) == {{"FINISHED"}}
assert scene.frame_current == 13
frames = []
for frame in (11, 13, 15, 17):
    scene.frame_set(frame)
    place = settings.room.matrix_world.inverted() @ camera.matrix_world
    radiance = {{l.material["iris_lamp"]: [l.on * l.strength * c for c in l.color] for l in settings.lamps}}
    frames.append([[list(row) for row in place], radiance])
print("SEEN", json.dumps(frames))
scene.frame_set(11)
ball = bpy.data.objects.new("ball", bpy.data.meshes.new("ball"))
import bmesh
shape = bmesh.new()
bmesh.ops.create_uvsphere(shape, u_segments=16, v_segments=8, radius=0.25)
shape.to_mesh(ball.data)
ball.data.materials.append(bpy.data.materials.new("green"))
ball.data.materials[0].use_nodes = True
paint = next(n for n in ball.data.materials[0].node_tree.nodes if n.type == "BSDF_PRINCIPLED")
paint.inputs["Base Color"].default_value = (0, 1, 0, 1)
paint.inputs["Emission Color"].default_value = (0, 1, 0, 1)
paint.inputs["Emission Strength"].default_value = 2.0
scene.collection.objects.link(ball)
ball.matrix_world = camera.matrix_world @ __import__("mathutils").Matrix.Translation((0, 0, -0.8))
assert bpy.ops.iris.export_farm(directory={placed!r}, samples=2, chunk=3) == {{"FINISHED"}}
image = bpy.data.images.load({plate!r})
image.source = "SEQUENCE"
while camera.data.background_images:
    camera.data.background_images.remove(camera.data.background_images[0])
behind = camera.data.background_images.new()
behind.source, behind.image = "IMAGE", image
behind.image_user.frame_start, behind.image_user.frame_duration = 11, 7
behind.image_user.frame_offset = 1000
assert bpy.ops.iris.export_farm(directory={onto!r}, samples=2, chunk=3) == {{"FINISHED"}}
"""
AGAIN = """
assert bpy.ops.iris.open_demo() == {{"FINISHED"}}
settings, camera = scene.iris, scene.camera
scene.frame_start, scene.frame_end = 1, 4
for directory in {unchanged!r}, {unchanged!r} + " again":
    assert bpy.ops.iris.export_farm(directory=directory, samples=2) == {{"FINISHED"}}
assert bpy.ops.iris.export_farm(directory={sharper!r}, samples=4) == {{"FINISHED"}}
settings.lamps[0].strength *= 0.5
assert bpy.ops.iris.export_farm(directory={dimmed!r}, samples=2) == {{"FINISHED"}}
"""


@pytest.fixture(scope="module")
def exported(tmp_path_factory) -> tuple[Path, list]:
    """The bundle, and the cameras and lamps that Blender had at each of its frames."""
    home, bundle = tmp_path_factory.mktemp("home"), tmp_path_factory.mktemp("farm") / "bundle"
    package = build_package(tmp_path_factory.mktemp("package") / "iris.zip")
    plate = bundle.parent / "sh.1001.png"
    write_png(plate, np.full((72, 96, 3), 90, np.uint8))
    others = {"placed": str(bundle.parent / "placed"), "onto": str(bundle.parent / "onto"), "plate": str(plate)}
    output = in_blender(package, home, BODY.format(bundle=str(bundle), **others))
    seen = next(line for line in output.splitlines() if line.startswith("SEEN "))
    return bundle, json.loads(seen[5:])


def test_the_bundle_is_that_of_the_command_line(exported, tmp_path):
    bundle, _ = exported
    (job_file,) = bundle.glob("*.toml")
    assert cli.main(["farm", str(job_file), "--out", str(tmp_path)]) == 0
    for name in ("template.json", "parameter_values.json", "asset_references.json", "flamenco_job.json"):
        assert (bundle / name).read_bytes() == (tmp_path / name).read_bytes()
    (job,) = read_jobs(job_file)
    assert job.capture.is_dir() and job.config.preset == "balanced"
    assert (job.config.atlas_size, job.config.texels_per_metre) == (4096, 75)
    assert (job.frames[0].last, job.frames[0].chunks) == (4, 2)


def test_farms_take_it(exported):
    pytest.importorskip("openjd.cli", reason="openjd-cli is not installed")
    bundle, _ = exported
    command = [sys.executable, "-m", "openjd", "check", str(bundle / "template.json")]
    checked = subprocess.run(command, capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stdout + checked.stderr


def test_every_frame_has_the_camera_and_the_lamps_that_it_has_in_blender(exported):
    bundle, seen = exported
    (job_file,) = bundle.glob("*.toml")
    (job,) = read_jobs(job_file)
    result, spec = load_result(job.out), json.loads((bundle / f"{job_file.stem}-lights.json").read_text())
    cameras = [view.camera for view in read_views(bundle / f"{job_file.stem}-views.json")]
    levels = []
    for number, (pose, radiance) in enumerate(seen):
        time = number / len(seen)
        camera = camera_at(at_time(spec["camera"], time), cameras, result.up, time)
        np.testing.assert_allclose(camera.c2w, pose, atol=1e-5)
        found = lamp_radiance(result, at_time(spec["recovered"], time))
        for emitter, value in zip(result.emitters, found, strict=True):
            np.testing.assert_allclose(value, radiance[str(emitter.id)], rtol=1e-4, atol=1e-5)
        levels.append(sum(value.max() for value in found))
    assert np.ptp([pose[0][3] for pose, _ in seen]) > 0.1 and levels[0] > levels[-1]


@pytest.mark.parametrize(("kind", "waits"), [("placed", True), ("onto", False)])
def test_what_was_placed_travels_in_a_copy_of_the_scene(exported, kind, waits):
    """Frames without a plate share the exposure of the first; onto a plate each has its own."""
    bundle = exported[0].parent / kind
    (job_file,) = bundle.glob("*.toml")
    (frames,) = read_jobs(job_file)[0].frames
    assert (frames.command, frames.first, frames.last, frames.chunks) == ("composite", 11, 17, 3)
    assert frames.waits_for_first == waits and frames.scene == job_file.with_suffix(".blend")
    assets = json.loads((bundle / "asset_references.json").read_text())["assetReferences"]
    assert str(frames.scene) in assets["inputs"]["filenames"]
    look = f"import bpy\nwith bpy.data.libraries.load({str(frames.scene)!r}) as (found, _):\n    print(found.objects)"
    found = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True)
    assert "'ball'" in found.stdout


def out_of(bundle: Path) -> Path:
    (job_file,) = bundle.glob("*.toml")
    (job,) = read_jobs(job_file)
    return job.frames[0].out


def test_frames_of_a_changed_export_have_a_folder_of_their_own(tmp_path):
    """So that finished ones of another state of the scene, or of other settings, are not kept for them."""
    (tmp_path / "home").mkdir()
    package = build_package(tmp_path / "iris.zip")
    names = {name: str(tmp_path / name) for name in ("unchanged", "sharper", "dimmed")}
    in_blender(package, tmp_path / "home", AGAIN.format(**names))
    outs = {name: out_of(Path(path)) for name, path in names.items()}
    assert out_of(tmp_path / "unchanged again") == outs["unchanged"]
    assert len(set(outs.values())) == 3
    assert {out.parent for out in outs.values()} == {outs["unchanged"].parent}


def test_the_plate_travels_in_the_bundle_under_a_relative_path(exported, tmp_path):
    bundle = exported[0].parent / "onto"
    (job_file,) = bundle.glob("*.toml")
    scene = job_file.with_suffix(".blend")
    (plate,) = scene.with_suffix(".files").rglob("sh.1001.png")
    assets = json.loads((bundle / "asset_references.json").read_text())["assetReferences"]
    assert str(scene.with_suffix(".files")) in assets["inputs"]["directories"]
    look = f"import bpy\nbpy.ops.wm.open_mainfile(filepath={str(scene)!r})\n"
    look += "print('PATHS', [i.filepath for i in bpy.data.images if i.filepath and not i.packed_file])"
    found = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True)
    paths = next(line for line in found.stdout.splitlines() if line.startswith("PATHS"))
    assert f"'//{plate.relative_to(bundle).as_posix()}'" in paths and f"'{bundle.parent}" not in paths


def openjd_run(bundle: Path, tmp_path: Path, *steps: str) -> Frames:
    """Run steps of the frames in ``bundle`` as a farm does."""
    pytest.importorskip("openjd.cli", reason="openjd-cli is not installed")
    (job_file,) = bundle.glob("*.toml")
    iris = tmp_path / "iris"
    iris.write_text(f"#!{sys.executable}\nimport sys\nsys.path.insert(0, {str(ROOT)!r})\n")
    iris.write_text(iris.read_text() + "from headless.cli import main\nsys.exit(main())\n")
    iris.chmod(0o755)
    (job,) = read_jobs(job_file)
    for step in steps:
        command = [sys.executable, "-m", "openjd", "run", str(bundle / "template.json")]
        command += ["--step", f"{step} {job.frames[0].name}", "-p", f"Jobs={job_file}", "-p", f"Iris={iris}"]
        command += ["--task-param", "Chunk=0"] if step == "Frames" and job.frames[0].scene else []
        ran = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
        assert ran.returncode == 0, ran.stdout + ran.stderr
    return job.frames[0]


@pytest.mark.slow
def test_a_farm_renders_what_was_placed(exported, tmp_path):
    frames = openjd_run(exported[0].parent / "placed", tmp_path, "First frame", "Frames")
    picture = read_image(frames.out / "frame_0011.png") / 255.0
    middle = picture[picture.shape[0] // 2, picture.shape[1] // 2]
    assert (frames.out / "frame_0013.png").is_file() and middle[1] > middle[0] + 0.3


@pytest.mark.slow
def test_a_farm_renders_its_frames(exported, tmp_path):
    bundle, _ = exported
    (job,) = read_jobs(next(bundle.glob("*.toml")))
    openjd_run(bundle, tmp_path, "First frame", "Frames")
    pictures = [read_image(job.frames[0].out / f"frame_{k:04d}.png") for k in range(1, 5)]
    # The lamp that is dimmed from 4 to 1 shows, as all frames share the exposure of the first.
    assert float(pictures[0].mean()) > 1.05 * float(pictures[-1].mean())
