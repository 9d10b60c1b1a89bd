"""The stages of a solve in order: from a capture to a result folder. Each is a pure function of those before it.

::

    photos -> surface -> response -> transport -> lights -> materials -> textures -> result
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from .base.files import abandoned, remove_abandoned, require_own_folder
from .base.parallel import aside, waited_for
from .base.progress import Progress
from .base.random_streams import stream
from .cameras.fit import fit_cameras
from .capture.exposures import with_unit_mean
from .config import SolveConfig
from .decide import Decisions
from .lighting.candidates import read_given_emitters
from .lighting.hidden import HiddenSources, find_hidden, nothing_hidden
from .materials.first_lights import FirstLights, RoomInState, find_first_lights, pose_states
from .materials.rounds import solve_materials
from .materials.solution import Solution
from .model.capture import Capture
from .model.light_states import LightStates, joined_arrays, split_arrays
from .rays.engines import choose_engine
from .rays.tracer import Tracer
from .response.observations import Observations, observe
from .response.photo_quality import PhotoQuality
from .response.photometry import Photometry, fixed_response, measure_photometry, shown_pixels
from .response.unlike_lights import find_unlike_lights
from .results.assembly import make_result, with_figures
from .results.checkpoints import Checkpoints, Stage, fingerprint, sole_writer
from .results.files import REPORT_PAGE, require_no_links
from .results.folder import save_result
from .results.preview import write_previews
from .results.report import write_report
from .results.result import Result
from .surface.panes import find_panes
from .surface.photo_samples import PhotoSamples, sample_photos, within_budget
from .surface.scan_surface import choose_surface
from .surface.traced_room import TracedRoom, trace_room
from .textures.charts import atlas_for_photos
from .textures.texel_density import density_warnings, describe_atlas
from .transport.cache import cached_transport
from .transport.transport import choose_device

Made = TypeVar("Made")
STAGE_SECONDS = {
    "photos": 3,
    "surface": 3,
    "response": 6,
    "transport": 8,
    "lights": 15,
    "materials": 20,
    "textures": 20,
    "report": 5,
}
"""Expected seconds per stage, for the overall progress bar."""


def solve(
    capture: Capture, config: SolveConfig, out: Path, progress: Progress | None = None, resume: bool = False
) -> Result:
    """Recover response, exposures, lights and materials; write the result folder ``out``.

    Raises:
        BadInput: photos and mesh do not belong together, a photo cannot be read, all photos are clipped, another
            process is solving into ``out``, a link there leads elsewhere, or torch finds no GPU where one is requested.
        Cancelled: finished stages stay in ``out`` for ``resume``.
        IrisError: the disk is full.
    """
    if capture.mismatch is not None:
        raise capture.mismatch
    # Matrices are narrow: threads of the linear algebra library would only take cores from those of the solve.
    with sole_writer(out), threadpool_limits(1, "blas"):
        require_no_links(out)  # before hours of work; saving checks again
        for name in ("checkpoints", "report"):
            require_own_folder(out / name)
            remove_abandoned(out / name, 0.0)  # the lock makes this process the only writer
        remove_abandoned(out)
        for path in abandoned(out / REPORT_PAGE):
            path.unlink(missing_ok=True)
        return _solve(capture, config, out, progress or Progress(), resume)


def _solve(capture: Capture, config: SolveConfig, out: Path, progress: Progress, resume: bool) -> Result:
    progress.expect(STAGE_SECONDS)
    decisions = Decisions(asdict(config.refinements))
    fixed_response(config)  # an unusable file is an error of the first second
    device = choose_device(config.device)
    engine = choose_engine(device)
    key = fingerprint(capture, config, engine.name)
    checkpoints = Checkpoints(out / "checkpoints", key, resume, config.texture_size.words)
    unit = 1.0
    if config.hdr is None:
        views, unit = with_unit_mean(capture.views)
        capture = replace(capture, views=views)

    def cancellable(work: Callable[[], Made]) -> Made:
        """The result of work that does not check for a cancel itself; a cancel does not wait for its end."""
        return waited_for(aside(work), progress.check)

    def stage(name: Stage, compute: Callable[[], Mapping[str, NDArray]]) -> dict[str, NDArray]:
        """The arrays of a stage that may have been finished before, and the decisions made up to its end."""
        arrays = checkpoints.stage(name, lambda: {**compute(), "decisions": decisions.array()})
        decisions.restore(arrays.pop("decisions"))
        return arrays

    def traced(tracer: Tracer, photos: PhotoSamples) -> tuple[TracedRoom, Observations]:
        """The mesh as ``tracer`` sees it under the photos, and what they show of its patches."""
        patches = stream(config.seed, "surface.patches")
        room = cancellable(lambda: trace_room(reduced, surface, tracer, photos, config.max_patches, patches))
        seen, widths = room.samples, photos.small.sizes[:, 1]
        shown = room.patches.sample_patch, seen.view, seen.pixel, widths, photos.z, room.mixed.mask, photos.hdr
        return room, observe(*shown, stream(config.seed, "response.observations"))

    with progress.stage("photos"):
        if engine.warning:
            progress.update(0.0, engine.warning)
        surface, tracer = choose_surface(capture, stream(config.seed, "surface.scan"), progress, decisions, engine)
        capture, cameras = fit_cameras(capture, tracer, stream(config.seed, "cameras.points"), progress, decisions)
        reduced = replace(capture, views=within_budget(capture.views))
        states = LightStates.of(reduced.views)
        photos = sample_photos(reduced, tracer, config.hdr is not None, progress)
    with progress.stage("surface"):
        room, observations = traced(tracer, photos)
    with progress.stage("response"):

        def measure() -> dict[str, NDArray]:
            overlap = stream(config.seed, "response.overlap")
            found = measure_photometry(reduced, config, observations, photos, overlap, decisions)
            alike = room if len(states) == 1 else room.of_photos(states.photos(0))  # under one light
            panes = find_panes(surface, tracer, alike.samples, shown_pixels(found, alike), decisions)
            if isinstance(config.emitters, Path):  # a lamp that the user names is none
                panes = np.setdiff1d(panes, np.concatenate(read_given_emitters(config.emitters, tracer.areas) or [[]]))
            return {**found.arrays(), "panes": panes}

        arrays = stage("response", lambda: cancellable(measure))
        panes = arrays.pop("panes")
        photometry = Photometry.from_arrays(arrays)
    if len(panes):
        with progress.stage("surface"):  # once more, as one sees it through them
            tracer = Tracer(surface.mesh, surface.normals, surface.noise, without=panes, engine=engine)
            room, observations = traced(tracer, sample_photos(reduced, tracer, config.hdr is not None, progress))
    # One core at most, and not needed before there are textures.
    reduction = np.array([view.reduction for view in reduced.views])
    size = config.texture_size
    atlas = aside(lambda: atlas_for_photos(capture.mesh, room.samples, reduction, size))
    with progress.stage("transport"):
        gathered = cached_transport(room, config, stream(config.seed, "transport.gather_rays"), progress)
        transport = replace(gathered, device=device)

        def find_unshown(own: TracedRoom) -> HiddenSources:
            """Sources that the photos of ``own`` do not show."""
            if decisions.forbids("hidden_light"):
                return nothing_hidden(transport)
            faces = own.regions.of_face, own.smooth_components, own.surveyed
            return find_hidden(own.tracer, transport, *faces, stream(config.seed, "transport.openings"))

        in_states = [RoomInState.of(room, observations, states, k, find_unshown) for k in range(len(states))]
    with progress.stage("lights"):
        pose = partial(pose_states, in_states, room, observations, transport, config, decisions)
        problems = cancellable(lambda: pose(photometry))
        rooms = [own.room for own in in_states]
        search = partial(find_first_lights, pose, problems, photometry, rooms, progress)
        arrays = stage("lights", lambda: joined_arrays([own.arrays() for own in search()]))
        first = [FirstLights.from_arrays(own) for own in split_arrays(arrays, len(states))]
        if first[0].exponent != 1.0:
            photometry = photometry.raised(first[0].exponent)
            problems = pose(photometry)
        problems = [own.settle(problem) for own, problem in zip(first, problems, strict=True)]
        lights = [own.lights for own in first]
        write_previews(out, reduced, rooms[0].photos.z, photometry, problems[0], lights[0])
    with progress.stage("materials"):
        rounds = partial(solve_materials, problems, lights, config.rounds, progress)
        arrays = stage("materials", lambda: Solution(photometry, *rounds()).arrays())
        solution = Solution.from_arrays(photometry, arrays, len(states))
        problems = [problem.with_gloss(solution.gloss) for problem in problems]
        write_previews(out, reduced, rooms[0].photos.z, photometry, problems[0], solution.lights[0])
    with progress.stage("textures"):
        texels = waited_for(atlas, progress.check)
        result, rerenders = cancellable(
            lambda: make_result(room, capture.views, config, texels, problems, solution, checkpoints, progress)
        )
        result = result.with_exposures_times(unit / room.photos.unit)
    with progress.stage("report"):
        result = replace(result, panes=panes)
        result = cancellable(lambda: with_figures(result, room, config, cameras, problems, solution, progress))
        names = [view.name for view in reduced.views]
        unlike = cancellable(lambda: find_unlike_lights(observations, names, states, photometry.hdr, decisions))
        result.report["warnings"] += [lights.warning for lights in unlike]
        if not photometry.hdr:
            quality = PhotoQuality.of(observations)
            result.report["photos"] = quality.report()
            result.report["warnings"] += quality.warnings
        result.report["decisions"] = decisions.report()
        patterned = result.textures.lamp_pattern is not None
        result.report["atlas"] = reached = describe_atlas(result.mesh, texels, room.samples, patterned)
        result.report["warnings"] += density_warnings(reached, size)
        if capture.poses_to_mesh is not None:
            result.report["poses_to_mesh"] = capture.poses_to_mesh.tolist()
        if capture.mended_poses is not None:
            result.report["mended_poses"] = dict(capture.mended_poses)
        if capture.map_origin is not None:
            result.report["map_origin"] = dict(capture.map_origin)
        progress.update(0.5, force=True)
        save_result(result, out)
        write_report(result, capture, out, rerenders)
    checkpoints.clear()
    return result
