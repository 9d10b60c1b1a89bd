"""Cost against size as a chart and tables: slopes on log axes, and ten million triangles on paper."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from . import charts, tables
from .records import Record, machine_of

SWEEPS: dict[str, tuple[str, tuple[int, ...]]] = {
    "triangles": ("triangles", (10_000, 30_000, 100_000, 300_000, 1_000_000)),
    "photos": ("photos", (8, 16, 32, 75, 150, 300)),
    "pixels": ("pixels of all photos", (80, 160, 320, 640, 1280)),
}
"""What is swept: its name in the chart, and the sizes wanted (of a photo: its width)."""
EXTRAPOLATED_TRIANGLES = 10_000_000


def describe(records: Sequence[Record], images: Path) -> str:
    """Charts into ``images``; slopes, and the cost of ten million triangles on paper, as Markdown."""
    panels: dict[str, dict[str, tuple[list[float], list[float]]]] = {
        "seconds": {},
        "memory, GiB": {},
        "million rays": {},
    }
    stages: dict[str, tuple[list[float], list[float]]] = {}
    for sweep, (label, _) in SWEEPS.items():
        own = sorted((r for r in records if r["run"]["sweep"] == sweep), key=lambda r: r["actual_size"])
        if len(own) < 2:
            continue
        x = [float(r["actual_size"]) for r in own]
        for quantity, y in (
            ("seconds", [r["seconds_total"] for r in own]),
            ("memory, GiB", [r["peak_memory_bytes"] / 2**30 for r in own]),
            ("million rays", [r["rays_traced"] / 1e6 for r in own]),
        ):
            panels[quantity][f"{label}, slope {tables.loglog_slope(x, y):.2f}"] = (x, y)
        if sweep == "triangles":
            stages = {s: (x, [max(r["seconds"].get(s, 0.0), 1e-2) for r in own]) for s in own[0]["seconds"]}
    charts.save(charts.scaling(panels, title="Cost of a solve against the size of its input"), images / "scaling")
    presets = sorted({record["run"]["preset"] for record in records})
    lines = [
        "![Cost against size](images/benchmarks/scaling.png)\n",
        f"{machine_of(records)} `{', '.join(presets)}`.\n",
    ]
    lines += [f"- {quantity}: {name}" for quantity, found in panels.items() for name in found]
    if stages:
        lines += ["", *_extrapolate(stages)]
    return "\n".join(lines) + "\n"


def _extrapolate(stages: dict[str, tuple[list[float], list[float]]]) -> list[str]:
    """Seconds per stage at ten million triangles by the slope of the upper half, and the stage that limits."""
    expected, body = {}, []
    for stage, (x, y) in stages.items():
        upper = slice(len(x) // 2 if len(x) > 3 else 0, None)
        slope = tables.loglog_slope(x[upper], y[upper])
        expected[stage] = y[-1] * (EXTRAPOLATED_TRIANGLES / x[-1]) ** max(slope, 0.0)
        body.append([stage, f"{y[-1]:.1f}", f"{slope:.2f}", f"{expected[stage]:.0f}"])
    limiting = max(expected, key=lambda stage: expected[stage])
    last = next(iter(stages.values()))[0][-1]
    header = ["stage", f"seconds at {last:.0f} triangles", "slope", "seconds at 10⁷, extrapolated"]
    return [tables.markdown(header, body), f"Limiting stage at 10⁷ triangles: {limiting}."]
