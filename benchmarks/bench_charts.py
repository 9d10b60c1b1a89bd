"""Charts of :mod:`benchmarks.bench`: one per capture, and the mean over captures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from . import charts, tables
from .measured import machine_of
from .runs import Record

CHARTED = ("kd_psnr", "relight_psnr")
IN_CHARTS = ("ours", "mitsuba-prb", "iris-like", "fipt-ldr-like", "fipt-hdr-like", "single-bounce")


def write(records: Sequence[Record], out: Path) -> list[str]:
    """Write ``summary`` and a chart per capture that was scored by maps or relighting; their names.

    The summary is the mean over the captures on which every charted method was run, and has only the presets that were
    run on all of them, or a point would be judged by the easy ones.
    """
    by_capture = _scored(records)
    drawn = []
    if len(by_capture) > 1:
        common = _complete(by_capture)
        pool = _everywhere([record for name in common for record in by_capture[name]], len(common))
        if _draw(pool, f"Speed against accuracy, mean of {', '.join(common)}", out / "summary"):
            drawn.append("summary")
    drawn += [name for name, own in by_capture.items() if _draw(own, name, out / name)]
    return drawn


def _scored(records: Sequence[Record]) -> dict[str, list[Record]]:
    """Records by capture, of captures that have either charted metric."""
    by_capture: dict[str, list[Record]] = {}
    for record in records:
        if any(metric in record.get("metrics", {}) for metric in CHARTED):
            by_capture.setdefault(Path(record["run"]["capture"]).name, []).append(record)
    return dict(sorted(by_capture.items()))


def _complete(by_capture: dict[str, list[Record]]) -> list[str]:
    """Captures that have every charted method; all of them if none has."""
    methods = {name: {r["run"]["configuration"] for r in own} & set(IN_CHARTS) for name, own in by_capture.items()}
    everything = set().union(*methods.values()) - {"fipt-hdr-like"}  # needs radiance, which few captures keep
    return [name for name, found in methods.items() if everything <= found] or list(by_capture)


def _everywhere(records: Sequence[Record], n_captures: int) -> list[Record]:
    """Records of the methods and presets that have been run on all captures."""
    where: dict[tuple[str, str], set[str]] = {}
    for record in records:
        run = record["run"]
        where.setdefault((run["configuration"], run["preset"]), set()).add(run["capture"])
    return [r for r in records if len(where[r["run"]["configuration"], r["run"]["preset"]]) == n_captures]


def _draw(records: Sequence[Record], title: str, stem: Path) -> bool:
    panels = {metric: points for metric in CHARTED if (points := speed_points(records, metric))}
    if panels:
        charts.save(charts.speed_against_accuracy(panels, title=title, caption=machine_of(records)), stem)
    return bool(panels)


def speed_points(records: Sequence[Record], metric: str) -> list[charts.Points]:
    """One series per method, always in the same order, its points from the fastest on."""
    methods = tables.group(records, lambda row: row["configuration"])
    series = []
    for name in IN_CHARTS:
        by_preset: dict[str, list] = {}
        for row in methods.get(name, []):
            by_preset.setdefault(row["preset"], []).append(row)
        found = [(label, rows) for label, rows in by_preset.items() if len(tables.values(rows, metric))]
        found.sort(key=lambda item: tables.mean(item[1], "seconds_total"))
        if found:
            series.append(_points(name, metric, found))
    return series


def _points(name: str, metric: str, found: Sequence[tuple[str, list]]) -> charts.Points:
    """The mean over captures of the mean over seeds, and the span of the seeds where there is one capture."""
    seconds, value, spread = [], [], []
    for _, rows in found:
        seconds.append(tables.mean_over_captures(rows, "seconds_total"))
        value.append(tables.mean_over_captures(rows, metric))
        if len({row["capture"] for row in rows}) == 1:
            seeds = tables.values(rows, metric)
            spread.append((float(seeds.min()), float(seeds.max())))
    labels = [label for label, _ in found] if name == "ours" else ()
    return charts.Points(name, seconds, value, spread, labels, len(found) > 1, IN_CHARTS.index(name))
