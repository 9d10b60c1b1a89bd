"""The command line: arguments, exit codes, signals and messages; what commands do is in :mod:`headless.commands`.

:func:`main` is the entry point of the program ``iris`` and of ``headless/run.py``. Importing this module needs no
package beyond Python's own, so that a Python which lacks some can say which.

Exit codes: 0 done, 1 failed, 2 usage, 3 bad input, 4 solver environment missing, 130 cancelled. Errors are one line,
``error: what is wrong — how to fix it``, on stderr. With ``--json`` stdout carries one JSON object per line: progress,
then ``{"type": "done", "result": ...}`` or ``{"type": "error", "what": ..., "fix": ..., "exit_code": ...}``.
"""

from __future__ import annotations

import argparse
import io
import json
import math
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from iris_addon.base.errors import Cancelled, IrisError
from iris_addon.base.progress import Progress, Sink, console, json_lines
from iris_addon.config import MAX_SEED, PRESETS
from iris_addon.model.camera_height import CameraHeight
from iris_addon.model.texture_size import atlas_size_of, density_of

from .cancellation import cancelled_by_signals, stop_with_stdin
from .environment import delegate, missing_packages, prepare_blender, unusable

USAGE_CODE = 2
MAX_FRAMES, MAX_RESOLUTION = 1_000_000, 200_000_000
"""Of a run; pixels of a rendered photo."""
MAX_EXPOSURE, MAX_METRES = 1e12, 1e6
"""Metres of a unit, and one by it the least; of a coordinate."""
SEVERAL: dict[str, Any] = {"nargs": "+", "action": "extend"}
"""Names after an option, which may be given more than once."""
MAX_PANORAMA_WIDTH = 16384


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        self.exit(USAGE_CODE, f"error: {message} — see {self.prog} --help\n")


def main(arguments: list[str] | None = None) -> int:
    """Run one command.

    Args:
        arguments: the command and its options; None for those the program was started with. Inside Blender these are
            what stands after ``--``.

    Returns:
        The exit code.
    """
    _never_fail_to_print()
    argv = _own_arguments(sys.argv) if arguments is None else arguments
    try:
        args = make_parser().parse_args(argv)
    except SystemExit as ended:  # argparse has printed its message
        return int(ended.code or 0)
    lines = args.json is True
    if not args.debug:  # what libraries think of a file is for developers; an error about it is one line
        warnings.filterwarnings("ignore", module=r"PIL|trimesh|numpy")
    progress = Progress(_sink(args))
    try:
        if missing := missing_packages(args):
            return delegate(argv, missing)
        prepare_blender(args)
        if getattr(args, "stop_with_stdin", False):  # an option of the commands that write JSON lines
            stop_with_stdin(progress)
        with cancelled_by_signals(progress, lambda: _fail(_cancelled(args), lines)):
            from . import commands

            outcome = getattr(commands, args.command.replace("-", "_"))(args, progress)
    except (KeyboardInterrupt, Cancelled):
        return _fail(_cancelled(args), lines)
    except IrisError as error:
        if args.debug:
            traceback.print_exc()
        return _fail(error, lines)
    except ImportError as error:
        if args.debug:
            traceback.print_exc()
        return _fail(unusable(error), lines)
    except Exception as error:
        if args.debug:
            traceback.print_exc()
        return _fail(_unexpected(error), lines)
    if lines:
        from iris_addon.base.files import plain

        print(json.dumps({"type": "done", "result": plain(outcome.data)}, allow_nan=False), flush=True)
    else:
        print(outcome.text, flush=True)
    return outcome.exit_code


def _never_fail_to_print() -> None:
    """Escape what the encoding of a redirected output lacks: on Windows it has 256 characters."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _sink(args: argparse.Namespace) -> Sink:
    """Where progress goes."""
    if getattr(args, "openjd", False):
        from .farm import session_lines

        return session_lines(sys.stdout)
    return json_lines(sys.stdout) if args.json is True else console(sys.stderr)


def _own_arguments(argv: list[str]) -> list[str]:
    """The arguments meant for this program: inside Blender those after ``--``, otherwise all but the program's name."""
    if "bpy" in sys.modules:
        return argv[argv.index("--") + 1 :] if "--" in argv else []
    return argv[1:]


def _unexpected(error: Exception) -> IrisError:
    """A message for an error that no room has described: the file it is about, or else how to report it."""
    if isinstance(error, OSError) and error.filename is not None:
        fix = "check the path, its permissions and the space on the disk"
        return IrisError(f"cannot be used ({error.strerror})", fix, Path(error.filename))
    what = f"{type(error).__name__}: {' '.join(str(error).split()) or 'no message'}"
    return IrisError(what, "run again with --debug and report what it prints")


def _cancelled(args: argparse.Namespace) -> Cancelled:
    """What to say of a command that was stopped."""
    return Cancelled() if hasattr(args, "resume") else Cancelled("run again")


def _fail(error: IrisError, lines: bool) -> int:
    if lines:
        message = {"type": "error", "what": error.what, "fix": error.fix, "exit_code": error.exit_code}
        print(json.dumps(message), flush=True)
    print(f"error: {error}", file=sys.stderr, flush=True)
    return error.exit_code


# ---- arguments -----------------------------------------------------------------------------------------------------


Add = Callable[..., _Parser]
"""(name, text, parents) to the parser of a new command."""


def make_parser() -> _Parser:
    """The parser of the whole command line."""
    common = _Parser(add_help=False)
    common.add_argument("--debug", action="store_true", help="show a traceback with an error")
    lines = _Parser(add_help=False)
    lines.add_argument("--json", action="store_true", help="progress and result as JSON lines on stdout")
    lines.add_argument("--stop-with-stdin", action="store_true", help="stop when stdin closes: the caller is gone")
    parser = _Parser(prog="iris", description="Photos and mesh of a room in, a relightable .blend out.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def add(name: str, text: str, *parents: _Parser) -> _Parser:
        return commands.add_parser(name, help=text, description=text, parents=list(parents or (common, lines)))

    _add_solving(add)
    _add_rendering(add)
    _add_scoring(add, common)
    return parser


def _add_solving(add: Add) -> None:
    """From photos to a result and its files."""
    demo = add("demo", "everything on the bundled capture: solve, .blend, relit, inserted, report")
    demo.add_argument("--out", type=Path, default=Path("out/demo"), help="folder for everything; out/demo if left out")

    solve = add("solve", "capture folder (or file) to result folder")
    solve.add_argument("capture", type=Path, help="folder of the capture, or its transforms.json")
    solve.add_argument("--out", type=Path, required=True, help="folder of the result")
    solve.add_argument("--preset", choices=list(PRESETS), default="balanced", help="time against accuracy")
    solve.add_argument("--device", choices=["auto", "cpu", "cuda"], default="auto", help="where torch and rays run")
    solve.add_argument(
        "--response",
        type=_word_or_path("auto", "gamma"),
        default="auto",
        metavar="auto|gamma|FILE",
        help="estimate it, take z = x^(1/2.2), or read a curve",
    )
    _add_exposures(solve)
    solve.add_argument("--hdr", type=Path, metavar="DIR", help="one EXR of radiance per photo, in place of the photos")
    solve.add_argument("--strict", action="store_true", help="refuse a capture that lacks photos or poses")
    solve.add_argument("--exclude", **SEVERAL, default=[], metavar="PHOTO", help="photos to leave out")
    _add_unit(solve)
    _add_texture_size(solve)
    solve.add_argument("--resume", action="store_true", help="go on from the last finished stage")
    solve.add_argument("--seed", type=_whole, default=0, help="of all randomness")

    inspect = add("inspect", "measure a capture: clipping, exposure, alignment of photos and mesh")
    inspect.add_argument("capture", type=Path, help="folder of the capture, or its transforms.json")
    inspect.add_argument("--out", type=Path, required=True, help="folder for what was measured")
    _add_exposures(inspect)
    inspect.add_argument(
        "--strict", action="store_true", help="refuse a capture that lacks some of its photos or poses"
    )
    _add_unit(inspect)
    inspect.add_argument("--preset", choices=list(PRESETS), default="balanced", help="of the solve to come")
    _add_texture_size(inspect)

    fuse = add("fuse", "posed depth of an RGB-D capture to one mesh")
    fuse.add_argument("capture", type=Path, help="folder of the capture, or its transforms.json")
    fuse.add_argument("--out", type=Path, required=True, metavar="MESH.ply", help="the mesh to write")
    fuse.add_argument("--voxel", type=_metres, metavar="METRES", help="as the depth allows, if left out")

    apply = add("apply", "Principled materials and emissive lights as a .blend")
    apply.add_argument("result", type=Path, help="folder of a result")
    apply.add_argument("--blend", type=Path, required=True, help="the .blend to write")
    apply.add_argument("--glb", type=Path, help="a .glb beside it")
    apply.add_argument(
        "--light", action="store_true", help="the .glb with at most 150,000 faces and textures of 2048 pixels, as JPEG"
    )
    apply.add_argument("--usd", type=Path, help="a .usd beside it")
    apply.add_argument("--views", type=Path, metavar="CAPTURE", help="add the cameras of a transforms.json or capture")

    batch = add("batch", "many jobs, one summary; a job that fails does not stop the rest")
    batch.add_argument("jobs", type=Path, metavar="JOBS.toml", help="one table per solve, and what to render of it")
    batch.add_argument("--parallel", type=_positive, default=1, metavar="N", help="jobs at a time, as memory allows")
    batch.add_argument("--resume", action="store_true", help="solves go on from their last finished stage")
    batch.add_argument("--only", metavar="NAME", help="run one job, or JOB/FRAMES, and write no summary")
    batch.add_argument("--chunk", type=_whole, metavar="K", help="of the frames of --only, those of one farm task")
    batch.add_argument("--first-frame", action="store_true", help="of the frames of --only, the first")
    batch.add_argument("--summary", action="store_true", help="run nothing; collect what runs with --only have left")
    batch.add_argument("--path-mapping", type=Path, metavar="FILE", help="rules for absolute paths on this machine")
    batch.add_argument("--openjd", action="store_true", help="progress as Open Job Description reads it")

    farm = add("farm", "a job file as a bundle for farms that run Open Job Description")
    farm.add_argument("jobs", type=Path, metavar="JOBS.toml", help="as for batch")
    farm.add_argument("--out", type=Path, required=True, metavar="BUNDLE", help="folder of the bundle")


def _add_exposures(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--exposures",
        type=_word_or_path("auto", "none"),
        default="auto",
        metavar="auto|none|FILE",
        help="those of the capture, unknown, or of a file",
    )


def _add_unit(command: argparse.ArgumentParser) -> None:
    unit = command.add_mutually_exclusive_group()
    unit.add_argument(
        "--metres-per-unit",
        dest="unit",
        type=_metres,
        metavar="METRES",
        help="unit of poses and mesh, where they have none: a wall of 4 m that measures 2.5 has 1.6",
    )
    unit.add_argument(
        "--camera-height",
        dest="unit",
        type=_camera_height,
        metavar="METRES",
        help="assume this median height of the cameras over the floor, where nothing tells the unit",
    )


def _add_texture_size(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--atlas-size",
        type=_checked(atlas_size_of),
        default="auto",
        metavar="auto|SIDE",
        help="of the textures, in texels; auto: as the photos resolve, up to the limit of the preset",
    )
    command.add_argument(
        "--texels-per-metre",
        type=_checked(density_of),
        default="auto",
        metavar="auto|N",
        help="density of the textures, as far as the atlas holds it; auto: that of the photos",
    )


def _add_rendering(add: Add) -> None:
    """From a result to pictures."""
    render = add("render", "novel views in Cycles, as the photo's camera would see them, or linear EXR")
    relight = add("relight", "recovered lights off, scaled or recoloured, new lights added")
    relight.add_argument("--lights", type=Path, required=True, metavar="FILE", help="JSON of the changed lights")
    insert = add("insert", "objects lit by the recovered light")
    insert.add_argument("--objects", type=Path, required=True, metavar="FILE", help="JSON of the objects")
    insert.add_argument("--onto-photos", action="store_true", help="differential rendering onto the views' photos")
    insert.add_argument("--layers", action="store_true", help="with --onto-photos: layers for Nuke beside each")
    render.add_argument("--light-shares", action="store_true", help="one EXR per view with the share of every light")
    relight.add_argument("--shares", type=Path, metavar="DIR", help="mix what render --light-shares wrote; no render")
    for command, exposure in ((render, "photo"), (relight, "auto"), (insert, "photo")):
        command.add_argument("result", type=Path, help="folder of a result")
        command.add_argument("--views", type=Path, required=True, metavar="transforms.json", help="cameras to render")
        command.add_argument("--only", **SEVERAL, metavar="NAME", help="only these views; jobs count them from 0")
        command.add_argument("--out", type=Path, required=True, help="folder of the pictures")
        command.add_argument("--linear", action="store_true", help="write EXR of radiance instead of PNG")
        _add_acescg(command)
        command.add_argument(
            "--exposure",
            type=_exposure,
            default=exposure,
            metavar="photo|auto|FACTOR",
            help="that of the photos, one that maps the median of each picture to middle gray, or a factor "
            f"(default: {exposure})",
        )
        command.add_argument("--frames", type=_frames, metavar="1-120", help="an animation; finished frames are kept")
        command.add_argument("--length", type=_positive, help="frames of the whole, where --frames is a part of it")
        command.add_argument("--fps", type=_positive, default=24, help="of film.mp4, made where there is ffmpeg")

    plate = add("onto-plate", "objects onto every frame of a plate with a moving camera, each exposed as the frame is")
    plate.add_argument("result", type=Path, help="folder of a result")
    plate.add_argument("--plate", type=Path, required=True, metavar="FOLDER|shot.####.png", help="the numbered frames")
    plate.add_argument("--camera", type=Path, required=True, metavar="transforms.json", help="pose and lens by number")
    plate.add_argument("--objects", type=Path, required=True, metavar="FILE", help="JSON of the objects, as for insert")
    plate.add_argument("--out", type=Path, required=True, help="folder of the frames")
    plate.add_argument("--frames", type=_plate_frames, metavar="1001-1024", help="these alone; finished ones are kept")
    plate.add_argument("--linear", action="store_true", help="write EXR of radiance instead of PNG")
    plate.add_argument("--layers", action="store_true", help="an EXR of layers for each frame beside, for Nuke")
    _add_acescg(plate)
    plate.add_argument("--fps", type=_positive, default=24, help="of film.mp4, made where there is ffmpeg")

    composite = add("composite", "what was added to the solved room of a .blend, onto the photo of its camera")
    composite.add_argument("blend", type=Path, metavar="SCENE.blend", help="a solved room with additions")
    composite.add_argument("--result", type=Path, required=True, help="folder of the result that was applied")
    composite.add_argument("--photo", type=Path, metavar="FILE", help="undistorted, as the camera saw it")
    composite.add_argument("--view", metavar="NAME", help="of the photo, for its exposure and light state")
    composite.add_argument(
        "--frames", type=_plate_frames, metavar="1-120", help="of the plate behind the camera, in place of a photo"
    )
    composite.add_argument("--resume", action="store_true", help="frames of the plate that are there are kept")
    composite.add_argument("--out", type=Path, required=True, metavar="FILE.png|DIR", help="the picture, or the frames")
    composite.add_argument("--layers", action="store_true", help="an EXR of layers beside each picture, for Nuke")
    composite.add_argument("--acescg", action="store_true", help="layers in ACEScg, not Rec.709")

    probe = add("probe", "all light at one point of a solved room, as an equirectangular EXR (HDRI)")
    probe.add_argument("source", type=Path, metavar="RESULT|SCENE.blend", help="folder of a result, or a solved room")
    probe.add_argument("--at", type=_coordinate, nargs=3, required=True, metavar=("X", "Y", "Z"), help="the point")
    probe.add_argument("--out", type=Path, required=True, metavar="FILE.exr", help="the panorama to write")
    probe.add_argument("--width", type=_panorama_width, default=1024, help="pixels; half as many high (default: 1024)")
    probe.add_argument("--lights", type=Path, metavar="FILE", help="JSON of changed lights, as for relight")
    probe.add_argument("--acescg", action="store_true", help="in ACEScg, not Rec.709; Blender reads the latter")

    looks = add("looks", "the light of every source in the view of a .blend's camera, for pictures of looks")
    looks.add_argument("blend", type=Path, metavar="SCENE.blend", help="a solved room by its recovered light")
    looks.add_argument("--out", type=Path, required=True, metavar="FILE.npz", help="the archive to write")
    looks.add_argument("--width", type=_positive, default=320, help="pixels, at most (default: 320)")

    for lit in (render, relight, insert, plate, composite, probe):
        lit.add_argument("--light-state", metavar="NAME", help="of the room; else that of the views, or the first")
    for rendered in (render, relight, insert, plate, composite, probe, looks):
        _add_sampling(rendered)
        rendered.add_argument("--gpu", action="store_true", help="render on a GPU where Cycles finds one")

    camera = add("camera", "response, exposures and white balance as .cube tables and an OpenColorIO configuration")
    camera.add_argument("result", type=Path, help="folder of a result")
    camera.add_argument("--out", type=Path, required=True, help="folder of the tables")


def _add_scoring(add: Add, common: _Parser) -> None:
    """Ground truth made and used."""
    evaluate = add("evaluate", "the metrics of a result against ground truth or held-out photos", common)
    evaluate.add_argument("result", type=Path, help="folder of a result")
    evaluate.add_argument(
        "--gt", type=Path, required=True, metavar="CAPTURE", help="with ground truth or held-out photos"
    )
    evaluate.add_argument("--no-render", action="store_true", help="leave out what Cycles renders; needs no Blender")
    evaluate.add_argument(
        "--json", nargs="?", const=True, type=Path, metavar="FILE", help="write FILE; without it JSON lines on stdout"
    )
    _add_sampling(evaluate)

    synth = add("synth", "posed LDR capture with ground truth out of a Blender scene")
    synth.add_argument("scene", type=Path, metavar="SCENE.blend", help="the scene to photograph")
    synth.add_argument("--out", type=Path, required=True, help="folder of the capture")
    synth.add_argument("--cameras", **SEVERAL, metavar="NAME", help="camera objects to use; all without it")
    synth.add_argument("--resolution", type=_resolution, default=(320, 240), metavar="WxH", help="of the photos")
    synth.add_argument("--response", default="film", metavar="film|gamma|linear|FILE", help="of the camera")
    synth.add_argument("--compact", action="store_true", help="leave out what no metric needs, compress with loss")
    _add_sampling(synth, default=256)


@dataclass(frozen=True)
class FrameRange:
    """The requested frames of an animation: ``first`` … ``last``, both included."""

    first: int
    last: int

    @classmethod
    def parse(cls, text: str, lowest: int = 1) -> FrameRange:
        """``"1-120"`` or ``"7"``, from ``lowest`` on; raises ValueError."""
        first, _, last = text.partition("-")
        frames = cls(int(first), int(last or first))
        if not lowest <= frames.first <= frames.last <= MAX_FRAMES:
            raise ValueError(text)
        return frames

    def __iter__(self) -> Iterator[int]:
        return iter(range(self.first, self.last + 1))

    def __len__(self) -> int:
        return self.last - self.first + 1


class _InAces(argparse.Action):
    """What is written in ACEScg is linear."""

    def __call__(self, _parser: object, namespace: argparse.Namespace, *_: object) -> None:
        namespace.linear = namespace.acescg = True


def _add_acescg(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--acescg", action=_InAces, nargs=0, default=False, help="as --linear, in ACEScg, not Rec.709")


def _add_sampling(parser: argparse.ArgumentParser, default: int = 64) -> None:
    parser.add_argument("--samples", type=_positive, default=default, help="per pixel")
    parser.add_argument("--seed", type=_whole, default=0, help="of all randomness")


def _whole(text: str) -> int:
    if not text.isdecimal() or len(text) > 18 or int(text) > MAX_SEED:
        raise argparse.ArgumentTypeError(f"{text[:40]!r} is not a whole number from 0 to {MAX_SEED}")
    return int(text)


def _positive(text: str) -> int:
    if _whole(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 to {MAX_SEED}")
    return int(text)


def _coordinate(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.inf
    if not abs(value) <= MAX_METRES:
        raise argparse.ArgumentTypeError(f"{text[:40]!r} is not a coordinate in meters")
    return value


def _panorama_width(text: str) -> int:
    width = _positive(text)
    if width % 2 or not 8 <= width <= MAX_PANORAMA_WIDTH:
        raise argparse.ArgumentTypeError(f"{text!r} is not an even number of pixels from 8 to {MAX_PANORAMA_WIDTH}")
    return width


def _frames(text: str) -> FrameRange:
    try:
        return FrameRange.parse(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no range of frames like 1-120") from None


def _plate_frames(text: str) -> FrameRange:
    try:
        return FrameRange.parse(text, lowest=0)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no range of frames like 1001-1024") from None


def _resolution(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if _positive(width) * _positive(height) > MAX_RESOLUTION:
        raise argparse.ArgumentTypeError(f"{text!r} is more than {MAX_RESOLUTION // 1_000_000} million pixels")
    return int(width), int(height)


def _metres(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 1 / MAX_METRES <= value <= MAX_METRES:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a number of meters from {1 / MAX_METRES:g} to {MAX_METRES:g}"
        )
    return value


def _camera_height(text: str) -> CameraHeight:
    return CameraHeight(_metres(text))


def _exposure(text: str) -> str | float:
    if text in ("photo", "auto"):
        return text
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value <= MAX_EXPOSURE:
        raise argparse.ArgumentTypeError(f"{text!r} is neither photo, auto nor a factor above 0")
    return value


def _checked(read: Callable[[str], int | float | str]) -> Callable[[str], int | float | str]:
    """A type of argument whose errors are those of ``read``."""

    def checked(text: str) -> int | float | str:
        try:
            return read(text)
        except ValueError as error:
            raise argparse.ArgumentTypeError(f"{text[:40]!r} is {error}") from None

    return checked


def _word_or_path(*words: str) -> Callable[[str], str | Path]:
    return lambda text: text if text in words else Path(text)
