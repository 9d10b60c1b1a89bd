"""Jobs per hour of ``batch``: one after the other against several side by side.

    python -m benchmarks.farm [CAPTURE ...] [--jobs 6] [--parallel 1 2] [--preset draft] [--repeats 2]

The jobs of a batch solve the captures in turn, each with a seed of its own; arrangements take turns, so that a machine
that slows down slows all. Records lie in OUT/records; a run that has one is not repeated. The machine must be idle.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from iris_addon.base.errors import IrisError
from iris_addon.base.files import write_json
from iris_addon.base.progress import Progress, console
from iris_addon.base.untrusted import read_json
from iris_addon.config import PRESETS

from . import machine
from .records import OUT, read_records
from .runs import capture_folder, captures, has_truth, relative

RUN = machine.ROOT / "headless" / "run.py"


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", type=capture_folder, nargs="*", help="those of the bench with ground truth")
    parser.add_argument("--jobs", type=int, default=6, help="of one batch")
    parser.add_argument("--parallel", type=int, nargs="+", default=[1, 2], help="jobs at a time, to compare")
    parser.add_argument("--preset", choices=list(PRESETS), default="draft")
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--out", type=Path, default=OUT / "farm")
    parser.add_argument("--no-report", action="store_true", help="leave docs alone")
    args = parser.parse_args(arguments)
    chosen = [path.resolve() for path in args.captures or filter(has_truth, captures())]
    todo = [(repeat, parallel) for repeat in range(args.repeats) for parallel in args.parallel]
    progress, folder = Progress(console()), args.out / "records"
    with progress.stage("batches"):
        for number, (repeat, parallel) in enumerate(todo):
            progress.update(number / len(todo), f"{args.jobs} jobs, {parallel} at a time")
            path = folder / f"{args.preset}.{args.jobs}.{parallel}.{repeat}.json"
            if not path.is_file():
                write_json(path, measure(chosen, args.jobs, parallel, args.preset, repeat))
    if not args.no_report:
        from .report import publish

        publish("farm", read_records(folder))
    return 0


def measure(chosen: Sequence[Path], jobs: int, parallel: int, preset: str, repeat: int) -> dict[str, Any]:
    """The record of one batch, in a process of its own that reads no transport from the cache.

    Raises:
        IrisError: a job failed.
    """
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "jobs.toml"
        path.write_text(job_file(chosen, jobs, preset, repeat), encoding="utf-8")
        environment = os.environ | {"IRIS_CACHE": str(Path(scratch) / "cache")}
        load, begin = os.getloadavg()[0] if hasattr(os, "getloadavg") else None, time.monotonic()
        command = [sys.executable, str(RUN), "batch", str(path), "--parallel", str(parallel)]
        ended = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        seconds = time.monotonic() - begin
        if ended.returncode != 0:
            last = [line for line in ended.stderr.splitlines() if line.strip()] or ["no message"]
            raise IrisError(f"the batch ended with code {ended.returncode} ({last[-1][:200]})", "run it by hand")
        lines = read_json(path.with_suffix("") / "summary.json")["jobs"]
    run = {"captures": [relative(one) for one in chosen], "jobs": jobs, "parallel": parallel, "preset": preset}
    return {
        "run": run | {"repeat": repeat},
        "seconds_total": seconds,
        "jobs_per_hour": 3600 * jobs / seconds,
        "job_seconds": [line["wall_seconds"] for line in lines],
        "rays_traced": sum(line["figures"]["rays_traced"] for line in lines),
        "load_before": load,
        "machine": machine.describe(),
    }


def job_file(chosen: Sequence[Path], jobs: int, preset: str, repeat: int) -> str:
    """Jobs that solve the captures in turn; every job has a seed of its own."""
    tables = []
    for number in range(jobs):
        capture = chosen[number % len(chosen)]
        name = f"{capture.name}-{number}"
        words = {"capture": str(capture), "name": name, "preset": preset, "seed": repeat * jobs + number}
        tables.append("[[job]]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in words.items()))
    return "\n".join(tables)


if __name__ == "__main__":
    sys.exit(main())
