"""The result of a solve, assembled from its stages: base colour at pixels, textures, lamps, figures of the report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import BLOCK, over_blocks, peak_memory_bytes
from ..base.progress import Progress
from ..base.random_streams import stream
from ..brdf.ggx import DIELECTRIC_F0
from ..cameras.fit import CameraFit
from ..config import SolveConfig
from ..decide import MAX_UNSEEN_LIGHT
from ..lighting.backdrop import SeenBackdrop
from ..lighting.balance import MAX_ALBEDO
from ..lighting.problem import Lights
from ..lighting.shell_surface import as_surface
from ..materials.mirrors import smooth_metals, with_mirrors
from ..materials.rounds import MaterialProblem
from ..materials.shading import sunlight_at
from ..materials.solution import Solution
from ..materials.specular import subtract_specular
from ..model.capture import Camera, Capture, View
from ..model.device import Device
from ..model.light_states import LightStates
from ..model.local_exposure import UNIFORM
from ..model.recovered import Backdrop
from ..rays.tracer import Tracer
from ..response.photometry import Photometry, shown_pixels
from ..surface.primary_rays import PixelSamples, all_pixels, as_picture
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
from .state_lights import (
    StateLight,
    at_all_pixels,
    light_at_pixels,
    recovered_emitters,
    recovered_outside,
    recovered_states,
    recovered_sun,
    state_lights,
)

RERENDERED_PHOTOS = 4
"""Photos shown in the report beside their re-rendering."""
FEW_PHOTOS = 4
"""Photos of a light state below which a warning names it."""
Rows = slice | NDArray[np.integer]
"""Indexes some of the pixels."""


def make_result(
    room: TracedRoom,
    views: Sequence[View],
    config: SolveConfig,
    atlas: Atlas,
    problems: Sequence[MaterialProblem],
    solution: Solution,
    checkpoints: Checkpoints,
    progress: Progress,
) -> tuple[Result, dict[str, NDArray[np.float32]]]:
    """Textures painted from the photos; the result put together, and a few photos as it explains them.

    Args:
        views: the photos at full size.
        atlas: with the texels of the pixels of ``room``.
        problems: of each light state, with the lobes of ``solution``.
        checkpoints: keep what each photo shows.

    Returns:
        The result, its report without :func:`with_figures`; and a few re-rendered photos by name, (H, W, 3).
    """
    capture, photos, samples, gloss = room.capture, room.photos, room.samples, solution.gloss
    photometry, states = solution.photometry, state_lights(room, problems, solution)
    light, field = problems[0].light, room.field
    region, patch, n = light.regions[samples.face], room.patches.sample_patch, len(samples.face)
    pixel_light = light_at_pixels(states, gloss, config, n, progress)
    metallic = gloss.metallic[region]
    each_expected = [state.expected for state in states]
    expected = at_all_pixels(
        states, [own[patch[state.rows]] for state, own in zip(states, each_expected, strict=True)], n
    )
    albedo, weight, usual = _pixel_albedo(room, photometry, expected, pixel_light, metallic)
    each_lit = [_lit_faces(state, len(states) > 1) for state in states]
    lit = at_all_pixels(states, [own[samples.face[state.rows]] for state, own in zip(states, each_lit, strict=True)], n)
    weight[lit] = 0
    dielectric = gloss.metallic < 0.5
    of_patches = [
        residual_light(field, light.surface.region, dielectric, patch[rows], albedo[rows], weight[rows])
        for rows in (state.rows for state in states)
    ]
    interpolated = [
        field.at_samples(state.room.samples, patch[state.rows], own)
        for state, own in zip(states, of_patches, strict=True)
    ]
    # Of metals base colour is no quotient of irradiance; interpolation would bring in the factor of neighbours.
    brighter = np.where(metallic[:, None] > 0.5, np.float32(1), at_all_pixels(states, interpolated, n))
    albedo, diffuse_light = np.minimum(albedo / brighter, MAX_ALBEDO), pixel_light.diffuse * brighter
    ls0, ls1 = pixel_light.ls0, pixel_light.ls1
    # The base colour of a metal is no quotient of irradiance, that of a lamp with a pattern no base colour.
    painted = gloss.metallic < 0.5
    held_out = hold_out(room, stream(config.seed, "results.held_out_pixels"))
    patterned = _patterned(room, photometry, states[0].lights)
    lamp_level = np.zeros(len(light.regions), np.float32)
    for lamp in patterned:
        lamp_level[lamp.faces] = lamp.level
    shines = lamp_level > 0
    painted[np.setdiff1d(light.regions[shines], light.regions[~shines])] = False
    points = TexelPoints.of(room.tracer, atlas.uv, atlas.size)
    painters = [
        Painter(
            room=room,
            points=points,
            regions=light.regions,
            photometry=photometry,
            gloss=gloss,
            shading=state.shading,
            sunlight_at=partial(sunlight_at, state.problem.light, state.lights),
            light=pixel_light,
            expected=own_expected,
            brighter=of_patch,
            light_spread=field.spread(state.shading.irradiance),
            usual=usual,
            held_out=held_out.hidden,
            lamp_level=lamp_level,
            lit=own_lit,
        )
        for state, own_expected, of_patch, own_lit in zip(states, each_expected, of_patches, each_lit, strict=True)
    ]
    of_photo = LightStates.of(capture.views).index
    texels = paint_texels(painters, of_photo, views, atlas.size, checkpoints.table, progress)
    pixels = PixelAlbedo(albedo, weight * ~held_out.hidden[:, None])
    shown_gloss = gloss
    if len(smooth_metals(gloss)):
        rng = stream(config.seed, "materials.mirrors")
        own = states[0].room
        shown = shown_pixels(photometry, own)
        own_region = region[states[0].rows]
        shown_gloss = with_mirrors(gloss, room.tracer, own.samples, shown, own_region, rng, light.decisions)
    always_lit = np.all([state.lights.mask for state in states], axis=0)
    textures, paint = make_textures(atlas, light.regions, always_lit, shown_gloss, samples, pixels, texels, painted)
    if patterned:
        pattern, radiance = lamp_pattern(atlas, texels, light.tracer.areas, patterned)
        textures = replace(textures, lamp_pattern=pattern)
        states = [replace(states[0], lights=states[0].lights.with_radiance(states[0].lights.patterned, radiance))]
    emission = at_all_pixels(states, [_emission(state, len(light.regions)) for state in states], n)
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
    psnr, residual = -10 * np.log10(np.mean((found - shown) ** 2)), np.log(np.stack(of_patches)).std()
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
        emitters=tuple(recovered_emitters(states)),
        outside=recovered_outside(light, states[0].lights),
        sun=recovered_sun(light, states[0].lights),
        light_states=recovered_states(states),
        response=photometry.response,
        exposures=exposures,
        report=report,
        up=capture.up,
        local=UNIFORM if photometry.local is None else photometry.local.settings,
        devices=_further_devices(capture, photometry),
        backdrop=_recovered_backdrop(states[0], progress),
    )
    beyond = partial(_through_holes, states[0].problem.backdrop, room.tracer, photometry)
    return result, _rerenders(capture, samples, rerender, beyond)


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


def _rerenders(
    capture: Capture,
    samples: PixelSamples,
    explained: Callable[[slice], NDArray[np.float64]],
    beyond: Callable[[int, Camera, NDArray[np.integer]], tuple[NDArray[np.integer], NDArray[np.float64]]],
) -> dict[str, NDArray[np.float32]]:
    """A few photos by name as the model explains them, (H, W, 3); large ones without some rows and columns.

    Args:
        explained: display values of a slice of the ``samples``.
        beyond: as :func:`_through_holes` gives them, those of pixels without a sample.
    """
    pictures = {}
    for index in np.unique(np.linspace(0, len(capture.views) - 1, RERENDERED_PHOTOS).astype(int)):
        camera = capture.views[index].camera
        rows = slice(*np.searchsorted(samples.view, [index, index + 1]))
        step = max(1, camera.width // MAX_WIDTH)
        pixel, values = beyond(index, camera, np.setdiff1d(all_pixels(camera), samples.pixel[rows]))
        pixel, values = np.concatenate([samples.pixel[rows], pixel]), np.concatenate([explained(rows), values])
        pictures[capture.views[index].name] = as_picture(values, pixel, camera, step)
    return pictures


def _through_holes(
    backdrop: SeenBackdrop,
    tracer: Tracer,
    photometry: Photometry,
    index: int,
    camera: Camera,
    pixel: NDArray[np.integer],
) -> tuple[NDArray[np.integer], NDArray[np.float64]]:
    """Those (k,) of the pixels (n,) of photo ``index`` that show the backdrop, and their display values (k, 3)."""
    origins, directions = camera.rays(pixel)
    texel = backdrop.texels(origins, directions)
    shown = np.flatnonzero((texel >= 0) & (tracer.closest(origins, directions).face < 0))
    radiance = backdrop.radiance[texel[shown]].astype(np.float64)
    return pixel[shown], photometry.develop(radiance, np.full(len(shown), index), pixel[shown])


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


def _lit_faces(state: StateLight, several: bool) -> NDArray[np.bool_]:
    """(F,) faces on which photos of a state show no base colour, because they emit.

    In a room of ``several`` states a lamp is a surface in the photos of those in which it is off; in a room of one no
    photo tells its base colour, and it is given none in the end.
    """
    return state.lights.mask if several else np.zeros(len(state.lights.mask), bool)


def _emission(state: StateLight, n_faces: int) -> NDArray[np.float64]:
    """(k, 3) radiance that the pixels of one light state show emitted, without patterns."""
    samples, lights = state.room.samples, state.lights
    emission = lights.face_emission(n_faces)[samples.face]
    for faces, profile in lights.profiled:
        on = np.flatnonzero(np.isin(samples.face, faces))
        emission[on] *= profile.at(samples.cosine[on])[:, None]
    return emission


def _recovered_backdrop(state: StateLight, progress: Progress) -> Backdrop | None:
    problem, lights = state.problem, state.lights
    if problem.light.hidden.holes is None:
        return problem.backdrop.recovered
    shown = problem.light.hidden.completed(problem.backdrop, lights.hidden_radiance)
    return as_surface(shown, problem.light, lights, progress)


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
    problems: Sequence[MaterialProblem],
    solution: Solution,
    progress: Progress,
) -> Result:
    """``result`` of :func:`make_result` with the figures of the stages before it in its report."""
    problem, transport, gloss = problems[0], problems[0].light.transport, solution.gloss
    photometry, lights = solution.photometry, solution.lights[0]
    seen = room.samples.seen_faces(len(problem.light.regions))
    model = {
        "camera": cameras.report(),
        "response": photometry.report(),
        "lamps": len(result.emitters),
        "unseen_lamps": sum(not seen[emitter.faces].any() for emitter in result.emitters),
        **({"light_states": _states_figures(result)} if result.light_states else {}),
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
        "light_paths_unseen": round(transport.unseen(), 3),
        "pixels_per_patch": round(room.patches.pixels_per_patch, 2),
        **result.report["model"],
    }
    figures = {
        "preset": config.preset,
        "seed": config.seed,
        "seconds": {name: round(value, 2) for name, value in progress.seconds.items()},
        "peak_memory_bytes": peak_memory_bytes(),
        "device": transport.device,
        "rays_on": room.tracer.engine.name,
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
            *filter(None, [room.tracer.engine.warning]),
            *_unseen_warnings(transport.unseen()),
            *_state_warnings(result, photometry),
            *result.report["warnings"],
        ],
    }
    return replace(result, report={**result.report, **figures})


def _states_figures(result: Result) -> dict[str, dict[str, int]]:
    """Photos and lit lamps of each light state."""
    return {
        state.name: {"photos": len(state.photos), "lamps_on": int((state.radiance > 0).any(1).sum())}
        for state in result.light_states
    }


def _unseen_warnings(share: float) -> list[str]:
    """What a user should know where photos leave out much of the room; ``share`` as of :meth:`Transport.unseen`."""
    if share <= MAX_UNSEEN_LIGHT:
        return []
    return [
        f"no photo shows where {share:.0%} of the light on the shown surfaces may come from: lamps there are guessed "
        "or missing, and brightness of what is shown may be off by as much as they give: add photos of the other "
        "parts of the room"
    ]


def _state_warnings(result: Result, photometry: Photometry) -> list[str]:
    """What a user of a room with several light states should know."""
    if not result.light_states:
        return []
    dark = [
        state.name
        for state in result.light_states[1:]  # Lights warns of the first
        if not state.radiance.any() and state.outside is None and state.sun is None
    ]
    few = [f"{state.name} ({len(state.photos)})" for state in result.light_states if len(state.photos) < FEW_PHOTOS]
    warnings = [f"light states of few photos are told by little: {', '.join(few)}"] if few else []
    if dark:
        warnings.append(f"no light was found in light state {', '.join(dark)}, so the room renders black in it")
    if not (photometry.known_exposures or photometry.hdr):
        warnings.append("exposures are unknown: how bright one light state is beside another is not known")
    return warnings
