"""The extension: built, validated, installed into a Blender of its own, used, disabled. And the worker behind it."""

import json
import os
import subprocess
import sys
import textwrap
import time
import zipfile
from pathlib import Path

import bpy
import pytest

from iris_addon.blender.worker import Worker, solve_command
from iris_addon.errors import Cancelled, IrisError
from iris_addon.result.io import save_result
from tests.blender_room import room

pytestmark = pytest.mark.bpy

ROOT = Path(__file__).parents[1]


def blender_ext(*arguments: str) -> subprocess.CompletedProcess:
    scripts = Path(bpy.utils.resource_path("LOCAL")) / "scripts"
    tool = scripts / "addons_core" / "bl_pkg" / "cli" / "blender_ext.py"
    return subprocess.run([sys.executable, str(tool), *arguments], capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def package(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("package") / "iris.zip"
    built = blender_ext("build", "--source-dir", str(ROOT), "--output-filepath", str(path))
    assert built.returncode == 0, built.stdout + built.stderr
    return path


def test_the_package_is_valid_and_has_nothing_else_in_it(package):
    checked = blender_ext("validate", str(package))
    assert checked.returncode == 0, checked.stdout + checked.stderr
    names = zipfile.ZipFile(package).namelist()
    tops = {name.split("/")[0] for name in names}
    assert {"blender_manifest.toml", "__init__.py", "iris_addon", "operators", "headless"} <= tops
    assert not tops & {"tests", "benchmarks", "docs", "out", "dist", "pyproject.toml", ".ci", ".venv"}
    assert not [name for name in names if "__pycache__" in name]
    assert package.stat().st_size < 2_000_000


SCRIPT = """
import importlib.abc, sys
from pathlib import Path

class Absent(importlib.abc.MetaPathFinder):
    # What Blender's own Python does not have.
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {"torch", "trimesh", "scipy", "embreex", "OpenEXR", "PIL", "xatlas", "iris_addon"}:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Absent())
import bpy

package, worker, capture = sys.argv[1:4]
bpy.ops.extensions.package_install_files(filepath=package, repo="user_default", enable_on_install=True)
key = "bl_ext.user_default.iris"
assert key in bpy.context.preferences.addons, "not enabled"
preferences = bpy.context.preferences.addons[key].preferences
assert not bpy.ops.iris.solve.poll()
bpy.context.scene.iris.capture = capture
assert not bpy.ops.iris.solve.poll()
preferences.python = worker
BODY
bpy.ops.preferences.addon_disable(module=key)
assert not hasattr(bpy.types.Scene, "iris") and not hasattr(bpy.types, "IRIS_PT_solve")
bpy.ops.preferences.addon_enable(module=key)
assert hasattr(bpy.types.Scene, "iris") and hasattr(bpy.types, "IRIS_PT_solve")
print("ALL WELL")
"""


def in_blender(package: Path, home: Path, worker: Path, capture: Path, body: str) -> str:
    """Output of a fresh Blender with user folders of its own that installs the package and runs ``body``."""
    own = {"BLENDER_USER_RESOURCES": str(home), "BLENDER_USER_EXTENSIONS": str(home / "extensions")}
    script = home / "script.py"
    script.write_text(SCRIPT.replace("BODY", textwrap.dedent(body)))
    command = [sys.executable, str(script), str(package), str(worker), str(capture)]
    options = {"env": {**os.environ, **own}, "cwd": home, "capture_output": True, "text": True, "timeout": 120}
    run = subprocess.run(command, check=False, **options)
    assert run.returncode == 0 and "ALL WELL" in run.stdout, run.stdout + run.stderr
    return run.stdout


def fake_solver(folder: Path, body: str) -> Path:
    """A stand-in for the solver's Python: a program that gets the command line of a solve."""
    path = folder / "solver"
    path.write_text(f"#!{sys.executable}\nimport json, shutil, sys, time\n{textwrap.dedent(body)}")
    path.chmod(0o755)
    return path


@pytest.mark.skipif(sys.platform == "win32", reason="the stand-in solver is a script with a #! line")
def test_the_operator_solves_and_applies_in_a_blender_without_the_solver_s_packages(package, tmp_path):
    save_result(room(emission={3: (12, 10, 8)}), tmp_path / "solved")
    (tmp_path / "capture").mkdir()
    worker = fake_solver(
        tmp_path,
        f"""
        assert sys.argv[2].endswith("run.py") and sys.argv[3] == "solve" and "--json" in sys.argv, sys.argv
        print(json.dumps(dict(type="progress", stage="x", fraction=1, overall=1, seconds_left=0, message="")))
        shutil.copytree({str(tmp_path / "solved")!r}, sys.argv[sys.argv.index("--out") + 1])
        """,
    )
    body = """
    assert bpy.ops.iris.solve() == {"FINISHED"}
    room = bpy.context.scene.objects["IRIS Room Mesh"]
    assert len(room.data.polygons) == 12 and "IRIS Lamp 00" in room.data.materials
    """
    in_blender(package, tmp_path, worker, tmp_path / "capture", body)
    assert (tmp_path / "capture-iris" / "report.json").is_file()


@pytest.mark.skipif(sys.platform == "win32", reason="the stand-in solver is a script with a #! line")
def test_the_operator_says_what_the_solver_said(package, tmp_path):
    (tmp_path / "capture").mkdir()
    worker = fake_solver(tmp_path, 'print("error: no photos — add some", file=sys.stderr); sys.exit(3)')
    body = """
    try:
        bpy.ops.iris.solve()
    except RuntimeError as error:
        assert "no photos — add some" in str(error), error
    else:
        raise AssertionError("no error")
    assert not bpy.context.scene.objects.get("IRIS Room Mesh")
    """
    in_blender(package, tmp_path, worker, tmp_path / "capture", body)


EVENT = {"type": "progress", "stage": "tracing", "fraction": 0.5, "overall": 0.25, "seconds_left": 9.0}


def until_it_speaks(worker: Worker) -> None:
    for _ in range(1000):
        if worker.poll():
            return
        time.sleep(0.02)
    raise AssertionError("the worker said nothing")


def python(code: str) -> list[str]:
    return [sys.executable, "-c", textwrap.dedent(code)]


def test_a_worker_reports_progress_and_ends():
    worker = Worker(python(f"print('chatter'); print({json.dumps(EVENT)!r})"))
    worker.wait()
    worker.close()
    worker.poll()
    assert (worker.stage, worker.fraction, worker.overall, worker.seconds_left) == ("tracing", 0.5, 0.25, 9.0)
    worker.raise_if_failed()
    assert not worker.running


def test_a_worker_stops_when_interrupted_and_when_it_does_not_listen(monkeypatch):
    listens = Worker(python(f"import time; print({json.dumps(EVENT)!r}, flush=True); time.sleep(60)"))
    until_it_speaks(listens)
    listens.close()
    with pytest.raises(Cancelled):
        listens.raise_if_failed()
    monkeypatch.setattr("iris_addon.blender.worker.GRACE_SECONDS", 0.2)
    speak = f"print({json.dumps(EVENT)!r}, flush=True)"
    deaf = Worker(python(f"import signal, time; signal.signal(2, signal.SIG_IGN); {speak}; time.sleep(60)"))
    until_it_speaks(deaf)
    deaf.close()
    assert not deaf.running


def test_a_worker_that_dies_says_how():
    dead = Worker(python("import os, signal; os.kill(os.getpid(), signal.SIGKILL)"))
    dead.wait()
    dead.close()
    with pytest.raises(IrisError, match="killed by signal 9"):
        dead.raise_if_failed()
    with pytest.raises(IrisError, match="cannot be started"):
        Worker(["/no/such/python"])


def test_a_worker_does_not_inherit_blender_s_python(monkeypatch):
    monkeypatch.setenv("PYTHONHOME", "/blender")
    worker = Worker(solve_command(sys.executable, Path("/none"), Path("c"), Path("o"), "draft"))
    worker.wait()
    worker.close()
    with pytest.raises(IrisError, match=r"ended with code 2 .*/none/headless/run\.py"):
        worker.raise_if_failed()
