"""What the stages found, put together: albedo per pixel, textures, lamps, the figures of the report."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import BLOCK, filled, over_blocks, peak_memory_bytes
from ..base.progress import Progress
from ..base.random_streams import stream
from ..brdf.diffuse import schlick
from ..brdf.ggx import DIELECTRIC_F0
from ..cameras.fit import CameraFit
from ..config import SolveConfig
from ..lighting.balance import MAX_ALBEDO
from ..lighting.problem import LightProblem, Lights
from ..lighting.shell_surface import as_surface
from ..materials.gloss import Gloss
from ..materials.rounds import MaterialProblem
from ..materials.shading import Shading
from ..materials.specular import pixel_lobes, subtract_specular
from ..model.capture import Capture
from ..model.local_exposure import UNIFORM
from ..model.recovered import Emitter, OutsideLight
from ..rays.tracer import Tracer
from ..response.photometry import Photometry
from ..surface.patches import Surface
from ..surface.photo_samples import PhotoSamples
from ..surface.primary_rays import PixelSamples, as_picture
from ..textures.atlas import Atlas
from ..textures.bake import pixel_albedo, pixel_weight
from ..textures.paint import light_error, residual_light
from ..textures.principled import make_textures
from ..transport.transport import Transport
from .report import WIDEST
from .result import Result

SHOWN_PHOTOS = 4
UNSEEN = 0.2
"""Confidence in a lamp that no photo shows."""
HELD_OUT = 0.02
"""Share of pixels kept from the textures, to measure what they predict."""
Rows = slice | NDArray[np.bool_]
"""Some of the pixels."""


def make_result(
    capture: Capture,
    config: SolveConfig,
    atlas: Atlas,
    problem: MaterialProblem,
    photos: PhotoSamples,
    photometry: Photometry,
    lights: Lights,
    gloss: Gloss,
    progress: Progress,
) -> tuple[Result, dict[str, NDArray[np.float32]]]:
    """Albedo per pixel, fused on the atlas; the result put together, and a few photos as it explains them."""
    samples, light = photos.samples, problem.light
    region, patch = light.regions[samples.face], light.surface.sample_patch
    shading = problem.shading(lights)
    irradiance = light.field.at_samples(samples, patch, shading.irradiance)
    ls0, ls1 = pixel_lobes(
        problem.scene(lights),
        gloss,
        samples,
        irradiance,
        [view.camera for view in capture.views],
        photos.stride,
        config.specular_rays,
        stream(config.seed, "results.pixel_lobes"),
        progress,
    )
    metallic = gloss.metallic[region]
    view_factor = _view_factor(shading, patch, gloss.roughness[region], samples)
    diffuse_light = irradiance * view_factor[:, None]
    expected = problem.observed.radiance[patch]
    albedo, weight = _pixel_albedo(photos, photometry, expected, irradiance, diffuse_light, ls0, ls1, metallic)
    of_patch = residual_light(light.field, light.surface.region, gloss.metallic < 0.5, patch, albedo, weight)
    # Interpolation reaches over from regions beside a metal, whose base colour is no quotient of irradiance.
    brighter = np.where(metallic[:, None] > 0.5, np.float32(1), light.field.at_samples(samples, patch, of_patch))
    albedo, diffuse_light = np.minimum(albedo / brighter, MAX_ALBEDO), diffuse_light * brighter
    # The base colour of a metal is no quotient of irradiance, and a piece of a scan is what looked alike, not a thing.
    painted = gloss.metallic < 0.5
    painted[region[photos.scanned]] = False
    held_out = stream(config.seed, "results.held_out_pixels").random(len(region)) < HELD_OUT
    error = light_error(light.field.spread(shading.irradiance))[patch]
    textures, base_color, paint = make_textures(
        atlas,
        light.regions,
        lights.mask,
        gloss,
        samples,
        albedo,
        weight * ~held_out[:, None],
        error,
        painted,
    )
    emission = lights.face_emission(len(light.regions))[samples.face]

    def explained(rows: Rows) -> NDArray[np.float64]:
        """Display values of some pixels under the solved model."""
        seen = (column[rows] for column in (base_color, metallic, diffuse_light, ls0, ls1, emission))
        return photometry.develop(_predict(*seen), samples.view[rows], samples.pixel[rows])

    shown = photos.z[held_out]
    error = explained(held_out) - (shown if photos.hdr else np.clip(shown + 0.5 / 255, 0, 1))
    psnr, taken_off = -10 * np.log10(np.mean(error**2)), np.log(of_patch).std()
    paints = {"paints": paint.paints, "parts_of_one_colour": paint.plain_regions}
    report = {"holdout_psnr": float(psnr), "model": {"residual_light": round(float(taken_off), 4), **paints}}
    mesh = capture.mesh.with_uv(atlas.uv)
    exposures = {view.name: photometry.exposures[k] for k, view in enumerate(capture.views)}
    result = Result(
        mesh=mesh,
        regions=light.regions,
        textures=textures,
        emitters=tuple(_emitters(light, lights)),
        outside=_outside(light, lights),
        response=photometry.response,
        exposures=exposures,
        report=report,
        up=capture.up,
        local=UNIFORM if photometry.local is None else photometry.local.settings,
        backdrop=problem.beyond.backdrop
        if light.hidden.holes is None
        else as_surface(problem.beyond, light, lights, progress),
    )
    return result, _rerenders(capture, samples, explained)


def _pixel_albedo(
    photos: PhotoSamples,
    photometry: Photometry,
    expected: NDArray[np.floating],
    irradiance: NDArray[np.floating],
    diffuse_light: NDArray[np.floating],
    ls0: NDArray[np.floating],
    ls1: NDArray[np.floating],
    metallic: NDArray[np.floating],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(n, 3) base colour of each pixel, and its say per channel in units of the usual one.

    Args:
        expected: (n, 3) radiance of the patch of each.
        irradiance, diffuse_light: (n, 3) irradiance / pi, and what a white diffuse surface sends to the camera.
        ls0, ls1: (n, 3) specular lobes.
        metallic: (n,).
    """
    samples = photos.samples
    usual = float(np.median(samples.footprint)), float(np.median(irradiance))
    albedo, weight = np.empty(irradiance.shape, np.float32), np.empty(irradiance.shape, np.float32)

    def work(rows: slice) -> None:
        linear = photometry.linearise_pixels(photos.z[rows], samples.view[rows], samples.pixel[rows])
        linear = linear.agreeing_with(expected[rows])
        specular = subtract_specular(ls0[rows], ls1[rows], metallic[rows])
        albedo[rows] = pixel_albedo(linear.radiance, specular, ls0[rows], diffuse_light[rows], metallic[rows])
        seen = samples.cosine[rows], samples.footprint[rows]
        say = pixel_weight(*seen, irradiance[rows], specular, photos.mixed[rows], photos.scanned[rows], *usual)
        weight[rows] = say * linear.unclipped * linear.precision

    over_blocks(len(metallic), BLOCK, work)
    weight /= np.median(weight[weight > 0])
    return albedo, weight


def _view_factor(
    shading: Shading, patch: NDArray[np.integer], roughness: NDArray[np.floating], samples: PixelSamples
) -> NDArray[np.float32]:
    """(n,) factor of the diffuse lobe of ``roughness`` (n,) towards the camera of each pixel."""

    def factor(rows: slice) -> NDArray[np.floating]:
        angle, toward = schlick(samples.cosine[rows]), samples.direction[rows]
        return shading.view_factor(patch[rows], roughness[rows], angle, toward)

    return filled(np.empty(len(patch), np.float32), factor)


def _rerenders(
    capture: Capture, samples: PixelSamples, explained: Callable[[Rows], NDArray[np.float64]]
) -> dict[str, NDArray[np.float32]]:
    """A few photos by name as ``explained``, (H, W, 3), large ones at one of so many rows and columns."""
    pictures = {}
    for index in np.unique(np.linspace(0, len(capture.views) - 1, SHOWN_PHOTOS).astype(int)):
        view = capture.views[index]
        rows = slice(*np.searchsorted(samples.view, [index, index + 1]))
        step = max(1, view.camera.width // WIDEST)
        pictures[view.name] = as_picture(explained(rows), samples.pixel[rows], view.camera, step)
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
    areas = problem.tracer.areas
    confidence = np.where(_unseen(problem, lights), UNSEEN, 1.0 / (1.0 + lights.log_std))
    return [
        Emitter(id=k, faces=faces, radiance=radiance, area=float(areas[faces].sum()), confidence=float(confidence[k]))
        for k, (faces, radiance) in enumerate(zip(lights.emitters, lights.radiance, strict=True))
    ]


def _unseen(problem: LightProblem, lights: Lights) -> NDArray[np.bool_]:
    """(E,) lamps that no photo shows."""
    seen = problem.samples.seen_faces(len(problem.regions))
    return np.array([not seen[faces].any() for faces in lights.emitters], bool)


def _outside(problem: LightProblem, lights: Lights) -> OutsideLight | None:
    sh = problem.hidden.outside_sh(lights.hidden_radiance)
    return None if sh is None else OutsideLight(sh)


def report_figures(
    config: SolveConfig,
    capture: Capture,
    cameras: CameraFit,
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
            "camera": cameras.report(),
            "response": photometry.report(),
            "lamps": len(lights.emitters),
            "unseen_lamps": int(_unseen(problem.light, lights).sum()),
            "outside_directions": len(problem.light.hidden.directions),
            "light_through_holes": problem.light.hidden.holes is not None,
            "regions": len(problem.light.material),
            "materials": len(np.unique(problem.light.material)),
            "glossy_regions": int(((gloss.roughness < 1) & (gloss.metallic < 0.5)).sum()),
            "metallic_regions": int((gloss.metallic > 0.5).sum()),
            "diffuse": {"lobe": problem.diffuse.lobe, "gain_of_burley": round(problem.diffuse.gain, 4)},
            "pixels_per_patch": round(surface.pixels_per_patch, 2),
        },
        "warnings": [*capture.warnings, *cameras.warnings, *photometry.warnings, *lights.warnings],
    }
