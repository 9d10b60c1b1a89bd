"""The stability sweep as charts and a table: where each method fails along each axis, what breaks first on top."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from . import charts, tables
from .perturb import AXES, Axis
from .records import Record, flat, machine_of

METHODS = ("ours", "iris-like")
METRICS = ("kd_psnr_all_valid", "relight_psnr", "emission_log_l2")

Values = dict[tuple[str, str, str], NDArray[np.float64]]
"""(axis, method, metric) to (levels, seeds)."""


def collect(records: Sequence[Record], axes: Sequence[str], seeds: int) -> Values:
    """Metrics by axis, method, level and seed; NaN where a run failed."""
    rows = {}
    for record in records:
        row = flat(record)
        rows[row["axis"], row["configuration"], row["level"], row["seed"]] = row
    values = {}
    for name in axes:
        for method in METHODS:
            flat_line = AXES[name].masks_only and method == METHODS[0]
            for metric in METRICS:
                table = np.full((len(AXES[name].levels), seeds), np.nan)
                for level in range(len(table)):
                    for seed in range(seeds):
                        at = ("", method, 0, seed) if level == 0 or flat_line else (name, method, level, seed)
                        found = rows.get(at, {}).get(metric)
                        table[level, seed] = np.nan if found is None else found
                values[name, method, metric] = table
    return values


def failure(values: Values, axis: str, method: str) -> int | None:
    """First level where diffuse albedo or relighting is 3 dB below the capture as it is, or every seed fails."""
    both = [tables.failure_level(values[axis, method, metric]) for metric in METRICS[:2]]
    return min((level for level in both if level is not None), default=None)


def describe(records: Sequence[Record], images: Path) -> str:
    """A chart per axis into ``images``, the summary table as Markdown, what breaks ours first on top."""
    measured = {record["run"]["axis"] for record in records}
    axes = [name for name in AXES if name in measured]
    seeds = 1 + max(record["run"]["seed"] for record in records)
    values = collect(records, axes, seeds)
    rows = []
    for name in axes:
        axis = AXES[name]
        charts.save(_chart(values, axis), images / f"stability-{name}", svg=False)
        lost = {
            (method, metric): _mean(values[name, method, metric][0]) - _mean(values[name, method, metric][-1])
            for method in METHODS
            for metric in METRICS[:2]
        }
        worst = max(np.nan_to_num(lost[METHODS[0], metric], nan=np.inf) for metric in METRICS[:2])
        rows.append((failure(values, name, METHODS[0]), -worst, [_link(axis), *_cells(values, axis, lost)]))
    rows.sort(key=lambda row: (len(row[2]) if row[0] is None else row[0], row[1]))
    header = ["axis"]
    for method in METHODS:
        header += [f"{method} fails at", "kd lost, dB", "relight lost, dB"]
    text = f"{machine_of(records)} {seeds} {'seed' if seeds == 1 else 'seeds'}.\n\n"
    text += tables.markdown(header, [row for _, _, row in rows])
    text += f"\nFails at: the first level where kd or relight PSNR is more than {tables.FAILURE_DB:g} dB below the "
    text += "capture as it is; lost: at the hardest level. The first to fail stands first.\n"
    failed = sorted({f"{r['run']['axis']}: {r['error']}" for r in records if "error" in r})
    return text + "".join(f"\n- Failed runs, {line}" for line in failed)


def _link(axis: Axis) -> str:
    return f"[{axis.title}](images/benchmarks/stability-{axis.name}.png)"


def _cells(values: Values, axis: Axis, lost: Mapping[tuple[str, str], float]) -> list[str]:
    cells = []
    for method in METHODS:
        level = failure(values, axis.name, method)
        cells.append(
            "never" if level is None else f"{axis.label(level)} {axis.unit}".replace("unknown stops rms", "unknown")
        )
        cells += [
            f"{lost[method, metric]:.1f}" if np.isfinite(lost[method, metric]) else "fails" for metric in METRICS[:2]
        ]
    return cells


def _mean(row: NDArray[np.float64]) -> float:
    return float(np.nanmean(row)) if np.isfinite(row).any() else float("nan")


def _chart(values: Values, axis: Axis) -> charts.Figure:
    panels = {
        metric: [
            charts.Sweep(method, values[axis.name, method, metric], failure(values, axis.name, method))
            for method in METHODS
            if np.isfinite(values[axis.name, method, metric]).any()
        ]
        for metric in METRICS
    }
    ticks = [axis.label(level) for level in range(len(axis.levels))]
    return charts.stability(panels, ticks, title=axis.title, x_label=axis.unit)
