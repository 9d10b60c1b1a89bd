"""Many captures in one run: ``batch JOBS.toml``, whose form is that of :mod:`headless.job_file`.

A job that fails is reported, and the others go on. The summary is written beside the results as JSON and CSV. What one
machine does here, a farm does in tasks: ``--only NAME`` runs one job or one animation of the file, ``--chunk`` some
frames of it, and ``--summary`` collects what such runs have left behind.
"""

from __future__ import annotations

import argparse
import csv
import io
import time
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from iris_addon.base.errors import MAX_QUOTED, BadInput, Cancelled, IrisError, one_line
from iris_addon.base.files import atomic_write, write_json
from iris_addon.base.progress import Progress
from iris_addon.base.untrusted import read_json
from iris_addon.results.result import Result

from .child import run_command
from .frame_folder import frames_in, require_frames_of
from .job_file import Frames, Job, read_jobs
from .outcome import Outcome, summarise
from .side_by_side import run_side_by_side

FIGURES = ("holdout_psnr", "seconds", "lights", "rays_traced", "n_patches")


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


@dataclass(frozen=True)
class Unit:
    """What one line of the summary is about: a solve, or the frames of one."""

    job: Job
    frames: Frames | None = None

    @property
    def name(self) -> str:
        """Of the job, or of its frames."""
        return self.job.name if self.frames is None else self.frames.name

    def line(self) -> Line:
        """The line before anything has run."""
        out = self.job.out if self.frames is None else self.frames.out
        return Line(self.name, self.job.config.preset if self.frames is None else self.frames.command, out=str(out))


def run_batch(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Run the jobs of ``args.jobs``, or those that ``args`` chooses; exit code 0 if all are done, else 1.

    Raises:
        BadInput: it is not a job file, or has no such job; nothing has run then.
        Cancelled: between or within jobs; the summary of what was done is written first.
        IrisError: with ``--only``, what the job fails of.
    """
    jobs = read_jobs(args.jobs, args.path_mapping)
    units = [Unit(job, frames) for job in jobs for frames in (None, *job.frames)]
    folder = args.jobs.with_suffix("")
    if args.only is not None:
        return _run_only(_chosen(units, args), args, folder, progress)
    lines = [unit.line() for unit in units]
    try:
        if args.summary:
            lines = [_left_behind(unit, folder) for unit in units]
        elif args.parallel > 1:
            for unit in units:
                _line_file(unit, folder).unlink(missing_ok=True)  # of an earlier run
            try:
                run_side_by_side(args, [[u.name for u in units if u.job is job] for job in jobs], progress)
            finally:
                lines = [_left_behind(unit, folder) for unit in units]
        else:
            for unit, line in zip(units, lines, strict=True):
                with progress.stage(unit.name):
                    _run_unit(unit, line, lines, args, progress)
    finally:
        _write_summary(lines, folder)
    failed = sum(line.status != "done" for line in lines)
    text = "\n".join([_table(lines), f"summary: {folder / 'summary.json'}, {folder / 'summary.csv'}"])
    data = {"jobs": [asdict(line) for line in lines], "failed": failed, "summary": folder / "summary.json"}
    return Outcome(text, data, 1 if failed else 0)


def _chosen(units: Sequence[Unit], args: argparse.Namespace) -> Unit:
    unit = next((unit for unit in units if unit.name == args.only), None)
    if unit is None:
        names = ", ".join(unit.name for unit in units[:8])
        raise BadInput(f"has no job {args.only!r}", f"its jobs are {names}", args.jobs)
    if args.chunk is not None and (unit.frames is None or args.chunk >= unit.frames.chunks):
        has = "no frames" if unit.frames is None else f"{unit.frames.chunks} chunks"
        raise BadInput(f"{unit.name!r} has {has}", "leave out --chunk, or count the chunks from 0", args.jobs)
    return unit


def _run_only(unit: Unit, args: argparse.Namespace, folder: Path, progress: Progress) -> Outcome:
    """Run one job, or a chunk of its frames, as one task of many."""
    line = unit.line()
    try:
        with progress.stage(unit.name):
            _work(unit, line, args, progress)
    finally:
        if args.chunk is None and not args.first_frame:
            write_json(_line_file(unit, folder), asdict(line))
    return Outcome.of(unit.name, {"out": line.out, **line.figures})


def _run_unit(unit: Unit, line: Line, lines: Sequence[Line], args: argparse.Namespace, progress: Progress) -> None:
    """Run ``unit`` as one of many: a failure is written down, and the others go on."""
    solved = next(other for other in lines if other.name == unit.job.name)
    if unit.frames is not None and solved.status != "done":
        line.status, line.error = "failed", f"{unit.job.name} was not solved"
        return
    try:
        _work(unit, line, args, progress)
    except Cancelled:
        raise
    except IrisError as error:
        line.status, line.error = "failed", str(error)
    except Exception as error:  # the other jobs go on, whatever it is
        line.status, line.error = "failed", one_line(f"{type(error).__name__}: {error}", MAX_QUOTED)
        _write_traceback(unit.job.out / "traceback.txt", line)


def _work(unit: Unit, line: Line, args: argparse.Namespace, progress: Progress) -> None:
    """Do the work of ``unit`` and fill in its line."""
    begin = time.monotonic()
    # A separate progress keeps the stages of the jobs apart; cancelling the outer one stops it.
    inner = Progress(lambda event: progress.update(event.overall))
    try:
        if unit.frames is not None:
            line.figures = dict(_render(unit, unit.frames, args, inner))
        else:
            result = solve_job(unit.job, inner, resume=args.resume)
            line.figures = summarise(result)
            if unit.job.evaluate:
                from iris_addon.evaluate.evaluation import evaluate

                scores = evaluate(result, unit.job.capture, progress=inner)
                line.metrics = {name: value for name, value in scores.items() if isinstance(value, float)}
        line.status = "done"
    except IrisError as error:
        if not isinstance(error, Cancelled):
            line.status, line.error = "failed", str(error)
        raise
    finally:
        line.wall_seconds = round(time.monotonic() - begin, 2)


def solve_job(job: Job, progress: Progress, *, resume: bool = False) -> Result:
    """Read the capture of ``job`` and solve it."""
    from iris_addon.capture.reader import read_capture
    from iris_addon.pipeline import solve

    capture = read_capture(
        job.capture,
        exposures=job.config.exposures,
        hdr=job.config.hdr,
        exclude=job.exclude,
        metres_per_unit=job.unit,
        check=progress.check,
    )
    return solve(capture, job.config, job.out, progress, resume=resume)


def _render(unit: Unit, frames: Frames, args: argparse.Namespace, progress: Progress) -> Mapping[str, Any]:
    """Render ``frames``, the chunk that ``args`` names or all of them, in a process that Blender may take down."""
    first, last = frames.first, frames.last
    if args.first_frame:
        last = first
    elif args.chunk is not None:
        first, last = frames.frames_of(args.chunk)
    words = [frames.command, str(unit.job.out)]
    if frames.scene is not None:
        require_frames_of(frames.out, frames.scene)
        words = [frames.command, str(frames.scene), "--result", str(unit.job.out), "--resume"]
    words += ["--out", str(frames.out), "--frames", f"{first}-{last}"]
    length = [] if frames.command in ("onto-plate", "composite") else ["--length", str(frames.last)]
    return run_command([*words, *length, *frames.options], progress)


def _write_traceback(path: Path, line: Line) -> None:
    """Write the current traceback to ``path``; if that fails, the summary says so."""
    text = traceback.format_exc()
    try:
        atomic_write(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    except IrisError as unwritten:
        line.error += f"; {unwritten}"


# ---- the summary ---------------------------------------------------------------------------------------------------


def _line_file(unit: Unit, folder: Path) -> Path:
    return folder / "lines" / f"{unit.name.replace('/', '.')}.json"


def _left_behind(unit: Unit, folder: Path) -> Line:
    """The line that a run of ``unit`` alone has written; of frames that ran in chunks, how many there are."""
    line, path = unit.line(), _line_file(unit, folder)
    if path.is_file():
        return _read_line(path, line)
    if unit.frames is not None:
        wanted = range(unit.frames.first, unit.frames.last + 1)
        there = len(frames_in(unit.frames.out, wanted))
        line.figures = {"frames": there}
        line.status = "done" if there == len(wanted) else "failed"
        line.error = "" if there == len(wanted) else f"{len(wanted) - there} of {len(wanted)} frames are missing"
    else:
        line.status, line.error = "failed", "has not run"
    return line


def _read_line(path: Path, line: Line) -> Line:
    """``line`` with what the file ``path`` says; raises BadInput where that is no line."""
    content = read_json(path)
    for name in (f.name for f in fields(Line)):
        value, own = content.get(name, getattr(line, name)), getattr(line, name)
        if type(value) is not type(own) and not (isinstance(own, float) and isinstance(value, int)):
            raise BadInput(f"'{name}' is not what a run of a job writes", "delete it, and run the job again", path)
        setattr(line, name, one_line(value, MAX_QUOTED) if isinstance(value, str) else value)
    if not all(isinstance(value, int | float) for value in line.metrics.values()):
        raise BadInput("'metrics' are not numbers", "delete it, and run the job again", path)
    return line


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
    return "–" if value is None else f"{value:.4g}" if isinstance(value, float) else one_line(str(value), MAX_QUOTED)
