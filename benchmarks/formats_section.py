"""The bundled room in every format as a table, beside what each is held against."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from . import tables
from .format_captures import FORMATS
from .records import Record, machine_of

COLUMNS = {
    "kd_psnr": ("kd_psnr", 2),
    "kd_psnr_8x8": ("over 8×8", 2),
    "kd_psnr_all_8x8": ("kd_psnr_all over 8×8", 2),
    "emission_iou": ("emission_iou", 3),
    "emission_log_l2": ("emission_log_l2", 4),
    "holdout_psnr": ("held-out pixels", 2),
}
"""Metric of a record: its heading, and digits after the point."""
SAME_INPUT = {"place": 1e-6, "turn": 1e-4, "intrinsics": 1e-6, "exposure": 1e-9, "mesh": 1e-6, "pixels": 0.0}
"""Differences up to which two captures give the engine the same but for rounding, in the units of
:func:`benchmarks.format_captures.differences`."""
UNITS = {"place": "m", "turn": "°", "intrinsics": "px", "exposure": "stops", "mesh": "m", "pixels": "codes"}


def describe(records: Sequence[Record], _images: Path) -> str:
    """A row per format below the one that it is held against, as Markdown."""
    by_format: dict[str, list[Record]] = {}
    for record in records:
        by_format.setdefault(record["run"]["format"], []).append(record)
    references = dict.fromkeys(FORMATS[name].like for name in FORMATS)
    ordered = [name for like in references for name in _below(like) if name in by_format]
    body = [[_title(name), _input(name, by_format[name]), *_figures(by_format[name])] for name in ordered]
    header = ["format", "input", *(heading for heading, _ in COLUMNS.values())]
    return f"{machine_of(records)}\n\n{tables.markdown(header, body)}\n"


def _below(like: str) -> list[str]:
    return [like, *(name for name, form in FORMATS.items() if form.like == like and name != like)]


def _title(name: str) -> str:
    return f"**{name}**" if FORMATS[name].like == name else name


def _input(name: str, records: Sequence[Record]) -> str:
    """Whether the engine gets what it gets of the reference, and what differs."""
    if FORMATS[name].like == name:
        return f"{len(records)} seeds"
    found = records[0]["difference"]
    apart = {key: value for key, value in found.items() if not value <= SAME_INPUT[key]}
    return ", ".join(f"{key} {value:.2g} {UNITS[key]}" for key, value in apart.items()) or "the same"


def _figures(records: Sequence[Record]) -> list[str]:
    """Mean ± half the span over seeds."""
    cells = []
    for metric, (_, digits) in COLUMNS.items():
        values = np.array([record["metrics"][metric] for record in records])
        spread = f" ± {np.ptp(values) / 2:.{digits}f}" if len(values) > 1 else ""
        cells.append(f"{values.mean():.{digits}f}{spread}")
    return cells
