"""The commands that render a solved room: render, relight, insert, composite; and the export of its camera.

Each one reads the result, passes views and edits to Cycles, and writes every picture as soon as it is rendered.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from iris_addon.base.errors import BadInput
from iris_addon.base.progress import Progress
from iris_addon.base.untrusted import read_json
from iris_addon.edits.jobs import insertion_edits, relight_edit
from iris_addon.edits.scene_edit import SceneEdit
from iris_addon.model.capture import View
from iris_addon.model.render_settings import RenderSettings
from iris_addon.results.folder import load_result
from iris_addon.results.result import Result

from .asked_state import in_asked_state, state_of_photo
from .outcome import Outcome

if TYPE_CHECKING:
    from .pictures import Developer  # needs packages that Blender's own Python lacks; `composite` runs there

EditAt = Callable[[float], SceneEdit | None]


def camera(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Response, exposures and white balance as look-up tables."""
    from iris_addon.results.camera_luts import write_luts

    result = load_result(args.result)
    progress.check()
    return Outcome.of(
        "Wrote the camera", {"files": write_luts(args.out, result.response, result.exposures, result.devices)}
    )


def composite(args: argparse.Namespace, progress: Progress) -> Outcome:
    """The artist's additions to the room of a .blend, composited onto a photo or the frames of a plate."""
    if args.acescg and not args.layers:
        raise BadInput("--acescg is of layers: pictures have the photo's values", "give --layers with it", args.blend)
    if args.frames is not None:
        if args.photo is not None or args.view is not None or args.out.suffix:
            what = "has --frames, which are those behind its camera, and go into a folder"
            raise BadInput(what, "leave out --photo and --view, and give a folder as --out", args.blend)
        from .plates import composite_plate

        return composite_plate(args, progress)
    if args.photo is None or args.view is None:
        raise BadInput("is composited onto what?", "give --photo and --view, or --frames of a plate", args.blend)
    from iris_addon.base.color_spaces import ACESCG
    from iris_addon.blender.insert.photo_composite import RENDERS, CompositeFiles, composite_file
    from iris_addon.results.records import exposure_of, read_response

    camera = read_response(args.result)
    device = camera.device_of(args.view)
    if device.response.family == "identity":
        what, fix = "was solved from radiance, so the response of photos is not known", "solve the photos"
        raise BadInput(what, fix, args.result)
    layers = args.out.with_name(f"{args.out.stem}-layers.exr") if args.layers else None
    files = CompositeFiles(
        blend=args.blend, photo=args.photo, out=args.out, layers=layers, space=ACESCG if args.acescg else None
    )
    with progress.stage("composite"):
        composite_file(
            files,
            device,
            exposure_of(args.view, camera.exposures),
            _render_settings(args),
            state_of_photo(args),
            on_step=lambda done: progress.update(done / RENDERS),
        )
    return Outcome.of("Composited", {"files": [args.out, *([] if layers is None else [layers])]})


def render(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Novel views; with --light-shares the share of every light in them."""
    result, views = _read(args)
    if args.light_shares:
        _without_frames(args, "--light-shares")
        _without_exposure(args, "--light-shares")
        return _render_shares(args, progress, result, views)
    job = {"camera": {"path": "all"}}
    return _render_edited(args, progress, result, views, job, lambda _time: None)


def relight(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Views in other light, rendered or mixed from light shares."""
    result, views = _read(args)
    job = read_json(args.lights)
    if args.shares is not None:
        _without_frames(args, "--shares")
        return _mix_shares(args, progress, result, views, job)
    with _naming(args.lights):
        relight_edit(result, job, args.lights.parent)  # errors come before anything is rendered

    def edit_at(time: float) -> SceneEdit:
        return relight_edit(result, job, args.lights.parent, time)

    return _render_edited(args, progress, result, views, job, edit_at)


def insert(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Views with inserted objects, rendered completely or composited onto their photos."""
    result, views = _read(args)
    job = read_json(args.objects)
    cameras = [view.camera for view in views]

    def edits_at(time: float) -> list[tuple[int, SceneEdit]]:
        with _naming(args.objects):
            return insertion_edits(result, job, args.objects.parent, cameras, time)

    edits = edits_at(0.0)
    missing = [index for index, _ in edits if index >= len(views)]
    if missing:
        what = f"names view {missing[0]}, there are {len(views)}"
        raise BadInput(what, f"count the views of {args.views}", args.objects)
    shown = [index for index, _ in edits]
    repeated = [index for index in shown if shown.count(index) > 1]
    if repeated:
        raise BadInput(f"names view {repeated[0]} twice", "put all objects of a view into one entry", args.objects)
    if args.onto_photos:
        _without_exposure(args, "--onto-photos")
    if args.layers and (not args.onto_photos or args.frames is not None):
        raise BadInput("--layers are of single photos", "give --onto-photos with it, and no --frames")
    if args.onto_photos and "camera" in job:
        raise BadInput("moves the camera, but a photo stays where it is", "leave out 'camera'", args.objects)
    if args.frames is not None and len(edits) != 1:
        raise BadInput(f"has objects for {len(edits)} views", "keep one of them for an animation", args.objects)
    if args.onto_photos:
        return _insert_onto_photos(args, progress, result, views, job, edits_at)
    if args.frames is not None:
        job = {"camera": {"view": edits[0][0]}, **job}
        return _render_edited(args, progress, result, views, job, lambda time: edits_at(time)[0][1])

    from iris_addon.blender.render.cycles import render_views

    developer, written = _developer(args, result), []
    with progress.stage("insert"):
        for number, (index, edit) in enumerate(edits):
            cameras = [views[index].camera]
            (radiance,) = render_views(result, cameras, edit=edit, settings=_render_settings(args))
            written.append(developer.write(views[index], radiance))
            progress.update((number + 1) / len(edits))
    return Outcome.of("Rendered", {"files": written})


# ---- complete renders ----------------------------------------------------------------------------------------------


def _render_edited(
    args: argparse.Namespace,
    progress: Progress,
    result: Result,
    views: Sequence[View],
    job: dict[str, Any],
    edit_at: EditAt,
) -> Outcome:
    """Every view under one edit, or the frames of an animation."""
    if args.frames is not None:
        from .animation import render_frames

        return render_frames(args, progress, result, views, job, edit_at, _render_settings(args))
    from iris_addon.blender.render.cycles import render_views

    developer, written = _developer(args, result), []

    def on_view(index: int, radiance: NDArray[np.float32]) -> None:
        written.append(developer.write(views[index], radiance))
        progress.update((index + 1) / len(views))

    with progress.stage(args.command):
        cameras = [view.camera for view in views]
        render_views(result, cameras, edit=edit_at(0.0), settings=_render_settings(args), on_view=on_view)
    return Outcome.of("Rendered", {"files": written})


# ---- onto photos ---------------------------------------------------------------------------------------------------


def _insert_onto_photos(
    args: argparse.Namespace,
    progress: Progress,
    result: Result,
    views: Sequence[View],
    job: dict[str, Any],
    edits_at: Callable[[float], list[tuple[int, SceneEdit]]],
) -> Outcome:
    from iris_addon.base.color_spaces import ACESCG
    from iris_addon.blender.insert.differential import write_layers

    from .onto_photos import PhotoInsertion, write_changed

    edits = edits_at(0.0)
    for index, _ in edits:
        if views[index].photo is None:
            what = f"{views[index].name} has no photo"
            raise BadInput(what, "leave out --onto-photos or add the photo", args.views)
    if args.frames is not None:
        from .animation import insert_frames

        insertion = PhotoInsertion(result, views[edits[0][0]], _render_settings(args))
        return insert_frames(args, progress, insertion, job, lambda time: edits_at(time)[0][1])
    written, warnings = [], []
    with progress.stage("insert"):
        for number, (index, edit) in enumerate(edits):
            picture = PhotoInsertion(result, views[index], _render_settings(args)).picture(edit)
            written.append(write_changed(picture, args.out, views[index].name, linear=args.linear, acescg=args.acescg))
            picture_name = written[-1].name
            if args.layers:
                path = args.out / f"{views[index].name}-layers.exr"
                write_layers(path, picture, ACESCG if args.acescg else None)
                written.append(path)
            if (edit.objects or edit.spheres) and not picture.shows_added:
                warnings.append(f"{picture_name} shows none of its objects: check where they are placed")
            progress.update((number + 1) / len(edits))
    return Outcome.of("Rendered", {"files": written} | ({"warnings": warnings} if warnings else {}))


# ---- light shares --------------------------------------------------------------------------------------------------


def _render_shares(args: argparse.Namespace, progress: Progress, result: Result, views: Sequence[View]) -> Outcome:
    from iris_addon.blender.render.light_groups import render_light_shares
    from iris_addon.edits.light_shares import write_shares

    written = []
    with progress.stage("render"):
        for number, view in enumerate(views):
            shares = render_light_shares(result, view.camera, settings=_render_settings(args))
            written.append(args.out / f"{view.name}.exr")
            write_shares(written[-1], shares)
            progress.update((number + 1) / len(views))
    return Outcome.of("Rendered every light's share", {"files": written})


def _mix_shares(
    args: argparse.Namespace, progress: Progress, result: Result, views: Sequence[View], job: dict[str, Any]
) -> Outcome:
    from iris_addon.edits.light_shares import light_gains, mix_shares, read_shares

    with _naming(args.lights):
        gains = light_gains(result, job)
    developer, written = _developer(args, result), []
    with progress.stage("mix"):
        for number, view in enumerate(views):
            shares = read_shares(args.shares / f"{view.name}.exr", (view.camera.width, view.camera.height))
            written.append(developer.write(view, mix_shares(shares.shares, gains)))
            progress.update((number + 1) / len(views))
    return Outcome.of("Mixed", {"files": written})


# ---- common --------------------------------------------------------------------------------------------------------


def _render_settings(args: argparse.Namespace) -> RenderSettings:
    return RenderSettings(samples=args.samples, seed=args.seed, gpu=args.gpu)


def _read(args: argparse.Namespace) -> tuple[Result, tuple[View, ...]]:
    from iris_addon.capture.reader import read_views

    result = load_result(args.result)
    views = read_views(args.views, result.report)
    if args.only:
        missing = sorted(set(args.only) - {view.name for view in views})
        if missing:
            raise BadInput(f"has no view named {missing[0]}", "name views as the pictures are named", args.views)
        views = tuple(view for view in views if view.name in args.only)
    return in_asked_state(args, result, views), tuple(result.as_taken(views))


def _without_frames(args: argparse.Namespace, option: str) -> None:
    if args.frames is not None:
        raise BadInput(f"{option} makes one picture per view, --frames makes many", f"leave out {option} or --frames")


def _without_exposure(args: argparse.Namespace, option: str) -> None:
    if args.exposure != "photo":
        raise BadInput(f"{option} leaves no exposure to choose", f"leave out {option} or --exposure")


def _developer(args: argparse.Namespace, result: Result) -> Developer:
    from .pictures import Developer

    return Developer(result, args.out, args.exposure, linear=args.linear, acescg=args.acescg)


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Inside, errors about the job name its file."""
    try:
        yield
    except BadInput as error:
        raise BadInput(error.what, error.fix, path) from error
