"""Which lamps stay under the light found so far: a window between its bars, a lamp that is clipped in every photo."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from iris_addon.base.progress import Progress
from iris_addon.lighting import lamp_radiance as solve
from iris_addon.lighting import search, selection
from iris_addon.lighting.balance import ROBUST_LOG
from iris_addon.lighting.candidates import CERTAIN, MAX_LAMPS, Brightness
from iris_addon.lighting.hidden import HiddenSources
from iris_addon.lighting.problem import LightProblem, Lights
from iris_addon.model.capture import Mesh
from iris_addon.surface.topology import edge_adjacency

N_PATCHES = 60
WINDOW, BAR, WALL = 0, 1, 2
PATCH_FACE = np.repeat([WINDOW, BAR, WALL], [20, 20, 20])
OBSERVED = SimpleNamespace(weight=np.ones(N_PATCHES), known=np.ones((N_PATCHES, 3), bool))


def problem(floor: tuple[float, float, float], clipped: tuple[bool, bool, bool]) -> LightProblem:
    """Three faces that are three regions, a pixel on every patch."""
    value = np.array(floor)[PATCH_FACE][:, None].repeat(3, 1)
    bound = np.where(np.array(clipped)[PATCH_FACE][:, None], value, 0.0)
    nothing = np.zeros(0, np.int64)
    return SimpleNamespace(  # type: ignore[return-value]
        transport=SimpleNamespace(n_seen=N_PATCHES, n_patches=N_PATCHES, kappa=np.zeros(N_PATCHES), region=PATCH_FACE),
        surface=SimpleNamespace(
            sample_patch=np.arange(N_PATCHES), count=np.ones(N_PATCHES), spread=np.zeros(N_PATCHES)
        ),
        samples=SimpleNamespace(face=PATCH_FACE, seen_faces=lambda n: np.ones(n, bool)),
        tracer=SimpleNamespace(areas=np.array([2.0, 0.2, 10.0]), normals=np.eye(3)),
        regions=np.arange(3, dtype=np.int32),
        material=np.arange(3, dtype=np.int32),
        adjacency=(nothing, nothing),
        brightness=Brightness(value, np.where(bound > 0, np.nan, value), bound),
        brighter_neighbour=np.full(N_PATCHES, -1),
        hidden=HiddenSources((), np.zeros((0, 3)), np.zeros((N_PATCHES, 0, 2), np.float32)),
        given=None,
        robust_log=ROBUST_LOG,
    )


def lights(lamps: list[tuple[int, float]], irradiance: tuple[float, float, float], between: float = 0.0) -> Lights:
    """Lamps (face, radiance) under a given irradiance / pi; each fills the share ``between`` of the other's sky."""
    factors = np.zeros((N_PATCHES, len(lamps), 2), np.float32)
    for column, (face, _) in enumerate(lamps):
        others = (face != PATCH_FACE) & (PATCH_FACE != WALL)
        factors[others, column, 0] = between
    mask = np.isin(np.arange(3), [face for face, _ in lamps])
    radiance = np.array([[value] * 3 for _, value in lamps]).reshape(-1, 3)
    light = np.array(irradiance)[PATCH_FACE][:, None].repeat(3, 1)
    faces = [np.array([face]) for face, _ in lamps]
    return Lights(
        emitters=faces,
        radiance=radiance,
        hidden_radiance=np.zeros((0, 3)),
        log_std=np.zeros(len(lamps)),
        form_factors=factors,
        mask=mask,
        irradiance=light,
        patch_radiance=light,
    )


def found(problem: LightProblem, lights: Lights) -> list[int]:
    return [int(face) for faces in search._candidates(problem, lights, CERTAIN, 1.25) for face in faces]


@pytest.mark.parametrize("between", [0.0, 0.08])
def test_a_bar_that_was_taken_for_a_lamp_does_not_explain_the_window_away(between: float) -> None:
    """Of the light at the window 0.08 · 10 comes from its bar: without it, the window needs a reflectance of 2.4."""
    room = problem(floor=(1.2, 0.5, 0.1), clipped=(False, False, False))
    kept = found(room, lights([(WINDOW, 1.0), (BAR, 10.0)], irradiance=(1.3, 1.0, 0.5), between=between))
    assert kept == ([WINDOW] if between else [])


@pytest.mark.parametrize("clipped", [False, True])
def test_a_lamp_clipped_in_every_photo_is_as_bright_as_the_light_it_casts(clipped: bool) -> None:
    """Photos say 0.5 or more under a light of 0.6, the room's shading says 4: only a bound leaves room for both."""
    room = problem(floor=(0.5, 0.1, 0.1), clipped=(clipped, False, False))
    assert found(room, lights([(WINDOW, 4.0)], irradiance=(0.6, 0.5, 0.3))) == ([WINDOW] if clipped else [])


def test_what_is_no_lamp_yet_must_be_certain() -> None:
    under = lights([], irradiance=(0.4, 0.4, 0.4))
    assert found(problem(floor=(1.0, 0.1, 0.1), clipped=(False, False, False)), under) == []
    assert found(problem(floor=(2.0, 0.1, 0.1), clipped=(False, False, False)), under) == [WINDOW]


@pytest.mark.parametrize(
    ("shown", "loss_without", "stays"),
    [(1.0, 1.0, False), (1.0, 1.1, True), (1.0, 1.02, True), (1 / 64, 1.02, False)],
)
def test_a_lamp_without_which_the_room_is_lit_as_well_is_left_out(
    shown: float, loss_without: float, stays: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A radiance of 4 is two stops beyond photos that show 1, eight beyond those that show 1/64: that asks for more."""
    room = problem(floor=(shown, 4.0, 0.1), clipped=(True, True, False))
    both = lights([(WINDOW, 4.0), (BAR, 4.0)], irradiance=(0.6, 0.6, 0.5))

    def solved(
        _problem: object, _observed: object, emitters: list, _before: object, *_: object, **__: object
    ) -> Lights:
        faces = [int(lamp[0]) for lamp in emitters]
        assert BAR in faces, "the one that is certain is never left out"
        lamps = lights([(face, 4.0) for face in faces], irradiance=(0.6, 0.6, 0.5))
        return replace(lamps, held_out=1.0 if WINDOW in faces else loss_without)

    monkeypatch.setattr(selection, "solved", solved)
    kept = selection.needed_lamps(room, OBSERVED, both, Progress())  # type: ignore[arg-type]
    assert sorted(int(faces[0]) for faces in kept) == ([WINDOW, BAR] if stays else [BAR])


@pytest.mark.parametrize(
    ("shown", "lent", "stays"), [(4.0, 20, False), (4.0, 16, True), (2.0, 16, False), (2.0, 10, True)]
)
def test_a_bar_whose_own_pixels_could_reflect_what_they_show_must_be_needed(
    shown: float, lent: int, stays: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both are too bright to reflect, and the room is lit as well without the bar.

    A reflectance of 6.7 or 3.3 is needed for all that the bar shows, a fifth of it for the four pixels in twenty beside
    which the window is not as bright.
    """
    room = problem(floor=(4.0, shown, 0.1), clipped=(True, True, False))
    room.brighter_neighbour[np.flatnonzero(PATCH_FACE == BAR)[:lent]] = np.flatnonzero(PATCH_FACE == WINDOW)[0]
    both = lights([(WINDOW, 4.0), (BAR, 4.0)], irradiance=(0.6, 0.6, 0.5))

    def solved(
        _problem: object, _observed: object, emitters: list, _before: object, *_: object, **__: object
    ) -> Lights:
        lamps = lights([(int(lamp[0]), 4.0) for lamp in emitters], irradiance=(0.6, 0.6, 0.5))
        return replace(lamps, held_out=1.0)

    monkeypatch.setattr(selection, "solved", solved)
    kept = selection.needed_lamps(room, OBSERVED, both, Progress())  # type: ignore[arg-type]
    assert sorted(int(faces[0]) for faces in kept) == ([WINDOW, BAR] if stays else [WINDOW])


@pytest.mark.parametrize("lent", [0, 10, 20])
def test_photos_show_that_much_less_of_a_lamp_as_pixels_are_outshone(lent: int) -> None:
    """A radiance of 4 where photos show 1: two stops, one more if half its pixels may be the window's, ten if all."""
    room = problem(floor=(4.0, 1.0, 0.1), clipped=(True, True, False))
    room.brighter_neighbour[np.flatnonzero(PATCH_FACE == BAR)[:lent]] = np.flatnonzero(PATCH_FACE == WINDOW)[0]
    stops = selection._stops_beyond_photos(room, np.array([BAR]), np.full(3, 4.0))
    assert stops == pytest.approx({0: 2, 10: 3, 20: 10}[lent])


@pytest.mark.parametrize(("open_share", "stays"), [(0.0, True), (0.95, True), (1.05, False)])
def test_a_lamp_is_a_speck_beside_light_from_outside_too(open_share: float, stays: bool) -> None:
    """A sky that every patch sees all of would make the bar just 2 in 10,000 of all light."""
    room = problem(floor=(0.1, 4.0, 0.1), clipped=(False, True, False))
    sees = np.full((N_PATCHES, 1, 2), open_share, np.float32)
    room.hidden = HiddenSources((), np.array([[0.0, 0.0, 1.0]]), sees)  # type: ignore[misc]
    one = lights([(BAR, 4.0)], irradiance=(0.6, 0.6, 0.5))
    power = 0.2 * 4.0
    sky = power * (1 / selection.NEGLIGIBLE_POWER - 1) / room.tracer.areas.sum()
    lit = replace(one, hidden_radiance=np.full((1, 3), sky))
    kept = selection.needed_lamps(room, OBSERVED, lit, Progress())  # type: ignore[arg-type]
    assert [faces.tolist() for faces in kept] == ([[BAR]] if stays else [])


def test_rounds_of_gloss_bring_no_new_lamps(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bar seems to need a reflectance of 10, and was no lamp when the whole room was searched."""
    room = problem(floor=(4.0, 4.0, 0.1), clipped=(True, True, False))
    one = lights([(WINDOW, 4.0)], irradiance=(0.4, 0.4, 0.5))
    assert found(room, one) == [WINDOW, BAR]
    monkeypatch.setattr(search, "form_factors_of", lambda *_, **__: one.form_factors)
    monkeypatch.setattr(search, "solve_lights", lambda _problem, _observed, emitters, *_: emitters)
    again = search.reconsider_lamps(room, OBSERVED, one, None, None, Progress())  # type: ignore[arg-type]
    assert [faces.tolist() for faces in again] == [[WINDOW]]


def test_a_bright_surface_must_do_without_the_lamp_that_no_photo_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither is certain, and each is idle beside the other: what photos show is left out first, though it is larger,
    and the lamp is then the only one. Only its light explains the room."""
    room = problem(floor=(0.5, 0.1, 0.1), clipped=(False, False, False))
    room.samples.seen_faces = lambda n: np.arange(n) != BAR  # type: ignore[method-assign]
    both = lights([(WINDOW, 4.0), (BAR, 4.0)], irradiance=(0.6, 0.6, 0.5))

    def solved(
        _problem: object, _observed: object, emitters: list, _before: object, *_: object, **__: object
    ) -> Lights:
        faces = [int(lamp[0]) for lamp in emitters]
        return replace(lights([(face, 4.0) for face in faces], irradiance=(0.6, 0.6, 0.5)), held_out=1.0)

    monkeypatch.setattr(selection, "solved", solved)
    kept = selection.needed_lamps(room, OBSERVED, both, Progress())  # type: ignore[arg-type]
    assert [faces.tolist() for faces in kept] == [[BAR]]


def test_the_only_lamp_of_a_room_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    room = problem(floor=(1.0, 0.1, 0.1), clipped=(True, False, False))
    one = lights([(WINDOW, 4.0)], irradiance=(0.6, 0.6, 0.5))
    monkeypatch.setattr(selection, "solved", lambda *_, **__: replace(one, held_out=1.0))
    kept = selection.needed_lamps(room, OBSERVED, one, Progress())  # type: ignore[arg-type]
    assert [faces.tolist() for faces in kept] == [[WINDOW]]


@pytest.mark.parametrize(("radiance", "loss", "taken"), [(4.0, 0.9, True), (4.0, 0.995, False), (0.2, 0.9, False)])
def test_a_region_that_clips_is_a_lamp_if_the_room_asks_for_its_light(
    radiance: float, loss: float, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The window clips in every photo, at a bound that it could reflect: nobody but the other patches can tell."""
    room = problem(floor=(0.3, 4.0, 0.1), clipped=(True, False, False))
    bar = replace(lights([(BAR, 4.0)], irradiance=(0.6, 0.6, 0.5)), held_out=1.0)
    both = replace(lights([(BAR, 4.0), (WINDOW, radiance)], irradiance=(0.6, 0.6, 0.5)), held_out=loss)

    def solved(_problem: object, _observed: object, emitters: list, *_: object, **__: object) -> Lights:
        return both if len(emitters) == 2 else bar

    monkeypatch.setattr(selection, "solved", solved)
    result = selection.with_silent(room, OBSERVED, bar, Progress())  # type: ignore[arg-type]
    assert [int(faces[0]) for faces in result.emitters] == ([BAR, WINDOW] if taken else [BAR])


def test_a_lamp_that_specks_stood_in_for_is_found_when_they_are_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    room = problem(floor=(1.0, 4.0, 0.1), clipped=(True, True, False))
    speck = np.array([BAR])

    def with_silent(_problem: object, _observed: object, before: Lights, _progress: object) -> Lights:
        found = [int(faces[0]) for faces in before.emitters]
        return before if BAR in found else lights([(WINDOW, 4.0)], irradiance=(0.6, 0.6, 0.5))

    def needed_lamps(_problem: object, _observed: object, tried: Lights, _progress: object) -> list:
        return [faces for faces in tried.emitters if not np.array_equal(faces, speck)]

    def solved(_problem: object, _observed: object, emitters: list, *_: object, **__: object) -> Lights:
        return lights([(int(faces[0]), 4.0) for faces in emitters], irradiance=(0.6, 0.6, 0.5))

    monkeypatch.setattr(search, "with_silent", with_silent)
    monkeypatch.setattr(search, "needed_lamps", needed_lamps)
    monkeypatch.setattr(search, "solved", solved)
    monkeypatch.setattr(search, "with_all_rays", solved)
    monkeypatch.setattr(search, "lights_without_lamps", lambda *_: lights([], irradiance=(0.6, 0.6, 0.5)))
    monkeypatch.setattr(search, "_candidates", lambda *_: [speck])
    result = search.find_lights(room, OBSERVED, Progress())  # type: ignore[arg-type]
    assert [int(faces[0]) for faces in result.emitters] == [WINDOW]


def test_a_patch_says_less_of_the_light_the_less_its_normal_is_known() -> None:
    asked = problem((1.0, 1.0, 1.0), (False, False, False))
    assert solve.say_of(asked, OBSERVED) == pytest.approx(1.0)
    # Where light is off by as much as the balance scatters anyway, the variance is twice that of a plane.
    asked.surface.spread[:] = ROBUST_LOG / solve.TURNED
    assert solve.say_of(asked, OBSERVED) == pytest.approx(0.5)


def test_a_lamp_has_a_side_between_any_two_sharp_edges() -> None:
    """Of a box the six sides, of a tessellated ball itself."""
    ball = trimesh.creation.icosphere(2)
    for mesh, n_sides in ((trimesh.creation.box(), 6), (ball, 1)):
        faces = np.asarray(mesh.faces)
        scene = Mesh(np.asarray(mesh.vertices), faces, None, np.zeros(len(faces), np.int32))
        room = SimpleNamespace(
            regions=scene.regions, adjacency=edge_adjacency(scene), tracer=SimpleNamespace(normals=mesh.face_normals)
        )
        sides = selection._sides(room, np.arange(len(faces)))  # type: ignore[arg-type]
        assert len(sides) == n_sides
        assert np.array_equal(np.sort(np.concatenate(sides)), np.arange(len(faces)))


def test_without_a_lamp_surfaces_keep_the_light_that_is_not_its_own() -> None:
    """A lamp behind a ledge that was left out must not go on shining by way of the ledge."""
    room = problem((1.0, 1.0, 1.0), (False, False, False))
    # Window and bar send each other a fifth of their light: 0.2 * 3 of 2.0 at the bar, 0.2 * 1 of 1.0 at the window.
    both = lights([(WINDOW, 3.0), (BAR, 1.0)], (1.0, 2.0, 5.0), between=0.2)
    expected = {(WINDOW,): (0.8, 1, 1), (): (0.8, 0.7, 1), (BAR, WINDOW): (1, 1, 1), (WALL, WINDOW, BAR): (1, 1, 1)}
    for faces, shares in expected.items():
        kept = solve._light_kept(room, both, [np.array([face]) for face in faces])
        np.testing.assert_allclose(kept, np.array(shares)[PATCH_FACE][:, None].repeat(3, 1), rtol=1e-5)


def test_a_user_is_told_of_no_light_and_of_more_lamps_than_are_told_apart() -> None:
    none = lights([], (1.0, 1.0, 1.0))
    assert "no light" in none.warnings[0]
    assert lights([(WINDOW, 5.0)], (1.0, 1.0, 1.0)).warnings == ()
    many = replace(none, emitters=[np.array([k]) for k in range(MAX_LAMPS)], radiance=np.ones((MAX_LAMPS, 3)))
    assert str(MAX_LAMPS) in many.warnings[0]


@pytest.mark.parametrize(
    ("lamps", "by_direction", "chosen"),
    [
        (0, 1.999, 1),  # less than twice the error
        (0, 1.98, 12),
        (0, 2.1, 1),
        (1, 1.98, 1),  # a lamp gives the room its shadows
        (1, 1.9, 12),
    ],
)
def test_light_from_outside_is_chosen_anew_for_lamps_that_are_known(
    monkeypatch: pytest.MonkeyPatch, lamps: int, by_direction: float, chosen: int
) -> None:
    """A closed room: without a lamp, nothing is explained before there is light from outside."""
    directions = np.eye(3)[np.zeros(12, int)]
    posed = problem((1.0, 1.0, 1.0), (False, False, False))
    outside = HiddenSources((), directions, np.ones((N_PATCHES, 12, 2), np.float32))
    posed = SimpleNamespace(**{**vars(posed), "hidden": outside})
    posed.transport.target = np.zeros((N_PATCHES, 4), int)
    lit = lights([(WINDOW, 5.0)] * lamps, (1.0, 1.0, 1.0))
    known, losses = replace(lit, hidden_radiance=np.ones((1, 3)), held_out=0.1), {0: 3.0, 1: 2.0, 12: by_direction}

    def solve(_problem, _observed, emitters, before, *_args, warm_start):
        count = len(before.hidden_radiance)
        # Directions begin at the constant that they refine.
        assert not warm_start or (count == 12 and (before.hidden_radiance == 3.0).all())
        found = np.full((count, 3), 3.0)
        return replace(before, held_out=losses[count], hidden_radiance=found) if len(emitters) or count else before

    def renewed(it, **new):
        return replace(it, **new) if isinstance(it, Lights) else SimpleNamespace(**{**vars(it), **new})

    monkeypatch.setattr(search, "replace", renewed)
    monkeypatch.setattr(search, "mean_radiance", lambda *_: np.ones(3))
    monkeypatch.setattr(search, "solve_lights", solve)
    monkeypatch.setattr(search, "find_lights", lambda *_: pytest.fail("lamps were searched for again"))
    _, found = search.choose_outside(posed, OBSERVED, Progress(), known=known)  # type: ignore[arg-type]
    assert len(found.hidden_radiance) == chosen
