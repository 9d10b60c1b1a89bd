"""Sunlit rooms as a table, beside what is asked of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from .records import Record
from .tables import Column, room_table

COLUMNS: dict[str, Column] = {
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


def describe(records: Sequence[Record], _images: Path) -> str:
    """A row per room, and one of the marks, as Markdown."""
    return room_table(records, COLUMNS)
