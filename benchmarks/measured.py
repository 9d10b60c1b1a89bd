"""Where measurements lie: records of single runs under ``out``, what is committed under ``docs``.

Runs write one file each to OUT, so that they can be stopped and go on. What was measured is then packed, one line per
run, to COMMITTED, and charts and tables are made of that alone: anyone can make them again without measuring.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

from iris_addon.base.files import atomic_write

from .machine import ROOT
from .runs import Record

OUT = ROOT / "out" / "measured"
COMMITTED = ROOT / "docs" / "measured"
IMAGES = ROOT / "docs" / "images" / "benchmarks"


def pack(name: str, records: Iterable[Record], folder: Path = COMMITTED) -> Path:
    """Write ``records`` to ``folder/name.jsonl``, in the order of their runs; those that failed say so."""
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
    told = [record["machine"] for record in records if "machine" in record]
    machines = sorted({f"{m['processor']}, {m['cores']} cores" for m in told})
    commits = sorted({str(m["commit"]) for m in told})
    return f"Measured on {'; '.join(machines)}; commit {', '.join(commits)}."
