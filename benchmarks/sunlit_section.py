"""Sunlit rooms as a table, beside what is asked of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from . import tables
from .records import Record, machine_of

COLUMNS = {
    "lamps": ("false lamps", 0, "0"),
    "sun_degrees": ("direction of the sun, degrees off", 2, "≤ 2"),
    "sun_irradiance": ("its irradiance over true", 2, "0.9 … 1.1"),
    "kd_psnr_8x8": ("kd_psnr over 8×8", 2, "≥ 30"),
    "kd_psnr_all_8x8": ("kd_psnr_all over 8×8", 2, ""),
    "roughness_psnr": ("roughness", 2, ""),
    "nvs_psnr": ("novel views", 2, "≥ 28"),
    "relight_psnr": ("relit", 2, "≥ 28"),
    "insert_psnr": ("inserted", 2, "≥ 26"),
    "insert_psnr_around": ("around it", 2, "≥ 26"),
    "seconds_total": ("seconds", 0, ""),
}
"""Metric of a record: its heading, digits after the point, and the mark."""


def describe(records: Sequence[Record], _images: Path) -> str:
    """A row per room, and one of the marks, as Markdown."""
    groups = tables.group(records, lambda row: (row["capture"], row["preset"]))
    body = [
        [name, preset, *(tables.cell(rows, metric, digits) for metric, (_, digits, _) in COLUMNS.items())]
        for (name, preset), rows in sorted(groups.items())
    ]
    marks = ["**mark**", "", *(mark for _, _, mark in COLUMNS.values())]
    header = ["room", "preset", *(heading for heading, _, _ in COLUMNS.values())]
    return f"{machine_of(records)}\n\n{tables.markdown(header, [*body, marks])}\n"
