"""A job file as a bundle for render farms: ``farm JOBS.toml --out BUNDLE``.

:func:`steps_of` lists what is to be done; :func:`job_template` and :func:`flamenco_job` say it to two kinds of farm.

Open Job Description (https://github.com/OpenJobDescription/openjd-specifications, version 2023-09) is what AWS Deadline
Cloud and the reference runner ``openjd run`` execute. A step solves a capture; steps that depend on it render its
frames in chunks; the last one writes the summary. A task is ``batch JOBS.toml --only NAME``: the same work as without
a farm, and the same bytes. Solves resume, and frames that are there are kept, so a task that was killed is retried.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, TextIO

from iris_addon.base.errors import BadInput
from iris_addon.base.files import files_beside, write_json
from iris_addon.base.progress import ProgressEvent, Sink

from .job_file import Frames, Job, read_jobs
from .outcome import Outcome

SPECIFICATION = "jobtemplate-2023-09"
MAX_TASKS = 200_000
"""Of one bundle; a hundred thousand frames in chunks of ten are a twentieth."""
MAX_NAME = 64
"""Characters of the name of a step, by the specification."""
CORES, MEMORY_MIB = 2, 8192
"""What a host must have at least."""
STOP_SECONDS = 30
"""Between the notice to stop and the end of the process; a cancel takes less than one."""


def write_bundle(path: Path, out: Path) -> Outcome:
    """Write the bundle of the job file ``path`` into the folder ``out``: the template and the values of its parameters.

    Raises:
        BadInput: ``path`` is no job file, a name is too long for a step, or there are too many tasks.
    """
    jobs = read_jobs(path)
    steps = steps_of(path, jobs)
    tasks = sum(step.chunks or 1 for step in steps)
    if tasks > MAX_TASKS:
        raise BadInput(f"makes {tasks} tasks, more than {MAX_TASKS}", "give larger chunks, or two job files", path)
    values = [{"name": "Jobs", "value": str(path.absolute())}, {"name": "Iris", "value": "iris"}]
    write_json(out / "template.json", job_template(path, steps))
    write_json(out / "parameter_values.json", {"parameterValues": values})
    write_json(out / "asset_references.json", {"assetReferences": _assets(path, jobs)})
    write_json(out / "flamenco_job.json", flamenco_job(path, steps))
    return Outcome.of("Wrote the bundle", {"folder": out, "steps": len(steps), "tasks": tasks})


@dataclass(frozen=True)
class Step:
    """One or more tasks of a farm.

    Attributes:
        arguments: of ``batch``, after the job file; where ``chunks`` is not None, ``--chunk K`` follows.
        chunks: number of tasks, None for one task that is no chunk.
        after: steps that must have ended well.
        renders: whether it renders, rather than solves.
        gpu: whether a host must have one.
    """

    name: str
    arguments: tuple[str, ...]
    chunks: int | None = None
    after: tuple[str, ...] = ()
    renders: bool = False
    gpu: bool = False


def steps_of(path: Path, jobs: Sequence[Job]) -> list[Step]:
    """The steps of ``jobs``, read from ``path``, in an order in which they can be done; raises BadInput."""
    steps: list[Step] = []
    for job in jobs:
        solve = Step(f"Solve {job.name}", ("--only", job.name, "--resume"), gpu=job.config.device == "cuda")
        steps.append(solve)
        for frames in job.frames:
            steps += _frame_steps(frames, solve.name)
    steps.append(Step("Summary", ("--summary",), after=tuple(step.name for step in steps)))
    for step in steps:
        if len(step.name) > MAX_NAME:
            what = f"'{step.name}' is longer than the {MAX_NAME} characters of a step"
            raise BadInput(what, "shorten the name", path)
    return steps


def _frame_steps(frames: Frames, solve: str) -> list[Step]:
    """The chunks of ``frames``, after its solve, and after its first frame where that sets the exposure of all."""
    options = {"renders": True, "gpu": "--gpu" in frames.options}
    only = ("--only", frames.name)
    chunks = Step(f"Frames {frames.name}", only, chunks=frames.chunks, after=(solve,), **options)
    if not frames.waits_for_first:
        return [chunks]
    first = Step(f"First frame {frames.name}", (*only, "--first-frame"), after=(solve,), **options)
    return [first, replace(chunks, after=(first.name,))]


# ---- Open Job Description ------------------------------------------------------------------------------------------


def job_template(path: Path, steps: Sequence[Step]) -> dict[str, Any]:
    """The job template of ``steps`` of the job file ``path``."""
    return {
        "specificationVersion": SPECIFICATION,
        "name": f"IRIS {path.stem}"[:MAX_NAME],
        "parameterDefinitions": [
            {
                "name": "Jobs",
                "type": "PATH",
                "objectType": "FILE",
                "dataFlow": "IN",
                "description": "The job file; its relative paths are relative to it",
            },
            {"name": "Iris", "type": "STRING", "default": "iris", "description": "The program iris on the host"},
        ],
        "jobEnvironments": [
            {"name": "IRIS", "description": "Output is passed on line by line", "variables": {"PYTHONUNBUFFERED": "1"}}
        ],
        "steps": [_step(step) for step in steps],
    }


def _step(step: Step) -> dict[str, Any]:
    amounts = [
        {"name": "amount.worker.vcpu", "min": CORES},
        {"name": "amount.worker.memory", "min": MEMORY_MIB},
        *([{"name": "amount.worker.gpu", "min": 1}] if step.gpu else []),
    ]
    chunk = [] if step.chunks is None else ["--chunk", "{{Task.Param.Chunk}}"]
    mapping = ["--path-mapping", "{{Session.PathMappingRulesFile}}", "--openjd"]
    action = {
        "command": "{{Param.Iris}}",
        "args": ["batch", "{{Param.Jobs}}", *step.arguments, *chunk, *mapping],
        "cancelation": {"mode": "NOTIFY_THEN_TERMINATE", "notifyPeriodInSeconds": STOP_SECONDS},
    }
    described: dict[str, Any] = {
        "name": step.name,
        "script": {"actions": {"onRun": action}},
        "hostRequirements": {"amounts": amounts},
    }
    if step.chunks is not None:
        chunks = {"name": "Chunk", "type": "INT", "range": f"0-{step.chunks - 1}" if step.chunks > 1 else [0]}
        described["parameterSpace"] = {"taskParameterDefinitions": [chunks]}
    if step.after:
        described["dependencies"] = [{"dependsOn": name} for name in step.after]
    return described


def _assets(path: Path, jobs: Sequence[Job]) -> dict[str, Any]:
    """Files and folders that hosts need, and those they write, for farms that copy them."""
    files, folders, written = [path], [], []
    for job in jobs:
        (folders if job.capture.is_dir() else files).append(job.capture)
        written += [job.out, *(frames.out for frames in job.frames)]
        for frames in job.frames:
            words = frames.options
            files += [Path(word) for option, word in pairwise(words) if option in _FILE_OPTIONS]
            files += [] if frames.scene is None else [frames.scene]
            folders += (
                [] if frames.scene is None or not files_beside(frames.scene).is_dir() else [files_beside(frames.scene)]
            )
            plates = [Path(word) for option, word in pairwise(words) if option == "--plate"]
            folders += [plate if plate.is_dir() else plate.parent for plate in plates]
    inputs = {
        "filenames": sorted({str(file.absolute()) for file in files if not file.is_dir()}),
        "directories": sorted({str(folder.absolute()) for folder in folders}),
    }
    return {"inputs": inputs, "outputs": {"directories": sorted({str(folder.absolute()) for folder in written})}}


_FILE_OPTIONS = ("--views", "--lights", "--objects", "--camera")


def session_lines(stream: TextIO = sys.stdout) -> Sink:
    """Sink that writes progress as the sessions of Open Job Description read it from stdout."""

    def write(event: ProgressEvent) -> None:
        left = "" if event.seconds_left is None else f", about {event.seconds_left:.0f} s left"
        stream.write(f"openjd_progress: {100 * event.overall:.1f}\nopenjd_status: {event.stage}{left}\n")
        stream.flush()

    return write


# ---- Flamenco ------------------------------------------------------------------------------------------------------


def flamenco_job(path: Path, steps: Sequence[Step]) -> dict[str, Any]:
    """A job of the type ``assets/farm/iris-rooms.js``, as the Flamenco Manager takes it; each chunk is a task."""
    tasks: list[dict[str, Any]] = []
    made: dict[str, list[str]] = {}
    for step in steps:
        chunks = [None] if step.chunks is None else list(range(step.chunks))
        made[step.name] = [step.name if chunk is None else f"{step.name} {chunk + 1}" for chunk in chunks]
        for name, chunk in zip(made[step.name], chunks, strict=True):
            tasks.append(
                {
                    "name": name,
                    "type": "blender-render" if step.renders else "misc",
                    "arguments": [*step.arguments, *([] if chunk is None else ["--chunk", str(chunk)])],
                    "after": [each for before in step.after for each in made[before]],
                }
            )
    settings = {"jobs": str(path.absolute()), "iris": "iris", "tasks": json.dumps(tasks)}
    return {"name": f"IRIS {path.stem}", "type": "iris-rooms", "submitter_platform": "linux", "settings": settings}
