"""What a solve can be made to do, or to do without: given lamps, and refinements that are forced or forbidden."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from iris_addon.base.errors import BadInput
from iris_addon.base.files import to_ranges
from iris_addon.base.images import read_image
from iris_addon.base.progress import Progress
from iris_addon.config import AUTO, FULL, MINIMAL, Refinements, preset
from iris_addon.decide import Decisions
from iris_addon.lighting.candidates import read_given_emitters
from iris_addon.materials.gloss import GLOSS_LEVELS, GlossObservations, fit_gloss
from iris_addon.model.capture import Camera
from iris_addon.model.response import Response, gamma
from iris_addon.model.sphere import equirect_directions
from iris_addon.pipeline import solve
from iris_addon.rays.tracer import Tracer
from iris_addon.results.result import Result
from iris_addon.surface.primary_rays import trace_pixels
from tests.engine_room import LAMP_RADIANCE, LAMP_REGIONS, Room, cameras, furnished_room, photograph, render

TINY = preset("draft", max_patches=2000, gather_rays=48, shadow_rays=48, max_atlas_size=128, rounds=1, response="gamma")
N_VIEWS = 8
GAMMA = gamma()


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory):
    """Solve the furnished room, its mesh perhaps without a region, which photos show all the same or ``black``, with
    some fields of the configuration replaced."""
    folder = tmp_path_factory.mktemp("switches")
    fine, views = furnished_room(), cameras(N_VIEWS, 48, 36)
    radiance = render(fine, Tracer(fine.mesh), views, 48)
    room = furnished_room(np.inf)
    exposures = 0.25 / np.median(radiance.mean(-1).reshape(N_VIEWS, -1), 1) * 2.0 ** np.linspace(-3, 1, N_VIEWS)

    def run(
        name: str,
        known: bool = True,
        without: int = -1,
        black: bool = False,
        curve: Response = GAMMA,
        **changes: object,
    ) -> tuple[Room, Result]:
        kept = room.regions != without
        shown = np.where(black & missed(room, without, views)[..., None], 0, radiance)
        capture = photograph(room, views, shown, exposures, curve, folder / name)
        capture = replace(capture, mesh=replace(room.mesh, faces=room.mesh.faces[kept], regions=room.regions[kept]))
        if not known:
            capture = replace(capture, views=tuple(replace(view, exposure=None) for view in capture.views))
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("IRIS_CACHE", str(folder / "cache"))
            return room, solve(capture, replace(TINY, **changes), folder / f"out-{name}")

    return run


def missed(room: Room, region: int, views: list[Camera]) -> np.ndarray:
    """(V, H, W) pixels of the room that show ``region``."""
    samples = trace_pixels(Tracer(room.mesh), views, Progress())
    shows = np.zeros((len(views), views[0].height * views[0].width), bool)
    shows[samples.view, samples.pixel] = room.regions[samples.face] == region
    return shows.reshape(len(views), views[0].height, -1)


def write_mask(path: Path, lamps: list[np.ndarray]) -> Path:
    path.write_text(json.dumps({"emitters": [{"faces": np.asarray(to_ranges(faces)).tolist()} for faces in lamps]}))
    return path


def test_given_lamps_are_the_lamps_and_nothing_else_is(solved, tmp_path):
    room = furnished_room(np.inf)
    both = [np.flatnonzero(room.regions == region) for region in LAMP_REGIONS]
    _, told = solved("told", emitters=write_mask(tmp_path / "both.json", both))
    assert [emitter.faces.tolist() for emitter in told.emitters] == [faces.tolist() for faces in both]
    for emitter in told.emitters:
        assert emitter.radiance == pytest.approx(room.emission[room.regions[emitter.faces[0]]], rel=0.25)
    _, one = solved("one", emitters=write_mask(tmp_path / "one.json", both[:1]))
    assert len(one.emitters) == 1, "the missed lamp is not searched for"
    assert one.emitters[0].radiance.mean() != pytest.approx(told.emitters[0].radiance.mean(), rel=1e-3)


def test_an_empty_list_of_lamps_gives_a_dark_room(solved, tmp_path):
    _, result = solved("dark", emitters=write_mask(tmp_path / "none.json", []), refinements=MINIMAL)
    assert result.emitters == () and np.isfinite(result.textures.base_color).all()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("{}", "emitters"),
        ('{"emitters": [{"faces": [[0, 99]]}]}', "beyond"),
        ('{"emitters": [3]}', r"emitters\[0\]"),
        ('{"emitters": [{"faces": [[3, 4]]}]}', "has an area"),
        ('{"emitters": [{"faces": []}]}', "has an area"),
    ],
)
def test_an_invalid_file_of_lamps_is_bad_input_that_names_the_fault(tmp_path, content, said):
    path = tmp_path / "mask.json"
    path.write_text(content)
    with pytest.raises(BadInput, match=said):
        read_given_emitters(path, np.where(np.arange(12) == 3, 0.0, 1.0))


def test_given_lamps_are_disjoint_and_without_degenerate_faces(tmp_path):
    path = tmp_path / "mask.json"
    path.write_text('{"emitters": [{"faces": [[2, 5]]}, {"faces": [[4, 7]]}, {"faces": [[2, 4]]}]}')
    first, second = read_given_emitters(path, np.where(np.arange(12) == 3, 0.0, 1.0))
    assert first.tolist() == [2, 4] and second.tolist() == [5, 6]


def test_forced_full_and_minimal_use_all_and_nothing(solved):
    _, full = solved("full", known=False, response="auto", refinements=FULL)
    _, minimal = solved("minimal", known=False, response="auto", refinements=MINIMAL)
    curves = [result.report["model"]["response"]["curves"] for result in (full, minimal)]
    assert curves == [3, 1]
    assert not np.allclose(full.response.samples[0], full.response.samples[1])
    per_channel = [np.ptp(np.array(list(result.exposures.values())), axis=1).max() for result in (full, minimal)]
    assert per_channel[0] > 0 and per_channel[1] == 0
    assert minimal.report["model"]["glossy_regions"] == 0
    assert minimal.report["model"]["unseen_lamps"] == 0 and minimal.report["model"]["outside_directions"] == 0


@pytest.mark.parametrize("power", [0.3, 1.1])
def test_light_transport_finds_the_exponent_that_unknown_exposures_leave_open(solved, power):
    """Photos through a power law, of which overlap alone cannot tell which."""
    curve, wrong = gamma(power), []
    for allowed in (False, None):
        refinements = Refinements(exponent=allowed)
        _, result = solved(f"{power}-{allowed}", known=False, curve=curve, response="auto", refinements=refinements)
        middle = result.response.samples[1, 256]  # of a power law: 4 ** -power
        wrong.append(abs(np.log(-np.log(middle) / np.log(4) / power)))
    # On eight photos of 48 x 36 pixels 0.34 to 0.62 of the error is left, by how cells fall into patches.
    assert wrong[0] > 0.4 and wrong[1] < 0.7 * wrong[0]


def test_light_from_outside_is_forced_and_forbidden(solved):
    directions = []
    for forced in (True, False):
        _, result = solved(f"open-{forced}", without=5, refinements=Refinements(hidden_light=forced))
        directions.append(result.report["model"]["outside_directions"])
        assert (result.outside is not None) == forced
    assert directions == [12, 0]


CEILING, WALL = 5, 3


@pytest.mark.parametrize("missing", [CEILING, WALL])
def test_a_wall_that_the_mesh_lacks_is_recovered_from_what_photos_show_through_the_hole(solved, missing):
    """It lights the room as it did, whose lamps stay what they are, and has its albedo."""
    room, result = solved(f"lacks-{missing}", without=missing)
    assert result.report["model"]["light_through_holes"] and result.outside is None
    lamps = np.array([emitter.radiance for emitter in result.emitters])
    true = LAMP_RADIANCE[np.argsort(-LAMP_RADIANCE[:, 2])]
    np.testing.assert_allclose(lamps[np.argsort(-lamps[:, 2])], true, rtol=0.1)
    backdrop = result.backdrop
    assert backdrop is not None and backdrop.albedo is not None
    towards = equirect_directions(*backdrop.picture.shape[1::-1]) @ np.eye(3)[{CEILING: 2, WALL: 1}[missing]]
    np.testing.assert_allclose(np.median(backdrop.albedo[towards > 0.9], axis=0), room.albedo[missing], rtol=0.12)
    assert not backdrop.picture[towards > 0.9].any()


def test_the_report_shows_through_a_hole_what_photos_show_there(solved, tmp_path_factory):
    """Where a wall is missing, its re-renders have what lies beyond, not what lies beside the hole."""
    room, _ = solved("shown", without=WALL)
    (report,) = tmp_path_factory.getbasetemp().glob("switches[0-9]*/out-shown/report")
    beyond, off = missed(room, WALL, cameras(N_VIEWS, 48, 36)), []
    for name, hole in zip([f"{k:03d}" for k in range(N_VIEWS)], beyond, strict=True):
        if hole.sum() > 50 and (report / f"{name}-render.png").is_file():
            photo, shown = (read_image(report / f"{name}-{kind}.png") / 255 for kind in ("photo", "render"))
            off.append(np.median(np.abs(photo - shown)[hole]))
    assert off and max(off) < 0.03


def test_light_that_photos_do_not_show_is_fitted_instead(solved):
    """The room without its ceiling, beyond which photos are black: what comes from there they do not know."""
    _, result = solved("lacks-sky", without=CEILING, black=True)
    model = result.report["model"]
    assert not model["light_through_holes"] and model["outside_directions"]
    assert result.backdrop is not None and result.backdrop.albedo is None


def test_forced_gloss_is_fitted_below_the_acceptance_gain():
    """Radiance that the widest glossy lobe explains a little better than none: not enough unless forced."""
    rng = np.random.default_rng(0)
    n = 200
    patch = np.repeat(np.arange(n // 4), 4)
    irradiance = np.full((n, 3), 1.0)
    s1 = 0.02 * rng.random((n, 1)) * np.ones(3)
    noise = np.exp(0.15 * rng.standard_normal((n, 1)))
    radiance = 0.5 * irradiance * noise + 2 * s1
    lobes = [[(np.zeros((n, 3)), s1 * scale)] * 2 for scale in np.linspace(4, 0, len(GLOSS_LEVELS))]
    observed = GlossObservations(
        region=np.zeros(n, int),
        patch=patch,
        weight=np.ones(n),
        position=np.zeros((n, 3)),
        radiance=radiance,
        irradiance=irradiance,
        diffuse=np.ones((len(GLOSS_LEVELS), n)),
        lobes=lobes,
    )
    fits = [fit_gloss(observed, 1, Decisions({"gloss": forced})) for forced in (None, True, False)]
    assert fits[0].roughness[0] == 1 and fits[1].roughness[0] < 1 and fits[2].roughness[0] == 1
    assert not fits[2].decided.any()
    shown = replace(observed, radiance=0.5 * irradiance * noise)
    assert fit_gloss(shown, 1, Decisions({"gloss": True})).roughness[0] > 0.6


def test_nothing_is_forced_by_default():
    assert preset("balanced").refinements == AUTO and preset("balanced").emitters == "search"
