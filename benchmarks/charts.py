"""Charts as PNG and SVG, legible at the width of a README and without telling colours apart.

Colours are those of Okabe and Ito (2008); every series also has a marker of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

OKABE_ITO = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#F0E442")
MARKERS = ("o", "s", "^", "D", "v", "<", "X", "*")
GREY = "#595959"
STYLE: dict[Any, Any] = {
    "font.size": 12,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#d9d9d9",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "iris",  # the same chart gives the same file
}


@dataclass(frozen=True)
class Points:
    """One method: where it stands after how long.

    Attributes:
        seconds, value: mean over seeds, (n,); connected in this order if ``line``.
        spread: (n, 2) least and largest value over seeds.
        labels: text beside each point.
        style: which colour and marker, so that a method looks the same in every chart.
    """

    name: str
    seconds: Sequence[float]
    value: Sequence[float]
    spread: Sequence[tuple[float, float]] = ()
    labels: Sequence[str] = ()
    line: bool = False
    style: int = 0


@dataclass(frozen=True)
class Published:
    """A published figure: of other rooms and another machine, hence a mark and not a point.

    Attributes:
        name: with what makes its protocol another one, where the figure would mislead without.
        seconds: None where no time was published.
    """

    name: str
    seconds: float | None
    value: float
    machine: str


# IRIS, FIPT, NeILF: mean of the four FIPT rooms. The others have rooms and protocols of their own; docs/benchmarks.md
# has sources and caveats.
PUBLISHED = {
    "kd_psnr": (
        Published("IRIS", 57 * 60, 22.33, "RTX 4090"),
        Published("FIPT, HDR input", 50 * 60, 29.95, "RTX 4090"),
        Published("FIPT-LDR*", 50 * 60, 15.49, "RTX 4090"),
        Published("NeILF", 298 * 60, 16.85, "RTX 4090"),
        Published("IIF, learned prior", 60 * 60, 20.72, "RTX A6000"),
    ),
    "relight_psnr": (
        Published("IRIS", 57 * 60, 22.86, "RTX 4090"),
        Published("FIPT, HDR input", 50 * 60, 29.01, "RTX 4090"),
        Published("FIPT-LDR*", 50 * 60, 11.63, "RTX 4090"),
        Published("EAG-PT, Gaussians", 50 * 60, 29.0, "RTX 4090"),
        Published("LuxRemix, each picture rescaled", None, 30.76, ""),
    ),
}
SAME_LINE = 0.5
"""Decibels below which two published figures would have their names at one place; the later one is named below."""
AXIS_NAMES = {
    "kd_psnr": "diffuse albedo, PSNR in dB",
    "kd_psnr_all_valid": "diffuse albedo, PSNR in dB",
    "relight_psnr": "relit room, PSNR in dB",
    "emission_log_l2": "emission, log L2 error",
    "crf_l2": "response, L2 error",
}


TIMES = {10: "10 s", 30: "30 s", 60: "1 min", 180: "3 min", 600: "10 min", 1800: "30 min", 7200: "2 h", 18000: "5 h"}


def pareto_front(seconds: Sequence[float], value: Sequence[float]) -> list[int]:
    """Indices of the points that no other point beats in both time and value, fastest first."""
    best, front = -np.inf, []
    for index in np.lexsort((-np.asarray(value), np.asarray(seconds))):
        if np.isfinite(value[index]) and value[index] > best:
            best = value[index]
            front.append(int(index))
    return front


def speed_against_accuracy(panels: Mapping[str, Sequence[Points]], *, title: str, caption: str) -> Figure:
    """One panel per metric: seconds on a log axis against the metric, the Pareto front over all that was measured."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4 * len(panels), 5.4), layout="constrained")
        first: Axes | None = None
        for column, (metric, methods) in enumerate(panels.items()):
            axes = figure.add_subplot(1, len(panels), column + 1, sharex=first)
            first = first or axes
            _speed_panel(axes, metric, methods)
        handles, labels = figure.axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=min(4, len(labels)), fontsize=11)
        figure.suptitle(f"{title}\n", fontsize=14)
        figure.text(0.5, 0.945, caption, ha="center", va="top", fontsize=11, color=GREY)
    return figure


def _speed_panel(axes: Axes, metric: str, methods: Sequence[Points]) -> None:
    everything = [(t, v) for method in methods for t, v in zip(method.seconds, method.value, strict=True)]
    for method in methods:
        color, marker = OKABE_ITO[method.style % 8], MARKERS[method.style % 8]
        axes.plot(
            method.seconds,
            method.value,
            marker=marker,
            markersize=9,
            color=color,
            linestyle="-" if method.line else "none",
            markeredgecolor="white",
            label=method.name,
            zorder=3,
        )
        for t, (low, high) in zip(method.seconds, method.spread, strict=False):
            axes.plot([t, t], [low, high], color=color, linewidth=2, zorder=2)
        for number, (t, v, text) in enumerate(zip(method.seconds, method.value, method.labels, strict=False)):
            # The first below its point: other methods, nearly as good and as fast, stand above it and to the left.
            # The last beside it, since a step of quality may cost a factor of two, half the width of its name.
            last = 0 < number == len(method.labels) - 1
            shift, side = ((9, -4), "left") if last else ((0, 8 if number else -17), "center")
            axes.annotate(text, (t, v), xytext=shift, textcoords="offset points", ha=side, fontsize=10)
    if everything:
        seconds, value = (list(column) for column in zip(*everything, strict=True))
        front = pareto_front(seconds, value)
        axes.step(
            [seconds[k] for k in front],
            [value[k] for k in front],
            where="post",
            color=GREY,
            linewidth=1.2,
            linestyle=":",
            label="Pareto front",
            zorder=1,
        )
    axes.set_xscale("log")
    axes.set_xticks(list(TIMES), list(TIMES.values()))
    axes.minorticks_off()
    axes.set_xlabel("time of the whole solve")
    _published(axes, PUBLISHED.get(metric, ()))
    axes.set_ylabel(AXIS_NAMES.get(metric, metric))


def _published(axes: Axes, figures: Sequence[Published]) -> None:
    """Published figures as dashed lines with a tick at the time they took."""
    machines = ", ".join(sorted({figure.machine for figure in figures if figure.machine}))
    for number, figure in enumerate(figures):
        label = f"published: {machines}, other rooms" if number == 0 else None
        axes.axhline(figure.value, color=GREY, linewidth=0.9, linestyle=(0, (5, 4)), zorder=0, label=label)
        if figure.seconds is not None:
            axes.plot([figure.seconds], [figure.value], marker="|", color=GREY, markersize=12)
        taken = any(abs(figure.value - other.value) < SAME_LINE for other in figures[:number])
        axes.annotate(
            f"{figure.name}, {'no time' if figure.seconds is None else f'{figure.seconds / 60:.0f} min'}",
            (0.995, figure.value),
            xycoords=("axes fraction", "data"),
            xytext=(0, -12 if taken else 3),
            textcoords="offset points",
            ha="right",
            fontsize=9,
            color=GREY,
        )


# ---- sweeps --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sweep:
    """One method along one axis.

    Attributes:
        values: (levels, seeds) of a metric, NaN where a run failed.
        failure: index of the first level that counts as failed, or None.
    """

    name: str
    values: np.ndarray
    failure: int | None


def stability(panels: Mapping[str, Sequence[Sweep]], ticks: Sequence[str], *, title: str, x_label: str) -> Figure:
    """One panel per metric: mean over seeds with the span of the seeds shaded, the failure point circled."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4.4 * len(panels), 4.2), layout="constrained")
        for column, (metric, sweeps) in enumerate(panels.items()):
            axes = figure.add_subplot(1, len(panels), column + 1)
            for index, sweep in enumerate(sweeps):
                _sweep(axes, sweep, OKABE_ITO[index], MARKERS[index])
            axes.set_xticks(range(len(ticks)), ticks)
            axes.set_xlabel(x_label)
            axes.set_ylabel(AXIS_NAMES.get(metric, metric))
        handles, labels = figure.axes[0].get_legend_handles_labels()
        handles.append(Line2D([], [], marker="o", markersize=13, color=GREY, fillstyle="none", linestyle="none"))
        handles.append(Patch(color=GREY, alpha=0.3, linewidth=0))
        labels += ["failure point", "span of seeds"]
        figure.legend(handles, labels, loc="outside lower center", ncols=4)
        figure.suptitle(title, fontsize=13)
    return figure


def _sweep(axes: Axes, sweep: Sweep, color: str, marker: str) -> None:
    levels = np.flatnonzero(np.isfinite(sweep.values).any(1))
    mean, low, high = (f(sweep.values[levels], axis=1) for f in (np.nanmean, np.nanmin, np.nanmax))
    axes.fill_between(levels, low, high, color=color, alpha=0.2, linewidth=0)
    axes.plot(levels, mean, color=color, marker=marker, label=sweep.name)
    if sweep.failure is not None and sweep.failure in levels:
        at = int(np.flatnonzero(levels == sweep.failure)[0])
        axes.plot(
            [sweep.failure], [mean[at]], marker="o", markersize=18, color=color, fillstyle="none", markeredgewidth=1.8
        )


def scaling(panels: Mapping[str, Mapping[str, tuple[Sequence[float], Sequence[float]]]], *, title: str) -> Figure:
    """One panel per quantity: cost against size on log axes, one line per sweep, its slope in the legend."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4.8 * len(panels), 5.0), layout="constrained")
        for column, (quantity, lines) in enumerate(panels.items()):
            axes = figure.add_subplot(1, len(panels), column + 1)
            for index, (name, (x, y)) in enumerate(lines.items()):
                axes.plot(x, y, color=OKABE_ITO[index % 8], marker=MARKERS[index % 8], label=name)
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.set_xlabel("size: triangles, photos or pixels")
            axes.set_ylabel(quantity)
            axes.legend(fontsize=9, loc="upper center", bbox_to_anchor=(0.5, -0.16))
        figure.suptitle(title, fontsize=13)
    return figure


def responses(panels: Mapping[str, Mapping[str, tuple[Sequence[int], Sequence[float]]]], *, title: str) -> Figure:
    """One panel per metric over the ranks of curves by their distance from the mean of all."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4 * len(panels), 4.6), layout="constrained")
        for column, (metric, lines) in enumerate(panels.items()):
            axes = figure.add_subplot(1, len(panels), column + 1)
            for index, (name, (ranks, value)) in enumerate(lines.items()):
                axes.plot(ranks, value, color=OKABE_ITO[index], marker=MARKERS[index], label=name)
            axes.set_xlabel("curve, by its distance from the mean of all")
            axes.set_ylabel(AXIS_NAMES.get(metric, metric))
        figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
        figure.suptitle(title, fontsize=13)
    return figure


def save(figure: Figure, stem: Path, svg: bool = True) -> None:
    """Write ``stem``.png, 1280 pixels wide or more, and ``stem``.svg."""
    stem.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(stem.with_suffix(".png"), dpi=110, metadata={"Software": None})
    if svg:
        with mpl.rc_context(STYLE):
            figure.savefig(stem.with_suffix(".svg"), metadata={"Date": None})
