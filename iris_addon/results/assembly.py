"""The result of a solve, assembled from its stages: base colour at pixels, textures, lamps, figures of the report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

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
from ..materials.mirrors import smooth_metals, with_mirrors
from ..materials.rounds import MaterialProblem
from ..materials.shading import Shading, sunlight_at
from ..materials.solution import Solution
from ..materials.specular import pixel_lobes, subtract_specular
from ..model.capture import Capture, View
from ..model.device import Device
from ..model.local_exposure import UNIFORM
from ..model.recovered import Emitter, OutsideLight, Sunlight
from ..response.photometry import Photometry, shown_pixels
from ..surface.primary_rays import PixelSamples, as_picture
from ..surface.traced_room import TracedRoom
from ..textures.atlas import Atlas, interpolate_uv
from ..textures.bake import DIM_ALBEDO, PixelAlbedo, UsualPixel, pixel_albedo, pixel_weight
from ..textures.lamp_texels import PatternedLamp, lamp_pattern
from ..textures.paint import residual_light
from ..textures.painting import Painter, PixelLight, paint_texels
from ..textures.principled import make_textures
from ..textures.texel_points import TexelPoints
from .checkpoints import Checkpoints
from .held_out import MISFIT_ERROR, POOR_PSNR, base_color_of_pixels, errors_of_photos, hold_out, misfits
from .maps import bilinear
from .report import MAX_WIDTH
from .result import Result

RERENDERED_PHOTOS = 4
"""Photos shown in the report beside their re-rendering."""
UNSEEN_LAMP_CONFIDENCE = 0.2
"""Confidence in a lamp that no photo shows."""
Rows = slice | NDArray[np.integer]
"""Indexes some of the pixels."""


def make_result(
    room: TracedRoom,
    views: Sequence[View],
    config: SolveConfig,
    atlas: Atlas,
    problem: MaterialProblem,
    solution: Solution,
    checkpoints: Checkpoints,
    progress: Progress,
) -> tuple[Result, dict[str, NDArray[np.float32]]]:
    """Textures painted from the photos; the result put together, and a few photos as it explains them.

    Args:
        views: the photos at full size.
        atlas: with the texels of the pixels of ``room``.
        problem: with the lobes of ``solution``.
        checkpoints: keep what each photo shows.

    Returns:
        The result, its report without :func:`with_figures`; and a few re-rendered photos by name, (H, W, 3).
    """
    capture, photos, samples, light = room.capture, room.photos, room.samples, problem.light
    photometry, lights, gloss = solution.photometry, solution.lights, solution.gloss
    region, patch = light.regions[samples.face], light.surface.sample_patch
    shading = problem.shading(lights)
    irradiance = shading.at_pixels(light, lights)
    ls0, ls1 = pixel_lobes(
        problem.scene(lights),
        photos,
        room.cameras,
        gloss.roughness[region],
        irradiance,
        config.specular_rays,
        stream(config.seed, "results.pixel_lobes"),
        progress,
    )
    metallic = gloss.metallic[region]
    view_factor = _view_factor(shading, patch, gloss.roughness[region], samples)
    expected = problem.observed.radiance[patch]
    pixel_light = PixelLight(irradiance, irradiance * view_factor[:, None], ls0, ls1)
    albedo, weight, usual = _pixel_albedo(room, photometry, expected, pixel_light, metallic)
    of_patch = residual_light(light.field, light.surface.region, gloss.metallic < 0.5, patch, albedo, weight)
    # Of metals base colour is no quotient of irradiance; interpolation would bring in the factor of neighbours.
    brighter = np.where(metallic[:, None] > 0.5, np.float32(1), light.field.at_samples(samples, patch, of_patch))
    albedo, diffuse_light = np.minimum(albedo / brighter, MAX_ALBEDO), pixel_light.diffuse * brighter
    # The base colour of a metal is no quotient of irradiance, that of a lamp with a pattern no base colour.
    painted = gloss.metallic < 0.5
    held_out = hold_out(room, stream(config.seed, "results.held_out_pixels"))
    patterned = _patterned(room, photometry, lights)
    lamp_level = np.zeros(len(light.regions), np.float32)
    for lamp in patterned:
        lamp_level[lamp.faces] = lamp.level
    shines = lamp_level > 0
    painted[np.setdiff1d(light.regions[shines], light.regions[~shines])] = False
    painter = Painter(
        room=room,
        points=TexelPoints.of(room.tracer, atlas.uv, atlas.size),
        regions=light.regions,
        photometry=photometry,
        gloss=gloss,
        shading=shading,
        sunlight_at=partial(sunlight_at, light, lights),
        light=pixel_light,
        expected=problem.observed.radiance,
        brighter=of_patch,
        light_spread=light.field.spread(shading.irradiance),
        usual=usual,
        held_out=held_out.hidden,
        lamp_level=lamp_level,
    )
    texels = paint_texels(painter, views, atlas.size, checkpoints.table, progress)
    pixels = PixelAlbedo(albedo, weight * ~held_out.hidden[:, None])
    shown_gloss = gloss
    if len(smooth_metals(gloss)):
        rng = stream(config.seed, "materials.mirrors")
        shown = shown_pixels(photometry, room)
        shown_gloss = with_mirrors(gloss, room.tracer, samples, shown, region, rng, light.decisions)
    textures, paint = make_textures(atlas, light.regions, lights.mask, shown_gloss, samples, pixels, texels, painted)
    if patterned:
        pattern, radiance = lamp_pattern(atlas, texels, light.tracer.areas, patterned)
        textures = replace(textures, lamp_pattern=pattern)
        lights = lights.with_radiance(lights.patterned, radiance)
    emission = lights.face_emission(len(light.regions))[samples.face]
    for faces, profile in lights.profiled:
        on = np.flatnonzero(np.isin(samples.face, faces))
        emission[on] *= profile.at(samples.cosine[on])[:, None]
    if textures.lamp_pattern is not None:
        shine = np.flatnonzero(lamp_level[samples.face] > 0)
        uv = interpolate_uv(atlas.uv, samples.face[shine], samples.barycentric[shine])
        emission[shine] *= bilinear(textures.lamp_pattern, uv)

    def explained(rows: Rows, base_color: NDArray[np.floating]) -> NDArray[np.float64]:
        """(k, 3) display values of some pixels under the solved model; radiance for HDR input."""
        seen = (column[rows] for column in (metallic, diffuse_light, ls0, ls1, emission))
        return photometry.develop(_predict(base_color, *seen), samples.view[rows], samples.pixel[rows])

    def rerender(rows: slice) -> NDArray[np.float64]:
        uv = interpolate_uv(atlas.uv, samples.face[rows], samples.barycentric[rows])
        return explained(rows, bilinear(textures.base_color, uv))

    tested = np.flatnonzero(held_out.tested)
    shown = photos.z[tested]
    found = explained(tested, base_color_of_pixels(textures, atlas, room, tested))
    shown = shown if photos.hdr else np.clip(shown + 0.5 / 255, 0, 1)
    psnr, residual = -10 * np.log10(np.mean((found - shown) ** 2)), np.log(of_patch).std()
    of_photos = errors_of_photos(found, shown, samples.view[tested], len(capture.views))
    paints = {"paints": paint.paints, "parts_of_one_colour": paint.plain_regions}
    report = {
        "holdout_psnr": float(psnr),
        "model": {
            "residual_light": round(float(residual), 4),
            "mirrors": int((shown_gloss.roughness == 0).sum()),
            **paints,
        },
        "warnings": _misfit_warnings(capture, of_photos, np.inf if photos.hdr else float(psnr)),
    }
    mesh = capture.mesh.with_uv(atlas.uv)
    if room.surface.scanned.any():
        mesh = replace(mesh, normals=room.surface.normals)
    exposures = {view.name: photometry.exposures[k] for k, view in enumerate(capture.views)}
    result = Result(
        mesh=mesh,
        regions=light.regions,
        textures=textures,
        emitters=tuple(_emitters(light, lights)),
        outside=_outside(light, lights),
        sun=_sun(light, lights),
        response=photometry.response,
        exposures=exposures,
        report=report,
        up=capture.up,
        local=UNIFORM if photometry.local is None else photometry.local.settings,
        devices=_further_devices(capture, photometry),
        backdrop=problem.backdrop.recovered
        if light.hidden.holes is None
        else as_surface(light.hidden.completed(problem.backdrop, lights.hidden_radiance), light, lights, progress),
    )
    return result, _rerenders(capture, samples, rerender)


def _further_devices(capture: Capture, photometry: Photometry) -> tuple[Device, ...]:
    """The cameras whose response is not that of ``photometry.response``."""
    if photometry.device is None:
        return ()
    others = photometry.local.others if photometry.local is not None else (UNIFORM,) * len(photometry.others)
    recorded = np.array([view.exposure or 1.0 for view in capture.views])[:, None]
    over = np.log(photometry.exposures / recorded) if photometry.known_exposures else np.zeros((len(recorded), 3))
    found = []
    for k, (response, local) in enumerate(zip(photometry.others, others, strict=True), start=1):
        own = [capture.views[view] for view in np.flatnonzero(photometry.device == k)]
        factor = np.exp(over[photometry.device == k].mean(0) - over[photometry.device == 0].mean(0))
        found.append(
            Device(
                name=own[0].device,
                response=response,
                local=local,
                photos=tuple(view.name for view in own),
                exposure_factor=(float(factor[0]), float(factor[1]), float(factor[2])),
            )
        )
    return tuple(found)


def _pixel_albedo(
    room: TracedRoom,
    photometry: Photometry,
    expected: NDArray[np.floating],
    light: PixelLight,
    metallic: NDArray[np.floating],
) -> tuple[NDArray[np.float32], NDArray[np.float32], UsualPixel]:
    """(n, 3) base colour of each pixel, its weight per channel, 1 at the median, and the medians of all.

    Args:
        expected: (n, 3) radiance of the patch of each, scene-linear Rec.709.
        metallic: (n,).
    """
    photos, samples, mixed, scanned = room.photos, room.samples, room.mixed.mask, room.scanned_pixels
    irradiance, ls0, ls1 = light.irradiance, light.ls0, light.ls1
    usual = UsualPixel(float(np.median(samples.footprint)), float(np.median(irradiance)))
    albedo, weight = np.empty(irradiance.shape, np.float32), np.empty(irradiance.shape, np.float32)

    def work(rows: slice) -> None:
        linear = photometry.linearise_pixels(photos.z[rows], samples.view[rows], samples.pixel[rows])
        linear = linear.agreeing_with(expected[rows])
        specular = subtract_specular(ls0[rows], ls1[rows], metallic[rows])
        albedo[rows] = pixel_albedo(linear.radiance, specular, ls0[rows], light.diffuse[rows], metallic[rows])
        sharp = pixel_weight(samples.take(rows), irradiance[rows], specular, mixed[rows], scanned[rows], usual)
        level = expected[rows] + DIM_ALBEDO * light.diffuse[rows]
        weight[rows] = sharp * linear.unclipped * linear.precision_at(level)

    over_blocks(len(metallic), BLOCK, work)
    usual = replace(usual, weight=float(np.median(weight[weight > 0])))
    return albedo, weight / np.float32(usual.weight), usual


def _view_factor(
    shading: Shading, patch: NDArray[np.integer], roughness: NDArray[np.floating], samples: PixelSamples
) -> NDArray[np.float32]:
    """(n,) factor of the diffuse lobe towards the camera of each pixel, on ``patch`` (n,) of ``roughness`` (n,)."""

    def factor(rows: slice) -> NDArray[np.floating]:
        angle, toward = schlick(samples.cosine[rows]), samples.direction[rows]
        return shading.view_factor(patch[rows], roughness[rows], angle, toward)

    return filled(np.empty(len(patch), np.float32), factor)


def _rerenders(
    capture: Capture, samples: PixelSamples, explained: Callable[[slice], NDArray[np.float64]]
) -> dict[str, NDArray[np.float32]]:
    """A few photos by name as the model explains them, (H, W, 3); large ones without some rows and columns."""
    pictures = {}
    for index in np.unique(np.linspace(0, len(capture.views) - 1, RERENDERED_PHOTOS).astype(int)):
        view = capture.views[index]
        rows = slice(*np.searchsorted(samples.view, [index, index + 1]))
        step = max(1, view.camera.width // MAX_WIDTH)
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
    """(n, 3) radiance of pixels under the solved model: equation (2) plus emission.

    Args:
        base_color: (n, 3) linear Rec.709.
        metallic: (n,) 0 or 1.
        irradiance: (n, 3) irradiance / pi times the view factor of the diffuse lobe.
        ls0, ls1: (n, 3) specular lobes of equation (3).
        emission: (n, 3) radiance.
    """
    m = metallic[:, None]
    ks = base_color * m + DIELECTRIC_F0 * (1 - m)
    return base_color * (1 - m) * irradiance + ks * ls0 + ls1 + emission


def _emitters(problem: LightProblem, lights: Lights) -> list[Emitter]:
    areas = problem.tracer.areas
    confidence = np.where(_unseen(problem, lights), UNSEEN_LAMP_CONFIDENCE, 1.0 / (1.0 + lights.log_std))
    return [
        Emitter(
            id=k,
            faces=faces,
            radiance=radiance,
            area=float(areas[faces].sum()),
            confidence=float(confidence[k]),
            patterned=k in lights.patterned,
            profile=lights.profile_of(faces),
        )
        for k, (faces, radiance) in enumerate(zip(lights.emitters, lights.radiance, strict=True))
    ]


def _patterned(room: TracedRoom, photometry: Photometry, lights: Lights) -> list[PatternedLamp]:
    """The lamps that have a pattern, with the brightest radiance that a pixel of each shows."""
    lamps = []
    for k in lights.patterned:
        faces, samples = lights.emitters[k], room.samples
        rows = np.flatnonzero(np.isin(samples.face, faces))
        linear = photometry.linearise_pixels(room.photos.z[rows], samples.view[rows], samples.pixel[rows])
        brightest = float(np.where(linear.unclipped, linear.radiance, linear.bound).max())
        lamps.append(PatternedLamp(faces, lights.radiance[k], brightest / MAX_ALBEDO, brightest))
    return lamps


def _unseen(problem: LightProblem, lights: Lights) -> NDArray[np.bool_]:
    """(E,) lamps that no photo shows."""
    seen = problem.samples.seen_faces(len(problem.regions))
    return np.array([not seen[faces].any() for faces in lights.emitters], bool)


def _outside(problem: LightProblem, lights: Lights) -> OutsideLight | None:
    sh = problem.hidden.outside_sh(lights.hidden_radiance)
    return None if sh is None else OutsideLight(sh)


def _sun(problem: LightProblem, lights: Lights) -> Sunlight | None:
    sun = problem.hidden.sun
    return None if sun is None else Sunlight(sun.direction, lights.hidden_radiance[-1])


def _misfit_warnings(capture: Capture, errors: NDArray[np.floating], psnr: float) -> list[str]:
    """A warning that the photos are not explained, as a whole or those that it names; or none.

    Args:
        errors: (V,) of photos, as by :func:`errors_of_photos`.
        psnr: of all tested pixels as displayed; of radiance it says nothing.
    """
    typical = float(np.nanmedian(errors)) if np.isfinite(errors).any() else 0.0
    if typical > MISFIT_ERROR:
        return [
            f"the solved room does not explain the photos: their typical error is {typical:.0%} of brightness: check "
            "that photos, poses and mesh are of one room, that each recorded exposure is its photo's, and that no "
            "photo is edited"
        ]
    worst = misfits(errors)
    if not len(worst):
        poor = (
            f"the solved room explains the photos poorly, at {psnr:.1f} dB of pixels it was not fitted to, where good "
            "captures reach 21 and more: inspect the capture, and check that the mesh lies under all photos and is not "
            "mirrored"
        )
        return [poor] if psnr < POOR_PSNR else []
    names = ", ".join(f"{capture.views[k].name} ({errors[k]:.0%})" for k in worst[:5]) + (
        " …" if len(worst) > 5 else ""
    )
    return [
        f"{len(worst)} of {len(errors)} photos are not explained by the solved room, their typical error against "
        f"{typical:.0%} of brightness in the others: {names}: check that each photo belongs to its pose"
    ]


def with_figures(
    result: Result,
    room: TracedRoom,
    config: SolveConfig,
    cameras: CameraFit,
    problem: MaterialProblem,
    solution: Solution,
    progress: Progress,
) -> Result:
    """``result`` of :func:`make_result` with the figures of the stages before it in its report."""
    transport, gloss = problem.light.transport, solution.gloss
    photometry, lights = solution.photometry, solution.lights
    model = {
        "camera": cameras.report(),
        "response": photometry.report(),
        "lamps": len(lights.emitters),
        "unseen_lamps": int(_unseen(problem.light, lights).sum()),
        "outside_directions": len(problem.light.hidden.directions),
        "sun": problem.light.hidden.sun is not None,
        "faces_of_panes": len(result.panes),
        "light_through_holes": problem.light.hidden.kind.shown,
        "light_of_unseen": problem.light.hidden.kind.unseen,
        "regions": len(problem.light.material),
        "materials": len(np.unique(problem.light.material)),
        "glossy_regions": int(((gloss.roughness < 1) & (gloss.metallic < 0.5)).sum()),
        "metallic_regions": int((gloss.metallic > 0.5).sum()),
        "diffuse": {"lobe": problem.diffuse.lobe, "gain_of_burley": round(problem.diffuse.gain, 4)},
        "pixels_per_patch": round(room.patches.pixels_per_patch, 2),
        **result.report["model"],
    }
    figures = {
        "preset": config.preset,
        "seed": config.seed,
        "seconds": {name: round(value, 2) for name, value in progress.seconds.items()},
        "peak_memory_bytes": peak_memory_bytes(),
        "device": transport.device,
        "rays_traced": int(room.tracer.rays_traced),
        "n_patches": int(transport.n_patches),
        "n_views": len(room.capture.views),
        "excluded": list(room.capture.excluded),
        "metres_per_unit": room.capture.metres_per_unit,
        "model": model,
        "warnings": [
            *room.capture.warnings,
            *cameras.warnings,
            *photometry.warnings,
            *lights.warnings,
            *result.report["warnings"],
        ],
    }
    return replace(result, report={**result.report, **figures})
