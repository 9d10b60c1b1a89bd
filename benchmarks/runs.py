"""Runs and their records: one run is a capture, a configuration, a perturbation and a seed; its record is one JSON file.

Every run has a process of its own, so that its peak memory is its own and a crash costs one point. A run whose record
stands is not repeated: stop at any time and start again.
"""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from iris_addon.config import PresetName
from iris_addon.progress import Progress
from iris_addon.result.json_files import read_json, write_json

from .machine import ROOT

Scored = Literal["maps", "relight", "all"]
BUNDLED = ROOT / "assets" / "demo_room"
SHARED_CAPTURES = ROOT.parent / "shared" / "captures"
Record = dict[str, Any]


@dataclass(frozen=True)
class Run:
    """One measurement.

    Attributes:
        capture: folder.
        configuration: name in :data:`benchmarks.configurations.CONFIGURATIONS`.
        axis, level: perturbation of the capture; "" for none, and the index of its level.
        scored: "maps" renders nothing, "relight" renders the relighting references, "all" everything.
        samples: per pixel of a rendered view.
        warm: whether transport may be read from the cache that the runs of one folder share.
    """

    capture: str
    configuration: str = "ours"
    preset: PresetName = "balanced"
    seed: int = 0
    axis: str = ""
    level: int = 0
    scored: Scored = "all"
    samples: int = 64
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


def run_all(runs: Sequence[Run], folder: Path, progress: Progress) -> list[Record]:
    """Run what has no record in ``folder`` yet; returns the records of ``runs`` in their order.

    A run that fails leaves no record but a line in the returned list with "error"; the next call tries it again.
    """
    records = []
    with progress.stage("runs"):
        for index, run in enumerate(runs):
            progress.update(index / max(len(runs), 1), run.key)
            records.append(run_once(run, folder))
            if "error" in records[-1]:
                progress.update(index / len(runs), f"{run.key}: {records[-1]['error']}")
    return records


def run_once(run: Run, folder: Path) -> Record:
    """The record of ``run``, read back or made in a new process."""
    path = folder / f"{run.key}.json"
    if path.is_file():
        known = read_json(path)
        if known.get("run") == asdict(run):
            return known
    command = [sys.executable, "-m", "benchmarks.worker", json.dumps(asdict(run)), str(path.resolve())]
    process = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if process.returncode == 0 and path.is_file():
        return read_json(path)
    said = [line for line in process.stderr.splitlines() if line.strip()]
    error = said[-1] if said else f"ended with code {process.returncode}"
    return {"run": asdict(run), "error": error.removeprefix("error: ")}


def read_records(folder: Path) -> list[Record]:
    """All records of a folder, by name."""
    return [read_json(path) for path in sorted(folder.glob("*.json"))]


# ---- tables --------------------------------------------------------------------------------------------------------

METRICS = (
    "kd_psnr", "kd_psnr_all", "a_psnr", "roughness_psnr", "metallic_l2", "emission_iou", "emission_log_l2", "crf_l2",
    "exposure_log2_rmse", "nvs_psnr", "nvs_ssim", "relight_psnr", "relight_ssim", "insert_psnr", "insert_psnr_around",
)  # fmt: skip


def flat(record: Record) -> dict[str, Any]:
    """A record as one row of a table."""
    row = {**record["run"], "capture": Path(record["run"]["capture"]).name}
    row |= {name: record.get(name) for name in ("seconds_total", "peak_memory_bytes", "rays_traced", "n_patches")}
    row |= {f"seconds_{stage}": value for stage, value in record.get("seconds", {}).items()}
    row |= {name: value for name, value in record.get("metrics", {}).items() if isinstance(value, int | float)}
    machine = record.get("machine", {})
    return row | {"processor": machine.get("processor"), "commit": machine.get("commit"), "error": record.get("error")}


def write_csv(path: Path, records: Iterable[Record]) -> None:
    """All records as one CSV table, a column for everything that any of them has."""
    rows = [flat(record) for record in records]
    columns = list(dict.fromkeys(name for row in rows for name in row))
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)


def save_record(path: Path, record: Record) -> None:
    """Write a record in one step."""
    write_json(path, record)
