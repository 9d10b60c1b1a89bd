"""Scores of path-traced pictures: novel views, the two relighting references, inserted balls, held-out photos.

The renderer is an argument (in practice :func:`iris_addon.blender.render.cycles.render_views`), so nothing here needs
Blender.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from ..base.minimise import simplex
from ..base.progress import Progress
from ..base.random_streams import stream
from ..capture.photos import load_photo
from ..edits.jobs import insertion_edits, new_lights_edit, one_emitter_edit
from ..edits.parsing import json_map
from ..edits.scene_edit import SceneEdit
from ..model.capture import Camera, Photo, View
from ..model.render_settings import RenderSettings
from ..model.response import Response, gamma, grey_exposure
from ..results.result import Result
from . import metrics
from .ground_truth import GroundTruth, read_lights, read_mask, read_objects, read_rgb
from .metrics import FloatArray, Mask

RING_PIXELS = 20
"""How far around an inserted object its shadow and bounce are scored."""
FIT_PIXELS = 8192
"""Pixels of a held-out photo to which its exposure and white balance are fitted."""
GAIN_TOLERANCE = 1e-5
"""Of the logarithm of a factor on light or exposure, at which the search for it ends."""
MIDTONES = (0.02, 0.98)
"""Display values between which a pixel is neither black nor clipped."""


class RenderViews(Protocol):
    """Path-traces a result: one (H, W, 3) image of linear radiance per camera."""

    def __call__(
        self,
        result: Result,
        cameras: Sequence[Camera],
        *,
        edit: SceneEdit | None = None,
        settings: RenderSettings | None = None,
        on_view: Callable[[int, NDArray[np.float32]], None] | None = None,
    ) -> list[NDArray[np.float32]]:
        """Render ``cameras``; ``on_view`` is called with each finished image and may raise to stop."""
        ...


@dataclass(frozen=True)
class Picture:
    """A rendered view and what it should look like.

    Attributes:
        radiance: (H, W, 3) linear, rendered.
        truth: (H, W, 3) display values.
        response, exposure: how ``radiance`` becomes a photo.
        mask: pixels that count (insertion), or None for all.
    """

    metric: str
    view: str
    radiance: FloatArray
    truth: FloatArray
    response: Response
    exposure: float | FloatArray
    mask: Mask | None = None

    def ldr(self, scale: float = 1.0) -> FloatArray:
        """(H, W, 3) the photo of the rendering, all light multiplied by ``scale``."""
        return metrics.to_ldr(self.radiance * scale, self.response, self.exposure)


def score_pictures(pictures: Sequence[Picture]) -> dict[str, dict[str, float]]:
    """Per-image values by metric and view: psnr, over whole images also ssim, and both with one common light scale."""
    scores: dict[str, dict[str, float]] = {}
    for metric in dict.fromkeys(picture.metric for picture in pictures):
        mine = [picture for picture in pictures if picture.metric == metric]
        stem = metric.removesuffix("_psnr")
        for suffix, scale in (("", 1.0), ("_si", light_scale(mine))):
            for picture in mine:
                ldr = picture.ldr(scale)
                scores.setdefault(metric + suffix, {})[picture.view] = metrics.psnr(ldr, picture.truth, picture.mask)
                if picture.mask is None:
                    scores.setdefault(f"{stem}_ssim{suffix}", {})[picture.view] = metrics.ssim(ldr, picture.truth)
    return scores


def light_scale(pictures: Sequence[Picture]) -> float:
    """The one factor on all rendered radiance with the least squared error of the photos; within 2^±8."""

    def error(log2_scale: float) -> float:
        return sum(metrics.mse(p.ldr(2.0**log2_scale), p.truth, p.mask) for p in pictures)

    # The error has one minimum, but is flat where everything is black or clipped: a grid search finds the slope first.
    grid = np.arange(-8.0, 8.5, 0.5)
    best = grid[int(np.argmin([error(x) for x in grid]))]
    found, _ = simplex(lambda x: error(float(x[0])), np.array([[best], [best + 0.25]]), GAIN_TOLERANCE)
    return float(2.0 ** found[0])


# ---- Pictures of a capture with ground truth ------------------------------------------------------------------------


def novel_views(
    result: Result, truth: GroundTruth, render: RenderViews, samples: int, seed: int, progress: Progress
) -> list[Picture]:
    """The held-out views with the recovered response and the recorded exposures, beside their photos."""
    chosen = [
        (view, photo)
        for index, view in enumerate(truth.val_views)
        if view.exposure is not None
        and result.in_state_of(view) is not None
        and (photo := truth.photo(index)) is not None
    ]
    images = render_in_states(result, [view for view, _ in chosen], render, samples, seed, progress)
    devices = [result.device_of(view) for view, _ in chosen]
    return [
        Picture(
            metric="nvs_psnr",
            view=view.name,
            radiance=image,
            truth=photo,
            response=device.response,
            exposure=(view.exposure or 1.0) * np.array(device.exposure_factor),
        )
        for (view, photo), image, device in zip(chosen, images, devices, strict=True)
    ]


def relit_views(
    result: Result, truth: GroundTruth, render: RenderViews, samples: int, seed: int, progress: Progress
) -> list[Picture]:
    """Both kinds of relighting references: new lights alone, and only the recorded faces on, as they shine in the light
    state of the reference."""
    lights = read_lights(truth) or {}
    pictures: list[Picture] = []
    for kind, make_edit in (("new_lights", new_lights_edit), ("one_emitter", one_emitter_edit)):
        if kind not in lights:
            continue
        lit = _lit_as(result, json_map(lights[kind], kind)) if kind == "one_emitter" else result
        if lit is None:
            continue
        found = [
            (view, read_rgb(path))
            for index, view in enumerate(truth.val_views)
            if (path := truth.path(f"relight/{kind}", index)) is not None
        ]
        edit = make_edit(lit, lights)
        images = render_all(lit, [view.camera for view, _ in found], edit, render, samples, seed, progress)
        for (view, reference), image in zip(found, images, strict=True):
            pictures.append(_beside("relight_psnr", f"{kind}/{view.name}", image, reference, truth))
    return pictures


def inserted_views(
    result: Result, truth: GroundTruth, render: RenderViews, samples: int, seed: int, progress: Progress
) -> list[Picture]:
    """Inserted balls in the original light, that of the light state of the reference: within the object and 20 pixels
    around it, and that ring alone."""
    objects = read_objects(truth)
    pictures: list[Picture] = []
    for index, edit in [] if objects is None else insertion_edits(result, objects):
        lit = _lit_as(result, _reference_of(objects, index))
        if lit is None:
            continue
        path, mask_path = truth.path("insert/Image", index), truth.path("insert/mask", index, ".png")
        if path is None or mask_path is None or index >= len(truth.val_views):
            continue
        view, reference, inside = truth.val_views[index], read_rgb(path), read_mask(mask_path)
        (image,) = render_all(lit, [view.camera], edit, render, samples, seed, progress)
        near = np.less_equal(np.asarray(distance_transform_edt(~inside)), RING_PIXELS)
        pictures.append(_beside("insert_psnr", view.name, image, reference, truth, near))
        pictures.append(_beside("insert_psnr_around", view.name, image, reference, truth, near & ~inside))
    return pictures


def incomparable(result: Result, truth: GroundTruth) -> dict[str, str]:
    """References that are left out because ``result`` does not have their light, and why, by what they are of.

    Of a room that was photographed in several light states a reference has to say in which it was rendered.
    """
    if not result.light_states:
        return {}
    lights, objects = read_lights(truth) or {}, read_objects(truth)
    parts: dict[str, Mapping[str, Any]] = {}
    if "one_emitter" in lights:
        parts["relight_psnr of one_emitter"] = json_map(lights["one_emitter"], "one_emitter")
    for index, _ in [] if objects is None else insertion_edits(result, objects):
        parts[f"insert_psnr of view {index}"] = _reference_of(objects, index)
    states = {name: str(part.get("light_state", "")) for name, part in parts.items()}
    states |= {f"nvs_psnr of {view.name}": view.light_state for view in truth.val_views}
    return {
        name: f"the light state {state!r} was not solved" if state else "it does not say in which light state it is"
        for name, state in states.items()
        if state not in _solved_states(result)
    }


def _lit_as(result: Result, reference: Mapping[str, Any]) -> Result | None:
    """The room in the light state of a reference; None where that is not said, or was not solved."""
    if not result.light_states:
        return result
    name = str(reference.get("light_state", ""))
    return result.in_state(name) if name in _solved_states(result) else None


def _solved_states(result: Result) -> set[str]:
    return {state.name for state in result.light_states}


def _reference_of(objects: Mapping[str, Any] | None, index: int) -> Mapping[str, Any]:
    """The part of an insertion job that is of view ``index``."""
    views = [] if objects is None else objects.get("views", [])
    return next((view for view in views if view.get("view") == index), {})


def _beside(
    metric: str, view: str, image: FloatArray, reference: FloatArray, truth: GroundTruth, mask: Mask | None = None
) -> Picture:
    """Rendering and reference through the true response, exposed for the reference's median."""
    response = truth.response or gamma()
    exposure = grey_exposure(reference)
    return Picture(
        metric=metric,
        view=view,
        radiance=image,
        truth=metrics.to_ldr(reference, response, exposure),
        response=response,
        exposure=exposure,
        mask=mask,
    )


def render_in_states(
    result: Result, views: Sequence[View], render: RenderViews, samples: int, seed: int, progress: Progress
) -> list[NDArray[np.float32]]:
    """Render ``views``, each in its light state, which the result has; raises Cancelled."""
    images: dict[str, NDArray[np.float32]] = {}
    for state in dict.fromkeys(view.light_state for view in views):
        own = [view for view in views if view.light_state == state]
        lit = result.in_state_of(own[0])
        assert lit is not None
        found = render_all(lit, [view.camera for view in own], None, render, samples, seed, progress)
        images |= {view.name: image for view, image in zip(own, found, strict=True)}
    return [images[view.name] for view in views]


def render_all(
    result: Result,
    cameras: Sequence[Camera],
    edit: SceneEdit | None,
    render: RenderViews,
    samples: int,
    seed: int,
    progress: Progress,
) -> list[NDArray[np.float32]]:
    """Render ``cameras`` and report each finished view to ``progress``; raises Cancelled."""

    def on_view(index: int, _image: NDArray[np.float32]) -> None:
        progress.update((index + 1) / len(cameras))

    settings = RenderSettings(samples=samples, seed=seed)
    return render(result, cameras, edit=edit, settings=settings, on_view=on_view) if cameras else []


# ---- Held-out photos of a capture without ground truth --------------------------------------------------------------


def score_held_out(result: Result, views: Sequence[View], images: Sequence[FloatArray]) -> dict[str, dict[str, float]]:
    """``nvs_psnr`` and ``nvs_ssim`` by view name.

    A photo whose exposure is unknown may be brightened and tinted: an exposure and a white balance are fitted to it.

    Args:
        views: held-out views with their photos.
        images: their renderings, (H, W, 3) linear radiance each.
    """
    scores: dict[str, dict[str, float]] = {"nvs_psnr": {}, "nvs_ssim": {}}
    for view, radiance in zip(views, images, strict=True):
        photo, response = load_photo(view), result.device_of(view).response
        gains = fit_gains(radiance, photo, response)
        ldr = metrics.to_ldr(radiance, response, gains)
        # Pixels that undistortion could not fill count as right on both sides: SSIM wants a full image.
        truth = np.where(photo.valid[..., None], photo.values, ldr)
        scores["nvs_psnr"][view.name] = metrics.psnr(ldr, truth, photo.valid)
        scores["nvs_ssim"][view.name] = metrics.ssim(ldr, truth)
    return scores


def fit_gains(radiance: FloatArray, photo: Photo, response: Response) -> FloatArray:
    """(3,) exposure × white balance with the least squared error of the photo f(radiance · gains).

    The start is the median ratio of exposures over pixels that are neither black nor clipped, or the ratio of means for
    photos without such pixels.
    """
    usable = np.flatnonzero(photo.valid.ravel() & np.isfinite(radiance).all(-1).ravel())
    rng = stream(0, "evaluate.fitted_pixels")
    chosen = rng.choice(usable, min(FIT_PIXELS, len(usable)), replace=False)
    L = np.maximum(radiance.reshape(-1, 3)[chosen].astype(np.float64), 1e-9)
    z = photo.values.reshape(-1, 3)[chosen].astype(np.float64)
    x = response.invert(np.clip(z, 0.0, 1.0))
    mid = (z > MIDTONES[0]) & (z < MIDTONES[1])
    start = np.array(
        [
            np.median(np.log(x[m, c] + 1e-9) - np.log(L[m, c]))
            if m.any()
            else np.log((x[:, c].mean() + 1e-9) / L[:, c].mean())
            for c, m in enumerate(mid.T)
        ]
    )

    def error(channel: int, log_gain: float) -> float:
        exposed = np.repeat(L[:, channel, None] * np.exp(log_gain), 3, 1)
        return metrics.mse(response.apply(exposed)[:, channel], z[:, channel])

    def fitted(channel: int) -> float:
        corners = start[channel] + np.array([[0.0], [0.1]])
        return float(simplex(lambda x: error(channel, float(x[0])), corners, GAIN_TOLERANCE)[0][0])

    return np.exp([fitted(channel) for channel in range(3)])
