"""An insertion job put onto every frame of a plate, an image sequence whose moving camera is known in the solved room.

Frames are independent of each other: the exposure of each is found by itself, a finished one is not made again, one
that fails is named and the others go on. Several machines may each make a range of them.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from iris_addon.base.errors import MAX_QUOTED, BadInput, Cancelled, IrisError, one_line
from iris_addon.base.files import write_json
from iris_addon.base.progress import Progress

from .frame_folder import FloatArray, Frames, open_frames, result_digests, write_film
from .outcome import Outcome

if TYPE_CHECKING:
    import bpy

    from iris_addon.blender.insert.differential import ChangedPhoto, Differential
    from iris_addon.edits.scene_edit import SceneEdit
    from iris_addon.model.capture import View
    from iris_addon.model.device import Device
    from iris_addon.model.render_settings import RenderSettings
    from iris_addon.results.result import Result

EXPOSURES = "exposures"
"""Folder beside the frames with the exposure that was found for each."""
LAYERS = "layers"
"""Folder beside the frames with the layers of each, where they are asked for."""
MAX_NAMED = 20
"""Failed frames that one message lists."""


def onto_plate(args: argparse.Namespace, progress: Progress) -> Outcome:
    """A plate with the objects of a job in it."""
    from iris_addon.base.color_spaces import ACESCG
    from iris_addon.base.images import HDR_SUFFIXES, check_image, read_exr
    from iris_addon.base.untrusted import read_json
    from iris_addon.blender.insert.differential import write_layers
    from iris_addon.capture.exposures import with_device
    from iris_addon.capture.plate_files import plate_files
    from iris_addon.capture.reader import read_views
    from iris_addon.edits.jobs import insertion_edits
    from iris_addon.model.render_settings import RenderSettings
    from iris_addon.results.folder import load_result

    from .animation import moves
    from .asked_state import in_asked_state, state_of_frames
    from .onto_photos import write_changed

    pictures = plate_files(args.plate)
    result = load_result(args.result)
    taken = read_views(args.camera, result.report)
    result = in_asked_state(args, result, taken)
    views = _by_number(result.as_taken(taken), args.camera)
    job = read_json(args.objects)
    for key, option in {"camera": "--camera", "length": "the plate"}.items():
        if key in job:
            raise BadInput(f"has '{key}', which {option} gives", f"leave out '{key}'", args.objects)
    cameras = [view.camera for view in views.values()]

    def edit_at(time: float) -> SceneEdit:
        try:
            edits = insertion_edits(result, job, args.objects.parent, cameras, time)
        except BadInput as error:
            raise BadInput(error.what, error.fix, args.objects) from error
        if len(edits) != 1:
            raise BadInput(f"has objects for {len(edits)} views", "keep one of them for a plate", args.objects)
        return edits[0][1]

    edit_at(0.0)  # errors of the job come before anything is rendered
    first = min(views)
    hdr = args.linear or next(iter(pictures.values())).suffix.lower() in HDR_SUFFIXES
    frames = open_frames(
        args.out,
        max(views) - first + 1,
        ".exr" if hdr else ".png",
        {
            "command": args.command,
            "result": result_digests(args.result),
            "cameras": [[n, view.camera.fx, view.camera.fy, view.camera.c2w] for n, view in views.items()],
            "plate": [first, *(path.name for path in pictures.values())],
            "job": job,
            "look": [args.samples, args.seed, *(["acescg"] if args.acescg else [])],
            **state_of_frames(args, taken),
        },
        first,
    )
    settings = RenderSettings(samples=args.samples, seed=args.seed, gpu=args.gpu)

    def work(number: int) -> bool:
        if number not in views:
            raise BadInput(
                f"has no camera of frame {number}", "track the whole range, or shorten --frames", args.camera
            )
        if number not in pictures:
            raise BadInput(f"has no frame {number}", "add the picture, or shorten --frames", args.plate)
        view = with_device(replace(views[number], name=frames.path(number).stem, photo=pictures[number], split="val"))
        picture, exposure = room.picture(view, frames.time(number))
        if exposure is not None:
            _write_exposure(frames, number, exposure, pictures[number])
        if args.layers:
            write_layers(_layers_of(frames, number), picture, ACESCG if args.acescg else None)
        write_changed(picture, frames.folder, view.name, linear=hdr, acescg=args.acescg)
        return picture.shows_added

    def whole_file(number: int) -> bool:
        path, layers = frames.path(number), _layers_of(frames, number)
        with suppress(BadInput):  # half of a file, as a copy that was stopped leaves
            if args.layers and not (layers.is_file() and read_exr(layers).size > 0):
                return False
            return frames.finished(number) and (read_exr(path).size if hdr else min(check_image(path))) > 0
        return False

    with PlateRoom(result, edit_at, moves(job), settings) as room:
        numbers = list(views if args.frames is None else args.frames)
        return make_frames(progress, frames, numbers, work, whole_file, args.fps)


def _by_number(views: Iterable[View], source: Path) -> dict[int, View]:
    """The views by frame number, in its order."""
    from iris_addon.capture.plate_files import frame_number

    found: dict[int, View] = {}
    for view in views:
        number = frame_number(view.name if view.photo is None else view.photo.stem)
        if number is None:
            raise BadInput(f"{view.name} has no frame number", "name frames as shot.1001.png", source)
        if number in found:
            what = f"has two cameras of frame {number}, {found[number].name} and {view.name}"
            raise BadInput(what, "keep one of them", source)
        found[number] = view
    return dict(sorted(found.items()))


class PlateRoom:
    """The solved room with a job in it, as the camera of one frame after another sees it; a context manager.

    The room alone is built once, with the job once as well unless that ``moves``.
    """

    def __init__(
        self, result: Result, edit_at: Callable[[float], SceneEdit], moves: bool, settings: RenderSettings
    ) -> None:
        self.result, self.edit_at, self.moves, self.settings = result, edit_at, moves, settings
        self._kept = ExitStack()
        self._room: Any = None
        self._edited: Any = None

    def __enter__(self) -> PlateRoom:
        return self

    def __exit__(self, *_raised: object) -> None:
        self._kept.close()

    def picture(self, view: View, time: float) -> tuple[ChangedPhoto, FloatArray | None]:
        """The frame ``view`` with the objects as they are at ``time``, and its exposure (3,), None if nothing changes.

        Raises:
            BadInput: the frame cannot be read, is of another size than its camera, or shows too little.
        """
        from iris_addon.blender.insert.differential import change_photo, unchanged_photo
        from iris_addon.capture.photos import load_photo
        from iris_addon.response.matching import match_exposure

        from .onto_photos import require_response

        photo, device = load_photo(view), self.result.device_of(view)
        response = None if photo.hdr else device.response
        require_response(self.result, photo, view)
        values, edit = photo.values.astype(np.float64), self.edit_at(time)
        if edit.changes_nothing:
            return unchanged_photo(values, response, 1.0), None
        changed = self._change(view, edit)
        gain = np.ones(1) if photo.hdr else device.gain(photo.values)
        exposure = match_exposure(changed.without, photo, device.response, gain)
        return change_photo(values, changed, response, gain * exposure), exposure

    def _change(self, view: View, edit: SceneEdit) -> Differential:
        from iris_addon.blender.insert.differential import change_of, pair_of, render_change, room_built

        if self._room is None:
            self._room = self._kept.enter_context(room_built(self.result, None))
        without = pair_of(self._room, view.camera, self.settings)
        if self.moves:
            return render_change(self.result, view.camera, edit, without, self.settings)
        if self._edited is None:
            self._edited = self._kept.enter_context(room_built(self.result, edit))
        return change_of(self._edited, view.camera, without, self.settings)


# ---- the scene of a .blend ------------------------------------------------------------------------------------------


def composite_plate(args: argparse.Namespace, progress: Progress) -> Outcome:
    """What was added to the room of a .blend, onto the plate behind its camera, or the whole scene where that shows
    none; needs no package but Blender's."""
    from iris_addon.base.color_spaces import ACESCG
    from iris_addon.blender.insert.photo_composite import open_scene
    from iris_addon.blender.insert.plate import RADIANCE_SUFFIX, plate_picture, shows_plate
    from iris_addon.blender.insert.plate_composite import FrameLayers, composite_frame
    from iris_addon.model.render_settings import RenderSettings
    from iris_addon.results.records import read_response

    from .asked_state import state_of_plate

    device = read_response(args.result).device_of("")  # that of most photos: a plate is none of them
    scene = open_scene(args.blend)
    if not shows_plate(scene):
        if args.light_state is not None:
            what = "shows no plate behind its camera, so it is rendered in the light that it has"
            raise BadInput(what, "leave out --light-state, and set its lights", args.blend)
        if args.layers:
            what = "shows no plate behind its camera, so there are no layers over it"
            raise BadInput(what, "leave out --layers", args.blend)
        return _whole_scene(args, progress, scene, device)
    light_state = state_of_plate(args)
    hdr = plate_picture(scene, args.frames.first).suffix.lower() == RADIANCE_SUFFIX
    if device.response.family == "identity" and not hdr:
        what, fix = "was solved from radiance, so the response of the plate is not known", "give the plate as EXR"
        raise BadInput(what, fix, args.result)
    frames = _frames_of(args, scene, ".exr" if hdr else ".png", light_state)
    settings = RenderSettings(samples=args.samples, seed=args.seed, gpu=args.gpu)
    if args.layers:
        _forget_layers_of_another(frames, "acescg" if args.acescg else "rec709")

    def work(number: int) -> bool:
        layers = FrameLayers(_layers_of(frames, number), ACESCG if args.acescg else None) if args.layers else None
        frame = composite_frame(scene, number, frames.path(number), device, settings, light_state, layers)
        _write_exposure(frames, number, frame.exposure, frame.picture)
        return frame.shows_added

    return _make_scene_frames(args, progress, scene, frames, work)


def _whole_scene(args: argparse.Namespace, progress: Progress, scene: bpy.types.Scene, device: Device) -> Outcome:
    """The frames of a scene without a plate, as the camera of the photos would show them at the exposure of the first
    that this run renders, or with --resume that of the run before."""
    from iris_addon.blender.insert.photo_composite import write_png
    from iris_addon.blender.render.cycles import render_linear, set_cycles
    from iris_addon.model.render_settings import RenderSettings
    from iris_addon.model.response import grey_exposure

    if scene.camera is None:
        raise BadInput("has no active camera", "add the camera of the animation", args.blend)
    frames = _frames_of(args, scene, ".png")
    if not args.resume and frames.facts.pop("exposure", None) is not None:  # of a scene that may have changed since
        frames.remember()
    scene.render.use_border = False
    set_cycles(scene, RenderSettings(samples=args.samples, seed=args.seed, gpu=args.gpu))

    def work(number: int) -> bool:
        scene.frame_set(number)
        radiance = render_linear(scene)
        if "exposure" not in frames.facts:
            frames.remember(exposure=grey_exposure(radiance))
        write_png(frames.path(number), device.response.apply(radiance * frames.exposure()))
        return True

    return _make_scene_frames(args, progress, scene, frames, work)


def _frames_of(args: argparse.Namespace, scene: bpy.types.Scene, suffix: str, light_state: str | None = None) -> Frames:
    made_of = {"command": "composite", "result": result_digests(args.result)}
    if light_state is not None:
        made_of["light_state"] = light_state
    whole = {"first": scene.frame_start, "length": scene.frame_end - scene.frame_start + 1}
    return replace(open_frames(args.out, 1, suffix, made_of), **whole)


def _forget_layers_of_another(frames: Frames, space: str) -> None:
    """Remove the layers of an earlier run in another color space than ``space``: one sequence has one."""
    if frames.facts.get("layers", space) != space:
        for number in range(frames.first, frames.first + frames.length):
            _layers_of(frames, number).unlink(missing_ok=True)
    frames.remember(layers=space)


def _make_scene_frames(
    args: argparse.Namespace,
    progress: Progress,
    scene: bpy.types.Scene,
    frames: Frames,
    work: Callable[[int], bool],
) -> Outcome:
    from iris_addon.base.image_headers import announced_size
    from iris_addon.blender.images import read_image

    def finished(number: int) -> bool:
        with suppress(BadInput):
            layers = _layers_of(frames, number)
            if not args.resume or (args.layers and not (layers.is_file() and announced_size(layers))):
                return False
            return frames.finished(number) and read_image(frames.path(number)).size > 0
        return False

    fps = max(round(scene.render.fps / scene.render.fps_base), 1)
    return make_frames(progress, frames, list(args.frames), work, finished, fps)


# ---- frame by frame ------------------------------------------------------------------------------------------------


def make_frames(
    progress: Progress,
    frames: Frames,
    numbers: Sequence[int],
    work: Callable[[int], bool],
    finished: Callable[[int], bool],
    fps: int,
) -> Outcome:
    """Let ``work`` make the frames ``numbers`` that are not ``finished``; it tells whether a frame shows an object.

    A frame that fails is named on stderr at once.

    Raises:
        IrisError: frames failed; all others are there.
    """
    todo = [number for number in numbers if not finished(number)]
    failed: dict[int, str] = {}
    shown: list[bool] = []
    with progress.stage("frames"):
        for done, number in enumerate(todo):
            progress.update((len(numbers) - len(todo) + done) / len(numbers))
            try:
                shown.append(work(number))
            except Cancelled:
                raise
            except IrisError as error:
                failed[number] = str(error)
            except Exception as error:  # the other frames go on, whatever it is
                failed[number] = one_line(f"{type(error).__name__}: {error}", MAX_QUOTED)
            if number in failed:
                print(f"frame {number}: {failed[number]}", file=sys.stderr, flush=True)
    if failed:
        first = next(iter(failed))
        names = ", ".join(map(str, list(failed)[:MAX_NAMED])) + (" …" if len(failed) > MAX_NAMED else "")
        what = f"{len(failed)} of {len(numbers)} frames failed ({names}), frame {first} because: {failed[first]}"
        raise IrisError(what, "mend it and run again: finished frames are kept", frames.folder)
    figures = {
        "frames": len(numbers),
        "rendered now": len(todo),
        "folder": frames.folder,
        "film": write_film(frames, fps),
        "warnings": ["no frame shows what was added: check where it is placed"] if shown and not any(shown) else None,
    }
    return Outcome.of("Put onto the plate", {key: value for key, value in figures.items() if value is not None})


def _layers_of(frames: Frames, number: int) -> Path:
    return frames.folder / LAYERS / f"{frames.path(number).stem}.exr"


def _write_exposure(frames: Frames, number: int, exposure: FloatArray, picture: Path) -> None:
    path = frames.folder / EXPOSURES / f"{frames.path(number).stem}.json"
    write_json(path, {"exposure": exposure, "picture": picture.name})
