"""The panel's farm job is the bundle that the command line writes, and its frames show the scene as it is animated."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from headless import cli
from headless.job_file import read_jobs
from iris_addon.base.images import read_image
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
"""


@pytest.fixture(scope="module")
def exported(tmp_path_factory) -> tuple[Path, list]:
    """The bundle, and the cameras and lamps that Blender had at each of its frames."""
    home, bundle = tmp_path_factory.mktemp("home"), tmp_path_factory.mktemp("farm") / "bundle"
    package = build_package(tmp_path_factory.mktemp("package") / "iris.zip")
    output = in_blender(package, home, BODY.format(bundle=str(bundle)))
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


@pytest.mark.slow
def test_a_farm_renders_its_frames(exported, tmp_path):
    pytest.importorskip("openjd.cli", reason="openjd-cli is not installed")
    bundle, _ = exported
    (job_file,) = bundle.glob("*.toml")
    iris = tmp_path / "iris"
    iris.write_text(f"#!{sys.executable}\nimport sys\nsys.path.insert(0, {str(ROOT)!r})\n")
    iris.write_text(iris.read_text() + "from headless.cli import main\nsys.exit(main())\n")
    iris.chmod(0o755)
    (job,) = read_jobs(job_file)
    for step in ("First frame", "Frames"):
        command = [sys.executable, "-m", "openjd", "run", str(bundle / "template.json")]
        command += ["--step", f"{step} {job.frames[0].name}", "-p", f"Jobs={job_file}", "-p", f"Iris={iris}"]
        ran = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
        assert ran.returncode == 0, ran.stdout + ran.stderr
    pictures = [read_image(job.frames[0].out / f"frame_{k:04d}.png") for k in range(1, 5)]
    # The lamp that is dimmed from 4 to 1 shows, as all frames share the exposure of the first.
    assert float(pictures[0].mean()) > 1.05 * float(pictures[-1].mean())
