"""The job file of ``batch`` and ``farm``: captures to solve, and what to render of their results.

::

    [[job]]
    capture = "rooms/kitchen"       # relative to this file; the only key a job must have
    name = "kitchen draft"          # default: the capture's folder name
    preset = "draft"
    out = "results/kitchen-draft"   # default: a folder beside this file, named after it, and the job's name in it
    exposures = "none"              # as the options of solve: also response, hdr, device, seed
    exclude = ["frame_0007"]        # photos to leave out
    atlas_size = 4096               # or "auto"; and texels_per_metre = 200, or "auto"
    metres_per_unit = 0.3048        # as of solve; or camera_height = 1.5
    evaluate = true                 # score maps, light and camera against the capture's ground truth

    [[job.frames]]                  # any number of them, rendered when the job above is solved
    command = "relight"             # render, relight, insert, onto-plate or composite, with the options of that
    lights = "evening.json"         # of relight; objects = "..." of insert and onto-plate
    views = "cameras.json"          # default: the capture; onto-plate has plate = "..." and camera = "..." instead,
                                    # composite scene = "shot.blend", and exposure = "auto" without a plate
    frames = "1-120"
    chunk = 10                      # frames of one task on a farm
    name = "evening"                # default: the command
    out = "results/evening"         # default: the result's folder, and the name in it
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from iris_addon.base.errors import BadInput
from iris_addon.base.untrusted import read_json, read_toml
from iris_addon.config import MAX_SEED, PRESETS, TEXTURE_OPTIONS, SolveConfig, preset
from iris_addon.model.camera_height import CameraHeight

MAX_JOBS_BYTES = 4 << 20
OPTIONS = ("response", "exposures", "hdr", "device", "seed", *TEXTURE_OPTIONS)
UNITS = ("metres_per_unit", "camera_height")
MAX_METRES = 1e6
KEYS = ("name", "capture", "preset", "out", "exclude", "evaluate", "frames", *UNITS, *OPTIONS)
WORDS = {"response": ("auto", "gamma"), "exposures": ("auto", "none")}
COMMANDS: dict[str, tuple[str, ...]] = {
    "render": (),
    "relight": ("lights",),
    "insert": ("objects",),
    "onto-plate": ("plate", "camera", "objects"),
    "composite": ("scene",),
}
"""Commands that render, and the keys of the files that each needs beside the views."""
NEEDED = ("lights", "objects", "plate", "camera", "scene")
NOT_FOR_PLATES = ("views", "exposure", "onto_photos")
NOT_FOR_SCENES = ("views", "onto_photos", "linear", "acescg", "fps")
"""Of ``composite``, which has the rate of its scene; its ``exposure`` is that of the plate, or auto without one."""
FRAME_PATHS = ("views", "out", *NEEDED)
ONLY_FOR_PLATES = ("layers",)
FRAME_SWITCHES = ("linear", "acescg", "gpu", "onto_photos", *ONLY_FOR_PLATES)
FRAME_NUMBERS = ("samples", "seed", "fps")
FRAME_WORDS = ("exposure", "light_state")
FRAME_KEYS = ("name", "command", "frames", "chunk", *FRAME_WORDS, *FRAME_PATHS, *FRAME_SWITCHES, *FRAME_NUMBERS)
CHUNK = 10
MAX_FRAMES = 1_000_000


@dataclass(frozen=True)
class Frames:
    """An animation that is rendered of the result of a job.

    Attributes:
        name: that of the job, a slash, and its own.
        options: of the command line, all but the result, ``--out`` and ``--frames``.
        first, last: frames, both included.
        chunk: frames of one task on a farm.
        waits_for_first: whether all frames share an exposure that is measured on the first.
        scene: the .blend that ``composite`` renders.
    """

    name: str
    command: str
    out: Path
    options: tuple[str, ...]
    first: int
    last: int
    chunk: int
    waits_for_first: bool
    scene: Path | None = None

    @property
    def chunks(self) -> int:
        """Tasks on a farm."""
        return -(-(self.last - self.first + 1) // self.chunk)

    def frames_of(self, chunk: int) -> tuple[int, int]:
        """First and last frame of the task ``chunk``, counted from 0."""
        first = self.first + chunk * self.chunk
        return first, min(first + self.chunk - 1, self.last)


@dataclass(frozen=True)
class Job:
    """One capture of the file."""

    name: str
    capture: Path
    out: Path
    config: SolveConfig
    exclude: tuple[str, ...] = ()
    unit: float | CameraHeight | None = None
    evaluate: bool = False
    frames: tuple[Frames, ...] = ()


Located = Callable[[str], Path]
"""A path of the job file on this machine."""


def read_jobs(path: Path, mapping: Path | None = None) -> list[Job]:
    """The jobs of a TOML file.

    Args:
        mapping: rules for absolute paths that lie elsewhere on this machine, as Open Job Description writes them.

    Raises:
        BadInput: for everything that can be checked before the first job runs.
    """
    content = read_toml(path, MAX_JOBS_BYTES)
    entries = content.get("job")
    if not isinstance(entries, list) or not entries or set(content) != {"job"}:
        raise BadInput("has no [[job]], or something else beside them", "write one [[job]] table per job", path)
    located = _located(path.parent, mapping)
    jobs = [_job(entry, number, path, located) for number, entry in enumerate(entries)]
    units = [*jobs, *(frames for job in jobs for frames in job.frames)]
    for what in ("name", "out"):
        counts = Counter(getattr(unit, what) for unit in units)
        repeated, count = counts.most_common(1)[0]
        if count > 1:
            raise BadInput(f"two jobs have the {what} {repeated}", f"give each job its own {what}", path)
    return jobs


def _job(entry: Any, number: int, path: Path, located: Located) -> Job:
    where = f"job {number + 1}"
    if not isinstance(entry, dict) or not isinstance(entry.get("capture"), str):
        raise BadInput(f"{where} has no capture", 'add capture = "FOLDER"', path)
    _require_known(entry, KEYS, where, path)
    for key, value in entry.items():
        kind = {"seed": int, "evaluate": bool, "exclude": list, "frames": list}.get(key, str)
        if key in UNITS:
            _require_metres(value, key, where, path)
        elif type(value) is not kind and key not in TEXTURE_OPTIONS:
            raise BadInput(f"{where}: {key} is {value!r}", f"give a {kind.__name__}", path)
        _require_printable(value, key, where, path)
    if not 0 <= entry.get("seed", 0) <= MAX_SEED:
        raise BadInput(f"{where}: seed is {entry['seed']}", f"give a number from 0 to {MAX_SEED}", path)
    if entry.get("preset", "balanced") not in PRESETS:
        raise BadInput(f"{where}: preset is {entry['preset']!r}", f"presets are {', '.join(PRESETS)}", path)
    if entry.get("device", "auto") not in ("auto", "cpu", "cuda"):
        raise BadInput(f"{where}: device is {entry['device']!r}", "devices are auto, cpu, cuda", path)
    excluded = entry.get("exclude", [])
    if not all(isinstance(photo, str) for photo in excluded):
        raise BadInput(f"{where}: exclude is {excluded!r}", "give a list of names of photos", path)
    options = {key: entry[key] for key in OPTIONS if key in entry}
    for key in ("response", "exposures", "hdr"):
        if key in options and options[key] not in WORDS.get(key, ()):
            options[key] = located(options[key])
    capture = located(entry["capture"])
    name = _name(entry.get("name", capture.stem if capture.suffix else capture.name), where, path)
    out = located(entry["out"]) if "out" in entry else path.with_suffix("") / name
    try:
        config = preset(entry.get("preset", "balanced"), **options)
    except BadInput as error:
        raise BadInput(f"{where}: {error.what}", error.fix, path) from error
    frames = tuple(
        _frames(table, f"{where}, frames {index + 1}", path, located, (name, capture, out))
        for index, table in enumerate(entry.get("frames", []))
    )
    return Job(
        name=name,
        capture=capture,
        out=out,
        config=config,
        exclude=tuple(excluded),
        unit=_unit(entry, where, path),
        evaluate=entry.get("evaluate", False),
        frames=frames,
    )


def _frames(entry: Any, where: str, path: Path, located: Located, job: tuple[str, Path, Path]) -> Frames:
    job_name, capture, result = job
    if not isinstance(entry, dict):
        raise BadInput(f"{where} is no table", "write [[job.frames]]", path)
    _require_known(entry, FRAME_KEYS, where, path)
    for key, value in entry.items():
        kind = int if key in (*FRAME_NUMBERS, "chunk") else bool if key in FRAME_SWITCHES else str
        if type(value) is not kind or (isinstance(value, int) and not 0 <= value <= MAX_FRAMES):
            raise BadInput(f"{where}: {key} is {value!r}", f"give a {kind.__name__}", path)
        _require_printable(value, key, where, path)
    command = entry.get("command", "render")
    if command not in COMMANDS:
        raise BadInput(f"{where}: command is {command!r}", f"commands are {', '.join(COMMANDS)}", path)
    needed, on_plate, own_scene = COMMANDS[command], command == "onto-plate", command == "composite"
    not_for = [key for key in NEEDED if key not in needed] + list(NOT_FOR_PLATES if on_plate else ONLY_FOR_PLATES)
    not_for += NOT_FOR_SCENES if own_scene else ()
    wrong = next((key for key in (*needed, *not_for) if (key in entry) != (key in needed)), None)
    if wrong is not None:
        raise BadInput(
            f"{where}: {wrong} {'is missing' if wrong in needed else 'is not for ' + command}", "mend it", path
        )
    if own_scene and entry.get("exposure", "auto") != "auto":
        raise BadInput(
            f"{where}: exposure is {entry['exposure']!r}", "leave it out, or give auto without a plate", path
        )
    first, last = _range(entry.get("frames"), 0 if on_plate or own_scene else 1, where, path)
    name = _name(entry.get("name", command), where, path)
    views = located(entry["views"]) if "views" in entry else capture
    options = [] if on_plate or own_scene else ["--views", str(views)]
    for key in () if own_scene else needed:
        options += [f"--{key}", str(located(entry[key]))]
    for key in (*FRAME_NUMBERS, *(word for word in FRAME_WORDS if not own_scene or word != "exposure")):
        options += [f"--{key.replace('_', '-')}", str(entry[key])] if key in entry else []
    options += [f"--{key.replace('_', '-')}" for key in FRAME_SWITCHES if entry.get(key)]
    exposure = entry.get("exposure", "auto" if command == "relight" else "photo")
    return Frames(
        name=f"{job_name}/{name}",
        command=command,
        out=located(entry["out"]) if "out" in entry else result / name,
        options=tuple(options),
        first=first,
        last=last,
        chunk=max(1, entry.get("chunk", CHUNK)),
        waits_for_first=exposure == "auto" and not (entry.get("linear") or entry.get("acescg")),
        scene=located(entry["scene"]) if own_scene else None,
    )


def _range(text: object, lowest: int, where: str, path: Path) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{1,7})(?:-(\d{1,7}))?", text) if isinstance(text, str) else None
    first, last = (int(found[1]), int(found[2] or found[1])) if found else (-1, -1)
    if not lowest <= first <= last <= MAX_FRAMES:
        raise BadInput(f"{where}: frames is {text!r}", 'give a range, such as frames = "1-120"', path)
    return first, last


def _name(name: str, where: str, path: Path) -> str:
    if not name or name != Path(name).name or name.startswith("."):
        raise BadInput(f"{where}: name is {name!r}", "give a name that can be a folder's", path)
    return name


def _require_printable(value: object, key: str, where: str, path: Path) -> None:
    if isinstance(value, str) and not value.isprintable():
        raise BadInput(f"{where}: {key} has control characters", "leave them out", path)


def _require_metres(value: object, key: str, where: str, path: Path) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 1 / MAX_METRES <= value <= MAX_METRES:
        raise BadInput(f"{where}: {key} is {value!r}", f"give meters from {1 / MAX_METRES:g} to {MAX_METRES:g}", path)


def _unit(entry: Mapping[str, Any], where: str, path: Path) -> float | CameraHeight | None:
    if all(key in entry for key in UNITS):
        raise BadInput(f"{where} has {' and '.join(UNITS)}", "give one of them", path)
    height = entry.get("camera_height")
    return entry.get("metres_per_unit") if height is None else CameraHeight(height)


def _require_known(entry: Mapping[str, object], keys: Sequence[str], where: str, path: Path) -> None:
    unknown = [key for key in entry if key not in keys]
    if unknown:
        raise BadInput(f"{where} has an unknown key {unknown[0]!r}", f"keys are {', '.join(keys)}", path)


# ---- paths on other machines ---------------------------------------------------------------------------------------


def _located(folder: Path, mapping: Path | None) -> Located:
    """Paths relative to ``folder``, absolute ones as the rules in the file ``mapping`` say."""
    rules = [] if mapping is None else _rules(mapping)

    def located(text: str) -> Path:
        for source, destination in rules:
            if text == source or text.startswith((source.rstrip("/\\") + "/", source.rstrip("/\\") + "\\")):
                rest = text[len(source.rstrip("/\\")) :].lstrip("/\\").replace("\\", "/")
                return Path(destination, rest)
        return folder / text

    return located


def _rules(path: Path) -> list[tuple[str, str]]:
    """(source, destination) of the path mapping rules of a session, the longest source first; raises BadInput."""
    try:
        content = read_json(path)
        rules = [(str(r["source_path"]), str(r["destination_path"])) for r in content.get("path_mapping_rules", [])]
    except (KeyError, TypeError, AttributeError) as error:
        raise BadInput(f"holds no path mapping rules ({error})", "leave out --path-mapping", path) from error
    return sorted(rules, key=lambda rule: -len(rule[0]))
