"""Runs: a capture, a configuration, a perturbation, a seed; the record of each is one JSON file.

Every run has a process of its own, so that its peak memory is its own and a crash costs one point. A run whose record
stands is not repeated: stop at any time and start again.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean
from typing import Literal

from iris_addon.base.parallel import cores
from iris_addon.base.progress import Progress
from iris_addon.base.untrusted import read_json

from .machine import ROOT
from .records import Record

Scored = Literal["maps", "relight", "all"]
BUNDLED = ROOT / "assets" / "demo_room"
SHARED_CAPTURES = ROOT.parent / "shared" / "captures"
SCAN = "-scan"
"""Added to the name of a capture whose mesh is that of a scanner."""
SWEPT_VIEWS = 2
"""Held-out views that the sweeps relight."""


def capture_folder(text: str) -> Path:
    """A capture named on a command line."""
    folder = Path(text)
    if not folder.is_dir():
        raise argparse.ArgumentTypeError(f"{text}: no such folder")
    return folder


@dataclass(frozen=True)
class Run:
    """One measurement.

    Attributes:
        capture: folder, relative to the repository.
        configuration: name in :data:`benchmarks.configurations.CONFIGURATIONS`.
        axis, level: perturbation of the capture; "" for none, and the index of its level.
        preset: of the engine, or "sweep" (see :mod:`benchmarks.configurations`); of another program, its settings.
        scored: "maps" renders nothing, "relight" renders the relighting references, "all" everything.
        samples: per pixel of a rendered view.
        views: held-out views whose relighting references are rendered, 0 for all.
        warm: whether transport may be read from the cache that the runs of one folder share.
    """

    capture: str
    configuration: str = "ours"
    preset: str = "balanced"
    seed: int = 0
    axis: str = ""
    level: int = 0
    scored: Scored = "all"
    samples: int = 64
    views: int = 0
    warm: bool = False

    @property
    def key(self) -> str:
        """File name of the record, without suffix."""
        where = f"{self.axis}-{self.level}" if self.level else "as-captured"
        return f"{Path(self.capture).name}.{self.configuration}.{self.preset}.{where}.{self.seed}"


def captures() -> list[Path]:
    """The bundled capture and those of the shared folder that are there."""
    found = sorted(p for p in SHARED_CAPTURES.glob("*") if p.is_dir()) if SHARED_CAPTURES.is_dir() else []
    return [path for path in (BUNDLED, *found) if path.is_dir()]


def has_truth(capture: Path) -> bool:
    """Whether a result can be scored by maps: the capture has ground truth of its materials."""
    return any((capture / folder / "DiffCol").is_dir() for folder in ("gt/train", "train"))


def relative(capture: Path) -> str:
    """How records name a capture: relative to the repository, where every run starts."""
    return Path(os.path.relpath(capture, ROOT)).as_posix()


def run_all(runs: Sequence[Run], folder: Path, progress: Progress, jobs: int = 1) -> list[Record]:
    """Run what has no record in ``folder`` yet; returns the records of ``runs`` in their order.

    A run that fails leaves no record but an entry with "error" in the returned list; the next call tries it again.

    Args:
        jobs: runs at a time. More than one spoils the seconds in the records, not the scores.
    """
    records = {index: record for index, run in enumerate(runs) if (record := standing_record(run, folder)) is not None}
    missing = [index for index in range(len(runs)) if index not in records]
    spent = [record["seconds_run"] for record in records.values() if "seconds_run" in record]
    with progress.stage("runs"), ThreadPoolExecutor(jobs) as pool:
        progress.update(0.0, f"{len(missing)} of {len(runs)} runs to measure{_estimate(spent, len(missing), jobs)}")
        waiting = {pool.submit(run_once, runs[index], folder, jobs): index for index in missing}
        try:
            for count, done in enumerate(as_completed(waiting), start=1):
                records[waiting[done]] = record = done.result()
                spent += [record["seconds_run"]] if "seconds_run" in record else []
                text = runs[waiting[done]].key
                text += f": {record['error']}" if "error" in record else ""
                text += _estimate(spent, len(missing) - count, jobs) if count in (1, 10) else ""
                progress.update(count / len(missing), text)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return [records[index] for index in range(len(runs))]


def _estimate(spent: Sequence[float], left: int, jobs: int) -> str:
    """How long the runs to come will take by those before, as text."""
    if not spent or not left:
        return ""
    return f"; about {fmean(spent) * left / jobs / 60:.0f} minutes at {fmean(spent):.0f} s each, {jobs} at a time"


def standing_record(run: Run, folder: Path) -> Record | None:
    """The record of ``run`` if it stands; one of another run under the same name is removed."""
    path = folder / f"{run.key}.json"
    if not path.is_file():
        return None
    record = read_json(path)
    if record.get("run") == asdict(run):
        return record
    path.unlink()  # measured with other settings
    return None


def run_once(run: Run, folder: Path, jobs: int = 1) -> Record:
    """The record of ``run``, made in a new process that is one of ``jobs`` at a time."""
    path = folder / f"{run.key}.json"
    error = run_isolated("benchmarks.worker", path, [json.dumps(asdict(run))], jobs)
    return read_json(path) if error is None else {"run": asdict(run), "error": error}


def run_isolated(module: str, path: Path, arguments: Sequence[str], jobs: int = 1) -> str | None:
    """Let ``python -m module RECORD_FILE arguments`` write the record at ``path``, unless it stands.

    Args:
        jobs: processes at a time; each gets its share of the cores, or their threads would wait for each other.

    Returns:
        None, or the last line that the process wrote to stderr when it failed.
    """
    if path.is_file():
        return None
    command = [sys.executable, "-m", module, str(path.resolve()), *arguments]
    threads = str(max(1, cores() // jobs))
    environment = os.environ | ({"OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads} if jobs > 1 else {})
    process = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=environment)
    if process.returncode == 0 and path.is_file():
        return None
    lines = [line for line in process.stderr.splitlines() if line.strip()]
    return lines[-1].removeprefix("error: ") if lines else f"ended with code {process.returncode}"


def run_each(module: str, todo: Mapping[str, Sequence[str]], folder: Path, progress: Progress) -> None:
    """Let ``module`` write the record ``folder/NAME.json`` of every name that has none, one after the other."""
    with progress.stage("runs"):
        for index, (name, arguments) in enumerate(todo.items()):
            progress.update(index / len(todo), f"{name}, {len(todo) - index} to go")
            error = run_isolated(module, folder / f"{name}.json", arguments)
            if error is not None:
                progress.update(index / len(todo), f"{name}: {error}")
