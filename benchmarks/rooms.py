"""Rooms solved at one preset and some seeds, scored and published as a section: what such benchmarks have in common.

Some rooms are of our own making; a module of their name renders them.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from iris_addon.base.progress import Progress, console
from iris_addon.config import PRESETS

from .machine import ROOT
from .records import OUT
from .runs import Run, Scored, relative, run_all

TRUTH_SAMPLES, SAMPLES = 48, 16
"""Per pixel of photos that we render, which are denoised, and of what results are scored by there."""


def parser_of(section: str, description: str | None) -> argparse.ArgumentParser:
    """Options of the benchmark behind ``section``, which keeps its captures and records in OUT/``section``."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", choices=list(PRESETS), default="draft")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--out", type=Path, default=OUT / section)
    parser.add_argument("--no-report", action="store_true", help="leave docs alone")
    return parser


def measure_rooms(
    section: str, rooms: Sequence[Path], args: argparse.Namespace, scored: Scored = "all", samples: int = Run.samples
) -> None:
    """Solve ``rooms`` as the options ``args`` of :func:`parser_of` say, and publish their records."""
    runs = [
        Run(relative(room), preset=args.preset, seed=seed, scored=scored, samples=samples)
        for seed in range(args.seeds)
        for room in rooms
    ]
    records = run_all(runs, args.out / "records", Progress(console()))
    if not args.no_report:
        from .report import publish

        publish(section, records)


def rendered(maker: str, name: str, folder: Path) -> Path:
    """The capture of the room ``name`` in ``folder``, rendered by the module ``maker`` unless it is there; Blender has
    a process of its own."""
    capture = (folder / name).resolve()
    if not (capture / "meta.json").is_file():
        made = [sys.executable, "-m", f"benchmarks.{maker}", name, "--out", str(capture)]
        subprocess.run([*made, "--samples", str(TRUTH_SAMPLES)], cwd=ROOT, check=True)
    return capture
