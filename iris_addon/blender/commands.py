"""Command lines of the jobs that Blender starts. Nothing here touches bpy."""

from __future__ import annotations

import sys
from pathlib import Path

ADDON = Path(__file__).resolve().parents[2]
RUN = ADDON / "headless" / "run.py"
JSON_LINES = ["--json", "--stop-with-stdin"]


def inspect_command(python: str, capture: Path, out: Path) -> list[str]:
    """A look at ``capture`` into ``out``."""
    return [*_program(python), "inspect", *_absolute(capture, "--out", out), *JSON_LINES]


def solve_command(python: str, capture: Path, out: Path, preset: str, device: str = "auto", seed: int = 0) -> list[str]:
    """A solve of ``capture`` into ``out`` that goes on where an earlier one stopped."""
    options = ["--preset", preset, "--device", device, "--seed", str(seed), "--resume"]
    return [*_program(python), "solve", *_absolute(capture, "--out", out), *options, *JSON_LINES]


def composite_command(
    blender: str, blend: Path, result: Path, photo: Path, view: str, out: Path, samples: int
) -> list[str]:
    """What stands in the room of ``blend`` onto ``photo``, as the picture ``out``.

    Args:
        blender: the program; empty where Blender is a module of this Python.
    """
    in_blender = [blender, "-b", "--factory-startup", "--python-exit-code", "1", "-P", str(RUN), "--"]
    program = in_blender if blender else _program(sys.executable)
    files = _absolute(blend, "--result", result, "--photo", photo, "--view", view, "--out", out)
    return [*program, "composite", *files, "--samples", str(samples), *JSON_LINES]


def environment_command(folder: Path, test_only: Path | None = None) -> list[str]:
    """Make the solver's environment in ``folder`` with Blender's own Python, or only test that of ``test_only``."""
    script = [sys.executable, "-I", "-X", "utf8", "-B", str(ADDON / "headless" / "make_environment.py")]
    return [*script, "--test", str(test_only)] if test_only is not None else [*script, *_absolute(folder)]


def _absolute(*arguments: str | Path) -> list[str]:
    # A worker has another current folder than Blender.
    return [str(argument.absolute()) if isinstance(argument, Path) else argument for argument in arguments]


def _program(python: str) -> list[str]:
    # -B: nothing may be written into the add-on's folder.
    return [python, "-B", str(RUN)]
