"""Rooms without a lamp, lit by the sun and the sky through a window: is the sun found, and what is the room worth?

    python -m benchmarks.sunlit [ROOM ...] [--preset draft] [--seeds 1]

The rooms are those of :mod:`benchmarks.sunlit_room`, rendered to OUT/captures once. Records lie in OUT/records; a run
that has one is not repeated.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from .machine import ROOT
from .rooms import measure_rooms, parser_of

ROOMS = ("blind", "pane", "scan")
TRUTH_SAMPLES, SAMPLES = 48, 16
"""Per pixel of the photos, which are denoised, and of what results are scored by."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = parser_of("sunlit", __doc__)
    parser.add_argument("rooms", nargs="*", choices=[*ROOMS, []], default=[], metavar="ROOM", help="by default all")
    args = parser.parse_args(arguments)
    rooms = [rendered(name, args.out / "captures") for name in args.rooms or ROOMS]
    measure_rooms("sunlit", rooms, args, samples=SAMPLES)
    return 0


def rendered(name: str, folder: Path) -> Path:
    """The capture of the room ``name`` in ``folder``, rendered unless it is there; Blender has a process of its own."""
    capture = (folder / name).resolve()
    if not (capture / "meta.json").is_file():
        made = [sys.executable, "-m", "benchmarks.sunlit_room", name, "--out", str(capture)]
        subprocess.run([*made, "--samples", str(TRUTH_SAMPLES)], cwd=ROOT, check=True)
    return capture


if __name__ == "__main__":
    sys.exit(main())
