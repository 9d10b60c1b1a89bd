"""Scores of material and emission maps over the training views, as IRIS and FIPT evaluate them.

Emitter pixels of the truth are zeroed on both sides and stay in the denominator. Beside each number, ``*_valid`` is the
error over surface pixels only, ``*_8x8`` compares means over blocks of 8 x 8 pixels, and ``*_si`` allows one
least-squares factor over all images of that metric.
Values are means over images of the per-image value.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ..base.progress import Progress
from ..model.capture import View
from ..results.maps import MapRenderer, ViewMaps
from . import metrics
from .ground_truth import GroundTruth
from .metrics import FloatArray, Mask

FULLY_ROUGH = 0.999
"""True roughness above which a pixel counts as diffuse."""
MIN_ROUGHNESS = 0.2
"""Smaller values are not distinguished: both sides are clamped to [0.2, 1]."""


@dataclass(frozen=True)
class AlbedoPair:
    """An albedo of one image, (H, W, 3) linear: as recovered, in truth, and which pixels count."""

    metric: str
    image: FloatArray
    truth: FloatArray
    mask: Mask


class _ScaleFit:
    """The least-squares factor s of Σ (s p − g)² over everything added."""

    def __init__(self) -> None:
        self.pg = self.pp = 0.0

    def add(self, image: FloatArray, truth: FloatArray) -> None:
        p, g = image.astype(np.float64), truth.astype(np.float64)
        self.pg, self.pp = self.pg + float((p * g).sum()), self.pp + float((p * p).sum())

    @property
    def factor(self) -> float:
        return self.pg / self.pp if self.pg > 0 and self.pp > 0 else 1.0


def score_maps(
    renderer_of: Callable[[View], MapRenderer], truth: GroundTruth, progress: Progress
) -> dict[str, dict[str, float]]:
    """Per-image values of every map metric the ground truth allows: metric, then view name.

    Args:
        renderer_of: of the room in the light state of a view.
    """
    albedo_fits: dict[str, _ScaleFit] = {}
    light_fit = _LogScaleFit()
    for _index, _maps, pairs, emission in _views(renderer_of, truth, progress, 0.0):
        for pair in pairs:
            albedo_fits.setdefault(pair.metric, _ScaleFit()).add(pair.image[pair.mask], pair.truth[pair.mask])
        if emission is not None:
            light_fit.add(*emission)

    scores: dict[str, dict[str, float]] = {}
    for index, maps, pairs, emission in _views(renderer_of, truth, progress, 0.5):
        found: dict[str, float] = {}
        for pair in pairs:
            found |= _albedo_scores(pair, maps.hit, albedo_fits[pair.metric].factor)
        found |= _gloss_scores(maps, truth, index)
        if emission is not None:
            found |= _emission_scores(*emission, light_fit.factor)
        for metric, value in found.items():
            scores.setdefault(metric, {})[truth.views[index].name] = value
    return scores


def _views(
    renderer_of: Callable[[View], MapRenderer], truth: GroundTruth, progress: Progress, start: float
) -> Iterator[tuple[int, ViewMaps, list[AlbedoPair], tuple[FloatArray, FloatArray] | None]]:
    """For each training view its maps, its albedo pairs, and its emission (ours, true) if a true emitter shows."""
    for index, view in enumerate(truth.views):
        progress.update(start + 0.5 * index / len(truth.views))
        maps = renderer_of(view).maps(view.camera)
        true_emission = truth.map("Emit", "train", index)
        shows = true_emission is not None and bool((true_emission > 0).any())
        yield (
            index,
            maps,
            list(_albedo_pairs(maps, truth, index)),
            (maps.emission, true_emission) if true_emission is not None and shows else None,
        )


def _not_emitter(maps: ViewMaps, truth: GroundTruth, index: int) -> Mask:
    emission = truth.map("Emit", "train", index)
    return np.ones(maps.hit.shape, bool) if emission is None else emission.max(axis=-1) <= 0


def _albedo_pairs(maps: ViewMaps, truth: GroundTruth, index: int) -> Iterator[AlbedoPair]:
    surface = _not_emitter(maps, truth, index)
    kd, roughness = truth.map("DiffCol", "train", index), truth.map("Roughness", "train", index)
    if kd is not None:
        yield AlbedoPair("kd_psnr_all", maps.kd, kd, surface)
        if roughness is not None:
            yield AlbedoPair("kd_psnr", maps.kd, kd, surface & (roughness[..., 0] > FULLY_ROUGH))
    directional = truth.map("albedo", "train", index)
    if directional is not None:
        yield AlbedoPair("a_psnr", maps.directional_albedo, directional, surface)
        yield AlbedoPair("a_lobe_psnr", maps.lobed_albedo, directional, surface)


def _albedo_scores(pair: AlbedoPair, hit: Mask, factor: float) -> dict[str, float]:
    """Nothing for an image without a pixel that counts: zero against zero would be a perfect score for free."""
    scores = {}
    if (pair.mask & hit).any():
        keep = pair.mask[..., None]
        truth = metrics.quantise8(pair.truth)
        for suffix, scale in (("", 1.0), ("_si", factor)):
            image = metrics.quantise8(pair.image * scale)
            scores[f"{pair.metric}{suffix}"] = metrics.psnr(image * keep, truth * keep)
            scores[f"{pair.metric}_valid{suffix}"] = metrics.psnr(image, truth, pair.mask & hit)
            scores[f"{pair.metric}_8x8{suffix}"] = metrics.block_psnr(image * keep, truth * keep)
            scores[f"{pair.metric}_valid_8x8{suffix}"] = metrics.block_psnr(image, truth, pair.mask & hit)
    return scores


def _gloss_scores(maps: ViewMaps, truth: GroundTruth, index: int) -> dict[str, float]:
    surface = _not_emitter(maps, truth, index)
    scores = {}
    roughness, metallic = truth.map("Roughness", "train", index), truth.map("Metallic", "train", index)
    if roughness is not None:
        image, true = (np.clip(x, MIN_ROUGHNESS, 1.0) for x in (maps.roughness, roughness[..., 0]))
        scores["roughness_psnr"] = metrics.psnr(image * surface, true * surface)
        scores["roughness_psnr_valid"] = metrics.psnr(image, true, surface & maps.hit)
    if metallic is not None:
        scores["metallic_l2"] = metrics.mse(maps.metallic * surface, metallic[..., 0] * surface)
        scores["metallic_l2_valid"] = metrics.mse(maps.metallic, metallic[..., 0], surface & maps.hit)
    return scores


# ---- Emission -------------------------------------------------------------------------------------------------------


class _LogScaleFit:
    """The factor that brings the log of our emission closest to the true one, over pixels where both emit."""

    def __init__(self) -> None:
        self._sum, self._count = 0.0, 0

    def add(self, emission: FloatArray, truth: FloatArray) -> None:
        both = (emission > 0) & (truth > 0)
        self._sum += float((np.log(truth[both].astype(np.float64)) - np.log(emission[both])).sum())
        self._count += int(both.sum())

    @property
    def factor(self) -> float:
        return float(np.exp(self._sum / self._count)) if self._count else 1.0


def _emission_scores(emission: FloatArray, truth: FloatArray, factor: float) -> dict[str, float]:
    return {
        "emission_iou": metrics.iou(emission.max(axis=-1) > 0, truth.max(axis=-1) > 0),
        "emission_log_l2": metrics.log_l2(emission, truth),
        "emission_log_l2_si": metrics.log_l2(emission * factor, truth),
    }
