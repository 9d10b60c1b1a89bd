"""Speed against accuracy: every preset and every peer on every capture, charts and tables.

    python -m benchmarks.bench [--captures DIR ...] [--seeds 3] [--out docs/bench] [--no-mitsuba] [--charts-only]

Records lie in OUT/records; a run that has one is not repeated.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from iris_addon.config import PRESETS
from iris_addon.progress import Progress, console

from . import charts, machine, tables
from .configurations import CONFIGURATIONS
from .peer_mitsuba import NAME, snapshot_records
from .runs import METRICS, Record, Run, captures, read_records, relative, run_all, write_csv

PEER_PRESET = "balanced"
CHARTED = ("kd_psnr", "relight_psnr")
RESPONSE_ABLATION = ("constant-exposure", "mean-response", "gamma", "ours")
IN_CHARTS = ("ours", NAME, "iris-like", "fipt-ldr-like", "fipt-hdr-like", "single-bounce")
PUBLISHED_ABLATION = {"constant-exposure": 4.074, "mean-response": 4.240, "gamma": 3.683, "ours": 1.363}
"""CRF L2 of the same ablation in the IRIS paper, on its own rooms."""


def planned(folders: Sequence[Path], seeds: int, samples: int) -> list[Run]:
    """All runs but Mitsuba's: our presets, then the peers at one preset."""
    runs = []
    for folder in folders:
        for seed in range(seeds):
            runs += [Run(relative(folder), "ours", name, seed, samples=samples) for name in PRESETS]
            for name in (name for name in CONFIGURATIONS if name != "ours"):
                # The ablation of the response is about maps and curves; nothing is rendered for it.
                scored = "maps" if name in RESPONSE_ABLATION else "all"
                runs.append(Run(relative(folder), name, PEER_PRESET, seed, scored=scored, samples=samples))
    return runs


def speed_points(records: Sequence[Record], metric: str) -> list[charts.Points]:
    """One series per method, always in the same order, its points from the fastest on."""
    methods = tables.group(records, lambda row: row["configuration"])
    series = []
    for name in IN_CHARTS:
        rows = methods.get(name, [])
        by_preset: dict[str, list] = {}
        for row in rows:
            by_preset.setdefault(row["preset"], []).append(row)
        found = [(label, group) for label, group in by_preset.items() if len(tables.values(group, metric))]
        found.sort(key=lambda item: tables.mean(item[1], "seconds_total"))
        if not found:
            continue
        several = len(found) > 1
        series.append(
            charts.Points(
                name,
                [tables.mean(group, "seconds_total") for _, group in found],
                [tables.mean(group, metric) for _, group in found],
                [(float(v.min()), float(v.max())) for _, group in found for v in [tables.values(group, metric)]],
                [label for label, _ in found] if name == "ours" else (),
                line=several,
            )
        )
    return series


def write_charts(records: Sequence[Record], out: Path) -> None:
    """A chart per capture with ground truth, and the mean over captures as summary."""
    by_capture: dict[str, list[Record]] = {}
    for record in records:
        by_capture.setdefault(Path(record["run"]["capture"]).name, []).append(record)
    for name, own in by_capture.items():
        panels = {metric: points for metric in CHARTED if (points := speed_points(own, metric))}
        if panels:
            figure = charts.speed_against_accuracy(panels, title=name, caption=_caption(own))
            charts.save(figure, out / name)
    panels = {metric: points for metric in CHARTED if (points := speed_points(records, metric))}
    if panels:
        title = "Speed against accuracy, mean of " + ", ".join(by_capture)
        charts.save(charts.speed_against_accuracy(panels, title=title, caption=_caption(records)), out / "summary")


def _caption(records: Sequence[Record]) -> str:
    processors = {f"{m['processor']}, {m['cores']} cores" for r in records if (m := r.get("machine"))}
    return "measured on " + "; ".join(sorted(processors))


def write_tables(records: Sequence[Record], out: Path) -> None:
    """records.csv, a Markdown table of every capture, and the ablation of the response."""
    write_csv(out / "records.csv", records)
    text = [f"Measured on {machine.name()}. Mean ± half the span over seeds.\n"]
    for capture, rows in tables.group(records, lambda row: row["capture"]).items():
        methods: dict[str, list] = {}
        for row in rows:
            methods.setdefault(f"{row['configuration']} {row['preset']}".strip(), []).append(row)
        metrics = [metric for metric in METRICS if any(len(tables.values(g, metric)) for g in methods.values())]
        body = [
            [name, tables.cell(own, "seconds_total", 0), *(tables.cell(own, metric) for metric in metrics)]
            for name, own in methods.items()
        ]
        text += [f"### {capture}\n", tables.markdown(["method", "seconds", *metrics], body)]
    text += ["### Response\n", _ablation(records)]
    failed = [record for record in records if "error" in record]
    text += [f"- {r['run']['configuration']} on {Path(r['run']['capture']).name}: {r['error']}" for r in failed]
    (out / "tables.md").write_text("\n".join(text) + "\n", encoding="utf-8")


def _ablation(records: Sequence[Record]) -> str:
    chosen = [r for r in records if r["run"].get("preset") == PEER_PRESET]
    groups = tables.group(chosen, lambda row: row["configuration"])
    body = [
        [
            name,
            *(
                tables.cell(groups.get(name, []), metric)
                for metric in ("kd_psnr", "a_psnr", "roughness_psnr", "crf_l2")
            ),
            f"{PUBLISHED_ABLATION[name]:.3f}",
        ]
        for name in RESPONSE_ABLATION
    ]
    return tables.markdown(["response", "kd", "a'", "σ", "CRF L2", "CRF L2 in IRIS's paper (other rooms)"], body)


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--captures", type=Path, nargs="+", default=captures())
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--samples", type=int, default=32, help="per pixel of the pictures that are scored")
    parser.add_argument("--out", type=Path, default=machine.ROOT / "docs" / "bench")
    parser.add_argument("--no-mitsuba", action="store_true")
    parser.add_argument("--charts-only", action="store_true", help="only draw what was measured before")
    args = parser.parse_args(arguments)
    folder = args.out / "records"
    failed: list[Record] = []
    if not args.charts_only:
        progress = Progress(console())
        failed += [
            r for r in run_all(planned(args.captures, args.seeds, args.samples), folder, progress) if "error" in r
        ]
        for capture in [] if args.no_mitsuba else args.captures:
            failed += [r for r in snapshot_records(capture, folder, args.samples, progress) if "error" in r]
    records = [*read_records(folder), *failed]
    write_charts(records, args.out)
    write_tables(records, args.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
