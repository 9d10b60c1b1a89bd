"""Radiance of observations and patches: means, and the bounds that clipped and black observations give."""

from __future__ import annotations

import numpy as np
import pytest

from iris_addon.model import response as curve
from iris_addon.model.response import N_SAMPLES, Response
from iris_addon.response.curve_table import CurveTable
from iris_addon.response.overlap_problem import OverlapProblem
from iris_addon.response.radiance import (
    MODEL_NOISE,
    Linearised,
    group_radiance,
    linearise,
    linearise_bytes,
    raised_by_clipped,
    relative_exposure,
)
from tests.engine_room import observe_off_edges
from tests.response.photographed_patches import EXPOSURES, observations_of


def test_radiance_comes_back_through_the_curve() -> None:
    rng = np.random.default_rng(6)
    truth = curve.gamma()
    observations, radiance = observations_of(truth, EXPOSURES, rng)
    linear = linearise(observations, truth, np.repeat(EXPOSURES[observations.view, None], 3, 1))
    found = group_radiance(linear, observations.patch, observations.count, len(radiance))
    assert found.known.all()
    assert found.radiance == pytest.approx(radiance, rel=0.03)


def test_one_view_with_a_highlight_does_not_move_a_patch() -> None:
    rng = np.random.default_rng(7)
    observations, radiance = observations_of(curve.gamma(), EXPOSURES, rng)
    linear = linearise(observations, curve.gamma(), np.repeat(EXPOSURES[observations.view, None], 3, 1))
    linear.radiance[observations.view == 4] *= 8
    found = group_radiance(linear, observations.patch, observations.count, len(radiance))
    off = np.abs(np.log(found.radiance / radiance))
    assert np.median(off) < 0.12


def test_radiance_clipped_in_every_photo_is_a_lower_bound() -> None:
    patch, view = np.array([0, 0, 1, 1], np.int32), np.array([0, 1, 0, 1], np.int16)
    z = np.array([[1.0] * 3, [1.0] * 3, [0.5] * 3, [1.0] * 3], np.float32)
    observations = observe_off_edges(patch, view, z, np.random.default_rng(8))
    linear = linearise(observations, curve.gamma(), np.array([[2.0] * 3, [0.25] * 3])[observations.view])
    found = group_radiance(linear, observations.patch, observations.count, 2)
    assert (found.known == [[False] * 3, [True] * 3]).all()
    assert found.bound == pytest.approx(np.full((2, 3), 4.0))
    assert found.radiance[0] == pytest.approx(4.0)
    assert found.radiance[1] == pytest.approx(((0.5 + 0.5 / 255) ** 2.2) / 2, rel=1e-3)
    # The long exposure tells nothing of what clips in the short one.
    of_short = observations.count[(observations.patch == 0) & (observations.view == 1)]
    assert found.weight[0] == pytest.approx(of_short.sum())


def test_pixels_that_clip_in_the_shortest_exposure_raise_their_patch() -> None:
    """Half of the pixels of a patch shine twice as much as the others and clip in both exposures; a patch all of
    whose pixels the short exposure shows is left as it is, however many of the long one clipped."""
    exposures, truth = np.array([1.0, 8.0]), curve.gamma()
    radiance = np.array([[0.6, 1.2], [0.4, 0.4]])  # (patches, halves)
    patch, half, view = (axis.ravel() for axis in np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"))
    z = truth.apply(np.repeat(np.clip(radiance[patch, half] * exposures[view], 0, 1)[:, None], 3, 1))
    shown = np.where(z >= 1, 1.0, np.floor(z * 255) / 255).astype(np.float32)
    # Observations are means of one photo on one patch; halves seen by photos of their own.
    view = (2 * half + view).astype(np.int16)
    observations = observe_off_edges(patch, view, shown, np.random.default_rng(0))
    linear = linearise(observations, truth, np.repeat(np.tile(exposures, 2)[observations.view, None], 3, 1))
    o, plain = observations, np.ones(len(observations.patch))
    found = group_radiance(linear, o.patch, o.count, 2)
    raised = raised_by_clipped(found, linear, o.patch, o.count, plain)
    assert found.radiance[:, 0] == pytest.approx([0.6, 0.4], rel=0.01)
    assert raised[:, 0] == pytest.approx([0.8, 0.4], rel=0.01)  # (0.6 + bound 1) / 2 and as it was


# ---- Black observations ---------------------------------------------------------------------------------------------


TOE = 0.25
"""Relative exposure up to which the curve below is black."""


def crushing() -> Response:
    """A straight line that begins to rise at TOE."""
    return Response(np.tile(np.clip((np.linspace(0, 1, N_SAMPLES) - TOE) / (1 - TOE), 0, 1), (3, 1)), "file")


def photographed(radiance: np.ndarray, exposures: np.ndarray) -> tuple[Linearised, np.ndarray, np.ndarray]:
    """One pixel per patch and photo: radiance (P, V) under exposures (V,); with patch and count of the observations."""
    patch, view = (axis.ravel() for axis in np.indices(radiance.shape))
    z = np.floor(255 * crushing().apply(np.repeat((radiance * exposures).reshape(-1, 1), 3, 1))) / 255
    o = observe_off_edges(patch, view, z.astype(np.float32), np.random.default_rng(0))
    return linearise(o, crushing(), np.repeat(exposures[o.view, None], 3, 1)), o.patch, o.count


@pytest.mark.parametrize("response", [crushing(), curve.gamma(1.0)], ids=["crushing", "linear"])
def test_a_black_pixel_is_a_uniform_exposure_below_the_next_byte(response: Response) -> None:
    below = response.invert(np.full((1, 3), 1 / 255))[0, 0]
    mean, noise = relative_exposure(response, np.zeros((1, 3)), np.ones((1, 3)))
    assert mean == pytest.approx(np.full((1, 3), below / 2))
    assert noise == pytest.approx(np.full((1, 3), 1 / np.sqrt(3)), rel=1e-6)  # (b / sqrt 12) / (b / 2)


def test_a_mean_over_black_pixels_is_that_of_their_exposures() -> None:
    """Pixels exposed evenly up to twice TOE: half of them black. Their mean display value alone would say 0.31."""
    x = (np.arange(4000) + 0.5) / 4000 * 2 * TOE
    z = np.floor(255 * crushing().apply(np.repeat(x[:, None], 3, 1))) / 255
    shown, black = z.mean(0, keepdims=True), (z == 0).mean(0, keepdims=True)
    assert relative_exposure(crushing(), shown, black)[0] == pytest.approx(np.full((1, 3), TOE), rel=0.01)
    assert crushing().invert(shown + 0.5 / 255)[0, 0] == pytest.approx(0.3125, abs=0.001)


def test_black_photos_of_less_exposure_do_not_move_a_patch() -> None:
    radiance = np.full((1, 6), 0.1)
    linear, patch, count = photographed(radiance, np.array([0.25, 0.5, 0.5, 1.0, 4.0, 8.0]))
    assert np.isfinite(linear.ceiling[:, 0]).tolist() == [True] * 4 + [False] * 2
    assert linear.ceiling[3, 0] == pytest.approx(TOE, rel=0.02)
    found = group_radiance(linear, patch, count, 1)
    assert found.radiance == pytest.approx(np.full((1, 3), 0.1), rel=0.01)


def test_black_photos_outweigh_the_highlight_that_one_shows() -> None:
    """A dark surface at 0.02 that one photo of eight sees shine at 0.5. Seven, exposed by 4, are black: below 0.063."""
    radiance = np.full((1, 8), 0.02)
    radiance[0, 3] = 0.5
    linear, patch, count = photographed(radiance, np.array([4.0] * 3 + [1.0] + [4.0] * 4))
    found = group_radiance(linear, patch, count, 1)
    assert (found.radiance < 1.1 * TOE / 4).all()


def test_a_patch_black_in_all_photos_lies_below_its_lowest_ceiling_with_little_weight() -> None:
    radiance = np.array([[0.01] * 4, [0.3] * 4])
    linear, patch, count = photographed(radiance, np.array([0.5, 1.0, 2.0, 4.0]) * 0.9)
    found = group_radiance(linear, patch, count, 2)
    assert (found.radiance[0] < TOE / 3.6).all() and (found.radiance[0] > 0).all()
    assert found.weight[0] < 0.02 * found.weight[1]
    assert found.radiance[1] == pytest.approx(np.full(3, 0.3), rel=0.01)


def test_black_pixels_agree_with_expected_radiance_up_to_their_ceiling() -> None:
    linear, _, _ = photographed(np.array([[0.1, 0.1, 0.1]]), np.array([1.0, 2.0, 4.0]))
    agreeing = linear.agreeing_with(np.full((3, 3), 0.2))
    # Below 0.25, below 0.125, and seen.
    assert agreeing.radiance[:, 0] == pytest.approx([0.2, TOE / 2, 0.1], rel=0.02)
    assert (np.diff(agreeing.precision[:, 0]) < 0)[1] and agreeing.precision[0, 0] < 0.01 * agreeing.precision[1, 0]


def test_a_dark_byte_is_coarse_for_dark_surfaces_and_not_for_bright_ones() -> None:
    """Bytes of 1 and 200 under a straight curve, of patches that are expected as dark as the first, and bright."""
    straight = Response(np.repeat(np.linspace(0, 1, N_SAMPLES)[None], 3, 0), "power")
    z = np.repeat(np.array([[1.0], [200.0], [1.0], [200.0]]) / 255, 3, 1)
    linear = linearise_bytes(straight, z, np.ones_like(z), np.zeros_like(z), np.zeros_like(z))
    level = np.array([[1.5], [1.5], [200.5], [200.5]]) / 255 * np.ones(3)
    own = np.array([1.5, 200.5, 1.5, 200.5]) / 255
    noise = 1 / 255 / np.sqrt(12)
    expected = 1 / (MODEL_NOISE**2 + (noise / level[:, 0]) ** 2)
    assert linear.precision_at(level)[:, 0] == pytest.approx(expected, rel=1e-3)
    assert linear.precision_at(own[:, None] * np.ones(3)) == pytest.approx(linear.precision, rel=1e-6)


def test_the_overlap_of_photos_reads_radiance_where_it_is_not_black() -> None:
    """Dark patches under four exposures, of which one or two are not black."""
    rng = np.random.default_rng(1)
    radiance, exposures = rng.uniform(0.08, 0.2, 200), np.array([0.5, 1.0, 2.0, 4.0])
    patch, view = (axis.ravel() for axis in np.indices((200, 4)))
    z = np.floor(255 * crushing().apply(np.repeat((radiance[patch] * exposures[view])[:, None], 3, 1))) / 255
    o = observe_off_edges(patch, view, z.astype(np.float32), rng)
    problem, curves = OverlapProblem.build(o, np.arange(len(o.patch)), exposures, 4), CurveTable.of(crushing())
    found = problem.exposed(curves).numpy().T[view == 1]  # of the photos whose exposure is 1
    assert found == pytest.approx(np.repeat(radiance[:, None], 3, 1), rel=0.02)


def test_black_observations_are_not_well_exposed() -> None:
    """A dark floor: its short exposures are black and do not tell of it, the long ones do."""
    rng = np.random.default_rng(2)
    radiance = np.repeat(rng.uniform(0.1, 0.2, (200, 1)), 8, 1)
    linear, _, _ = photographed(radiance, np.tile([0.25, 4.0], 4))
    assert linear.well_exposed.reshape(200, 8)[:, 1::2].all() and not linear.well_exposed.reshape(200, 8)[:, ::2].any()


def test_black_pixels_that_agree_keep_the_noise_of_their_byte() -> None:
    """Black under a ceiling twice as high as expected: its error is that of the byte, not of what is expected."""
    linear, _, _ = photographed(np.array([[0.1, 0.1, 0.1]]), np.array([1.0, 2.0, 4.0]))
    level = np.full((3, 3), 0.125)
    agreeing = linear.agreeing_with(level)
    assert agreeing.radiance[0] == pytest.approx(level[0]), "below its ceiling of 0.25"
    assert agreeing.precision_at(level)[0] == pytest.approx(linear.precision_at(level)[0])
    assert agreeing.precision_at(2 * level)[0, 0] > 3 * agreeing.precision_at(level)[0, 0]
