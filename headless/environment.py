"""Which packages a command needs, and handing it to another Python where the current one lacks them.

Blender's Python changes with every release and has no torch; the solver's own Python is named by IRIS_PYTHON.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

from iris_addon.base.errors import IrisError, SolverEnvironmentMissing
from iris_addon.blender.as_module import import_blender
from iris_addon.blender.worker.process import worker_environment

from .cancellation import restore_handlers

_IMAGES = ("numpy", "OpenEXR", "PIL")
_READING = (*_IMAGES, "scipy", "trimesh", "numba", "mapbox_earcut")
_SOLVER = (*_READING, "torch", "embreex", "xatlas", "filelock", "threadpoolctl")
NEEDS = {
    "demo": (*_SOLVER, "bpy"),
    "solve": _SOLVER,
    "inspect": (*_READING, "embreex"),
    "fuse": (*_READING, "embreex"),
    "batch": _SOLVER,
    "farm": ("numpy",),
    "apply": ("numpy", "bpy"),
    "render": (*_READING, "bpy"),
    "relight": (*_READING, "bpy"),
    "insert": (*_READING, "bpy"),
    "onto-plate": (*_READING, "bpy"),
    "composite": ("numpy", "bpy"),
    "probe": ("numpy", "bpy"),
    "looks": ("numpy", "bpy"),
    "camera": (*_IMAGES, "trimesh"),
    "synth": (*_IMAGES, "bpy"),
    "evaluate": (*_READING, "torch", "embreex"),
}
RUN = Path(__file__).with_name("run.py")


def missing_packages(args: argparse.Namespace) -> list[str]:
    """Packages that the command of ``args`` needs and this Python lacks."""
    return [name for name in _needed(args) if name not in sys.modules and find_spec(name) is None]


def _needed(args: argparse.Namespace) -> tuple[str, ...]:
    renders = args.command == "evaluate" and not args.no_render
    return (*NEEDS[args.command], "bpy") if renders else NEEDS[args.command]


def prepare_blender(args: argparse.Namespace) -> None:
    """Import Blender as a module, if the command of ``args`` needs it."""
    if "bpy" in _needed(args):
        import_blender()


def unusable(error: ImportError) -> IrisError:
    """The error to report when a package was found but does not import, or an optional one is missing."""
    return SolverEnvironmentMissing(
        f"this Python ({sys.executable}) cannot import what it needs ({error})",
        "run make setup and use .venv/bin/python",
    )


def delegate(argv: list[str], missing: list[str]) -> int:
    """Run the same command line in the Python that IRIS_PYTHON names; returns its exit code.

    Raises:
        SolverEnvironmentMissing: IRIS_PYTHON is not set.
        IrisError: it cannot be started.
    """
    python = os.environ.get("IRIS_PYTHON")
    if not python:
        fix = "run make setup and use .venv/bin/python, or name a Python that has everything in IRIS_PYTHON"
        if missing == ["bpy"]:
            fix = "pip install iris-blender[blender], or run this command inside Blender"
        elif "--stop-with-stdin" in argv:
            fix = "press Create Environment in the preferences of the extension"
        raise SolverEnvironmentMissing(f"this Python ({sys.executable}) lacks {', '.join(missing)}", fix)
    try:
        # Its environment has no IRIS_PYTHON: a Python that lacks the same packages says so and does not start itself.
        process = subprocess.Popen([python, str(RUN), *argv], env=worker_environment())
    except OSError as error:
        raise SolverEnvironmentMissing(
            f"{python}: cannot be started ({error.strerror})", "correct IRIS_PYTHON"
        ) from error

    def forward(number: int, _frame: object) -> None:
        if process.poll() is None:
            process.send_signal(number)

    # A terminal sends Ctrl-C to both processes, anybody else to this one alone.
    before = {number: signal.signal(number, forward) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        code = process.wait()
    finally:
        restore_handlers(before)
    if code < 0:
        fix = "run again with --resume" if argv[0] == "solve" else "run again"
        raise IrisError(f"the solver was killed by signal {-code}", fix)
    return code
