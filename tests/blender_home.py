"""A Blender of its own for tests of the extension: the built package, user folders that nothing else uses."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import bpy

ROOT = Path(__file__).parents[1]

# What Blender's own Python does not have must not be imported by the extension.
PRELUDE = """
import importlib.abc, json, os, shutil, sys, time
from pathlib import Path

class Absent(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {"torch", "trimesh", "scipy", "embreex", "OpenEXR", "PIL", "iris_addon"}:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Absent())
import bpy

package, home = sys.argv[1], Path(sys.argv[2])
KEY = "bl_ext.user_default.iris"
bpy.ops.extensions.package_install_files(filepath=package, repo="user_default", enable_on_install=True)
assert KEY in bpy.context.preferences.addons, "not enabled"
preferences = bpy.context.preferences.addons[KEY].preferences
scene = bpy.context.scene

def fails(operator, *words, **properties):
    try:
        operator(**properties)
    except RuntimeError as error:
        missing = [word for word in words if word not in str(error)]
        assert not missing, (missing, str(error))
    else:
        raise AssertionError("no error")
"""


def blender_ext(*arguments: str) -> subprocess.CompletedProcess:
    scripts = Path(bpy.utils.resource_path("LOCAL")) / "scripts"
    tool = scripts / "addons_core" / "bl_pkg" / "cli" / "blender_ext.py"
    return subprocess.run([sys.executable, str(tool), *arguments], capture_output=True, text=True, check=False)


def build_package(path: Path) -> Path:
    built = blender_ext("build", "--source-dir", str(ROOT), "--output-filepath", str(path))
    assert built.returncode == 0, built.stdout + built.stderr
    return path


def in_blender(package: Path, home: Path, body: str) -> str:
    """Output of a fresh Blender with user folders of its own that installs the package and runs ``body``."""
    own = {"BLENDER_USER_RESOURCES": str(home / "user"), "BLENDER_USER_EXTENSIONS": str(home / "extensions")}
    script = home / "script.py"
    script.write_text(f"{PRELUDE}\n{textwrap.dedent(body)}\nprint('ALL WELL')\n")
    options = {"env": {**os.environ, **own}, "cwd": home, "capture_output": True, "text": True, "timeout": 300}
    run = subprocess.run([sys.executable, str(script), str(package), str(home)], check=False, **options)
    assert run.returncode == 0 and "ALL WELL" in run.stdout, run.stdout + run.stderr
    return run.stdout + run.stderr


def fake_solver(folder: Path, body: str, name: str = "solver") -> Path:
    """A stand-in for the solver's Python: a program that gets the command line of a job."""
    path = folder / name
    path.write_text(f"#!{sys.executable}\nimport json, os, shutil, sys, time\n{textwrap.dedent(body)}")
    path.chmod(0o755)
    return path
