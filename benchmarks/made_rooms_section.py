"""Rooms that we render ourselves as tables, beside what is asked of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from .records import Record
from .tables import Column, room_table

RENDERS: dict[str, Column] = {
    "nvs_psnr": ("novel views", 2, ""),
    "relight_psnr": ("relit", 2, ""),
    "insert_psnr": ("inserted", 2, ""),
    "seconds_total": ("seconds", 0, ""),
}
SUNLIT: dict[str, Column] = {
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
MIRRORS: dict[str, Column] = {
    "kd_psnr_8x8": ("kd_psnr over 8×8", 2, ""),
    "kd_psnr_all_8x8": ("kd_psnr_all over 8×8", 2, ""),
    "roughness_psnr": ("roughness", 2, ""),
    "metallic_l2": ("metallic, squared error", 4, ""),
    "emission_iou": ("emission_iou", 3, ""),
    **RENDERS,
}
PATTERNS: dict[str, Column] = {
    "kd_psnr_8x8": ("kd_psnr over 8×8", 2, "≥ 37.5"),
    "kd_psnr_all_8x8": ("kd_psnr_all over 8×8", 2, ""),
    "roughness_psnr": ("roughness", 2, ""),
    "emission_iou": ("emission_iou", 3, "≥ 0.99"),
    "emission_log_l2": ("emission_log_l2", 4, ""),
    **RENDERS,
}


def describe_sunlit(records: Sequence[Record], _images: Path) -> str:
    """A row per room with a sun, and one of the marks, as Markdown."""
    return room_table(records, SUNLIT)


def describe_mirrors(records: Sequence[Record], _images: Path) -> str:
    """A row per room with a mirror or polished steel, as Markdown."""
    return room_table(records, MIRRORS)


def describe_patterns(records: Sequence[Record], _images: Path) -> str:
    """A row per room with a screen or a window, and one of the marks, as Markdown."""
    return room_table(records, PATTERNS)
