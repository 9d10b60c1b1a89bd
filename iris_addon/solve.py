"""The whole solve: a capture in, a result folder out. Each stage is a pure function of the ones before.

::

    photos -> surface -> transport -> response -> lights -> materials -> textures -> result
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from .calibration import Calibration, calibrate
from .capture.types import Capture
from .checkpoint import Checkpoints, fingerprint
from .compute import choose_device, peak_memory_bytes
from .config import Refinements, SolveConfig
from .emission.backdrop import fit_backdrop
from .emission.candidates import brightness
from .emission.given import read_given_emitters
from .emission.hidden import find_hidden, nothing_hidden
from .emission.search import choose_outside
from .emission.types import LightProblem, Lights
from .photo_samples import PhotoSamples, sample_photos
from .photometry import Photometry, measure_photometry
from .progress import Progress
from .refine.joint import joint_arrays, joint_report, refine_lights
from .reflectance.bake import pixel_albedo, pixel_weight
from .reflectance.diffuse_lobe import choose_diffuse
from .reflectance.ggx import DIELECTRIC_F0
from .reflectance.gloss import LEVELS, Gloss, rough_everywhere
from .reflectance.materials import MaterialProblem, scene_of, smooth_irradiance, solve_materials
from .reflectance.shading import IrradianceField
from .reflectance.specular import specular_lobes, subtract_specular
from .reflectance.textures import make_textures
from .response.observations import Observations, observe
from .response.radiance import group_radiance, linearise
from .result.io import save_result
from .result.report_html import write_report
from .result.types import Emitter, OutsideLight, Result
from .surface.atlas import build_atlas, texel_density_from_footprint
from .surface.build import Surface, build_surface
from .surface.parts import edge_adjacency
from .surface.samples import PixelSamples
from .surface.segment import split_parts
from .transport.cache import cached_transport
from .transport.diffuse import grazing_gain, schlick
from .transport.tracer import Tracer
from .transport.transport import Transport

WEIGHTS = {"photos": 3, "surface": 3, "transport": 8, "response": 6, "lights": 15, "materials": 20, "textures": 20}
"""Expected seconds per stage, for the overall progress bar."""
JOINT_WEIGHT = {"joint": 20}
SHOWN_PHOTOS = 4
DIM = 0.05
"""Share of the median irradiance below which a quotient of radiance and irradiance is not worth much."""
HELD_OUT = 0.02
"""Share of pixels kept from the textures, to measure what they predict."""


def solve(
    capture: Capture, config: SolveConfig, out: Path, progress: Progress | None = None, resume: bool = False
) -> Result:
    """Recover response, exposures, lights and materials; write the result folder ``out``.

    Raises:
        BadInput: a photo cannot be read.
        Cancelled: finished stages stay in ``out`` for ``resume``.
        IrisError: the disk is full.
    """
    progress = progress or Progress()
    progress.expect(WEIGHTS | JOINT_WEIGHT if config.joint else WEIGHTS)
    checkpoints = Checkpoints(out / "checkpoints", fingerprint(capture, config), resume)
    with progress.stage("photos"):
        tracer = Tracer(capture.mesh)
        capture, calibration = calibrate(capture, tracer, progress)
        photos = sample_photos(capture, tracer, config.hdr is not None, progress)
    with progress.stage("surface"):
        adjacency = edge_adjacency(capture.mesh)
        parts = split_parts(capture.mesh, adjacency, tracer.normals, photos.samples, photos.z)
        surface = build_surface(capture.mesh, photos.samples, parts, config.max_patches, _rng(config, 1))
        field = IrradianceField.build(surface)
    with progress.stage("transport"):
        transport = cached_transport(
            capture, tracer, surface, parts, config.gather_rays, config.seed, _rng(config, 2), progress
        )
        transport = replace(transport, device=choose_device(config.device))
    observations = observe(surface.sample_patch, photos.samples.view, photos.z, photos.hdr, _rng(config, 3))
    with progress.stage("response"):
        photometry = Photometry.from_arrays(
            checkpoints.stage(
                "response",
                lambda: measure_photometry(capture, config, observations, photos.hdr, _rng(config, 4)).arrays(),
            )
        )
    problem = _problem(config, tracer, photos, parts, adjacency, surface, transport, observations, photometry, field)
    with progress.stage("lights"):
        arrays = checkpoints.stage("lights", lambda: _lights(problem, config.refinements, progress))
        lights = Lights.from_arrays(arrays)
        problem = problem.with_outside(int(arrays["directions"]))
    with progress.stage("materials"):
        solved = checkpoints.stage("materials", lambda: _materials(problem, lights, config.rounds, progress))
        lights, gloss = Lights.from_arrays(solved), Gloss.from_arrays(solved)
        problem = problem.with_gloss(gloss)
    joint: dict[str, Any] = {}
    if config.joint:
        with progress.stage("joint"):
            arrays = checkpoints.stage(
                "joint", lambda: joint_arrays(*refine_lights(problem, photometry, lights, gloss, progress))
            )
            lights, joint = Lights.from_arrays(arrays), {"joint": joint_report(arrays)}
    with progress.stage("textures"):
        result, rerenders = _textures(capture, config, problem, photos, photometry, lights, gloss, progress)
    result.report.update(
        _report(config, capture, calibration, tracer, surface, transport, photometry, problem, lights, gloss, progress)
    )
    result.report["model"].update(joint)
    save_result(result, out)
    write_report(result, capture, out, rerenders)
    checkpoints.clear()
    return result


def _rng(config: SolveConfig, stage: int) -> np.random.Generator:
    """A generator per stage: a stage draws the same numbers whether those before it ran or were read back."""
    return np.random.default_rng([config.seed, stage])


def _problem(
    config: SolveConfig,
    tracer: Tracer,
    photos: PhotoSamples,
    parts: NDArray[np.int32],
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
    surface: Surface,
    transport: Transport,
    observations: Observations,
    photometry: Photometry,
    field: IrradianceField,
) -> MaterialProblem:
    linear = linearise(observations, photometry.response, photometry.exposures)
    n, forced = len(surface.part), config.refinements
    angle = schlick(photos.samples.cosine[observations.sample].astype(np.float64))
    diffuse = choose_diffuse(observations, linear, angle)
    light = LightProblem(
        tracer,
        photos.samples,
        surface,
        transport,
        parts,
        adjacency,
        brightness(observations, linear, n),
        nothing_hidden(transport) if forced.hidden_light is False else find_hidden(transport, int(parts.max()) + 1),
        config.shadow_rays,
        config.seed,
        given=read_given_emitters(config.emitters, len(parts)) if isinstance(config.emitters, Path) else None,
    )
    part = parts[photos.samples.face[observations.sample]]
    view_factor = 1 + grazing_gain(diffuse.lobe, np.array(LEVELS[-1])) * angle
    observed = group_radiance(linear, observations.patch, observations.count, n, view_factor=view_factor)
    problem = MaterialProblem(
        light,
        observations,
        linear,
        observed,
        field,
        part,
        angle,
        diffuse,
        config.specular_rays,
        config.seed,
        forced.gloss,
    )
    return problem.with_gloss(rough_everywhere(int(parts.max()) + 1))


def _lights(problem: MaterialProblem, forced: Refinements, progress: Progress) -> dict[str, NDArray]:
    light, lights = choose_outside(problem.light, problem.observed, progress, forced.hidden_light is True)
    return {**lights.arrays(), "directions": np.array(len(light.hidden.directions))}


def _materials(problem: MaterialProblem, lights: Lights, rounds: int, progress: Progress) -> dict[str, NDArray]:
    lights, gloss = solve_materials(problem, lights, rounds, progress)
    return {**lights.arrays(), **gloss.arrays()}


def _textures(
    capture: Capture,
    config: SolveConfig,
    problem: MaterialProblem,
    photos: PhotoSamples,
    photometry: Photometry,
    lights: Lights,
    gloss: Gloss,
    progress: Progress,
) -> tuple[Result, dict[str, NDArray[np.float32]]]:
    """Albedo per pixel, fused on the atlas; the result put together, and a few photos as it explains them."""
    samples, light = photos.samples, problem.light
    part = light.parts[samples.face]
    irradiance = problem.field.at_samples(samples, light.surface.sample_patch, smooth_irradiance(problem.field, lights))
    ls0, ls1 = specular_lobes(
        scene_of(light, lights),
        gloss,
        samples,
        np.arange(len(part)),
        part,
        irradiance,
        config.specular_rays,
        _rng(config, 6),
        progress,
    )
    metallic = gloss.metallic[part]
    specular = subtract_specular(ls0, ls1, metallic)
    linear = photometry.linearise_pixels(photos.z, samples.view)
    view_factor = 1 + grazing_gain(problem.diffuse.lobe, gloss.roughness[part]) * schlick(samples.cosine)
    diffuse_light = irradiance * view_factor[:, None].astype(np.float32)
    albedo = pixel_albedo(linear.radiance, specular, ls0, diffuse_light, metallic)
    seen_well = pixel_weight(samples.cosine, samples.footprint, np.ones(len(part)))
    lit = irradiance / (irradiance + DIM * np.median(irradiance))
    weight = seen_well[:, None] * linear.open * linear.precision * lit**2
    weight /= np.median(weight[weight > 0])
    held_out = _rng(config, 7).random(len(part)) < HELD_OUT
    uv = capture.mesh.uv
    if uv is None:
        density = texel_density_from_footprint(samples.face, samples.footprint, len(light.parts))
        uv = build_atlas(capture.mesh, density, config.atlas_size)
    textures, base_color = make_textures(
        uv, config.atlas_size, light.parts, lights.mask, gloss, samples, albedo, weight * ~held_out[:, None]
    )
    emission = lights.face_emission(len(light.parts))[samples.face]
    predicted = _predict(base_color, metallic, diffuse_light, ls0, ls1, emission)
    z = photometry.develop(predicted, samples.view)
    error = (z - np.clip(photos.z + 0.5 / 255, 0, 1))[held_out] if not photos.hdr else (z - photos.z)[held_out]
    report = {"holdout_psnr": float(-10 * np.log10(np.mean(error**2)))}
    closed = config.refinements.hidden_light is False
    backdrop = None if closed else fit_backdrop(photos.beyond, photometry)
    mesh = capture.mesh.with_uv(uv)
    exposures = {view.name: photometry.exposures[k] for k, view in enumerate(capture.views)}
    result = Result(
        mesh,
        light.parts,
        textures,
        tuple(_emitters(light, lights)),
        _outside(light, lights, backdrop),
        photometry.response,
        exposures,
        report,
        capture.up,
    )
    return result, _rerenders(capture, samples, z)


def _rerenders(capture: Capture, samples: PixelSamples, z: NDArray[np.floating]) -> dict[str, NDArray[np.float32]]:
    """Predicted display values of a few photos by name, (H, W, 3); pixels off the lattice take their neighbour's."""
    pictures = {}
    for index in np.unique(np.linspace(0, len(capture.views) - 1, SHOWN_PHOTOS).astype(int)):
        camera = capture.views[index].camera
        rows = slice(*np.searchsorted(samples.view, [index, index + 1]))
        known = np.zeros((camera.height, camera.width), bool)
        image = np.zeros((camera.height, camera.width, 3), np.float32)
        known.ravel()[samples.pixel[rows]] = True
        image.reshape(-1, 3)[samples.pixel[rows]] = z[rows]
        if known.any():
            nearest = np.asarray(distance_transform_edt(~known, return_distances=False, return_indices=True))
            image = image[nearest[0], nearest[1]]
        pictures[capture.views[index].name] = image
    return pictures


def _predict(
    base_color: NDArray[np.floating],
    metallic: NDArray[np.floating],
    irradiance: NDArray[np.floating],
    ls0: NDArray[np.floating],
    ls1: NDArray[np.floating],
    emission: NDArray[np.floating],
) -> NDArray[np.float64]:
    """(n, 3) radiance of pixels under the solved model, ``kd Ld + ks Ls0 + Ls1`` plus emission."""
    m = metallic[:, None]
    ks = base_color * m + DIELECTRIC_F0 * (1 - m)
    return base_color * (1 - m) * irradiance + ks * ls0 + ls1 + emission


def _emitters(problem: LightProblem, lights: Lights) -> list[Emitter]:
    """Lamps seen, then unseen parts that must glow: brighter than anything they could reflect."""
    areas = problem.tracer.areas
    found = [
        (faces, radiance, float(1.0 / (1.0 + std)))
        for faces, radiance, std in zip(lights.emitters, lights.radiance, lights.log_std, strict=True)
    ]
    typical = np.median(lights.irradiance[: problem.transport.n_seen], axis=0)
    for part, radiance in zip(problem.hidden.parts, lights.hidden_radiance, strict=False):
        if radiance.mean() > typical.mean():
            found.append((np.flatnonzero((problem.parts == part) & (areas > 0)), radiance, 0.2))
    return [
        Emitter(k, faces, radiance, float(areas[faces].sum()), confidence)
        for k, (faces, radiance, confidence) in enumerate(found)
    ]


def _outside(problem: LightProblem, lights: Lights, backdrop: NDArray[np.float64] | None) -> OutsideLight | None:
    sh = problem.hidden.outside_sh(lights.hidden_radiance[len(problem.hidden.parts) :])
    if sh is None and backdrop is None:
        return None
    return OutsideLight(np.zeros((1, 3)) if sh is None else sh, backdrop)


def _report(
    config: SolveConfig,
    capture: Capture,
    calibration: Calibration,
    tracer: Tracer,
    surface: Surface,
    transport: Transport,
    photometry: Photometry,
    problem: MaterialProblem,
    lights: Lights,
    gloss: Gloss,
    progress: Progress,
) -> Mapping[str, Any]:
    """The figures of report.json beside the held-out PSNR."""
    return {
        "preset": config.preset,
        "seed": config.seed,
        "seconds": {name: round(value, 2) for name, value in progress.seconds.items()},
        "peak_memory_bytes": peak_memory_bytes(),
        "device": transport.device,
        "rays_traced": int(tracer.rays_traced),
        "n_patches": int(transport.n_patches),
        "n_views": len(capture.views),
        "model": {
            "camera": calibration.report(),
            "response": photometry.report(),
            "lamps": len(lights.emitters),
            "hidden_parts": len(problem.light.hidden.parts),
            "outside_directions": len(problem.light.hidden.directions),
            "glossy_parts": int(((gloss.roughness < 1) & (gloss.metallic < 0.5)).sum()),
            "metallic_parts": int((gloss.metallic > 0.5).sum()),
            "diffuse": {"lobe": problem.diffuse.lobe, "gain_of_burley": round(problem.diffuse.gain, 4)},
            "pixels_per_patch": round(surface.pixels_per_patch, 2),
        },
        "warnings": [*capture.warnings, *calibration.warnings, *photometry.warnings],
    }
