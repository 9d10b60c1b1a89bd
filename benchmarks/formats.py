"""The bundled room written in every format that is read: does it solve to the same metrics?

    python -m benchmarks.formats [--only NAME ...] [--preset draft] [--reference-seeds 3]

The formats that others are held against are solved with several seeds, all others with the first. Each run has a
process of its own (:mod:`benchmarks.formats_worker`). Records lie in OUT/records; a run that has one is not repeated.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from iris_addon.base.progress import Progress, console
from iris_addon.config import PRESETS

from .format_captures import FORMATS
from .records import OUT, read_records
from .runs import run_each


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=list(FORMATS), default=list(FORMATS), metavar="NAME")
    parser.add_argument("--preset", choices=list(PRESETS), default="draft")
    parser.add_argument("--reference-seeds", type=int, default=3)
    parser.add_argument("--out", type=Path, default=OUT / "formats")
    parser.add_argument("--no-report", action="store_true", help="leave docs alone")
    args = parser.parse_args(arguments)
    folder = args.out / "records"
    todo = {}
    for name in args.only:
        seeds = args.reference_seeds if FORMATS[name].like == name else 1
        for seed in range(seeds):
            key = re.sub("[^a-z0-9]+", "-", name.lower().replace("++", "pp"))
            todo[f"{key}.{args.preset}.{seed}"] = [name, args.preset, str(seed)]
    run_each("benchmarks.formats_worker", todo, folder, Progress(console()))
    if not args.no_report:
        from .report import publish

        publish("formats", read_records(folder))
    return 0


if __name__ == "__main__":
    sys.exit(main())
