"""What each refinement of the model earns: every one left out, on every capture.

    python -m benchmarks.ablation [--captures DIR ...] [--only NAME ...] [--preset draft]

Each run has a process of its own (:mod:`benchmarks.ablation_worker`). Records lie in OUT/records; a run that has one is
not repeated. A refinement that a capture never accepts cannot be missed there: its run would repeat the one that leaves
nothing out, and is not made. At the end the records are packed into docs/measured and docs/benchmarks.md is made anew.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from iris_addon.base.files import write_json
from iris_addon.base.progress import Progress, console
from iris_addon.base.untrusted import read_json
from iris_addon.config import PRESETS
from iris_addon.decide import REFINEMENTS

from .ablation_section import NOTHING
from .ablation_worker import variants
from .records import OUT, read_records
from .runs import capture_folder, captures, relative, run_each

WORKER = "benchmarks.ablation_worker"


def _run(capture: Path, name: str, preset_name: str) -> tuple[str, list[str]]:
    """Name of the record of a run, and the arguments of its worker."""
    return f"{capture.name}.{re.sub('[^a-z]+', '-', name)}.{preset_name}", [relative(capture), name, preset_name]


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
    progress = Progress(console())
    for capture in args.captures:
        whole = _run(capture, NOTHING, args.preset)
        run_each(WORKER, dict([whole]), folder, progress)
        runs = [_run(capture, name, args.preset) for name in args.only if name != NOTHING]
        record = read_json(folder / f"{whole[0]}.json")
        for key, (path, name, preset) in runs:
            if name in REFINEMENTS and name not in record["accepted"] and not (folder / f"{key}.json").is_file():
                run = {"capture": path, "left_out": name, "preset": preset}
                write_json(folder / f"{key}.json", {**record, "run": run, "seconds_total": 0.0})
        run_each(WORKER, dict(runs), folder, progress)
    if not args.no_report:
        from .report import publish

        publish("ablation", read_records(folder))
    return 0


if __name__ == "__main__":
    sys.exit(main())
