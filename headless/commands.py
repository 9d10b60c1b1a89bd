"""What each command does: read, call one room of the engine, write. Returns an :class:`Outcome`; errors are raised.

Rooms are imported where they are called, so that a command needs only the packages it uses.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from iris_addon.base.files import write_json
from iris_addon.base.progress import Progress
from iris_addon.config import TEXTURE_OPTIONS, preset
from iris_addon.model.capture import View
from iris_addon.results.folder import load_result

from .outcome import Outcome, summarise
from .plates import onto_plate
from .probing import looks, probe
from .relighting import camera, composite, insert, relight, render

__all__ = [
    "apply",
    "batch",
    "camera",
    "composite",
    "demo",
    "evaluate",
    "farm",
    "fuse",
    "insert",
    "inspect",
    "looks",
    "onto_plate",
    "probe",
    "relight",
    "render",
    "solve",
    "synth",
]


def solve(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Capture folder to result folder."""
    from iris_addon.capture.reader import read_capture

    _mesh_of_depth(args.capture, progress)
    config = preset(
        args.preset,
        **{name: getattr(args, name) for name in ("response", "exposures", "hdr", "device", "seed", *TEXTURE_OPTIONS)},
    )
    capture = read_capture(
        args.capture,
        exposures=config.exposures,
        hdr=config.hdr,
        strict=args.strict,
        metres_per_unit=args.unit,
        exclude=args.exclude,
        check=progress.check,
    )
    from iris_addon.pipeline import solve as run_solve  # slow to import: errors of the capture come first

    result = run_solve(capture, config, args.out, progress, resume=args.resume)
    figures = {"result": args.out, "report": args.out / "report.html", **summarise(result)}
    return Outcome.of(f"Solved {capture.name}", figures)


def inspect(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Measurements of a capture before it is solved."""
    from iris_addon.capture.inspection import inspect as measure
    from iris_addon.capture.reader import read_capture

    _mesh_of_depth(args.capture, progress)
    with progress.stage("reading"):
        capture = read_capture(
            args.capture,
            exposures=args.exposures,
            strict=args.strict,
            metres_per_unit=args.unit,
            check=progress.check,
        )
    config = preset(args.preset, **{name: getattr(args, name) for name in TEXTURE_OPTIONS})
    content = measure(capture, args.out, progress, config)
    figures = {"photos": len(capture.views), "textures": content["textures"]["text"], "warnings": content["warnings"]}
    return Outcome.of(f"Looked at {capture.name}", figures)


def fuse(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Posed depth to one mesh."""
    from iris_addon.capture.mesh_from_depth import fuse_capture

    with progress.stage("depth"):
        made = fuse_capture(args.capture, args.out, args.voxel, progress.update)
    figures = {"mesh": made.path, "faces": made.faces, "depth maps": made.maps, "voxel": f"{made.voxel:.3g} m"}
    return Outcome.of("Fused the depth", figures)


def _mesh_of_depth(path: Path, progress: Progress) -> None:
    """Fuse a capture's depth where it has no mesh, with progress of its own."""
    from iris_addon.capture.mesh_from_depth import depth_without_mesh, keep_fused

    if maps := depth_without_mesh(path):
        with progress.stage("depth"):
            keep_fused(path, maps, progress.update)


def apply(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Result folder to .blend."""
    from iris_addon.blender.apply.lighten import Limits
    from iris_addon.blender.apply.scene_files import apply as write_blend
    from iris_addon.blender.images import read_image

    result = load_result(args.result, read_image)
    views: Sequence[View] = ()
    if args.views is not None:
        from iris_addon.capture.reader import read_views

        views = result.as_taken(read_views(args.views, result.report))
    progress.check()
    write_blend(result, args.blend, views=views, glb=args.glb, usd=args.usd, light=Limits() if args.light else None)
    written = [path for path in (args.blend, args.glb, args.usd) if path is not None]
    return Outcome.of("Wrote the room", {"files": written})


def evaluate(args: argparse.Namespace, progress: Progress) -> Outcome:
    """The metrics of a result."""
    from iris_addon.evaluate.evaluation import evaluate as score

    render_views = None
    if not args.no_render:
        from iris_addon.blender.render.cycles import render_views
    result = load_result(args.result)
    scores = score(result, args.gt, render=render_views, samples=args.samples, seed=args.seed, progress=progress)
    if isinstance(args.json, Path):
        write_json(args.json, scores)
    outcome = Outcome.of(f"{args.result} against {args.gt}", scores)
    left_out = [f"  left out: {name} ({why})" for name, why in scores["left_out"].items()]
    return Outcome("\n".join([outcome.text, *left_out]), scores)


def synth(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Blender scene to capture with ground truth."""
    from iris_addon.blender.synth.run import TRUTH_RENDER, SynthConfig
    from iris_addon.blender.synth.run import synth as write_capture

    config = SynthConfig(
        cameras=args.cameras,
        resolution=args.resolution,
        response=args.response,
        compact=args.compact,
        render=replace(TRUTH_RENDER, samples=args.samples, seed=args.seed),
    )
    write_capture(args.scene, args.out, config, progress)
    return Outcome.of("Wrote the capture", {"capture": args.out})


def batch(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Many jobs, one summary."""
    from .batch import run_batch

    return run_batch(args, progress)


def farm(args: argparse.Namespace, _progress: Progress) -> Outcome:
    """A job file as a bundle for a farm."""
    from .farm import write_bundle

    return write_bundle(args.jobs, args.out)


def demo(args: argparse.Namespace, progress: Progress) -> Outcome:
    """The whole job on the bundled capture."""
    from .demo import run_demo

    return run_demo(args.out, progress)
