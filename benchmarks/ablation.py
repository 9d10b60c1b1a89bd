"""What each refinement of the model earns: every one left out, on every capture.

    python -m benchmarks.ablation [--captures DIR ...] [--only NAME ...] [--preset draft]

Each run has a process of its own (:mod:`benchmarks.ablation_worker`). Records lie in OUT/records; a run that has one is
not repeated. At the end they are packed into docs/measured and docs/benchmarks.md is made anew.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from iris_addon.base.progress import Progress, console
from iris_addon.config import PRESETS

from .ablation_section import NOTHING
from .ablation_worker import variants
from .records import OUT, read_records
from .runs import capture_folder, captures, relative, run_each


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--captures", type=capture_folder, nargs="+", default=captures())
    parser.add_argument("--only", nargs="+", choices=variants(), default=variants(), metavar="NAME")
    parser.add_argument("--preset", choices=list(PRESETS), default="draft")
    parser.add_argument("--out", type=Path, default=OUT / "ablation")
    parser.add_argument("--no-report", action="store_true", help="leave docs alone")
    args = parser.parse_args(arguments)
    folder = args.out / "records"
    todo = {
        f"{capture.name}.{re.sub('[^a-z]+', '-', name)}.{args.preset}": [relative(capture), name, args.preset]
        for capture in args.captures
        for name in dict.fromkeys([NOTHING, *args.only])
    }
    run_each("benchmarks.ablation_worker", todo, folder, Progress(console()))
    if not args.no_report:
        from .report import publish

        publish("ablation", read_records(folder))
    return 0


if __name__ == "__main__":
    sys.exit(main())
