"""Records of runs: one JSON file per run under ``out``, all of them in one file per benchmark under ``docs``.

Runs write one file each to OUT, so that they can be stopped and go on. What was measured is then packed, one line per
run, to COMMITTED, and charts and tables are made of that alone: anyone can make them again without measuring.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from iris_addon.base.errors import IrisError
from iris_addon.base.files import atomic_write, write_json
from iris_addon.base.untrusted import read_json

from .machine import ROOT

OUT = ROOT / "out" / "measured"
COMMITTED = ROOT / "docs" / "measured"
IMAGES = ROOT / "docs" / "images" / "benchmarks"
Record = dict[str, Any]


def write_record(path: Path, measure: Callable[[], Record]) -> int:
    """What a worker does: the record of ``measure`` at ``path``, or what is wrong on stderr; the exit code."""
    try:
        write_json(path, measure())
    except IrisError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def read_records(folder: Path) -> list[Record]:
    """All records of a folder, by name."""
    return [read_json(path) for path in sorted(folder.glob("*.json"))]


def pack(name: str, records: Iterable[Record], folder: Path = COMMITTED) -> Path:
    """Write ``records`` to ``folder/name.jsonl``, in the order of their runs; those that failed have an ``error``."""
    ordered = sorted(records, key=lambda record: json.dumps(record["run"], sort_keys=True))
    lines = [json.dumps(record, sort_keys=True) for record in ordered]
    path = folder / f"{name}.jsonl"
    atomic_write(path, lambda temporary: temporary.write_text("\n".join(lines) + "\n", encoding="utf-8"))
    return path


def unpack(name: str, folder: Path = COMMITTED) -> list[Record]:
    """The records that :func:`pack` wrote; none where nothing was measured."""
    path = folder / f"{name}.jsonl"
    if not path.is_file():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line]


def machine_of(records: Iterable[Record]) -> str:
    """Machine and commits that the records name, as one line."""
    machines = [record["machine"] for record in records if "machine" in record]
    names = sorted({f"{m['processor']}, {m['cores']} cores" for m in machines})
    commits = sorted({str(m["commit"]) for m in machines})
    return f"Measured on {'; '.join(names)}; commit {', '.join(commits)}."


def flat(record: Record) -> dict[str, Any]:
    """A record as one row of a table."""
    row = {**record["run"], "capture": Path(record["run"]["capture"]).name}
    costs = ("seconds_total", "seconds_run", "peak_memory_bytes", "rays_traced", "n_patches", "holdout_psnr", "lamps")
    row |= {name: record.get(name) for name in costs}
    row |= {f"seconds_{stage}": value for stage, value in record.get("seconds", {}).items()}
    row |= {name: value for name, value in record.get("metrics", {}).items() if isinstance(value, int | float)}
    machine = record.get("machine", {})
    return row | {"processor": machine.get("processor"), "commit": machine.get("commit"), "error": record.get("error")}
