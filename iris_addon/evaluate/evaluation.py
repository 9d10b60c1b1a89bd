"""All metrics of a result against a capture: one call for the command line, benchmarks and tests."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import BadInput
from ..base.progress import Progress
from ..capture.reader import read_capture
from ..model.capture import View
from ..model.recovered import Sunlight
from ..rays.tracer import Tracer
from ..results.maps import MapRenderer
from ..results.result import Result
from . import metrics
from .ground_truth import GroundTruth, read_ground_truth, read_sun
from .map_scores import score_maps
from .pictures import (
    RenderViews,
    incomparable,
    inserted_views,
    novel_views,
    relit_views,
    render_in_states,
    score_held_out,
    score_pictures,
)

RENDERED = ("nvs_psnr", "nvs_ssim", "relight_psnr", "relight_ssim", "insert_psnr", "insert_psnr_around")
MAPPED = (
    "kd_psnr", "kd_psnr_8x8", "kd_psnr_all", "kd_psnr_all_8x8", "a_psnr", "a_psnr_8x8", "a_lobe_psnr",
    "a_lobe_psnr_8x8", "roughness_psnr", "metallic_l2", "emission_iou", "emission_log_l2",
)  # fmt: skip
LIGHT_AND_CAMERA = ("crf_l2", "exposure_log2_rmse")
SUN = ("sun_degrees", "sun_irradiance")
TINY = 1e-9
"""Irradiance that stands for none."""


def evaluate(
    result: Result,
    gt_root: Path | str,
    *,
    render: RenderViews | None = None,
    samples: int = 64,
    seed: int = 0,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Score ``result`` against the capture it was solved from.

    With ground truth (FIPT layout, ``gt`` folder or maps beside the photos) every metric the files allow; without, the
    held-out photos (``nvs_*``), an exposure and a white balance fitted to each.

    Args:
        gt_root: the capture, as :func:`iris_addon.capture.reader.read_capture` takes it.
        render: path tracer for novel views, relighting and insertion; None leaves those out.
        samples: per pixel of each rendered view.

    Returns:
        Metric by name, ``per_view`` (metric, view name, value), and ``left_out`` (metric, reason).

    Raises:
        BadInput: the capture has neither ground truth nor held-out photos, or belongs to another mesh.
    """
    progress = progress or Progress()
    truth = read_ground_truth(Path(gt_root))
    if truth is None:
        per_view, left_out = _held_out(result, Path(gt_root), render, samples, seed, progress), {}
        numbers: dict[str, float] = {}
    else:
        per_view, numbers, left_out = _against_truth(result, truth, render, samples, seed, progress)
    numbers |= {metric: metrics.combine(list(values.values())) for metric, values in per_view.items()}
    left_out["lpips"] = "its weights are not installed"
    return {**numbers, "per_view": per_view, "left_out": left_out}


def _against_truth(
    result: Result, truth: GroundTruth, render: RenderViews | None, samples: int, seed: int, progress: Progress
) -> tuple[dict[str, dict[str, float]], dict[str, float], dict[str, str]]:
    """Per-view values, numbers that have no views, and what is missing and why."""
    with progress.stage("maps"):
        per_view = score_maps(_renderers(result), truth, progress)
    sun = read_sun(truth)
    numbers = _camera_scores(result, truth) | ({} if sun is None else _sun_scores(result.sun, sun))
    if render is not None:
        pictures = []
        for name, views in (("novel views", novel_views), ("relighting", relit_views), ("insertion", inserted_views)):
            with progress.stage(name):
                pictures += views(result, truth, render, samples, seed, progress)
        per_view |= score_pictures(pictures)
    found = per_view.keys() | numbers.keys()
    missing = "the capture has no reference for it"
    left_out = {name: missing for name in (*MAPPED, *LIGHT_AND_CAMERA) if name not in found}
    if render is not None:
        left_out |= incomparable(result, truth)
    if sun is not None:
        left_out |= {name: "no sun was found" for name in SUN if name not in found}
    left_out |= {
        name: missing if render is not None else "nothing was rendered" for name in RENDERED if name not in found
    }
    return per_view, numbers, left_out


def _renderers(result: Result) -> Callable[[View], MapRenderer]:
    """The renderer of maps in the light state of a view; of one that the result does not have, that of the first."""
    tracer = Tracer(result.mesh, without=result.panes)
    made: dict[str, MapRenderer] = {}

    def renderer_of(view: View) -> MapRenderer:
        if view.light_state not in made:
            made[view.light_state] = MapRenderer(result.in_state_of(view) or result, tracer)
        return made[view.light_state]

    return renderer_of


def _camera_scores(result: Result, truth: GroundTruth) -> dict[str, float]:
    scores = {}
    if truth.response is not None:
        scores["crf_l2"] = metrics.crf_l2(result.response.samples, truth.response.samples)
    pairs = [
        (np.exp(np.mean(np.log(result.exposures[view.name]))), view.exposure)
        for view in truth.views
        if view.exposure is not None and view.name in result.exposures
    ]
    if pairs:
        ours, true = np.array(pairs).T
        scores["exposure_log2_rmse"] = metrics.exposure_log2_rmse(ours, true)
    return scores


def _sun_scores(sun: Sunlight | None, truth: Sunlight) -> dict[str, float]:
    """How far off the direction of the sun is, degrees, and its irradiance over the true one, in the geometric mean of
    the channels; nothing where none was found."""
    if sun is None:
        return {}
    cosine = float(np.clip(sun.direction @ truth.direction, -1.0, 1.0))
    ratio = np.log(np.maximum(sun.irradiance, TINY) / np.maximum(truth.irradiance, TINY))
    return {"sun_degrees": float(np.degrees(np.arccos(cosine))), "sun_irradiance": float(np.exp(ratio.mean()))}


def _held_out(
    result: Result, root: Path, render: RenderViews | None, samples: int, seed: int, progress: Progress
) -> dict[str, dict[str, float]]:
    held_out = [view for view in read_capture(root).val_views if view.photo is not None]
    views = result.as_taken(view for view in held_out if result.in_state_of(view) is not None)
    if not views:
        raise BadInput("has neither ground truth nor held-out photos", 'give some photos the split "val"', root)
    if render is None:
        raise BadInput(
            "has no ground truth, and its held-out photos can only be scored by rendering",
            "evaluate with rendering",
            root,
        )
    with progress.stage("novel views"):
        images = render_in_states(result, views, render, samples, seed, progress)
    return score_held_out(result, views, images)
