"""Records put together: means and spans over seeds, failure points, Markdown tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .records import Record, flat, machine_of

Column = tuple[str, int, str]
"""Heading of a metric, digits after the point, and its mark."""
FAILURE_DB = 3.0
"""A method has failed at the first level where it is this far below the capture as it is."""


def group(records: Iterable[Record], key: Callable[[dict[str, Any]], Any]) -> dict[Any, list[dict[str, Any]]]:
    """Rows of the records that did not fail, by ``key`` of the row, in order of first appearance."""
    groups: dict[Any, list[dict[str, Any]]] = {}
    for record in records:
        if "error" not in record:
            row = flat(record)
            groups.setdefault(key(row), []).append(row)
    return groups


def values(rows: Sequence[Mapping[str, Any]], metric: str) -> NDArray[np.float64]:
    """(n,) ``metric`` of the rows that have it."""
    return np.array([row[metric] for row in rows if isinstance(row.get(metric), int | float)], np.float64)


def mean(rows: Sequence[Mapping[str, Any]], metric: str) -> float:
    """Mean over the rows that have it, else NaN."""
    found = values(rows, metric)
    return float(found.mean()) if len(found) else float("nan")


def mean_over_captures(rows: Sequence[Mapping[str, Any]], metric: str) -> float:
    """Mean over captures of the mean over seeds: a capture with more seeds does not count for more."""
    by_capture: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        by_capture.setdefault(row["capture"], []).append(row)
    means = [value for own in by_capture.values() if np.isfinite(value := mean(own, metric))]
    return float(np.mean(means)) if means else float("nan")


def number(value: float, digits: int = 2) -> str:
    """A figure, a dash for NaN."""
    return f"{value:.{digits}f}" if np.isfinite(value) else "–"


def cell(rows: Sequence[Mapping[str, Any]], metric: str, digits: int = 2) -> str:
    """Mean ± half the span over seeds; a dash where there is none."""
    found = values(rows, metric)
    if not len(found):
        return "–"
    text = f"{found.mean():.{digits}f}"
    return text if len(found) == 1 else f"{text} ± {np.ptp(found) / 2:.{digits}f}"


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def failure_level(by_level: NDArray[np.floating], drop: float = FAILURE_DB) -> int | None:
    """First level whose mean over seeds (levels, seeds) is more than ``drop`` below level 0, or has no run left."""
    alive = np.isfinite(by_level)
    means = np.where(alive.any(1), np.nansum(by_level, 1) / np.maximum(alive.sum(1), 1), -np.inf)
    failed = np.flatnonzero(means < means[0] - drop)
    return int(failed[0]) if len(failed) else None


def loglog_slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Exponent k of the least-squares fit y ~ x^k."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def room_table(records: Sequence[Record], columns: Mapping[str, Column]) -> str:
    """A row per room, and one of the marks if there are any, as Markdown; ``columns`` by metric."""
    groups = group(records, lambda row: (row["capture"], row["preset"]))
    body = [
        [name, preset, *(cell(rows, metric, digits) for metric, (_, digits, _) in columns.items())]
        for (name, preset), rows in sorted(groups.items())
    ]
    if any(mark for _, _, mark in columns.values()):
        body.append(["**mark**", "", *(mark for _, _, mark in columns.values())])
    header = ["room", "preset", *(heading for heading, _, _ in columns.values())]
    return f"{machine_of(records)}\n\n{markdown(header, body)}\n"
