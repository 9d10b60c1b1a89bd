"""The ends of the harness's scale: the truth scores near-perfect in every metric, grey as badly as it should."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import worker
from benchmarks.runs import Run
from iris_addon.blender.render import cycles as blender_render
from iris_addon.evaluate.ground_truth import read_ground_truth, read_rgb
from iris_addon.model.response import identity
from iris_addon.results.result import Result
from tests.truth_room import true_result, write_references, write_truth_room

PERFECT = {"kd_psnr": 60, "kd_psnr_all": 60, "a_psnr": 60, "roughness_psnr": 60, "nvs_psnr": 50, "relight_psnr": 50}
"""Decibels: 8-bit quantisation and interpolation are all that is between the truth and itself."""
RADIANCE = np.random.default_rng(0).random((24, 32, 3)).astype(np.float32)


def grey_result() -> Result:
    """Everything half grey, rough and unlit, the photos taken for linear ones of equal exposure."""
    result = true_result()
    textures = result.textures
    grey = replace(
        textures,
        base_color=np.full_like(textures.base_color, 0.5),
        roughness=np.full_like(textures.roughness, 0.5),
        metallic=np.full_like(textures.metallic, 0.5),
    )
    equal = {name: np.ones(3) for name in result.exposures}
    return replace(result, textures=grey, emitters=(), response=identity(), exposures=equal)


def render_like(result: Result, cameras: list, **_options: Any) -> list[np.ndarray]:
    """A renderer of two answers: the references for the truth, an even grey for anything else."""
    picture = RADIANCE if result.emitters else np.full_like(RADIANCE, RADIANCE.mean())
    return [picture] * len(cameras)


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(blender_render, "render_views", render_like)
    root = write_truth_room(tmp_path / "room")
    write_references(root, RADIANCE)
    return root


pytestmark = pytest.mark.bpy


def test_the_truth_scores_near_perfect_in_every_metric(root):
    scores = worker.score(true_result(), Run("room", scored="all", samples=1), root)
    assert {name: scores[name] > floor for name, floor in PERFECT.items()} == dict.fromkeys(PERFECT, True)
    assert scores["emission_iou"] == 1 and scores["emission_log_l2"] < 1e-9 and scores["metallic_l2"] < 1e-9
    assert scores["crf_l2"] == 0 and scores["exposure_log2_rmse"] < 1e-9
    assert scores["insert_psnr"] > 50 and set(scores["left_out"]) == {"lpips"}


def test_constant_grey_scores_as_badly_as_it_should(root):
    scores = worker.score(grey_result(), Run("room", scored="all", samples=1), root)
    for name in PERFECT:
        assert scores[name] < 20, name
    assert scores["emission_iou"] == 0
    # All lamps missed: the error is log(1 + true radiance) squared over the pixels that show them.
    truth = read_ground_truth(root)
    assert truth is not None
    emission = [read_rgb(path) for k in range(len(truth.views)) if (path := truth.path("train/Emit", k)) is not None]
    expected = np.mean([np.mean(np.log1p(image) ** 2) for image in emission if image.any()])
    assert scores["emission_log_l2"] == pytest.approx(expected, rel=1e-3)
    assert scores["metallic_l2"] > 0.1
    assert scores["crf_l2"] > 4 and scores["exposure_log2_rmse"] > 1


def test_relighting_alone_agrees_with_all_metrics(root):
    both = [
        worker.score(grey_result(), Run(str(root), scored=scored, samples=1), root)["relight_psnr"]
        for scored in ("all", "relight")
    ]
    assert both[0] == pytest.approx(both[1])


def test_another_response_does_not_move_the_decibels_of_relighting(root, tmp_path):
    """A sweep of responses changes the photos; what the room is like is asked through one curve throughout."""
    other = write_truth_room(tmp_path / "other")
    write_references(other, RADIANCE)
    dark = np.linspace(0, 1, identity().samples.shape[1]) ** 3
    np.save(other / "gt" / "cam" / "crf_gt.npy", np.tile(dark, (3, 1)))
    run = Run(str(root), scored="relight", axis="response", level=3, samples=1)
    scored = [worker.score(grey_result(), run, truth)["relight_psnr"] for truth in (root, other)]
    assert scored[0] == pytest.approx(scored[1])
