"""Speed against accuracy as charts and tables: one chart per capture and the mean over captures; all metrics, the
response ablation, the speed-up over Mitsuba.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from . import charts, tables
from .records import Record, machine_of

CHARTED = ("kd_psnr", "relight_psnr")
IN_CHARTS = ("ours", "mitsuba-prb", "iris-like", "fipt-ldr-like", "fipt-hdr-like", "single-bounce")
COLUMNS = {
    "kd_psnr": "kd", "kd_psnr_all": "kd all", "kd_psnr_all_8x8": "kd all 8×8", "a_psnr": "a'", "roughness_psnr": "σ",
    "emission_iou": "IoU", "emission_log_l2": "log L2", "crf_l2": "CRF L2", "nvs_psnr": "NVS",
    "relight_psnr": "relight", "insert_psnr": "insert",
}  # fmt: skip
ABLATION = {"constant-exposure": 4.074, "mean-response": 4.240, "gamma": 3.683, "ours": 1.363}
"""CRF L2 of the same ablation in the IRIS paper, on its own rooms."""
README_ROWS = (
    ("seconds_total", "solve time, s", "lower", 0),
    ("rays_traced", "rays traced, 10⁶", "lower", 0),
    ("peak_memory_bytes", "peak memory, GB", "lower", 1),
    ("kd_psnr", "`kd_psnr`, dB", "higher", 1),
    ("kd_psnr_8x8", "`kd_psnr_8x8`, dB", "higher", 1),
    ("kd_psnr_all", "`kd_psnr_all`, dB", "higher", 1),
    ("a_psnr", "`a_psnr`, dB", "higher", 1),
    ("a_lobe_psnr", "`a_lobe_psnr`, dB", "higher", 1),
    ("roughness_psnr", "`roughness_psnr`, dB", "higher", 1),
    ("metallic_l2", "`metallic_l2`", "lower", 4),
    ("emission_iou", "`emission_iou`", "higher", 2),
    ("emission_log_l2", "`emission_log_l2`", "lower", 4),
    ("crf_l2", "`crf_l2`", "lower", 2),
    ("nvs_psnr", "`nvs_psnr`, dB", "higher", 1),
    ("relight_psnr", "`relight_psnr`, dB", "higher", 1),
    ("insert_psnr", "`insert_psnr`, dB", "higher", 1),
)
UNITS = {"rays_traced": 1e6, "peak_memory_bytes": 1e9}
Rows = Sequence[Mapping[str, Any]]


def describe(records: Sequence[Record], images: Path) -> str:
    """Charts into ``images``, tables as Markdown."""
    names = draw(records, images)
    pictures = [f"![Speed against accuracy, {name}](images/benchmarks/{name}.png)\n" for name in names]
    return "\n".join([*pictures, all_tables(records)])


# ---- charts ----------------------------------------------------------------------------------------------------------


def draw(records: Sequence[Record], out: Path) -> list[str]:
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
    return charts.Points(
        name=name,
        seconds=seconds,
        value=value,
        spread=spread,
        labels=labels,
        line=len(found) > 1,
        style=IN_CHARTS.index(name),
    )


# ---- tables ----------------------------------------------------------------------------------------------------------


def balanced_table(records: Sequence[Record]) -> str:
    """The README's table: `balanced` on every capture, means over seeds."""
    chosen = [r for r in records if (r["run"]["configuration"], r["run"]["preset"]) == ("ours", "balanced")]
    captures = dict(sorted(tables.group(chosen, lambda row: row["capture"]).items()))
    body = [
        [label, better, *(_readme_cell(rows, metric, digits) for rows in captures.values())]
        for metric, label, better, digits in README_ROWS
    ]
    return f"{tables.markdown(['', 'better', *captures], body)}\n{machine_of(records)} Means over seeds.\n"


def _readme_cell(rows: Rows, metric: str, digits: int) -> str:
    value = tables.mean(rows, metric) / UNITS.get(metric, 1.0)
    return tables.number(value, digits).replace("–", "n/a")


def all_tables(records: Sequence[Record]) -> str:
    """All tables."""
    text = [f"{machine_of(records)} Mean ± half the span over seeds where there is more than one.\n"]
    for capture, rows in sorted(tables.group(records, lambda row: row["capture"]).items()):
        text += [f"#### {capture}\n", _all_metrics(rows)]
    text += ["#### The response: what each simplification costs\n", _ablation(records)]
    text += ["#### Against Mitsuba\n", *_speed_up(records)]
    failed = [record for record in records if "error" in record]
    text += [f"- {r['run']['configuration']} on {Path(r['run']['capture']).name}: {r['error']}" for r in failed]
    return "\n".join(text) + "\n"


def _all_metrics(rows: Rows) -> str:
    methods: dict[str, list] = {}
    for row in sorted(rows, key=lambda row: (row["configuration"] != "ours", row["configuration"])):
        methods.setdefault(f"{row['configuration']} {row['preset']}", []).append(row)
    ordered = sorted(methods.items(), key=lambda item: (item[1][0]["configuration"] != "ours",
                     item[1][0]["configuration"], tables.mean(item[1], "seconds_total")))  # fmt: skip
    found = [metric for metric in COLUMNS if any(len(tables.values(own, metric)) for own in methods.values())]
    body = [
        [
            name,
            tables.cell(own, "seconds_total", 0),
            *(tables.cell(own, m, 4 if m == "emission_log_l2" else 2) for m in found),
        ]
        for name, own in ordered
    ]
    return tables.markdown(["method", "seconds", *(COLUMNS[metric] for metric in found)], body)


def _ablation(records: Sequence[Record]) -> str:
    ablated = tables.group(records, lambda row: row["configuration"])
    preset = next((rows[0]["preset"] for name, rows in ablated.items() if name in ABLATION and name != "ours"), "draft")
    captures = {row["capture"] for name in ABLATION if name != "ours" for row in ablated.get(name, [])}
    body = []
    for name, published in ABLATION.items():
        rows = [r for r in ablated.get(name, []) if r["preset"] == preset and r["capture"] in captures]
        values = [tables.mean_over_captures(rows, m) for m in ("kd_psnr", "a_psnr", "roughness_psnr", "crf_l2")]
        body.append([name, *(tables.number(value) for value in values), f"{published:.3f}"])
    return tables.markdown(["response", "kd", "a'", "σ", "CRF L2", "CRF L2 in IRIS's paper (other rooms)"], body)


def _speed_up(records: Sequence[Record]) -> list[str]:
    """Per capture and preset: when Mitsuba gets as far, if it does."""
    lines = []
    for capture, rows in tables.group(records, lambda row: row["capture"]).items():
        peer = [
            (row["seconds_total"], row["relight_psnr"])
            for row in rows
            if row["configuration"] == "mitsuba-prb" and isinstance(row.get("relight_psnr"), float)
        ]
        if not peer:
            continue
        best, last = max(value for _, value in peer), max(seconds for seconds, _ in peer)
        for preset in ("draft", "balanced"):
            own = [row for row in rows if (row["configuration"], row["preset"]) == ("ours", preset)]
            if not len(tables.values(own, "relight_psnr")):
                continue
            seconds, value = tables.mean(own, "seconds_total"), tables.mean(own, "relight_psnr")
            reached = [t for t, v in peer if v >= value]
            end = (
                f"Mitsuba needs {min(reached):.0f} s for as much, {min(reached) / seconds:.1f} times as long"
                if reached
                else f"Mitsuba's best in {last:.0f} s is {best:.2f} dB, so the speed-up is over {last / seconds:.0f}"
            )
            lines.append(f"- {capture}, `{preset}`: relight {value:.2f} dB after {seconds:.0f} s; {end}.")
    return [*lines, ""]
