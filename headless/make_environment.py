"""Create or test the solver's environment: run by Blender's Python as a separate process, with the standard library.

    make_environment.py FOLDER          a virtual environment in FOLDER/venv with what solver_lock.txt lists
    make_environment.py --test PYTHON   import everything a solve needs in PYTHON

Speaks the JSON lines of the worker. Cancelled by a signal, or when stdin closes.
"""

from __future__ import annotations

import json
import os
import platform
import re
import signal
import subprocess
import sys
import tempfile
import threading
from pathlib import Path, PureWindowsPath
from typing import Any, NoReturn

HERE = Path(__file__).resolve().parent
LOCK = HERE / "solver_lock.txt"
"""Every package with the hashes of its files, for all platforms; ``make lock`` writes it."""
OPTIONAL = HERE / "optional_lock.txt"
"""Decoders of single formats and rays on a GPU, which not every system has: what fails to install is missed when it is
needed."""
LONGEST_MEMBER = 170
"""Characters of the longest path within site-packages that the pinned packages install (torch's licences)."""
WINDOWS_PATH = 259
"""Characters of a path that Windows takes by default."""
IMPORTS = (
    *("numpy", "scipy", "torch", "trimesh", "embreex.rtcore_scene", "xatlas", "OpenEXR", "PIL.Image", "numba"),
    *("filelock", "threadpoolctl", "mapbox_earcut"),
)
FAILED, CANCELLED = 1, 130

_child: subprocess.Popen[str] | None = None
_stop = threading.Event()


FOUND = """
import importlib.util, platform, torch
device = torch.cuda.get_device_name() if torch.cuda.is_available() else "CPU"
if torch.cuda.is_available():
    device += " with Warp" if importlib.util.find_spec("warp") else " without Warp, rays on the CPU"
print(f"Python {platform.python_version()}, torch {torch.__version__.partition('+')[0]}, {device}")
"""
"""What a Python that has all packages says of itself."""


def main(arguments: list[str]) -> None:
    """Create or test, as the arguments say."""
    for name in ("SIGINT", "SIGTERM", "SIGBREAK"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), lambda *_: stop())
    threading.Thread(target=stop_with_stdin, daemon=True).start()
    testing, given = arguments[0] == "--test", arguments[-1]
    if not testing or Path(given).name != given:  # otherwise the name of a program on the PATH
        given = str(Path(given).absolute())
    # Python's -m and -c import from the current folder first, and Windows searches it for programs. Blender's current
    # folder is often that of a file from an untrusted source: an empty folder replaces it.
    with tempfile.TemporaryDirectory(prefix="iris-") as empty:
        os.chdir(empty)
        try:
            if testing:
                found = test(given)
            else:
                found = make(Path(given))
        finally:
            os.chdir(HERE)  # Windows cannot remove the current folder
    say(type="done", result={"found": found})


def make(folder: Path) -> str:
    """Create the virtual environment, install the packages and :func:`test` them."""
    venv = folder / "venv"
    check_platform(sys.platform, platform.machine())
    if os.name == "nt" and not windows_takes_long_paths():
        check_length(PureWindowsPath(venv))
    python = venv / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    progress("making the environment", 0.0)
    # A Blender without ensurepip fails here, which has its own message.
    if call([sys.executable, "-I", "-m", "venv", "--clear", str(venv)]):
        fail(
            f"{sys.executable} cannot make a virtual environment",
            "install Python with venv and pip (python3-venv on Debian), make one by hand as the manual says, "
            "and name its Python here",
        )
    progress("downloading and installing, this takes minutes", 0.1)
    pip = [str(python), "-I", "-m", "pip", "install", "--disable-pip-version-check", "--no-input"]
    exactly = ["--require-hashes", "--only-binary", ":all:"]
    if call([*pip, *exactly, "--progress-bar", "off", "-r", str(LOCK)]):
        fail("pip could not install the solver's packages", "read the log: mostly the network, the disk, or a proxy")
    for number, entry in enumerate(re.findall(r"^\w.*(?:\n .*)*", OPTIONAL.read_text(encoding="utf-8"), re.M)):
        one = Path(f"optional-{number}.txt")  # in the empty folder
        one.write_text(entry + "\n", encoding="utf-8")
        call([*pip, *exactly, "--no-deps", "--progress-bar", "off", "-r", str(one)])
    return test(str(python), 0.9)


def check_platform(system: str, machine: str) -> None:
    """Fail on a system for which the pinned torch has no build; it would be pip's riddle."""
    if system == "darwin" and machine == "x86_64":
        fail(
            "PyTorch, which the solver needs, has no build for Intel Macs any more",
            "solve on another computer and apply the result folder here; on a Mac with Apple silicon use the Blender "
            "made for it",
        )


def check_length(venv: PureWindowsPath) -> None:
    """Fail if files of the packages would have longer paths than Windows takes."""
    longest = len(str(venv / "Lib" / "site-packages")) + 1 + LONGEST_MEMBER
    if longest > WINDOWS_PATH:
        fail(
            f"{venv} is too long a path: files in it would have {longest} characters, Windows takes {WINDOWS_PATH}",
            "enable long paths in Windows (LongPathsEnabled), or make an environment in a shorter folder by hand as "
            "the manual says, and name its Python here",
        )


def windows_takes_long_paths() -> bool:
    """Whether this Windows has its limit of 260 characters switched off."""
    import winreg

    try:
        with winreg.OpenKey(winreg.HKEY_LOCAL_MACHINE, r"SYSTEM\CurrentControlSet\Control\FileSystem") as key:  # type: ignore[attr-defined]
            return bool(winreg.QueryValueEx(key, "LongPathsEnabled")[0])  # type: ignore[attr-defined]
    except OSError:
        return False


def test(python: str, at: float = 0.0) -> str:
    """Import all packages; fail with the names of missing ones. Returns what a solve will run on."""
    progress("importing the packages", at)
    # Not isolated: packages in the user's site folder are available to a solve as well.
    missing = []
    for number, name in enumerate(IMPORTS):
        try:
            if call([python, "-c", f"import {name}"]):
                missing.append(name.partition(".")[0])
        except OSError as error:
            fail(
                f"{python}: cannot be started ({error.strerror})",
                "choose a Python, for example bin/python of an environment",
            )
        progress("importing the packages", at + (1 - at) * (number + 1) / len(IMPORTS))
    if missing:
        fail(f"{python} lacks {', '.join(missing)}", "install them into it, or press Create Environment")
    said: list[str] = []
    call([python, "-c", FOUND], said)
    return said[-1] if said else ""


def call(command: list[str], said: list[str] | None = None) -> int:
    """Run ``command`` with its output in the log, and in ``said``; returns its exit code. Exits if a stop was
    requested."""
    global _child
    _child = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace"
    )
    assert _child.stdout is not None
    for line in _child.stdout:
        print(line.rstrip(), file=sys.stderr, flush=True)
        if said is not None:
            said.append(line.rstrip())
    code = _child.wait()
    if _stop.is_set():
        say(type="error", what="cancelled", fix="start it again", exit_code=CANCELLED)
        sys.exit(CANCELLED)
    return code


def stop() -> None:
    """Stop the running command."""
    _stop.set()
    if _child is not None and _child.poll() is None:
        _child.terminate()


def stop_with_stdin() -> None:
    """Stop when the calling program has ended."""
    while os.read(0, 4096):
        pass
    stop()


def progress(stage: str, overall: float) -> None:
    """Report progress."""
    say(type="progress", stage=stage, fraction=overall, overall=overall, seconds_left=None, message="")


def say(**message: Any) -> None:
    """Write one JSON line."""
    print(json.dumps(message), flush=True)


def fail(what: str, fix: str) -> NoReturn:
    """Report an error and exit."""
    say(type="error", what=what, fix=fix, exit_code=FAILED)
    sys.exit(FAILED)


if __name__ == "__main__":
    main(sys.argv[1:])
