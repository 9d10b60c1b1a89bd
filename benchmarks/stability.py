"""Stability where methods fail: every axis of :mod:`benchmarks.perturb`, ours against the IRIS-like configuration.

    python -m benchmarks.stability [CAPTURE] [--axes NAME ...] [--seeds 3] [--jobs 2]

The capture is halved in width and height and solved with the settings "sweep", a ``draft`` of one round. A run that has
a record in OUT/records is not repeated: stop at any time and start again. At the end the records are packed into
docs/measured and the charts and the table of docs/benchmarks.md are made anew (:mod:`benchmarks.report`).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from iris_addon.base.parallel import cores
from iris_addon.base.progress import Progress, console

from .halved_capture import halved_capture
from .perturb import AXES, axis_applies
from .perturb_scene import CHANGES, rendered
from .records import OUT, Record
from .runs import BUNDLED, SWEPT_VIEWS, Run, capture_folder, relative, run_all
from .stability_section import METHODS, METRICS

SAMPLES = 8
"""Per pixel of the relit pictures; they are denoised, and a sweep looks for decibels, not for hundredths."""


def planned(capture: Path, axes: Sequence[str], seeds: int) -> list[Run]:
    """All runs; the capture as it is comes first and is shared by all axes."""

    def run(method: str, seed: int, axis: str = "", level: int = 0) -> Run:
        return Run(
            capture=relative(capture),
            configuration=method,
            preset="sweep",
            seed=seed,
            axis=axis,
            level=level,
            scored="relight",
            samples=SAMPLES,
            views=SWEPT_VIEWS,
            warm=True,
        )

    runs = [run(method, seed) for seed in range(seeds) for method in METHODS]
    for seed in range(seeds):
        for name in axes:
            # Who searches for lamps does not look at a mask, so its line is flat and costs no run.
            methods = METHODS[1:] if AXES[name].masks_only else METHODS
            runs += [run(m, seed, name, level) for level in range(1, len(AXES[name].levels)) for m in methods]
    return runs


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=capture_folder, nargs="?", default=BUNDLED)
    parser.add_argument("--axes", nargs="+", choices=sorted(AXES), default=list(AXES), metavar="NAME")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--jobs", type=int, default=cores(), help="runs at a time")
    parser.add_argument("--out", type=Path, default=OUT / "stability")
    parser.add_argument("--no-report", action="store_true", help="leave docs alone")
    args = parser.parse_args(arguments)
    progress = Progress(console())
    capture = halved_capture(args.capture.resolve())
    reasons = {name: why for name in args.axes if (why := axis_applies(name, capture)) is not None}
    for name, why in reasons.items():
        print(f"{AXES[name].title}: left out, {why}", file=sys.stderr)
    axes = [name for name in args.axes if name not in reasons]
    with progress.stage("rooms rendered anew"):
        changed = [(name, level) for name in axes if name in CHANGES for level in AXES[name].levels[1:]]
        for index, (name, level) in enumerate(changed):
            progress.update(index / len(changed), f"{name} {level:g}, {len(changed) - index} to go")
            rendered(name, level, capture)
    records = run_all(planned(capture, axes, args.seeds), args.out / "records", progress, args.jobs)
    if not args.no_report:
        from .report import publish

        publish("stability", [slim(record) for record in records])
    return 0


def slim(record: Record) -> Record:
    """What the charts need of a record; there are hundreds."""
    kept = {key: record[key] for key in ("run", "machine", "perturbation", "seconds_run", "error") if key in record}
    if "metrics" in record:
        kept["metrics"] = {name: record["metrics"].get(name) for name in METRICS}
    return kept


if __name__ == "__main__":
    sys.exit(main())
