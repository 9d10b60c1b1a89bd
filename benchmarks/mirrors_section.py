"""Rooms with mirrors as a table, beside what is asked of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from .records import Record
from .tables import Column, room_table

COLUMNS: dict[str, Column] = {
    "kd_psnr_8x8": ("kd_psnr over 8×8", 2, ""),
    "kd_psnr_all_8x8": ("kd_psnr_all over 8×8", 2, ""),
    "roughness_psnr": ("roughness", 2, ""),
    "metallic_l2": ("metallic, squared error", 4, ""),
    "emission_iou": ("emission_iou", 3, ""),
    "nvs_psnr": ("novel views", 2, ""),
    "relight_psnr": ("relit", 2, ""),
    "insert_psnr": ("inserted", 2, ""),
    "seconds_total": ("seconds", 0, ""),
}


def describe(records: Sequence[Record], _images: Path) -> str:
    """A row per room, as Markdown."""
    return room_table(records, COLUMNS)
