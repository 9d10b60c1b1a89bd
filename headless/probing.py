"""Commands that render the light of a room: probe, at one point as a panorama; looks, by its source in one view."""

from __future__ import annotations

import argparse

from iris_addon.base.errors import BadInput
from iris_addon.base.progress import Progress
from iris_addon.base.untrusted import read_json
from iris_addon.edits.jobs import relight_edit
from iris_addon.model.render_settings import RenderSettings
from iris_addon.results.folder import load_result

from .outcome import Outcome


def probe(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Result folder or .blend to an HDRI."""
    from iris_addon.blender.images import read_image
    from iris_addon.blender.insert.probe import probe_file, probe_result

    if args.out.suffix.lower() != ".exr":
        raise BadInput("is no .exr", "name the panorama with that suffix: other formats hold no radiance", args.out)
    if args.acescg:
        from .pictures import write_picture  # needs more than Blender's Python has, and says so before anything is done
    settings = RenderSettings(samples=args.samples, seed=args.seed, gpu=args.gpu)
    with progress.stage("probe"):
        if args.source.is_dir():
            result, edit = load_result(args.source, read_image).in_state(args.light_state), None
            if args.lights is not None:
                edit = relight_edit(result, read_json(args.lights), args.lights.parent)
            progress.check()
            probe_result(result, args.at, args.out, width=args.width, settings=settings, edit=edit)
        elif args.lights is not None or args.light_state is not None:
            option = "--lights" if args.light_state is None else "--light-state"
            raise BadInput("already has its lights in the .blend", f"leave out {option}, or give a result", args.source)
        elif not args.source.is_file():
            raise BadInput("is neither the folder of a result nor a .blend", "correct the path", args.source)
        else:
            probe_file(args.source, args.at, args.out, width=args.width, settings=settings)
        if args.acescg:
            write_picture(args.out, read_image(args.out), acescg=True)
    return Outcome.of("Wrote the light at that point", {"files": [args.out]})


def looks(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Light shares of the view of a .blend's camera, for the panel."""
    from iris_addon.blender.insert.look_shares import look_shares_file

    settings = RenderSettings(samples=args.samples, seed=args.seed, gpu=args.gpu)
    with progress.stage("looks"):
        look_shares_file(args.blend, args.out, width=args.width, settings=settings)
    return Outcome.of("Wrote the light of every source", {"files": [args.out]})
