"""What each refinement earns, as a table: the fall of each metric where it is left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from . import tables
from .records import Record, flat, machine_of

NOTHING = "nothing"
METRICS: Mapping[str, str] = {
    "kd_psnr_all": "albedo (`kd_psnr_all`)",
    "roughness_psnr": "roughness",
    "holdout_psnr": "held-out pixels",
}
"""Metrics in decibels of which differences are shown, with their headers."""


def describe(records: Sequence[Record], _images: Path) -> str:
    """One table per metric: refinements down, captures across, decibels that each earns there."""
    rows = [flat(record) for record in records if "error" not in record]
    names = list(dict.fromkeys(row["left_out"] for row in rows if row["left_out"] != NOTHING))
    found = sorted({row["capture"] for row in rows})
    by = {(row["capture"], row["left_out"]): row for row in rows}
    parts = [machine_of(records) + " " + ", ".join(sorted({f"`{row['preset']}`" for row in rows})) + ".\n"]
    for metric, header in METRICS.items():
        body = [[name, *(tables.number(_earned(by, capture, name, metric)) for capture in found)] for name in names]
        parts.append(tables.markdown([f"dB of {header} earned by", *found], body))
    return "\n".join(parts)


def _earned(by: Mapping[tuple[str, str], Mapping[str, object]], capture: str, name: str, metric: str) -> float:
    """Decibels of ``metric`` that ``capture`` loses without ``name``; NaN where one of the two was not measured."""
    whole, without = (by.get((capture, each), {}).get(metric) for each in (NOTHING, name))
    if not isinstance(whole, int | float) or not isinstance(without, int | float):
        return np.nan
    return float(whole) - float(without)
