"""A room photographed with one lamp, with the other, and with both: solved together, with one set of materials."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from iris_addon.config import preset
from iris_addon.model.capture import Capture
from iris_addon.model.response import gamma
from iris_addon.pipeline import solve
from iris_addon.rays.tracer import Tracer
from iris_addon.results.folder import load_result
from iris_addon.results.result import Result
from iris_addon.textures.atlas import rasterise_atlas
from tests.engine_room import LAMP_RADIANCE, LAMP_REGIONS, Room, cameras, furnished_room, photograph, render

CONFIG = preset("draft", max_patches=4000, gather_rays=64, shadow_rays=64, max_atlas_size=128, rounds=1)
LIT = {"both": (8, 9), "large": (8,), "small": (9,)}
"""Lamps that are on in each light state."""
UNLIT = 0.5
"""Albedo of a lamp that is off."""
STATES = ("both", "both", "large", "small") * 4


def lit_room(on: tuple[int, ...]) -> Room:
    room = furnished_room()
    albedo, emission = room.albedo.copy(), room.emission.copy()
    for region in set(LAMP_REGIONS) - set(on):
        emission[region], albedo[region] = 0.0, UNLIT
    return Room(room.mesh, albedo, emission)


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    views = cameras(len(STATES), 48, 36)
    radiance = np.zeros((len(views), 36, 48, 3))
    for state, on in LIT.items():
        own = [k for k, name in enumerate(STATES) if name == state]
        room = lit_room(on)
        radiance[own] = render(room, Tracer(room.mesh), [views[k] for k in own], 128)
    stops = 2.0 ** np.array([0, -3, 1, -1, -1, -4, -2, -3] * 2)
    exposures = 0.25 / np.median(radiance.mean(-1).reshape(len(views), -1), 1) * stops
    coarse = furnished_room(np.inf)
    taken = photograph(coarse, views, radiance, exposures, gamma(), tmp_path_factory.mktemp("photos"))
    named = zip(taken.views, STATES, strict=True)
    return replace(taken, views=tuple(replace(view, light_state=state) for view, state in named))


@pytest.fixture(scope="module")
def folder(capture: Capture, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("solved")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("IRIS_CACHE", str(out / "cache"))
        solve(capture, CONFIG, out / "result")
    return out / "result"


@pytest.fixture(scope="module")
def found(folder: Path) -> Result:
    return load_result(folder)


def seen_texels(capture: Capture, result: Result) -> tuple[np.ndarray, np.ndarray]:
    """Part of the room and base colour of the texels that photos reached."""
    regions, uv = capture.mesh.regions, result.mesh.uv
    assert regions is not None
    assert uv is not None
    face, _ = rasterise_atlas(uv, len(result.textures.base_color))
    seen = (face >= 0) & (result.textures.confidence > 0)
    return regions[face[seen]], result.textures.base_color[seen]


def test_each_state_has_its_lamps_with_their_radiance(capture: Capture, found: Result) -> None:
    regions = capture.mesh.regions
    assert regions is not None
    assert [state.name for state in found.light_states] == list(LIT)
    lamps = [int(regions[emitter.faces[0]]) for emitter in found.emitters]
    assert sorted(lamps) == list(LAMP_REGIONS)
    for state in found.light_states:
        for region, radiance in zip(lamps, state.radiance, strict=True):
            if region in LIT[state.name]:
                assert radiance == pytest.approx(LAMP_RADIANCE[LAMP_REGIONS.index(region)], rel=0.2)
            else:
                assert not radiance.any()


def test_the_lights_of_the_result_are_those_of_the_state_of_most_photos(found: Result) -> None:
    first = found.light_states[0]
    assert first.name == "both"
    assert np.array_equal([emitter.radiance for emitter in found.emitters], first.radiance)


def test_one_albedo_explains_the_photos_of_all_states(capture: Capture, found: Result) -> None:
    region, color = seen_texels(capture, found)
    error = np.abs([color[region == k].mean(0) - furnished_room(np.inf).albedo[k] for k in range(8)])
    assert error.mean() < 0.05
    assert error.max() < 0.12
    assert found.report["holdout_psnr"] > 28


def test_a_lamp_has_the_base_colour_that_photos_show_where_it_is_off(capture: Capture, found: Result) -> None:
    region, color = seen_texels(capture, found)
    own = region == LAMP_REGIONS[0]
    assert own.any()
    assert np.median(color[own]) == pytest.approx(UNLIT, abs=0.15)


def test_the_report_names_the_states(found: Result) -> None:
    photos = {name: STATES.count(name) for name in LIT}
    told = found.report["model"]["light_states"]
    assert {name: figures["photos"] for name, figures in told.items()} == photos
    assert {name: figures["lamps_on"] for name, figures in told.items()} == {"both": 2, "large": 1, "small": 1}


def test_photos_of_several_lights_that_pass_for_one_are_said_to_be(
    capture: Capture, found: Result, tmp_path: Path
) -> None:
    unnamed = replace(capture, views=tuple(replace(view, light_state="") for view in capture.views))
    told = solve(unnamed, CONFIG, tmp_path / "mixed").report["warnings"]
    (warning,) = [text for text in told if "light_state" in text]
    assert "show the room under several" in warning
    assert not [text for text in found.report["warnings"] if "light_state" in text]


def test_the_report_has_the_noise_of_the_photos(found: Result) -> None:
    assert found.report["photos"]["noise"] < 0.01
    assert not [text for text in found.report["warnings"] if "noisy" in text or "compress" in text]


def test_a_lamp_that_is_dimmed_in_one_state_has_a_radiance_in_each(capture: Capture, tmp_path: Path) -> None:
    """The same photos under exposures twice as long, in one state, show half the light."""
    dimmed = [
        replace(view, exposure=2 * (view.exposure or 1.0)) if view.light_state == "small" else view
        for view in capture.views
    ]
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("IRIS_CACHE", str(tmp_path / "cache"))
        result = solve(replace(capture, views=tuple(dimmed)), CONFIG, tmp_path / "result")
    regions = capture.mesh.regions
    assert regions is not None
    (small,) = [k for k, emitter in enumerate(result.emitters) if regions[emitter.faces[0]] == LAMP_REGIONS[1]]
    radiance = {state.name: state.radiance[small] for state in result.light_states}
    assert radiance["both"] == pytest.approx(LAMP_RADIANCE[1], rel=0.2)
    assert radiance["small"] == pytest.approx(LAMP_RADIANCE[1] / 2, rel=0.2)


def test_a_lamp_that_is_only_switched_has_one_radiance(capture: Capture, found: Result) -> None:
    regions = capture.mesh.regions
    assert regions is not None
    both, large, small = found.light_states
    for k, emitter in enumerate(found.emitters):
        alone = large if regions[emitter.faces[0]] == LAMP_REGIONS[0] else small
        assert np.array_equal(both.radiance[k], alone.radiance[k])
