"""Responses unlike any prior: measured curves (DoRF) on the bundled capture, its exposures known and withheld.

    python -m benchmarks.curves [CAPTURE] [--preset balanced] [--curves 24]

The curves are spread evenly by their distance from the mean of all; each takes all photos anew, in a process of its own
(:mod:`benchmarks.curves_worker`). Records lie in OUT/records; a run that has one is not repeated. At the end they are
packed into docs/measured and docs/benchmarks.md is made anew.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from iris_addon.base.errors import BadInput
from iris_addon.base.progress import Progress, console
from iris_addon.config import PRESETS

from .curves_section import EXPOSURES
from .perturb_photos import curves_by_distance
from .records import OUT, read_records
from .runs import BUNDLED, capture_folder, relative, run_each


def spread(n: int, count: int) -> list[int]:
    """``count`` of ``n`` ranks from the first to the last, evenly."""
    return sorted({round(rank) for rank in np.linspace(0, n - 1, min(count, n))})


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=capture_folder, nargs="?", default=BUNDLED)
    parser.add_argument("--preset", choices=list(PRESETS), default="balanced")
    parser.add_argument("--curves", type=int, default=24, help="how many of the measured ones")
    parser.add_argument("--out", type=Path, default=OUT / "curves")
    parser.add_argument("--no-report", action="store_true", help="leave docs alone")
    args = parser.parse_args(arguments)
    progress, folder = Progress(console()), args.out / "records"
    try:
        ranks = spread(len(curves_by_distance()), args.curves)
    except BadInput as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    todo = {
        f"{args.capture.name}.{rank:03d}.{exposures}.{args.preset}": [
            relative(args.capture),
            str(rank),
            exposures,
            args.preset,
        ]
        for exposures in EXPOSURES
        for rank in ranks
    }
    run_each("benchmarks.curves_worker", todo, folder, progress)
    if not args.no_report:
        from .report import publish

        publish("curves", read_records(folder))
    return 0


if __name__ == "__main__":
    sys.exit(main())
