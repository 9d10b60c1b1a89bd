"""Cost against size: seconds, memory and rays over triangles, photos and photo size; slopes on log axes.

    python -m benchmarks.scaling [CAPTURE] [--preset balanced] [--sweeps NAME ...]

How captures of other sizes are made: :mod:`benchmarks.scaling_worker`. Records lie in OUT/records; a run that has one
is not repeated. At the end they are packed into docs/measured and docs/benchmarks.md is made anew.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from iris_addon.base.progress import Progress, console
from iris_addon.config import PRESETS

from . import charts, tables
from .measured import OUT, machine_of, pack
from .runs import BUNDLED, Record, capture_folder, read_records, relative, run_each

SWEEPS: dict[str, tuple[str, tuple[int, ...]]] = {
    "triangles": ("triangles", (10_000, 30_000, 100_000, 300_000, 1_000_000)),
    "photos": ("photos", (8, 16, 32, 75, 150, 300)),
    "pixels": ("pixels of all photos", (80, 160, 320, 640, 1280)),
}
"""What is swept: its name in the chart, and the sizes asked for (of a photo: its width)."""
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


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=capture_folder, nargs="?", default=BUNDLED)
    parser.add_argument("--preset", choices=list(PRESETS), default="balanced")
    parser.add_argument("--sweeps", nargs="+", choices=list(SWEEPS), default=list(SWEEPS))
    parser.add_argument("--largest", type=int, default=1_000_000, help="leave out sizes above this")
    parser.add_argument("--out", type=Path, default=OUT / "scaling")
    parser.add_argument("--no-report", action="store_true", help="leave docs alone")
    args = parser.parse_args(arguments)
    sizes = [(sweep, size) for sweep in args.sweeps for size in SWEEPS[sweep][1] if size <= args.largest]
    progress, folder = Progress(console()), args.out / "records"
    todo = {
        f"{args.capture.name}.{sweep}.{size}.{args.preset}": [relative(args.capture), sweep, str(size), args.preset]
        for sweep, size in sizes
    }
    run_each("benchmarks.scaling_worker", todo, folder, progress)
    if not args.no_report:
        from .report import write

        pack("scaling", read_records(folder))
        write(["scaling"])
    return 0


if __name__ == "__main__":
    sys.exit(main())
