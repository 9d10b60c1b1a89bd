"""Cost against size: seconds, memory and rays over triangles, photos and photo size; slopes on log axes.

    python -m benchmarks.scaling [CAPTURE] [--preset balanced] [--sweeps NAME ...]

How captures of other sizes are made: :mod:`benchmarks.scaling_worker`. Records lie in OUT/records; a run that has one
is not repeated. At the end they are packed into docs/measured and docs/benchmarks.md is made anew.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from iris_addon.base.progress import Progress, console
from iris_addon.config import PRESETS

from .records import OUT, read_records
from .runs import BUNDLED, capture_folder, relative, run_each
from .scaling_section import SWEEPS


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=capture_folder, nargs="?", default=BUNDLED)
    parser.add_argument("--preset", choices=list(PRESETS), default="balanced")
    parser.add_argument("--sweeps", nargs="+", choices=list(SWEEPS), default=list(SWEEPS))
    parser.add_argument("--largest", type=int, default=1_000_000, help="leave out sizes above this")
    parser.add_argument("--out", type=Path, default=OUT / "scaling")
    parser.add_argument("--no-report", action="store_true", help="leave docs alone")
    args = parser.parse_args(arguments)
    sizes = [(sweep, size) for sweep in args.sweeps for size in SWEEPS[sweep][1] if size <= args.largest]
    progress, folder = Progress(console()), args.out / "records"
    todo = {
        f"{args.capture.name}.{sweep}.{size}.{args.preset}": [relative(args.capture), sweep, str(size), args.preset]
        for sweep, size in sizes
    }
    run_each("benchmarks.scaling_worker", todo, folder, progress)
    if not args.no_report:
        from .report import publish

        publish("scaling", read_records(folder))
    return 0


if __name__ == "__main__":
    sys.exit(main())
