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

from . import charts, tables
from .measured import OUT, machine_of, pack
from .perturb_photos import curves_by_distance
from .runs import BUNDLED, Record, capture_folder, read_records, relative, run_each

EXPOSURES = ("known", "withheld")
COLUMNS = (
    ("`crf_l2`: median", "crf_l2", 50, 2),
    ("90th percentile", "crf_l2", 90, 2),
    ("worst", "crf_l2", 100, 2),
    ("`kd_psnr`, dB: median", "kd_psnr", 50, 1),
    ("10th percentile", "kd_psnr", 10, 1),
    ("worst", "kd_psnr", 0, 1),
)
"""Header, metric, percentile over the curves, digits."""


def spread(n: int, count: int) -> list[int]:
    """``count`` of ``n`` ranks from the first to the last, evenly."""
    return sorted({round(rank) for rank in np.linspace(0, n - 1, min(count, n))})


def describe(records: Sequence[Record], images: Path) -> str:
    """Chart into ``images``, percentiles over the curves as Markdown."""
    body, panels = [], {metric: {} for metric in ("crf_l2", "kd_psnr")}
    for exposures in EXPOSURES:
        own = sorted((r for r in records if r["run"]["exposures"] == exposures), key=lambda r: r["run"]["rank"])
        if not own:
            continue
        ranks = [r["run"]["rank"] for r in own]
        for metric, lines in panels.items():
            lines[f"exposures {exposures}"] = ranks, [r["metrics"][metric] for r in own]
        figures = [
            tables.number(float(np.percentile([r["metrics"][metric] for r in own], percentile)), digits)
            for _, metric, percentile, digits in COLUMNS
        ]
        body.append([exposures, str(len(own)), *figures])
    taken = " and ".join(sorted({Path(record["run"]["capture"]).name for record in records}))
    charts.save(charts.responses(panels, title=f"Measured responses, {taken}"), images / "curves", svg=False)
    presets = ", ".join(sorted({record["run"]["preset"] for record in records}))
    return "\n".join(
        [
            "![Measured responses](images/benchmarks/curves.png)\n",
            f"{machine_of(records)} `{presets}`.\n",
            tables.markdown(["exposures", "curves", *(header for header, *_ in COLUMNS)], body),
        ]
    )


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
        from .report import write

        pack("curves", read_records(folder))
        write(["curves"])
    return 0


if __name__ == "__main__":
    sys.exit(main())
