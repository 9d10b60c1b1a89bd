"""Which faces count as lamps: faces brighter than a surface could be, in every view and all over."""

from __future__ import annotations

import numpy as np
import pytest

from iris_addon.lighting.brightness import Brightness, brightness, pixel_sized_spots, reflectance_needed
from iris_addon.lighting.candidates import (
    continued,
    emitting_faces,
    fewer_lamps,
    group_emitters,
    joined_pieces,
    tie_fixtures,
    voted,
    with_gaps_closed,
    with_specks_filled,
)
from iris_addon.model.response import gamma
from iris_addon.rays.tracer import Tracer
from iris_addon.response.radiance import linearise
from iris_addon.surface.topology import edge_adjacency
from tests.engine_room import assemble, observe_off_edges, quad

N_VIEWS = 12
EXPOSURES = 2.0 ** np.linspace(-3, 3, N_VIEWS)


def brightness_of(
    radiance: np.ndarray, exposures: np.ndarray = EXPOSURES, specular: np.ndarray | None = None
) -> Brightness:
    """The brightness of patches whose radiance (P, V) may depend on the view."""
    n = len(radiance)
    patch, view = (a.ravel() for a in np.meshgrid(np.arange(n), np.arange(len(exposures)), indexing="ij"))
    exposed = np.clip(radiance[patch, view] * exposures[view], 0, 1)[:, None]
    z = np.floor(255 * gamma().apply(np.repeat(exposed, 3, 1))) / 255
    o = observe_off_edges(patch, view, z, np.random.default_rng(0))
    linear = linearise(o, gamma(), np.repeat(exposures[o.view, None], 3, 1))
    return brightness(o, linear, n, None if specular is None else specular[patch, view][:, None].repeat(3, 1))


def test_a_patch_bright_in_every_view_counts_in_full() -> None:
    radiance = np.array([0.3, 1.0, 4.0])[:, None] * np.ones(N_VIEWS)
    assert brightness_of(radiance).floor[:, 0] == pytest.approx([0.3, 1.0, 4.0], rel=0.05)


def test_a_highlight_in_few_views_does_not_count() -> None:
    radiance = np.full((1, N_VIEWS), 0.3)
    radiance[0, [2, 7]] = 6.0
    assert brightness_of(radiance).floor[0, 0] == pytest.approx(0.3, rel=0.05)


def test_specular_light_is_subtracted() -> None:
    specular = np.full((1, N_VIEWS), 2.0)
    assert brightness_of(specular + 0.1).floor[0, 0] == pytest.approx(2.1, rel=0.05)
    assert brightness_of(specular + 0.1, specular=specular).floor[0, 0] < 0.3


def test_a_patch_clipped_in_every_photo_takes_the_highest_bound() -> None:
    exposures = np.array([1.0, 0.5, 2.0])
    seen = brightness_of(np.full((1, 3), 50.0), exposures)
    assert seen.floor[0] == pytest.approx(2.0)
    assert seen.bound[0] == pytest.approx(2.0)
    assert np.isnan(seen.measured[0]).all()


def test_one_unclipped_view_limits_the_brightness_of_a_clipped_wall() -> None:
    """Eleven photos in which the wall is white, one in which it is not: it needs a reflectance below 1."""
    exposures = np.array([0.5] + [8.0] * 11)
    seen = brightness_of(np.array([0.6, 6.0])[:, None] * np.ones(12), exposures)
    needed = reflectance_needed(seen, np.full((2, 3), 0.8))
    assert needed[0] < 1.0 < 2.4 < needed[1]


def test_a_face_emits_only_if_nearly_all_its_pixels_do() -> None:
    sample_face = np.repeat([0, 1, 2], [10, 10, 10]).astype(np.int32)
    passed = np.zeros(30, bool)
    passed[:10] = True  # a lamp
    passed[10:14] = True  # the reflection of a window on a large triangle
    emitting, count = emitting_faces(passed, np.arange(30, dtype=np.int32), sample_face, 4)
    assert emitting.tolist() == [True, False, False, False]
    assert count.tolist() == [10, 10, 10, 0]


# Grouping ------------------------------------------------------------------------------------------------------------


def test_lamps_are_connected_faces_or_whole_regions() -> None:
    panels = [quad([x, 0, 2], [0.5, 0, 0], [0, 0.5, 0]) for x in (0.0, 1.0, 2.0)]
    wall = quad([0, 3, 0], [4, 0, 0], [0, 0, 2], 1.0)
    mesh = assemble([*panels, wall], [0, 0, 1, 2])
    assert mesh.regions is not None
    areas = np.ones(len(mesh.faces))
    emitting = np.zeros(len(mesh.faces), bool)
    emitting[:6] = True
    emitting[8] = True  # one bright triangle of the wall
    count = np.full(len(mesh.faces), 20)
    emitters = group_emitters(emitting, count, areas, mesh.regions, edge_adjacency(mesh))
    assert [faces.tolist() for faces in emitters] == [[8], [0, 1, 2, 3], [4, 5]]


def test_the_unseen_side_of_a_lamp_belongs_to_it() -> None:
    mesh = assemble([quad([0, 0, 2], [1, 0, 0], [0, 1, 0]), quad([0, 0, 2.1], [1, 0, 0], [0, 1, 0])], [0, 0])
    assert mesh.regions is not None
    emitting, count = np.array([True, True, False, False]), np.array([30, 30, 0, 0])
    emitters = group_emitters(emitting, count, np.ones(4), mesh.regions, edge_adjacency(mesh))
    assert [faces.tolist() for faces in emitters] == [[0, 1, 2, 3]]


def test_few_pixels_are_no_lamp_and_degenerate_faces_do_not_emit() -> None:
    mesh = assemble([quad([k, 0, 0], [0.5, 0, 0], [0, 0.5, 0]) for k in range(2)], [0, 1])
    assert mesh.regions is not None
    areas = np.array([1.0, 0.0, 1.0, 1.0])
    emitters = group_emitters(np.ones(4, bool), np.array([9, 9, 3, 3]), areas, mesh.regions, edge_adjacency(mesh))
    assert [faces.tolist() for faces in emitters] == []
    emitters = group_emitters(np.ones(4, bool), np.array([90, 9, 3, 3]), areas, mesh.regions, edge_adjacency(mesh))
    assert [faces.tolist() for faces in emitters] == [[0]]


def test_only_copies_of_one_lamp_are_tied() -> None:
    areas = np.array([1, 1, 1, 1, 1, 1, 1, 1, 3.0, 1, 1, 1])
    emitters = [np.array([0, 1, 2]), np.array([3, 4, 5]), np.array([6, 7, 8]), np.array([9, 10])]
    label = tie_fixtures(emitters, areas)
    assert label[0] == label[1]
    assert len(set(label.tolist())) == 3
    assert set(label.tolist()) == {0, 1, 2}
    assert len(tie_fixtures([], areas)) == 0


def test_squares_are_copies_if_their_edges_are_as_long() -> None:
    sizes = ((1, 1), (1, 1), (4, 0.25))
    mesh = assemble([quad([0, k, 0], [wide, 0, 0], [0, 0, deep]) for k, (wide, deep) in enumerate(sizes)], [0, 1, 2])
    corners, emitters = mesh.vertices[mesh.faces], [np.array([2 * k, 2 * k + 1]) for k in range(3)]
    label = tie_fixtures(emitters, np.full(6, 0.5), corners=corners)
    assert label[0] == label[1] != label[2]


def test_a_pane_continues_in_its_plane_and_not_around_its_edge() -> None:
    """A row of four faces and one apart; the first is certain."""
    adjacency = np.array([0, 1, 2]), np.array([1, 2, 3])
    up, side = [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]
    certain = np.array([True, False, False, False, False])
    bright = np.array([True, True, True, True, True])

    def found(normals: list[list[float]], emitting: np.ndarray) -> list[int]:
        modelled = np.zeros(5, bool)
        return np.flatnonzero(
            continued(certain, emitting, np.ones(5, np.int64), np.array(normals), adjacency, modelled)
        ).tolist()

    assert found([up, up, up, side, up], bright) == [0, 1, 2]
    assert found([up, [-x for x in up], up, up, up], bright) == [0, 1, 2, 3]  # wound the other way
    assert found([up] * 5, bright & ~np.array([False, True, False, False, False])) == [0]  # a dark face between


@pytest.mark.parametrize("emits_beside", [True, False])
def test_triangles_smaller_than_pixels_belong_to_the_lamp_around_them(emits_beside: bool) -> None:
    """Every other triangle of a pane is hit by a pixel; gaps that border a wall, or lie around a corner, stay dark."""
    mesh = assemble([quad([0, 0, 0], [1, 0, 0], [0, 1, 0], 0.1), quad([1, 0, 0], [0, 0, 1], [0, 1, 0], 0.1)], [0, 0])
    tracer, adjacency = Tracer(mesh), edge_adjacency(mesh)
    faces = np.arange(len(mesh.faces))
    pane = faces < len(faces) // 2
    seen = pane & (faces % 2 == 0)
    emitting = seen & (emits_beside | (tracer.corners[:, :, 0].mean(1) < 0.3))
    closed = with_gaps_closed(emitting, seen, tracer.normals, adjacency)
    assert closed[emitting].all() and not closed[~pane].any()
    assert (closed == pane).all() if emits_beside else not closed[tracer.corners[:, :, 0].min(1) > 0.35].any()


# Scans ---------------------------------------------------------------------------------------------------------------


def test_on_a_scan_a_share_of_a_bright_surface_must_be_certain() -> None:
    """A row of five rough faces, all bright: a few are always certain by chance."""
    adjacency = np.arange(4), np.arange(1, 5)
    normals = np.linalg.qr(np.random.default_rng(0).standard_normal((5, 3)))[0]
    bright, scan, count = np.ones(5, bool), np.ones(5, bool), np.array([1, 10, 10, 10, 10])

    def found(certain: list[bool]) -> list[bool]:
        return continued(np.array(certain), bright, count, normals, adjacency, scan).tolist()

    assert found([True, False, False, False, False]) == [False] * 5
    assert found([False, True, False, False, True]) == [True] * 5


def test_what_few_photos_show_of_a_scan_is_no_lamp() -> None:
    mesh = assemble([quad([k, 0, 0], [0.5, 0, 0], [0, 0.5, 0]) for k in range(3)], [0, 1, 2])
    assert mesh.regions is not None
    emitting, count = np.array([True, True, True, True, False, False]), np.array([90, 90, 15, 15, 180, 180])

    def found(scanned: bool) -> list[list[int]]:
        scan = np.full(6, scanned)
        assert mesh.regions is not None
        lamps = group_emitters(emitting, count, np.ones(6), mesh.regions, edge_adjacency(mesh), scanned=scan)
        return [faces.tolist() for faces in lamps]

    assert found(True) == [[0, 1]]
    assert found(False) == [[0, 1], [2, 3]]


def test_faces_of_a_scan_vote_with_their_neighbours_and_modelled_ones_do_not() -> None:
    mesh = assemble([quad([0, 0, 0], [1, 0, 0], [0, 1, 0], 0.025)], [0])
    adjacency, n = edge_adjacency(mesh), len(mesh.faces)
    centre = mesh.vertices[mesh.faces].mean(1)
    lamp = centre[:, 0] < 0.5
    rng = np.random.default_rng(0)
    noisy, count = lamp ^ (rng.random(n) < 0.05), np.full(n, 3)
    count[rng.random(n) < 0.1] = 0  # no photo shows these
    noisy[count == 0] = False
    assert voted(noisy, count, adjacency, np.zeros(n, bool)).tolist() == noisy.tolist()
    smooth = voted(noisy, count, adjacency, np.ones(n, bool))
    assert np.mean(smooth == lamp) > 0.98 > 0.92 > np.mean(noisy == lamp)


def test_specks_within_a_lamp_of_a_scan_are_lamp_and_large_or_open_gaps_are_not() -> None:
    mesh = assemble([quad([0, 0, 0], [1, 0, 0], [0, 1, 0], 0.025)], [0])
    adjacency, n = edge_adjacency(mesh), len(mesh.faces)
    area, centre = np.full(n, 1.0), mesh.vertices[mesh.faces].mean(1)
    within = np.abs(centre[:, :2] - 0.5).max(1) < 0.4
    speck = np.abs(centre[:, :2] - [0.3, 0.3]).max(1) < 0.04
    picture = np.abs(centre[:, :2] - 0.6).max(1) < 0.15  # a fifth of the lamp: a thing of its own
    lamp = within & ~speck & ~picture
    filled = with_specks_filled(lamp, area, adjacency, np.ones(n, bool))
    assert speck.sum() > 10 and (filled == (lamp | speck)).all()
    assert (with_specks_filled(lamp, area, adjacency, np.zeros(n, bool)) == lamp).all()
    halves = within & (np.abs(centre[:, 0] - 0.5) > 0.02)  # two lamps with a bar between them
    assert (with_specks_filled(halves, area, adjacency, np.ones(n, bool)) == halves).all()


def test_pieces_of_a_window_are_one_lamp_and_specks_beside_it_none() -> None:
    """Two panes behind a bar, a speck on the frame, a darker pane, a pane around the corner, and a lamp far away."""
    side, up, wide = [1.0, 0, 0], [0, 0, 1.0], 0.1
    pieces = [
        quad([0, 0, 0], side, up, wide),
        quad([0, 0, 1.05], side, up, wide),
        quad([1.02, 0, 0.5], [0.02, 0, 0], [0, 0, 0.02]),
        quad([-1.1, 0, 0], side, up, wide),
        quad([0, 0, 2.1], [0, 1.0, 0], side, wide),
        quad([5, 0, 0], side, up, wide),
    ]
    mesh = assemble(pieces, list(range(6)))
    assert mesh.regions is not None
    lamps = [np.flatnonzero(mesh.regions == k) for k in range(6)]
    level = np.array([4.0, 4.1, 4.0, 2.0, 4.0, 4.0])[mesh.regions]
    tracer, n = Tracer(mesh), len(mesh.faces)

    def regions(found: list[np.ndarray]) -> list[list[int]]:
        assert mesh.regions is not None
        return [np.unique(mesh.regions[faces]).tolist() for faces in found]

    assert regions(joined_pieces(lamps, level, tracer, np.ones(n, bool))) == [[0, 1], [3], [4], [5]]
    assert regions(joined_pieces(lamps, level, tracer, np.zeros(n, bool))) == [[k] for k in range(6)]


def test_of_too_many_lamps_equal_neighbours_become_one_and_none_is_lost() -> None:
    mesh = assemble([quad([k, 0, 0], [0.2, 0, 0], [0, 0.2, 0]) for k in (0, 1, 2.5, 9)], [0, 1, 2, 3])
    assert mesh.regions is not None
    lamps, tracer = [np.flatnonzero(mesh.regions == k) for k in range(4)], Tracer(mesh)

    def joined(level: list[float], most: int) -> list[list[int]]:
        assert mesh.regions is not None
        found = fewer_lamps(lamps, np.array(level)[mesh.regions], tracer, most)
        assert np.array_equal(np.sort(np.concatenate(found)), np.arange(len(mesh.faces)))
        return [np.unique(mesh.regions[faces]).tolist() for faces in found]

    assert joined([5.0, 5.0, 5.0, 5.0], 4) == [[0], [1], [2], [3]]
    assert joined([5.0, 5.0, 5.0, 5.0], 3) == [[0, 1], [2], [3]]
    assert joined([5.0, 9.0, 5.0, 5.0], 3) == [[0, 2], [1], [3]]
    assert joined([5.0, 9.0, 1.0, 2.0], 1) == [[0], [1], [2], [3]]


def test_a_lamp_on_faces_smaller_than_pixels_is_whole():
    """A fifth of the faces of a fine scan has a pixel; a lamp that is seen half as often is found between them."""
    side = 120
    faces = np.arange(2 * side * side)
    square, half = np.divmod(faces, 2)
    row, column = np.divmod(square, side)
    first = 2 * (row * side + column)
    across, down = half == 0, (half == 1) & (row < side - 1)
    right = (half == 1) & (column < side - 1)
    adjacency = (
        np.concatenate([first[across], first[right] + 1, first[down] + 1]),
        np.concatenate([first[across] + 1, first[right] + 2, first[down] + 2 * side]),
    )
    lamp = np.hypot(row - 60, column - 50) < 25
    rng = np.random.default_rng(0)
    count = (rng.random(len(faces)) < np.where(lamp, 0.1, 0.2)).astype(np.int64)
    scanned, areas = np.ones(len(faces), bool), np.full(len(faces), 1e-4)
    emitting = voted(lamp & (count > 0), count, adjacency, scanned)
    assert emitting[lamp].mean() > 0.93 and emitting[~lamp].mean() < 0.02
    lamps = group_emitters(emitting, count, areas, np.zeros(len(faces), np.int32), adjacency, scanned=scanned)
    assert len(lamps) == 1 and np.isin(np.flatnonzero(lamp), lamps[0]).mean() > 0.93


def test_a_spot_is_a_pixel_wide_and_within_its_patch():
    rng = np.random.default_rng(0)
    position = rng.uniform(-1, 1, (4000, 3)) * [1, 1, 0]
    patch = (position[:, 0] > 0).astype(np.int32)
    spot = pixel_sized_spots(position, np.full(4000, 0.1), patch)
    for label in np.unique(spot):
        own = spot == label
        assert np.ptp(position[own], axis=0).max() <= 0.1 and len(np.unique(patch[own])) == 1
    assert 400 <= len(np.unique(spot)) <= 480, "21 by 21 cells of a tenth, as the rest of one is cut off"
