"""The search for lamps in rooms whose radiosity is known: what becomes a lamp, what stays one, and what is left out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from threadpoolctl import threadpool_limits

from iris_addon.base.progress import Progress
from iris_addon.lighting.lamp_radiance import NORMAL_SENSITIVITY, patch_weight
from iris_addon.lighting.problem import Lights
from iris_addon.lighting.search import choose_outside, find_lights, reconsider_lamps
from iris_addon.lighting.selection import LAMP_MIN_POWER, needed_lamps, solved
from iris_addon.model.sphere import dodecahedron
from tests.engine_room import SIZE, box, quad
from tests.light_room import CEILING_LAMP, WALL_PANEL, LitRoom, Panel, light_room, panels

LAMP, PANEL = 6, 7
"""Regions of the rooms here: a lamp under the ceiling, and what stands or hangs before a wall."""
STRIP: Panel = ([0.05, 1.0, 0.9], [0, 0.15, 0], [0, 0, 0.9])
EAST_WALL = 1


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    """As in a solve: threads of the linear algebra wait for each other in problems this small."""
    with threadpool_limits(1, "blas"):
        yield


def search(room: LitRoom) -> Lights:
    return find_lights(room.problem, room.observed, Progress())


def reconsider(room: LitRoom, lights: Lights) -> Lights:
    """The lamps tested again, as between rounds of gloss."""
    weight = patch_weight(room.problem, room.observed)
    return reconsider_lamps(room.problem, room.observed, lights, weight, room.observed.radiance, Progress())


def needed(room: LitRoom, lights: Lights) -> list[set[int]]:
    """Regions of each lamp that the room needs."""
    kept = needed_lamps(room.problem, room.observed, lights, Progress())
    return [set(room.room.regions[faces].tolist()) for faces in kept]


def brightness(room: LitRoom, lights: Lights, region: int) -> float:
    """Radiance of the lamp that a region is."""
    (k,) = (k for k, faces in enumerate(lights.emitters) if np.isin(room.faces(region), faces).any())
    return float(lights.radiance[k].mean())


def lamp_and_panel(emission: dict[int, float], **photos: object) -> LitRoom:
    """A lamp under the ceiling and a white panel before a wall, lit to an irradiance / pi of about 0.5."""
    return light_room(*panels(CEILING_LAMP, WALL_PANEL, albedo=0.85), emission, **photos)  # type: ignore[arg-type]


# ---- evidence of the photos --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("shown", "lamps"), [(1.0, {LAMP}), (3.0, {LAMP, PANEL})])
def test_glare_is_a_lamp_only_if_no_reflectance_explains_it(shown: float, lamps: set[int]) -> None:
    """A strip as bright as by a reflectance of two may be a caustic; of six it cannot be."""
    room = light_room(*panels(CEILING_LAMP, STRIP, albedo=0.85), {LAMP: 10.0}, shown={PANEL: shown})
    assert room.lamps(search(room)) == lamps


@pytest.mark.parametrize(("emits", "lamps"), [(4.0, {LAMP, PANEL}), (0.0, {LAMP})])
def test_a_clipped_surface_is_a_lamp_only_if_the_walls_show_its_light(emits: float, lamps: set[int]) -> None:
    """Every photo clips it at a radiance that it could nearly reflect. Only the light on the walls distinguishes."""
    emission = {LAMP: 10.0, PANEL: emits} if emits else {LAMP: 10.0}
    room = lamp_and_panel(emission, clip=1.0, shown=None if emits else {PANEL: 1.0})
    lights = search(room)
    assert room.lamps(lights) == lamps
    if emits:
        assert brightness(room, lights, PANEL) == pytest.approx(emits, rel=0.1)


@pytest.mark.parametrize(("shown", "lamps"), [(1.0, {LAMP}), (1.4, {LAMP, PANEL})])
def test_what_is_too_bright_to_reflect_stays_a_lamp_though_the_walls_say_nothing(shown: float, lamps: set[int]) -> None:
    """A strip that photos show at 1.0 or 1.4 and more needs a reflectance of 1.9 or 2.7, neither of them certain; its
    light is too little to be told from noise."""
    room = light_room(*panels(CEILING_LAMP, STRIP, albedo=0.85), {LAMP: 10.0}, clip=shown, shown={PANEL: shown})
    assert room.lamps(search(room)) == lamps


def test_a_lamp_clipped_in_every_photo_keeps_the_radiance_of_its_light() -> None:
    """Photos show 0.5 or more where the irradiance / pi is 0.55: by that alone it might be paper."""
    room = lamp_and_panel({LAMP: 10.0, PANEL: 4.0}, clip=0.5)
    lights = search(room)
    again = reconsider(room, lights)
    assert again is not lights, "no lamp was left to solve for"
    assert room.lamps(again) == {LAMP, PANEL}
    assert brightness(room, again, PANEL) == pytest.approx(4.0, rel=0.1)


@pytest.mark.parametrize(("off_its_edge", "found"), [(0.0, 10.0), (0.7, 3.0)])
def test_a_lamp_whose_every_pixel_is_on_its_edge_is_brighter_than_it_looks(off_its_edge: float, found: float) -> None:
    """Blur makes the few pixels of a lamp of radiance 10 as dark as 3; further off its edge they would be believed."""
    room = light_room(*panels(CEILING_LAMP, albedo=0.85), {LAMP: 10.0}, shown={LAMP: 3.0}).on_edge(LAMP, off_its_edge)
    assert brightness(room, room.solved(LAMP), LAMP) == pytest.approx(found, rel=0.1)


@pytest.mark.parametrize(("blue", "found"), [(0.9, 4.0), (0.3, 0.3)])
def test_what_shines_hardly_less_than_clips_beside_a_clipped_channel_is_not_measured(blue: float, found: float) -> None:
    """A white lamp of radiance 4 of which red and green clip at 1, and blurred blue does not; or an orange lamp."""
    room = light_room(*panels(CEILING_LAMP, albedo=0.85), {LAMP: (4.0, 4.0, found)}, clip=1.0)
    lights = room.showing(LAMP, 2, blue).solved(LAMP)
    np.testing.assert_allclose(lights.radiance[0], [4.0, 4.0, found], rtol=0.1)


def test_a_lamp_measured_to_be_dim_is_dropped() -> None:
    room = lamp_and_panel({LAMP: 10.0}, shown={PANEL: 0.5})
    assert room.lamps(reconsider(room, room.lights({LAMP: 10.0, PANEL: 4.0}))) == {LAMP}


def test_rounds_of_gloss_bring_no_new_lamps() -> None:
    """A surface that seems to emit only after its highlight was subtracted is no lamp."""
    room = lamp_and_panel({LAMP: 10.0, PANEL: 4.0})
    assert room.lamps(search(room)) == {LAMP, PANEL}
    assert room.lamps(reconsider(room, room.lights({LAMP: 10.0}))) == {LAMP}


@pytest.mark.parametrize("taken_for", [2.5, 4.0])
def test_bars_mistaken_for_lamps_do_not_hide_the_window_behind_them(taken_for: float) -> None:
    """With the light attributed to the bars the window needs a reflectance below one, without it of two."""
    window, bars = 6, 8
    pieces, regions, albedo = panels(([0.03, 0.8, 0.8], [0, 1.4, 0], [0, 0, 1.2]), CEILING_LAMP)
    pieces += [quad([0.12, 0.85 + 0.36 * k, 0.8], [0, 0.18, 0], [0, 0, 1.2], 0.25) for k in range(4)]
    albedo = np.concatenate([albedo, np.full((1, 3), 0.3)])
    room = light_room(pieces, regions + [bars] * 4, albedo, {window: 1.2, 7: 10.0}, shown={bars: 0.2})
    assumed = room.lights({window: 1.2, 7: 10.0, bars: taken_for})
    behind = room.patches(window)
    assert np.median(room.observed.radiance[behind] / assumed.irradiance[behind]) < 1.0
    assert room.lamps(reconsider(room, assumed)) == {window, 7}


def test_a_row_of_lamps_is_told_from_what_glares_in_one_region_with_it() -> None:
    """Four lamps and twelve strips, as the walls of the wells that lamps sit in, that photos clip at what a wall might
    reflect. They are one region of the mesh; only the light on the room tells which of them shine."""
    places = [(x, y) for x in (0.8, 2.8) for y in (0.6, 1.9)]
    lamps = [([x, y, 2.4], [0.4, 0, 0], [0, 0.4, 0]) for x, y in places]
    sides = (([0, -0.1, -0.2], [0.4, 0, 0]), ([0, 0.5, -0.2], [0.4, 0, 0]), ([-0.1, 0, -0.2], [0, 0.4, 0]))
    strips = [([x + dx, y + dy, 2.4 + dz], along, [0, 0, 0.15]) for x, y in places for (dx, dy, dz), along in sides]
    shining, glaring = range(6, 10), range(10, 22)
    room = light_room(
        *panels(*lamps, *strips, albedo=0.6),
        dict.fromkeys(shining, 8.0),
        clip=0.5,
        shown=dict.fromkeys(glaring, 0.5),
        join=dict.fromkeys([*shining, *glaring], 6),
    )
    lights = search(room)
    for found in (lights, reconsider(room, lights)):
        light_of = dict.fromkeys([*shining, *glaring], 0.0)
        for faces, radiance in zip(found.emitters, found.radiance.mean(1), strict=True):
            for face in faces:
                light_of[int(room.room.regions[face])] += float(radiance * room.problem.tracer.areas[face])
        assert [light_of[k] for k in shining] == pytest.approx([8.0 * 0.4**2] * 4, rel=0.15)
        assert sum(light_of[k] for k in glaring) < 0.02 * sum(light_of.values())


# ---- evidence of the room ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("share", "lamps"), [(0.0, {LAMP, PANEL}), (0.5, {LAMP, PANEL}), (1.0, {LAMP})])
def test_pixels_beside_something_as_bright_are_no_evidence_of_a_lamp(share: float, lamps: set[int]) -> None:
    """A frame that glares by the window's light: of a reflectance of 3.5, half its pixels leave 1.7, none leaves 0."""
    room = lamp_and_panel({LAMP: 10.0}, clip=1.75, shown={PANEL: 1.75}).borrowed(PANEL, LAMP, share)
    assert room.lamps(search(room)) == lamps


def test_the_only_lamp_of_a_closed_room_stays() -> None:
    """By its pixels, which need a reflectance of 2.5, it is not certain."""
    room = light_room(*panels(CEILING_LAMP), {LAMP: 10.0}, clip=0.5)
    lights = search(room)
    assert room.lamps(lights) == {LAMP}
    assert brightness(room, lights, LAMP) == pytest.approx(10.0, rel=0.15)


@pytest.mark.parametrize(("share", "stays"), [(0.0, True), (0.95, True), (1.05, False)])
def test_light_from_outside_counts_in_the_power_below_which_a_lamp_is_dropped(share: float, stays: bool) -> None:
    """Under a sky that leaves the strip LAMP_MIN_POWER of all light, and 5 % on either side."""
    pieces, regions, albedo = panels(STRIP)
    inside = [k for k, region in enumerate(regions) if region != EAST_WALL]
    room = light_room([pieces[k] for k in inside], [regions[k] for k in inside], albedo, {6: 4.0})
    hidden, areas = room.problem.hidden.with_directions(1), room.problem.tracer.areas
    per_sky = areas.sum() * hidden.irradiance(np.ones((1, 3)), room.problem.transport.kappa).mean()
    sky = share * areas[room.faces(6)].sum() * 4.0 * (1 / LAMP_MIN_POWER - 1) / per_sky
    room = replace(room, problem=replace(room.problem, hidden=hidden))
    lights = replace(room.lights({6: 4.0}), hidden_radiance=np.full((1, 3), sky))
    assert needed(room, lights) == ([{6}] if stays else [])


def cove_room(emission: dict[int, float], **photos: object) -> tuple[LitRoom, int]:
    """A lamp in a cove that is open above, where no photo looks, and a white panel; the region of the cove."""
    pieces, regions, albedo = panels(([1.6, 1.1, 2.1], [0.8, 0, 0], [0, 0.8, 0]), WALL_PANEL, albedo=0.85)
    sides = box([1.4, 0.9, 2.0], [2.6, 2.1, 2.2], 0.25)[:5]
    albedo = np.concatenate([albedo, np.full((1, 3), 0.8)])
    room = light_room(pieces + sides, regions + [8] * 5, albedo, emission, **photos)  # type: ignore[arg-type]
    assert not room.problem.samples.seen_faces(len(room.room.regions))[room.faces(LAMP)].any()
    return room, 8


@pytest.mark.parametrize(("emits", "kept"), [(0.0, [{LAMP}]), (3.0, [{PANEL}, {LAMP}])])
def test_a_bright_surface_gives_way_to_a_hidden_emitter(emits: float, kept: list[set[int]]) -> None:
    """Photos clip the panel. Where it only reflects, the lamp in the cove is enough for the room."""
    emission = {LAMP: 20.0, PANEL: emits} if emits else {LAMP: 20.0}
    room, _ = cove_room(emission, clip=0.3, shown=None if emits else {PANEL: 0.3}, noise=0.1)
    assert needed(room, room.solved(PANEL, LAMP)) == kept


def test_photos_that_do_not_show_a_lamp_do_not_dismiss_it() -> None:
    """The walls are of many colours: the loss rises by 2 % without its light, which is enough to be found."""
    room, _ = cove_room({LAMP: 0.7, PANEL: 3.0}, noise=1.5)
    assert needed(room, room.solved(PANEL, LAMP)) == [{PANEL}, {LAMP}]


def test_light_of_a_dropped_lamp_is_removed_from_unseen_surfaces() -> None:
    """No photo shows the inside of the cove: how bright it is follows from the lamps that are left."""
    room, cove = cove_room({LAMP: 20.0, PANEL: 4.0})
    both = room.solved(PANEL, LAMP)
    without = solved(room.problem, room.observed, [room.faces(PANEL)], both, Progress(), warm_start=True)
    n = room.problem.transport.n_seen
    inside = n + np.flatnonzero(room.problem.transport.region[n:] == cove)
    assert without.patch_radiance[inside].mean() < 0.5 * both.patch_radiance[inside].mean()


# ---- the shape of a lamp -------------------------------------------------------------------------------------------


def test_only_the_emitting_sides_of_an_angular_lamp_are_kept() -> None:
    """Both sides of an angle are clipped, one of them shines."""
    angle = ([1.5, 1.0, 1.6], [0, 1.0, 0], [0, 0, 0.8])
    room = light_room(*panels(CEILING_LAMP, angle), {LAMP: 10.0}, clip=0.4, shown={PANEL: 0.4}, join={PANEL: LAMP})
    lights = search(room)
    assert lights.mask[room.faces(LAMP)].all()
    assert not lights.mask[room.faces(PANEL)].any()


def test_a_round_lamp_is_kept_whole() -> None:
    ball = trimesh.creation.icosphere(2, 0.3)
    pieces, regions, albedo = panels()
    pieces.append((np.asarray(ball.vertices) + SIZE * [0.5, 0.5, 0.76], np.asarray(ball.faces)))
    room = light_room(pieces, [*regions, 6], np.concatenate([albedo, np.full((1, 3), 0.8)]), {6: 10.0}, clip=0.5)
    lights = search(room)
    assert lights.mask[room.faces(6)].all() and len(lights.emitters) == 1


# ---- light from outside --------------------------------------------------------------------------------------------


def open_room(sky: float | np.ndarray, emission: dict[int, float] | None = None, **photos: float) -> LitRoom:
    """The room without the wall in the east, and with its lamp unless ``emission`` is empty."""
    emission = {LAMP: 10.0} if emission is None else emission
    pieces, regions, albedo = panels(CEILING_LAMP) if emission else panels()
    inside = [k for k, region in enumerate(regions) if region != EAST_WALL]
    return light_room([pieces[k] for k in inside], [regions[k] for k in inside], albedo, emission, sky=sky, **photos)  # type: ignore[arg-type]


SUN = 3 * np.maximum(0, dodecahedron() @ [0.6, -0.7, 0.4])
"""Of the lobes of outside light, from the south-east."""


@pytest.mark.parametrize(("sky", "directions"), [(0.0, {0}), (1.0, {1, 12}), (SUN, {12})])
def test_chosen_light_from_outside_is_that_on_the_walls(sky: float | np.ndarray, directions: set[int]) -> None:
    """Nothing from the dark; from an even sky, or one with a sun, what arrives at the patches."""
    room = open_room(sky)
    problem, lights = choose_outside(room.problem, room.observed, Progress())
    assert room.lamps(lights) == {LAMP}
    assert len(problem.hidden.directions) in directions
    kappa = problem.transport.kappa
    true = room.problem.hidden.irradiance(np.broadcast_to(np.asarray(sky), 12)[:, None].repeat(3, 1), kappa)
    found = problem.hidden.irradiance(lights.hidden_radiance, kappa)
    assert np.linalg.norm(found - true) <= 0.1 * np.linalg.norm(true)


@pytest.mark.parametrize("lit", [False, True])
def test_what_clips_bounds_the_light_of_a_room_without_lamps(lit: bool) -> None:
    """One patch in five clips in all photos; beside a lamp it would be glare."""
    sky = np.full(12, 0.3)
    sky[3] = 6.0
    emission = {LAMP: 10.0} if lit else {}
    clip = float(np.quantile(open_room(sky, emission, noise=0.15).observed.radiance, 0.8))
    room = open_room(sky, emission, noise=0.15, clip=clip)
    problem, lights = choose_outside(room.problem, room.observed, Progress())
    clips = ~room.observed.known.all(1)
    assert clips.mean() > 0.15
    assert clips[lights.losses.observation].any() == (not lit)
    if not lit:
        kappa = problem.transport.kappa
        true = room.problem.hidden.irradiance(sky[:, None].repeat(3, 1), kappa)
        found = problem.hidden.irradiance(lights.hidden_radiance, kappa)
        assert not lights.emitters
        assert np.linalg.norm(found - true) <= 0.05 * np.linalg.norm(true)


def test_light_from_outside_is_chosen_again_without_a_search_for_known_lamps() -> None:
    room = lamp_and_panel({LAMP: 10.0, PANEL: 4.0})
    known = room.lights({LAMP: 10.0})
    _, lights = choose_outside(room.problem, room.observed, Progress(), known=known)
    assert room.lamps(lights) == {LAMP}


# ---- weights -------------------------------------------------------------------------------------------------------


def test_weight_of_a_patch_falls_with_the_spread_of_its_normals() -> None:
    """Where light is off by as much as the balance scatters anyway, the variance is twice that of a plane."""
    room = light_room(*panels(CEILING_LAMP), {LAMP: 10.0})
    surface = room.problem.surface
    weights = []
    for spread in (0.0, room.problem.robust_log / NORMAL_SENSITIVITY):
        turned = replace(surface, spread=np.full_like(surface.spread, spread))
        weights.append(patch_weight(replace(room.problem, surface=turned), room.observed))
    np.testing.assert_allclose(weights[1], 0.5 * weights[0], rtol=1e-5)
