"""Measured responses as a chart and a table: percentiles over the curves, exposures known and withheld."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from . import charts, tables
from .records import Record, machine_of

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
