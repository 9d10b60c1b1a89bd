"""The whole solve: a capture in, a result folder out. Each stage is a pure function of the ones before.

::

    photos -> surface -> transport -> response -> lights -> materials -> textures -> result
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from .base.errors import BadInput
from .base.files import require_own_folder
from .base.parallel import aside, waited_for
from .base.progress import Progress
from .base.random_streams import stream
from .brdf.diffuse import grazing_gain, schlick
from .cameras.fit import fit_cameras
from .capture.exposures import with_unit_mean
from .config import Refinements, SolveConfig
from .lighting.backdrop import Beyond, fit_backdrop
from .lighting.candidates import brightness, read_given_emitters
from .lighting.hidden import HiddenSources, find_hidden, nothing_hidden, through_holes
from .lighting.problem import LightProblem, Lights
from .lighting.search import choose_exponent, choose_outside
from .materials.gloss import LEVELS, Gloss, rough_everywhere
from .materials.rounds import MaterialProblem, solve_materials
from .materials.view_dependence import choose_diffuse, mirrored_radiance
from .model.capture import Capture, Mesh
from .rays.tracer import Tracer
from .response.observations import Observations, observe
from .response.photometry import Photometry, measure_photometry
from .response.radiance import group_radiance, linearise
from .results.assembly import make_result, report_figures
from .results.checkpoints import Checkpoints, fingerprint, sole_writer
from .results.files import require_no_links
from .results.folder import save_result
from .results.preview import write_previews
from .results.report import write_report
from .results.result import Result
from .surface.irradiance import IrradianceField
from .surface.mixed_pixels import mixed_pixels, outshone_by
from .surface.patches import Surface, build_surface
from .surface.photo_samples import PhotoSamples, sample_photos
from .surface.primary_rays import PixelSamples
from .surface.regions import Split, split_regions
from .surface.topology import edge_adjacency, pieces_between_edges
from .textures.atlas import Atlas
from .textures.charts import build_atlas, texel_density_from_footprint
from .transport.cache import cached_transport
from .transport.transport import Transport, choose_device

WEIGHTS = {"photos": 3, "surface": 3, "transport": 8, "response": 6, "lights": 15, "materials": 20, "textures": 20}
"""Expected seconds per stage, for the overall progress bar."""


def solve(
    capture: Capture, config: SolveConfig, out: Path, progress: Progress | None = None, resume: bool = False
) -> Result:
    """Recover response, exposures, lights and materials; write the result folder ``out``.

    Raises:
        BadInput: a photo cannot be read, the photos say nothing, another process is solving into ``out``, or a link
            there leads elsewhere.
        Cancelled: finished stages stay in ``out`` for ``resume``.
        IrisError: the disk is full.
    """
    # Matrices here are narrow; a linear algebra library that waits for work on threads of its own takes them from ours.
    with sole_writer(out), threadpool_limits(1, "blas"):
        require_no_links(out)  # saving asks again, hours later
        for name in ("checkpoints", "report"):
            require_own_folder(out / name)
        return _solve(capture, config, out, progress or Progress(), resume)


def _solve(capture: Capture, config: SolveConfig, out: Path, progress: Progress, resume: bool) -> Result:
    progress.expect(WEIGHTS)
    checkpoints = Checkpoints(out / "checkpoints", fingerprint(capture, config), resume)
    unit = 1.0
    if config.hdr is None:
        views, unit = with_unit_mean(capture.views)
        capture = replace(capture, views=views)
    with progress.stage("photos"):
        tracer = Tracer(capture.mesh)
        capture, cameras = fit_cameras(
            capture, tracer, config.refinements.poses, stream(config.seed, "cameras.points"), progress
        )
        photos = sample_photos(capture, tracer, config.hdr is not None, progress)
    with progress.stage("surface"):
        adjacency = edge_adjacency(capture.mesh)
        built = aside(lambda: _surface(capture, config, tracer, adjacency, photos))
        split, photos, surface, field = waited_for(built, progress.check)
        regions, scanned = split.regions, split.scanned
    with progress.stage("transport"):
        transport = cached_transport(
            capture,
            tracer,
            surface,
            regions,
            config.gather_rays,
            config.seed,
            stream(config.seed, "transport.gather_rays"),
            progress,
        )
        transport = replace(transport, device=choose_device(config.device))
        hidden = nothing_hidden(transport)
        if config.refinements.hidden_light is not False:
            pieces = pieces_between_edges(tracer.normals, adjacency, regions)
            # What a scanner saw of a room its photos saw too: what is left are scraps along the borders of both.
            hidden = find_hidden(transport, regions, pieces, photos.samples.seen_faces(len(regions)) | scanned)
    seen, widths = photos.samples, photos.small.sizes[:, 1]
    observations = observe(
        surface.sample_patch,
        seen.view,
        seen.pixel,
        widths,
        photos.z,
        photos.mixed,
        photos.hdr,
        stream(config.seed, "response.observations"),
    )
    # Little of this runs on more than one core, and nobody needs it before there are textures.
    atlas = aside(lambda: _atlas(capture.mesh, seen, config.atlas_size))
    with progress.stage("response"):
        measured = partial(
            measure_photometry, capture, config, observations, photos, stream(config.seed, "response.overlap")
        )
        arrays = checkpoints.stage("response", lambda: waited_for(aside(measured), progress.check).arrays())
        photometry = Photometry.from_arrays(arrays)
    pose = partial(
        _problem, capture, config, tracer, photos, split, adjacency, surface, transport, hidden, observations, field
    )
    with progress.stage("lights"):
        posed = aside(partial(pose, photometry))
        problem = waited_for(posed, progress.check)
        searched = partial(_lights, pose, problem, scanned, photometry, config.refinements, progress)
        arrays = checkpoints.stage("lights", searched)
        lights, exponent = Lights.from_arrays(arrays), float(arrays["exponent"])
        if exponent != 1.0:
            photometry = photometry.raised(exponent)
            problem = pose(photometry)
        problem = problem.with_materials(arrays["material"])
        problem = problem.with_outside(int(arrays["directions"]), bool(arrays["shown"]))
        write_previews(out, capture, photos.z, photometry, problem, lights)
    with progress.stage("materials"):
        solved = checkpoints.stage("materials", lambda: _materials(problem, lights, config.rounds, progress))
        lights, gloss = Lights.from_arrays(solved), Gloss.from_arrays(solved)
        problem = problem.with_gloss(gloss)
        write_previews(out, capture, photos.z, photometry, problem, lights)
    with progress.stage("textures"):
        texels = waited_for(atlas, progress.check)
        made = aside(lambda: make_result(capture, config, texels, problem, photos, photometry, lights, gloss, progress))
        result, rerenders = waited_for(made, progress.check)
        result = result.with_exposures_times(unit / photos.unit)
    figures = report_figures(
        config, capture, cameras, tracer, surface, transport, photometry, problem, lights, gloss, progress
    )
    of_textures = result.report["model"]
    result.report.update(figures)
    result.report["model"] |= of_textures
    save_result(result, out)
    write_report(result, capture, out, rerenders)
    checkpoints.clear()
    return result


def _surface(
    capture: Capture,
    config: SolveConfig,
    tracer: Tracer,
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
    photos: PhotoSamples,
) -> tuple[Split, PhotoSamples, Surface, IrradianceField]:
    """The faces in regions, the photos with the pixels marked that mix surfaces, patches and the field of their
    neighbours."""
    split = split_regions(capture.mesh, adjacency, tracer.normals, photos.samples, photos.z)
    taken_by = [view.camera for view in capture.views]
    regions = split.regions
    mixed = mixed_pixels(tracer, photos.samples, regions, taken_by, photos.stride)
    brighter = outshone_by(photos.samples, photos.z, mixed, regions, taken_by, photos.stride)
    photos = replace(photos, mixed=mixed, scanned=split.scanned[photos.samples.face], outshone_by=brighter)
    surface = build_surface(
        capture.mesh, photos.samples, regions, config.max_patches, stream(config.seed, "surface.patches")
    )
    return split, photos, surface, IrradianceField.build(surface)


def _atlas(mesh: Mesh, samples: PixelSamples, size: int) -> Atlas:
    """By the mesh's own texture coordinates, else by new ones with texels as large as the pixels of photos."""
    uv = mesh.uv
    if uv is None:
        density = texel_density_from_footprint(samples.face, samples.footprint, len(mesh.faces))
        uv = build_atlas(mesh, density, size)
    return Atlas.of(uv, size, samples.face, samples.barycentric)


def _problem(
    capture: Capture,
    config: SolveConfig,
    tracer: Tracer,
    photos: PhotoSamples,
    split: Split,
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
    surface: Surface,
    transport: Transport,
    hidden: HiddenSources,
    observations: Observations,
    field: IrradianceField,
    photometry: Photometry,
) -> MaterialProblem:
    exposure = photometry.exposure_at(observations.view, observations.pixel)
    linear = linearise(observations, photometry.response, exposure)
    if not linear.unclipped.all(1).any():
        raise BadInput("every pixel of the photos is clipped in one channel or another", "add darker photos")
    n, regions, forced = len(surface.region), split.regions, config.refinements
    angle = schlick(photos.samples.cosine[observations.sample].astype(np.float64))
    diffuse = choose_diffuse(observations, linear, angle)
    beyond = Beyond(None)
    if forced.hidden_light is not False:
        beyond = Beyond(fit_backdrop(photos.beyond, photometry, capture.mesh, capture.views))
    light = LightProblem(
        tracer=tracer,
        samples=photos.samples,
        surface=surface,
        transport=transport,
        regions=regions,
        material=np.arange(int(regions.max()) + 1, dtype=np.int32),
        adjacency=adjacency,
        brightness=brightness(observations, linear, n),
        outshone_by=photos.outshone_by,
        hidden=replace(hidden, holes=through_holes(transport, beyond)),
        field=field,
        shadow_rays=config.shadow_rays,
        seed=config.seed,
        given=read_given_emitters(config.emitters, tracer.areas) if isinstance(config.emitters, Path) else None,
    )
    region = regions[photos.samples.face[observations.sample]]
    view_factor = 1 + grazing_gain(diffuse.lobe, np.array(LEVELS[-1])) * angle
    observed = group_radiance(linear, observations.patch, observations.count, n, view_factor=view_factor)
    problem = MaterialProblem(
        light=light,
        observations=observations,
        linear=linear,
        mirrored=mirrored_radiance(observations, linear, observed, photos, photometry),
        observed=observed,
        region=region,
        schlick=angle,
        diffuse=diffuse,
        specular_rays=config.specular_rays,
        seed=config.seed,
        beyond=beyond,
        gloss=forced.gloss,
        given=split.given,
    )
    return problem.with_gloss(rough_everywhere(int(regions.max()) + 1))


def _lights(
    pose: Callable[[Photometry], MaterialProblem],
    problem: MaterialProblem,
    scanned: NDArray[np.bool_],
    photometry: Photometry,
    forced: Refinements,
    progress: Progress,
) -> dict[str, NDArray]:
    """The lamps, the regions of a scan that turn out to be one material under their light, and the exponent of
    ``photometry`` under which lamps balance where photos leave it open."""
    exponent, all_directions = 1.0, forced.hidden_light is True
    light, lights = choose_outside(problem.light, problem.observed, progress, all_directions)
    material = problem.materials_under(lights, scanned)
    if (material != problem.light.material).any():
        problem = problem.with_materials(material)
        light, lights = choose_outside(problem.light, problem.observed, progress, all_directions, lights)
    if photometry.exponent_unconstrained and forced.exponent is not False:
        exponent = choose_exponent(light, problem.observed, lights, photometry.exponent_error, progress)
    if exponent != 1.0:
        problem = pose(photometry.raised(exponent)).with_materials(material)
        light, lights = choose_outside(problem.light, problem.observed, progress, all_directions)
    outside = {"directions": np.array(len(light.hidden.directions)), "shown": np.array(light.hidden.holes is not None)}
    return {**lights.arrays(), **outside, "exponent": np.array(exponent), "material": material}


def _materials(problem: MaterialProblem, lights: Lights, rounds: int, progress: Progress) -> dict[str, NDArray]:
    lights, gloss = solve_materials(problem, lights, rounds, progress)
    return {**lights.arrays(), **gloss.arrays()}
