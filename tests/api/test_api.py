"""The package as a library: what `import iris_addon as iris` gives, and what it costs."""

from __future__ import annotations

import doctest
import shutil
import signal
import subprocess
import sys
import tomllib
from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest

import iris_addon as iris
from tests.result_room import room as solved_room

ROOT = Path(__file__).resolve().parents[2]
HEAVY = ("numpy", "torch", "scipy", "numba", "trimesh", "OpenEXR", "PIL", "bpy")


def in_new_python(script: str) -> str:
    run = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return run.stdout


def test_importing_the_package_imports_no_other() -> None:
    loaded = in_new_python(f"import sys, iris_addon; print([name for name in {HEAVY} if name in sys.modules])")
    assert loaded.strip() == "[]"


def test_every_public_name_is_there_and_has_a_docstring() -> None:
    assert set(iris.__all__) <= set(dir(iris))
    for name in iris.__all__:
        assert getattr(iris, name).__doc__, name
    with pytest.raises(AttributeError, match="no attribute 'sovle'"):
        iris.sovle  # noqa: B018


def test_functions_stay_functions_when_rooms_of_their_name_are_imported() -> None:
    in_new_python(
        "import iris_addon as iris, iris_addon.evaluate.evaluation\n"
        "from iris_addon.evaluate.evaluation import evaluate\n"
        "assert iris.evaluate is evaluate"
    )


def test_the_version_is_said_alike_everywhere() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    assert iris.__version__ == project["version"] == manifest["version"]


def test_a_lamp_changes_in_another_result_and_not_in_this_one() -> None:
    result = solved_room()
    lamp = result.emitters[0]
    before = lamp.radiance.copy()
    changed = result.with_emitter(lamp.id, radiance=(1.0, 2.0, 3.0))
    np.testing.assert_array_equal(result.emitters[0].radiance, before)
    np.testing.assert_array_equal(changed.emitters[0].radiance, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(changed.face_emission()[lamp.faces[0]], [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(result.with_emitter(lamp.id, 0).emitters[0].radiance, [0.0, 0.0, 0.0])


@pytest.mark.parametrize("radiance", [-1.0, float("nan"), (1.0, float("inf"), 0.0)])
def test_a_radiance_that_no_lamp_can_have_is_refused(radiance: object) -> None:
    result = solved_room()
    with pytest.raises(ValueError, match="radiance"):
        result.with_emitter(result.emitters[0].id, radiance)
    with pytest.raises(ValueError, match="no emitter 99"):
        result.with_emitter(99, 1.0)


def test_a_saved_result_is_the_one_that_is_loaded(tmp_path: Path) -> None:
    result = solved_room()
    changed = result.with_emitter(result.emitters[0].id, radiance=(1.0, 2.0, 3.0))
    changed.save(tmp_path / "room")
    np.testing.assert_allclose(iris.load_result(tmp_path / "room").emitters[0].radiance, [1.0, 2.0, 3.0])


def test_maps_show_what_the_camera_hits() -> None:
    result = solved_room()
    middle = result.mesh.vertices.mean(0)
    pose = np.eye(4)
    pose[:3, 3] = middle
    camera = iris.Camera(width=32, height=24, fx=8.0, fy=8.0, cx=16.0, cy=12.0, c2w=pose)
    maps = result.render_maps(camera)
    assert maps.base_color.shape == maps.emission.shape == (24, 32, 3)
    assert maps.roughness.shape == maps.metallic.shape == maps.hit.shape == (24, 32)


def test_inspecting_leaves_nothing_behind_without_a_folder(nerfstudio_room, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    report = iris.inspect(iris.read_capture(nerfstudio_room.root))
    assert len(report["views"]) > 0 and not list((tmp_path / "temporary").iterdir())


@pytest.mark.slow
def test_the_examples_of_the_docstrings_run_as_they_stand(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "assets").symlink_to(ROOT / "assets", target_is_directory=True)
    for name in ("solve", "inspect", "Result.render_maps", "Result.with_emitter"):
        documented = attrgetter(name)(iris)
        (test,) = doctest.DocTestFinder(recurse=False).find(documented, name, module=False)
        assert test.examples and doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(test).failed == 0
        if name == "solve":
            shutil.copytree(tmp_path / "out" / "room", tmp_path / "out" / "demo")


def test_ctrl_c_cancels_and_is_put_back(nerfstudio_room) -> None:
    """Under the handler that Python starts with: a shell may have started the tests with Ctrl-C ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(iris.Cancelled):
            iris.inspect(iris.read_capture(nerfstudio_room.root), progress=_Interrupted())
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)


class _Interrupted(iris.Progress):
    """Somebody presses Ctrl-C when the first news comes."""

    def update(self, fraction: float, message: str = "", *, force: bool = False) -> None:
        if fraction == 0.0:
            signal.raise_signal(signal.SIGINT)
        super().update(fraction, message, force=force)
