"""Jobs per hour of a batch as a table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import fmean

from . import tables
from .records import Record, machine_of


def describe(records: Sequence[Record], _images: Path) -> str:
    """Jobs per hour by how many run at a time, against the fewest, as Markdown."""
    groups: dict[tuple[str, int, int], list[Record]] = {}
    for record in records:
        run = record["run"]
        groups.setdefault((run["preset"], run["jobs"], run["parallel"]), []).append(record)
    body, first = [], {}
    for (preset, jobs, parallel), own in sorted(groups.items()):
        rate = fmean(record["jobs_per_hour"] for record in own)
        base = first.setdefault((preset, jobs), rate)
        one = fmean(seconds for record in own for seconds in record["job_seconds"])
        total = tables.cell(own, "seconds_total", 0)
        body.append([preset, str(jobs), str(parallel), total, f"{one:.0f}", f"{rate:.0f}", f"{rate / base:.2f}"])
    names = sorted({Path(capture).name for record in records for capture in record["run"]["captures"]})
    header = ["preset", "jobs", "at a time", "seconds", "seconds of a job", "jobs per hour", "gain"]
    return f"{machine_of(records)} Captures: {', '.join(names)}.\n\n{tables.markdown(header, body)}\n"
