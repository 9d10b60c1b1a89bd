"""Scans beside the exact meshes of the same rooms, as a table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from . import tables
from .records import Record, machine_of
from .runs import SCAN

COLUMNS = {
    "kd_psnr": ("kd_psnr", 2),
    "kd_psnr_8x8": ("over 8×8", 2),
    "kd_psnr_all": ("kd_psnr_all", 2),
    "roughness_psnr": ("roughness", 2),
    "emission_iou": ("emission_iou", 3),
    "emission_log_l2": ("emission_log_l2", 4),
    "holdout_psnr": ("held-out pixels", 2),
    "seconds_total": ("seconds", 0),
}
"""Metric of a record: its heading, and digits after the point."""


def describe(records: Sequence[Record], _images: Path) -> str:
    """A row per room and mesh, the exact one first, as Markdown."""
    groups = tables.group(records, lambda row: (Path(row["capture"]).name, row["preset"]))
    body = []
    for (name, preset), rows in sorted(groups.items()):
        rays = f"{tables.mean(rows, 'rays_traced') / 1e6:.0f}"
        mesh = "scan" if name.endswith(SCAN) else "exact"
        figures = [tables.cell(rows, metric, digits) for metric, (_, digits) in COLUMNS.items()]
        body.append([name.removesuffix(SCAN), mesh, preset, *figures, rays])
    header = ["room", "mesh", "preset", *(heading for heading, _ in COLUMNS.values()), "million rays"]
    return f"{machine_of(records)}\n\n{tables.markdown(header, body)}\n"
