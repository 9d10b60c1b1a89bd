"""The joint refinement: lamps from their mirror images, kept only where held-out patches are explained better."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from iris_addon import solve as solver
from iris_addon.config import preset
from iris_addon.photometry import Photometry
from iris_addon.progress import Progress
from iris_addon.refine.highlights import Highlights, trace_highlights
from iris_addon.refine.joint import PhotoLoss, Refinement, develop, refine, refine_lights
from iris_addon.reflectance.materials import scene_of
from iris_addon.reflectance.specular import specular_lobes, subtract_specular
from iris_addon.response.curve import SATURATED, gamma
from iris_addon.response.radiance import linearise
from iris_addon.transport.tracer import Tracer
from tests.engine_room import cameras, furnished_room, photograph, render

FLOOR = 4
TRUTH = np.array([[20.0, 15.0, 9.0], [6.0, 8.0, 11.0]])
EXPOSURES = 2.0 ** np.array([-3.0, -1.0, 0.0, 1.0])


def photometry(exposures: np.ndarray = EXPOSURES) -> Photometry:
    return Photometry(gamma(), np.repeat(exposures[:, None], 3, 1), np.nan, False, True)


def highlights(share: float = 0.02, n: int = 96) -> Highlights:
    """Patches seen four times, each time with another share of two lamps in the mirror; the lamps are TRUTH."""
    rng = np.random.default_rng(2)
    patch, view = np.repeat(np.arange(n), 4), np.tile(np.arange(4), n)
    shares = share * rng.random((4 * n, 2)) ** 2
    diffuse = rng.uniform(0.05, 0.4, (n, 3))
    x = photometry().exposures[view] * (diffuse[patch] + 0.01 + shares @ TRUTH)
    z = gamma().apply(np.minimum(x, 1.0))
    z = np.floor(z * 255) / 255 + 0.5 / 255
    everything = np.ones(4 * n)
    guess = np.tile(diffuse.mean(0), (n, 1))
    pixel, rest = np.zeros(4 * n, np.int32), np.full((4 * n, 3), 0.01)
    return Highlights(patch, everything, view, pixel, z, x >= 1, everything, shares, rest, guess)


def refined(h: Highlights, start: np.ndarray, log_std: float = 1.0, tie: tuple[int, ...] = (0, 1)) -> Refinement:
    return refine(h, photometry(), start, np.full(2, log_std), np.array(tie), "cpu", Progress())


def test_lamps_come_back_from_their_mirror_images() -> None:
    found = refined(highlights(), TRUTH * [[1.4], [0.7]])
    assert found.taken
    assert np.abs(np.log(found.radiance / TRUTH)).max() < 0.03


def test_the_pull_of_shading_holds_where_mirrors_say_little() -> None:
    start = TRUTH * 1.2
    found = refined(highlights(share=1e-5), start)
    assert not found.taken
    assert found.radiance == pytest.approx(start, rel=0.02)


def test_right_lamps_are_left_alone() -> None:
    assert not refined(highlights(), TRUTH).taken


def test_tied_lamps_change_together() -> None:
    found = refined(highlights(), TRUTH * 1.3, tie=(0, 0))
    assert found.radiance[0] / TRUTH[0] == pytest.approx(found.radiance[1] / TRUTH[1])


def test_a_clipped_photo_is_a_lower_bound() -> None:
    """Lamps seen themselves: clipped at first sight, so that they may be brighter than that and not darker."""
    h = highlights()
    lamp = replace(
        h,
        lobe=np.zeros(len(h.view)),
        share=np.tile(np.eye(2), (len(h.view) // 2, 1)),
        rest=np.zeros_like(h.rest),
        z=np.ones_like(h.z),
        clipped=np.ones_like(h.clipped),
    )
    change = torch.zeros((2, 3), dtype=torch.float64)
    loss = PhotoLoss.build(lamp, np.ones(len(h.view), bool), photometry(), 4 * TRUTH, np.arange(2), "cpu")
    assert float(loss.value(change, loss.log_diffuse)) == 0
    assert float(loss.value(change - 3, loss.log_diffuse)) > 1


@pytest.mark.parametrize("unknown", ["lamps", "diffuse"])
def test_the_gradient_is_that_of_finite_differences(unknown: str) -> None:
    h = highlights(n=6)
    loss = PhotoLoss.build(h, np.ones(24, bool), photometry(), 1.3 * TRUTH, np.arange(2), "cpu")
    values = [torch.zeros((2, 3), dtype=torch.float64), loss.log_diffuse.clone()]
    k = 0 if unknown == "lamps" else 1
    values[k].requires_grad_(True)
    loss.value(values[0], values[1]).backward()
    gradient = values[k].grad
    assert gradient is not None
    step = 1e-7  # within one step of the table of the response
    for index in range(values[k].numel()):
        ends = []
        for sign in (1, -1):
            moved = [value.detach().clone() for value in values]
            moved[k].view(-1)[index] += sign * step
            ends.append(float(loss.value(moved[0], moved[1])))
        assert (ends[0] - ends[1]) / (2 * step) == pytest.approx(float(gradient.view(-1)[index]), rel=1e-3, abs=1e-5)


def test_developing_is_the_response_and_goes_on_beyond_white() -> None:
    x = np.random.default_rng(0).uniform(1e-4, 1, (50, 3))
    curve = torch.from_numpy(gamma().samples)
    assert develop(curve, torch.from_numpy(x)).numpy() == pytest.approx(gamma().apply(x))
    white = develop(curve, torch.tensor([[1.0] * 3, [1.5] * 3], dtype=torch.float64)).numpy()
    assert white[0] == pytest.approx(1) and (white[1] > 1.1).all()


# In the room ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, ...]:
    """What the solve of a small room hands to the refinement; and that of a matte room, that it leaves it alone."""
    folder = tmp_path_factory.mktemp("joint")
    fine, views = furnished_room(), cameras(12, 48, 36)
    radiance = render(fine, Tracer(fine.mesh), views, 64)
    exposures = 0.25 / np.median(radiance.mean(-1).reshape(12, -1), 1) * 2.0 ** np.tile([0.0, -3.0, 1.0, -1.0], 3)
    capture = photograph(furnished_room(np.inf), views, radiance, exposures, gamma(), folder / "photos")
    config = preset("draft", max_patches=4000, atlas_size=64, rounds=1, response="gamma", joint=True)
    handed = []

    def spy(*arguments: Any) -> Any:
        handed.append(arguments)
        return refine_lights(*arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("IRIS_CACHE", str(folder / "cache"))
        patch.setattr(solver, "refine_lights", spy)
        result = solver.solve(capture, config, folder / "out")
    assert result.report["model"]["joint"].keys() == {"taken", "held_out_before", "held_out_after"}
    return handed[0][:4]


def test_a_matte_room_has_nothing_to_refine(stage: tuple[Any, ...]) -> None:
    problem, measured, lights, gloss = stage
    matte = replace(gloss, roughness=np.ones_like(gloss.roughness), metallic=np.zeros_like(gloss.metallic))
    after, found = refine_lights(problem, measured, lights, matte, Progress())
    assert not found.taken
    assert after.radiance == pytest.approx(lights.radiance)


def test_perturbed_lamps_come_back_in_a_room_with_a_polished_floor(stage: tuple[Any, ...]) -> None:
    problem, measured, lights, gloss = stage
    gloss = replace(gloss, roughness=np.where(np.arange(len(gloss.roughness)) == FLOOR, 0.15, 1.0))
    o, light = problem.observations, problem.light
    irradiance = lights.irradiance[o.patch]
    lobes = specular_lobes(
        scene_of(light, lights), gloss, light.samples, o.sample, problem.part, irradiance, 256,
        np.random.default_rng(8), Progress(),
    )  # fmt: skip
    specular = subtract_specular(*lobes, gloss.metallic[problem.part])
    radiance = 0.3 * irradiance + specular
    on_lamp = lights.mask[light.samples.face[o.sample]]
    radiance[on_lamp] = lights.face_emission(len(light.parts))[light.samples.face[o.sample[on_lamp]]]
    z = measured.response.apply(np.minimum(radiance * measured.exposures[o.view], 1)).astype(np.float32)
    o = replace(o, z=np.floor(255 * z) / np.float32(255), saturated=(z >= SATURATED).astype(np.float32))
    problem = replace(problem, observations=o, linear=linearise(o, measured.response, measured.exposures[o.view]))

    wrong = replace(lights, radiance=lights.radiance * np.array([[1.35], [0.75]]), log_std=np.full(2, 0.3))
    traced = trace_highlights(problem, wrong, gloss, np.random.default_rng(1))
    assert set(np.unique(problem.part[np.isin(o.patch, np.unique(o.patch[problem.part == FLOOR]))])) == {FLOOR}
    assert (traced.share >= 0).all() and traced.share.sum(1).max() <= 1
    after, found = refine_lights(problem, measured, wrong, gloss, Progress())
    assert found.taken and found.after < found.before
    before_error = np.abs(np.log(wrong.radiance / lights.radiance))
    error = np.abs(np.log(after.radiance / lights.radiance))
    assert error.max() < 0.12 and error.mean() < 0.3 * before_error.mean()
    assert after.irradiance.mean() == pytest.approx(
        wrong.irradiance.mean()
        + (wrong.form_factors[..., 0] @ (after.radiance - wrong.radiance)).mean(), rel=0.05
    )  # fmt: skip
