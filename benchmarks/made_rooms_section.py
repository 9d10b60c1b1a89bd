"""Rooms that we render ourselves as tables, beside what is asked of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from .records import Record
from .tables import room_table

HEADINGS = {
    "lamps": ("false lamps", 0),
    "sun_degrees": ("direction of the sun, degrees off", 2),
    "sun_irradiance": ("its irradiance over true", 2),
    "kd_psnr_8x8": ("kd_psnr over 8×8", 2),
    "kd_psnr_all_8x8": ("kd_psnr_all over 8×8", 2),
    "roughness_psnr": ("roughness", 2),
    "metallic_l2": ("metallic, squared error", 4),
    "emission_iou": ("emission_iou", 3),
    "emission_log_l2": ("emission_log_l2", 4),
    "nvs_psnr": ("novel views", 2),
    "relight_psnr": ("relit", 2),
    "insert_psnr": ("inserted", 2),
    "insert_psnr_around": ("around it", 2),
    "seconds_total": ("seconds", 0),
}
"""Heading and digits of each metric, in the order of the columns."""
OF_ALL = (
    "kd_psnr_8x8",
    "kd_psnr_all_8x8",
    "roughness_psnr",
    "nvs_psnr",
    "relight_psnr",
    "insert_psnr",
    "seconds_total",
)


def _table(records: Sequence[Record], *more: str, **marks: str) -> str:
    """The metrics of all sets, ``more`` and those that have ``marks``."""
    shown = {*OF_ALL, *more, *marks}
    columns = {name: (*heading, marks.get(name, "")) for name, heading in HEADINGS.items() if name in shown}
    return room_table(records, columns)


def describe_sunlit(records: Sequence[Record], _images: Path) -> str:
    """A row per room with a sun, and one of the marks, as Markdown."""
    return _table(
        records,
        lamps="0",
        sun_degrees="≤ 2",
        sun_irradiance="0.9 … 1.1",
        kd_psnr_8x8="≥ 30",
        nvs_psnr="≥ 28",
        relight_psnr="≥ 28",
        insert_psnr="≥ 26",
        insert_psnr_around="≥ 26",
    )


def describe_mirrors(records: Sequence[Record], _images: Path) -> str:
    """A row per room with a mirror or polished steel, as Markdown."""
    return _table(records, "metallic_l2", "emission_iou")


def describe_patterns(records: Sequence[Record], _images: Path) -> str:
    """A row per room with a screen or a window, and one of the marks, as Markdown."""
    return _table(records, "emission_log_l2", kd_psnr_8x8="≥ 37.5", emission_iou="≥ 0.99")


def describe_profiles(records: Sequence[Record], _images: Path) -> str:
    """A row per room with spots or a shielded panel, and one of the marks, as Markdown."""
    return _table(records, "emission_log_l2", kd_psnr_8x8="≥ 37.6", emission_iou="≥ 0.99")


def describe_states(records: Sequence[Record], _images: Path) -> str:
    """A row per room of several light states and of one, and one of the marks, as Markdown."""
    return _table(records, "emission_log_l2", kd_psnr_8x8="≥ 40.7", emission_iou="≥ 0.99")
