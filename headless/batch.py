"""Many captures and presets in one run: ``batch JOBS.toml``.

::

    [[job]]
    capture = "rooms/kitchen"       # relative to this file; the only key a job must have
    name = "kitchen draft"          # default: the capture's folder name
    preset = "draft"
    out = "results/kitchen-draft"   # default: a folder beside this file, named after it, and the job's name in it
    exposures = "none"              # as the options of solve: also response, hdr, device, seed
    evaluate = true                 # score maps, light and camera against the capture's ground truth

A job that fails is reported, and the others go on. The summary is written beside the results as JSON and CSV.
"""

from __future__ import annotations

import csv
import io
import time
import traceback
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from iris_addon.base.errors import MAX_QUOTED, BadInput, Cancelled, IrisError, one_line
from iris_addon.base.files import atomic_write, write_json
from iris_addon.base.progress import Progress
from iris_addon.base.untrusted import read_toml
from iris_addon.config import MAX_SEED, PRESETS, SolveConfig, preset
from iris_addon.results.result import Result

from .outcome import Outcome, summarise

MAX_JOBS_BYTES = 16 << 20
OPTIONS = ("response", "exposures", "hdr", "device", "seed")
KEYS = ("name", "capture", "preset", "out", "evaluate", *OPTIONS)
WORDS = {"response": ("auto", "gamma"), "exposures": ("auto", "none")}
FIGURES = ("holdout_psnr", "seconds", "lights", "rays_traced", "n_patches")


@dataclass(frozen=True)
class Job:
    """One job of the file."""

    name: str
    capture: Path
    out: Path
    config: SolveConfig
    evaluate: bool = False


@dataclass
class Line:
    """One line of the summary. ``status`` is done, failed or cancelled."""

    name: str
    preset: str
    status: str = "cancelled"
    wall_seconds: float = 0.0
    figures: dict[str, Any] = field(default_factory=dict)
    metrics: dict[str, float] = field(default_factory=dict)
    out: str = ""
    error: str = ""

    def flat(self) -> dict[str, Any]:
        """All values in one mapping, for the table and the CSV."""
        own = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("figures", "metrics")}
        ends = {"out": own.pop("out"), "error": own.pop("error")}
        return {**own, **{name: self.figures.get(name) for name in FIGURES}, **self.metrics, **ends}


def run_batch(path: Path, progress: Progress) -> Outcome:
    """Run every job of ``path``; exit code 0 if all are done, else 1.

    Raises:
        BadInput: ``path`` is not a job file; nothing has run then.
        Cancelled: between or within jobs; the summary of what was done is written first.
    """
    jobs = read_jobs(path)
    lines = [Line(job.name, job.config.preset, out=str(job.out)) for job in jobs]
    folder = path.with_suffix("")
    try:
        for job, line in zip(jobs, lines, strict=True):
            with progress.stage(job.name):
                _run(job, line, progress)
    finally:
        _write_summary(lines, folder)
    failed = sum(line.status != "done" for line in lines)
    text = "\n".join([_table(lines), f"summary: {folder / 'summary.json'}, {folder / 'summary.csv'}"])
    data = {"jobs": [asdict(line) for line in lines], "failed": failed, "summary": folder / "summary.json"}
    return Outcome(text, data, 1 if failed else 0)


def _run(job: Job, line: Line, progress: Progress) -> None:
    begin = time.monotonic()
    # A separate progress keeps the stages of the jobs apart; cancelling the outer one stops it.
    inner = Progress(lambda event: progress.update(event.overall))
    try:
        result = solve_job(job, inner)
        line.figures = summarise(result)
        if job.evaluate:
            from iris_addon.evaluate.evaluation import evaluate

            scores = evaluate(result, job.capture, progress=inner)
            line.metrics = {name: value for name, value in scores.items() if isinstance(value, float)}
        line.status = "done"
    except Cancelled:
        raise
    except IrisError as error:
        line.status, line.error = "failed", str(error)
    except Exception as error:  # the other jobs go on, whatever it is
        line.status, line.error = "failed", one_line(f"{type(error).__name__}: {error}", MAX_QUOTED)
        _write_traceback(job.out / "traceback.txt", line)
    finally:
        line.wall_seconds = round(time.monotonic() - begin, 2)


def _write_traceback(path: Path, line: Line) -> None:
    """Write the current traceback to ``path``; if that fails, the summary says so."""
    text = traceback.format_exc()
    try:
        atomic_write(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    except IrisError as unwritten:
        line.error += f"; {unwritten}"


def solve_job(job: Job, progress: Progress) -> Result:
    """Read the capture of ``job`` and solve it."""
    from iris_addon.capture.reader import read_capture
    from iris_addon.pipeline import solve

    capture = read_capture(job.capture, exposures=job.config.exposures, hdr=job.config.hdr, check=progress.check)
    return solve(capture, job.config, job.out, progress)


# ---- the job file --------------------------------------------------------------------------------------------------


def read_jobs(path: Path) -> list[Job]:
    """The jobs of a TOML file; raises BadInput for everything that can be checked before the first one runs."""
    content = read_toml(path, MAX_JOBS_BYTES)
    entries = content.get("job")
    if not isinstance(entries, list) or not entries or set(content) != {"job"}:
        raise BadInput("has no [[job]], or something else beside them", "write one [[job]] table per job", path)
    jobs = [_job(entry, number, path) for number, entry in enumerate(entries)]
    for what in ("name", "out"):
        values = [getattr(job, what) for job in jobs]
        repeated = next((value for value in values if values.count(value) > 1), None)
        if repeated is not None:
            raise BadInput(f"two jobs have the {what} {repeated}", f"give each job its own {what}", path)
    return jobs


def _job(entry: Any, number: int, path: Path) -> Job:
    where = f"job {number + 1}"
    if not isinstance(entry, dict) or not isinstance(entry.get("capture"), str):
        raise BadInput(f"{where} has no capture", 'add capture = "FOLDER"', path)
    unknown = [key for key in entry if key not in KEYS]
    if unknown:
        raise BadInput(f"{where} has an unknown key {unknown[0]!r}", f"keys are {', '.join(KEYS)}", path)
    for key, value in entry.items():
        kind = {"seed": int, "evaluate": bool}.get(key, str)
        if type(value) is not kind:
            raise BadInput(f"{where}: {key} is {value!r}", f"give a {kind.__name__}", path)
        if kind is str and not value.isprintable():
            raise BadInput(f"{where}: {key} has control characters", "leave them out", path)
    if not 0 <= entry.get("seed", 0) <= MAX_SEED:
        raise BadInput(f"{where}: seed is {entry['seed']}", f"give a number from 0 to {MAX_SEED}", path)
    if entry.get("preset", "balanced") not in PRESETS:
        raise BadInput(f"{where}: preset is {entry['preset']!r}", f"presets are {', '.join(PRESETS)}", path)
    if entry.get("device", "auto") not in ("auto", "cpu", "cuda"):
        raise BadInput(f"{where}: device is {entry['device']!r}", "devices are auto, cpu, cuda", path)
    options = {key: entry[key] for key in OPTIONS if key in entry}
    for key in ("response", "exposures", "hdr"):
        if key in options and options[key] not in WORDS.get(key, ()):
            options[key] = path.parent / options[key]
    capture = path.parent / entry["capture"]
    name = entry.get("name", capture.stem if capture.suffix else capture.name)
    if not name or name != Path(name).name or name.startswith("."):
        raise BadInput(f"{where}: name is {name!r}", "give a name that can be a folder's", path)
    out = path.parent / entry["out"] if "out" in entry else path.with_suffix("") / name
    config = preset(entry.get("preset", "balanced"), **options)
    return Job(name=name, capture=capture, out=out, config=config, evaluate=entry.get("evaluate", False))


# ---- the summary ---------------------------------------------------------------------------------------------------


def _columns(lines: Sequence[Line]) -> list[str]:
    return list(dict.fromkeys(key for line in lines for key in line.flat() if key not in ("out", "error"))) + [
        "out",
        "error",
    ]


def _write_summary(lines: Sequence[Line], folder: Path) -> None:
    write_json(folder / "summary.json", {"jobs": [asdict(line) for line in lines]})
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, _columns(lines))
    writer.writeheader()
    writer.writerows(line.flat() for line in lines)
    atomic_write(folder / "summary.csv", lambda temporary: temporary.write_text(text.getvalue(), encoding="utf-8"))


TABLE_METRICS = ("kd_psnr", "kd_psnr_all", "emission_iou", "emission_log_l2", "crf_l2")


def _table(lines: Sequence[Line]) -> str:
    """The summary for a terminal: the main figures, and below them the reasons of failures."""
    shown = ("name", "preset", "status", "wall_seconds", *FIGURES, *TABLE_METRICS)
    keys = [key for key in shown if any(line.flat().get(key) not in (None, "") for line in lines)]
    cells = [keys] + [[_cell(line.flat().get(key)) for key in keys] for line in lines]
    widths = [max(len(row[k]) for row in cells) for k in range(len(keys))]
    table = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in cells]
    return "\n".join(table + [f"{line.name}: {line.error}" for line in lines if line.error])


def _cell(value: Any) -> str:
    return "–" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
