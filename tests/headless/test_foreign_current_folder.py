"""Blender's current folder is often that of a file somebody else made: no program or module in it may run."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from headless import frame_folder, make_environment
from headless.environment import RUN
from iris_addon.blender.worker.jobs import (
    CompositeOptions,
    composite_command,
    environment_command,
    inspect_command,
    looks_command,
    probe_command,
    solve_command,
)
from iris_addon.blender.worker.process import Worker

PLANTED = (  # what -m and -c would find first
    "venv",
    "pip",
    "ensurepip",
    "sitecustomize",
    "json",
    "numpy",
    "torch",
    "scipy",
    "trimesh",
)
FAKE_PYTHON = """#!{python} -I
import os, sys
here = os.getcwd()
print("called", sys.argv[1:], "in a folder with", os.listdir(here), file=sys.stderr)
"""


@pytest.fixture
def foreign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, full of modules that leave a file when they are imported."""
    folder = tmp_path / "stranger"
    folder.mkdir()
    for name in PLANTED:
        (folder / f"{name}.py").write_text(f"open({str(folder / 'PWNED')!r}, 'a').write({name!r})\n")
    monkeypatch.chdir(folder)
    return folder


def ended(command: list[str]) -> Worker:
    worker = Worker(command)
    worker.wait()
    worker.close()
    return worker


def test_making_and_testing_an_environment_imports_nothing_from_the_current_folder(
    foreign: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (foreign / "requirements.txt").write_text("")
    by_hand = f"""
import sys
sys.path.insert(0, {str(make_environment.HERE)!r})
import make_environment
from pathlib import Path
make_environment.LOCK = make_environment.OPTIONAL = Path({str(foreign / "requirements.txt")!r})
make_environment.IMPORTS = ("json", "numpy")
make_environment.main(sys.argv[1:])
"""
    (tmp_path / "by_hand.py").write_text(by_hand)
    for arguments in (["--test", sys.executable], ["made here"]):
        process = subprocess.Popen(
            [sys.executable, "-B", str(tmp_path / "by_hand.py"), *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        assert process.stdout is not None
        with process:
            said = process.stdout.read()
        assert not (foreign / "PWNED").exists(), said
        if arguments[0] == "--test":
            assert '"done"' in said
        else:  # empty requirements: the environment is there, and lacks what is asked for
            assert "lacks numpy" in said
            assert (foreign / "made here" / "venv" / "pyvenv.cfg").is_file()


@pytest.mark.skipif(sys.platform == "win32", reason="a script as a program")
def test_a_chosen_python_is_tested_in_an_empty_folder(foreign: Path, tmp_path: Path) -> None:
    python = tmp_path / "python"
    python.write_text(FAKE_PYTHON.format(python=sys.executable))
    python.chmod(0o755)
    worker = ended(environment_command(tmp_path, test_only=python))
    said = [line for line in worker.log if line.startswith("called")]
    assert len(said) == len(make_environment.IMPORTS) + 1
    assert all(line.endswith("in a folder with []") for line in said)


def test_workers_start_in_the_folder_of_the_add_on(foreign: Path) -> None:
    worker = ended([sys.executable, "-c", "import os, sys; print(os.getcwd(), file=sys.stderr)"])
    assert Path(worker.log[-1]) == Path(__file__).resolve().parents[2]
    assert not (foreign / "PWNED").exists()


def test_paths_of_a_worker_are_absolute(foreign: Path) -> None:
    a, b = Path("capture"), Path("out")
    commands = [
        inspect_command("python", a, b),
        solve_command("python", a, b, "draft"),
        composite_command(
            "blender", a, b, Path("photo.png"), "view", Path("picture.png"), CompositeOptions(4, "evening")
        ),
        probe_command("blender", a, (0.0, -1.0, 2.0), b, 64, 4),
        looks_command("blender", a, b, 64, 4),
        environment_command(a),
    ]
    for command in commands:
        assert str(foreign / "capture") in command
        assert not {"capture", "out", "photo.png", "picture.png"} & {*command}


@pytest.mark.skipif(sys.platform == "win32", reason="a script as a program")
def test_ffmpeg_is_never_that_of_the_current_folder(
    foreign: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in (foreign, tmp_path / "bin"):
        folder.mkdir(exist_ok=True)
        (folder / "ffmpeg").write_text("#!/bin/sh\n")
        (folder / "ffmpeg").chmod(0o755)
    monkeypatch.setenv("PATH", os.pathsep.join(["", ".", str(tmp_path / "empty")]))
    assert frame_folder.find_ffmpeg() is None
    monkeypatch.setenv("PATH", os.pathsep.join([".", str(tmp_path / "bin")]))
    assert frame_folder.find_ffmpeg() == str(tmp_path / "bin" / "ffmpeg")


EVIL = """
#include <stdio.h>
__attribute__((constructor)) static void run(void) { FILE *file = fopen("PWNED", "w"); if (file) fclose(file); }
"""


@pytest.mark.bpy
@pytest.mark.skipif(sys.platform != "linux" or shutil.which("cc") is None, reason="there is no compiler for a library")
def test_blender_loads_no_library_of_the_current_folder(foreign: Path) -> None:
    """Its sound library looks for plug-ins there."""
    (foreign / "evil.c").write_text(EVIL)
    (foreign / "plugins").mkdir()
    subprocess.run(["cc", "-shared", "-fPIC", "-o", "plugins/evil.so", "evil.c"], check=True)
    command = [sys.executable, "-B", str(RUN), "probe", "nothing.blend", "--at", "0", "0", "0", "--out", "a.exr"]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ran.returncode == 3 and "nothing.blend" in ran.stderr, ran.stderr
    assert not (foreign / "PWNED").exists()
    for path in foreign.glob("*.py"):  # numpy.py and the rest, which Python itself would import by -c
        path.unlink()
    subprocess.run([sys.executable, "-c", "import bpy"], check=True)
    assert (foreign / "PWNED").exists(), "Blender does not look there any more: importing it needs no care"
