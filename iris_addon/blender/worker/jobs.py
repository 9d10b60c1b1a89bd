"""Jobs that run outside Blender, identified by the folder they write into: their state and their command lines.

A job outlives undo, the scene and the open file, and so belongs to none of them. A scene remembers only the folder;
from that and from the processes of this Blender follows the state of a job. Does not use bpy.

``job-NAME.json`` in the folder is written when a job starts and when it ends. A record that says "running" although
nothing runs comes from a Blender that was killed.
"""

from __future__ import annotations

import sys
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Literal, get_args

from ...base.errors import BadInput, Cancelled, IrisError, one_line
from ...base.files import write_json
from ...base.untrusted import read_json
from .process import ADDON, Worker

JobName = Literal["inspect", "solve", "composite", "plate", "probe", "meter", "looks", "farm", "environment", "test"]
MAX_RECORD_BYTES = 1 << 20
State = Literal["missing", "running", "done", "failed", "cancelled", "interrupted"]


@dataclass(frozen=True)
class Record:
    """The state of a job; ``what`` is wrong and its ``fix`` where it failed; where it is done, ``what`` it found or the
    folder it wrote, and as ``fix`` what to look at."""

    state: State
    what: str = ""
    fix: str = ""


MISSING = Record("missing")
INTERRUPTED = Record("interrupted", "Blender ended while this ran", "start it again: finished stages are kept")
CANCELLED = Record("cancelled")


OnEnd = Callable[[Record], Iterable[object] | None]


@dataclass
class Job:
    """A process that writes into ``folder``; ``began`` is when, on the monotonic clock.

    ``on_end`` is called once, on the thread that polls. What it returns is gone through there too, an item per poll,
    and until its end the job runs. If it raises IrisError, the job has failed.

    Attributes:
        ending: what is left of the end of a job whose process has ended.
    """

    name: JobName
    folder: Path
    worker: Worker
    on_end: OnEnd
    began: float = field(default_factory=time.monotonic)
    ending: Generator[object, None, None] | None = None


_running: dict[tuple[JobName, Path], Job] = {}
_ended: dict[tuple[JobName, Path], Record] = {}
"""Jobs that ended in this process, in case a full disk prevents writing their records."""


def start(name: JobName, folder: Path, command: list[str], on_end: OnEnd) -> Job:
    """Start ``command`` as the job ``name`` of ``folder``.

    Raises:
        IrisError: it runs already, the folder cannot be written, or the program cannot be started.
    """
    key = (name, folder)
    if key in _running:
        raise IrisError(f"{folder}: this runs already", "wait for it or cancel it")
    worker = Worker(command, folder / f"{name}.log")
    try:
        _write(name, folder, Record("running"))
    except IrisError:
        worker.close()
        raise
    _running[key] = job = Job(name, folder, worker, on_end)
    return job


def running(name: JobName, folder: Path) -> Job | None:
    """The job ``name`` of ``folder`` if it runs in this Blender."""
    return _running.get((name, folder))


def all_running() -> Iterator[Job]:
    """Everything that runs."""
    yield from list(_running.values())


def record(name: JobName, folder: Path) -> Record:
    """The state of the job ``name`` of ``folder``."""
    if (name, folder) in _running:
        return Record("running")
    if (name, folder) in _ended and folder.is_dir():
        return _ended[name, folder]
    try:
        content = read_json(_path(name, folder), MAX_RECORD_BYTES)
    except BadInput:  # missing, or not written by this module
        return MISSING
    state = next((state for state in get_args(State) if content.get("state") == state), None)
    if state is None:
        return MISSING
    found = Record(state, one_line(str(content.get("what", ""))), one_line(str(content.get("fix", ""))))
    return INTERRUPTED if found.state == "running" else found


def ended_here(name: JobName, folder: Path) -> Record:
    """How the job ``name`` of ``folder`` ended in this Blender: a record on disk may be a stranger's, and so is no
    source of paths to open."""
    return _ended.get((name, folder), MISSING)


def poll() -> bool:
    """Read the messages of all jobs and finish those that have ended; call it on the main thread.

    Returns:
        Whether anything changed.
    """
    changed = False
    for key, job in list(_running.items()):
        if job.ending is None:
            changed |= job.worker.poll()
            if job.worker.running:
                continue
            job.ending = _finish(job)
        if next(job.ending, _END) is _END:
            del _running[key]
            changed = True
    return changed


_END = object()


def wait(job: Job) -> None:
    """Block until ``job`` has ended, and finish it."""
    job.worker.wait()
    if _running.pop((job.name, job.folder), None) is not None:
        deque(job.ending or _finish(job), maxlen=0)


def stop_all() -> None:
    """End all jobs within about a second; finished stages stay on disk."""
    for job in all_running():
        job.worker.interrupt()
    for key, job in list(_running.items()):
        del _running[key]
        if job.ending is not None:
            job.ending.close()
            continue
        _end(job)
        deque(_notify(job, CANCELLED), maxlen=0)


def _finish(job: Job) -> Generator[object, None, None]:
    yield from _notify(job, _end(job))


def _notify(job: Job, ended: Record) -> Generator[object, None, None]:
    try:
        yield from job.on_end(ended) or ()
    except IrisError as error:
        _keep(job, Record("failed", error.what, error.fix))
    except Exception as error:  # an exception would remove the timer that polls all jobs
        _keep(job, Record("failed", f"{type(error).__name__}: {error}", "report this, with the log"))


def _end(job: Job) -> Record:
    job.worker.close()
    try:
        job.worker.raise_if_failed()
        ended = Record("done", job.worker.found, job.worker.warning)
    except Cancelled:
        ended = CANCELLED
    except IrisError as error:
        ended = Record("failed", error.what, error.fix)
    _keep(job, ended)
    return ended


def _keep(job: Job, ended: Record) -> None:
    try:
        _write(job.name, job.folder, ended)
    except IrisError as error:
        job.worker.log.append(f"error: {error}")
    _ended[job.name, job.folder] = ended


def _path(name: JobName, folder: Path) -> Path:
    return folder / f"job-{name}.json"


def _write(name: JobName, folder: Path, content: Record) -> None:
    path = _path(name, folder)
    try:
        write_json(path, {**asdict(content), "time": time.time()})
    except IrisError as error:
        raise IrisError(error.what, "free some disk space, or choose another folder for the result") from error


# ---- command lines -------------------------------------------------------------------------------------------------

RUN = ADDON / "headless" / "run.py"
JSON_LINES = ["--json", "--stop-with-stdin"]
NO_OPTIONS: Mapping[str, object] = MappingProxyType({})


def inspect_command(python: str, capture: Path, out: Path, metres_per_unit: float = 0.0) -> list[str]:
    """Inspect ``capture`` into ``out``; ``metres_per_unit`` 0 leaves the unit to the files."""
    return [*_program(python), "inspect", *_absolute(capture, "--out", out), *_unit(metres_per_unit), *JSON_LINES]


def solve_command(
    python: str,
    capture: Path,
    out: Path,
    preset: str,
    device: str = "auto",
    seed: int = 0,
    exclude: Sequence[str] = (),
    others: Mapping[str, object] = NO_OPTIONS,
) -> list[str]:
    """Solve ``capture`` without the photos ``exclude`` into ``out``, resuming an earlier solve.

    Args:
        others: options by their names in job files: the size of textures, the unit.
    """
    options = ["--preset", preset, "--device", device, "--seed", str(seed), "--resume"]
    if exclude:
        options += ["--exclude", *exclude]
    for name, value in others.items():
        options += [f"--{name.replace('_', '-')}", str(value)]
    return [*_program(python), "solve", *_absolute(capture, "--out", out), *options, *JSON_LINES]


def _unit(metres_per_unit: float) -> list[str]:
    return ["--metres-per-unit", f"{metres_per_unit:.9g}"] if metres_per_unit > 0 else []


@dataclass(frozen=True)
class CompositeOptions:
    """How additions are composited.

    Attributes:
        samples: paths per pixel.
        light_state: of the photo or plate; "" where the room has one, or the result knows it.
        layers: whether an EXR of layers is written beside each picture.
        acescg: whether these are in ACEScg.
    """

    samples: int
    light_state: str = ""
    layers: bool = False
    acescg: bool = False

    def words(self) -> list[str]:
        """On the command line."""
        found = ["--samples", str(self.samples)]
        if self.light_state:
            found += ["--light-state", self.light_state]
        if self.layers:
            found += ["--layers", *(["--acescg"] if self.acescg else [])]
        return found


def composite_command(
    blender: str, blend: Path, result: Path, photo: Path, view: str, out: Path, options: CompositeOptions
) -> list[str]:
    """Composite the additions to the room of ``blend`` onto ``photo``, as the picture ``out``.

    Args:
        blender: path of the program; empty where Blender is a module of this Python.
    """
    files = _absolute(blend, "--result", result, "--photo", photo, "--view", view, "--out", out)
    return [*_in_blender(blender), "composite", *files, *options.words(), *JSON_LINES]


def plate_command(
    blender: str,
    blend: Path,
    result: Path,
    out: Path,
    frames: str,
    options: CompositeOptions,
    *,
    resume: bool,
) -> list[str]:
    """Composite the additions to the room of ``blend`` onto ``frames`` of the plate behind its camera, into the folder
    ``out``; ``blender`` as above."""
    return [
        *_in_blender(blender),
        "composite",
        *_absolute(blend, "--result", result, "--out", out),
        *["--frames", frames, *(["--resume"] if resume else [])],
        *options.words(),
        *JSON_LINES,
    ]


def probe_command(
    blender: str, blend: Path, at: tuple[float, float, float], out: Path, width: int, samples: int
) -> list[str]:
    """Render the light at the point ``at`` of the room of ``blend`` as the panorama ``out``; ``blender`` as above."""
    sampling = ["--at", *(f"{value:.6f}" for value in at), "--width", str(width), "--samples", str(samples)]
    return [*_in_blender(blender), "probe", *_absolute(blend, "--out", out), *sampling, *JSON_LINES]


def looks_command(blender: str, blend: Path, out: Path, width: int, samples: int) -> list[str]:
    """Render the share of every light in the view of the room of ``blend`` into the archive ``out``; ``blender`` as
    above."""
    sampling = ["--width", str(width), "--samples", str(samples)]
    return [*_in_blender(blender), "looks", *_absolute(blend, "--out", out), *sampling, *JSON_LINES]


def farm_command(job_file: Path, bundle: Path) -> list[str]:
    """Write the farm bundle of ``job_file`` into the folder ``bundle``; Blender's own Python has all it needs."""
    return [*_program(sys.executable), "farm", *_absolute(job_file, "--out", bundle), *JSON_LINES]


def _in_blender(blender: str) -> list[str]:
    if not blender:
        return _program(sys.executable)
    return [blender, "-b", "--factory-startup", "--python-exit-code", "1", "-P", str(RUN), "--"]


def environment_command(folder: Path, test_only: Path | None = None) -> list[str]:
    """Create the solver's environment in ``folder`` with Blender's own Python, or only test ``test_only``."""
    script = [sys.executable, "-I", "-X", "utf8", "-B", str(ADDON / "headless" / "make_environment.py")]
    return [*script, "--test", str(test_only)] if test_only is not None else [*script, *_absolute(folder)]


def _absolute(*arguments: str | Path) -> list[str]:
    # A worker has another current folder than Blender.
    return [str(argument.absolute()) if isinstance(argument, Path) else argument for argument in arguments]


def _program(python: str) -> list[str]:
    # -B: nothing may be written into the add-on's folder.
    return [python, "-B", str(RUN)]
