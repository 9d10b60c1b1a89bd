"""A flat part in the window of a box room, whose photos are known in closed form: is it a pane?"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from iris_addon.base.progress import Progress
from iris_addon.decide import Decisions
from iris_addon.model.capture import Camera, Mesh
from iris_addon.rays.tracer import Tracer
from iris_addon.surface.panes import find_panes
from iris_addon.surface.photo_samples import ShownPixels
from iris_addon.surface.primary_rays import PixelSamples, trace_pixels
from iris_addon.surface.scan_surface import surface_behind
from tests.box_room import look_at
from tests.engine_room import assemble, box, quad

SIZE = np.array([4.0, 3.0, 2.5])
LEFT, RIGHT, LOW, HIGH = 1.2, 2.8, 0.8, 2.1
"""The window in the wall y = 0, metres in x and z."""
SOUTH, INNER, OUTER, BEYOND = 2, 6, 7, 8
"""Regions: the wall with the window, both sides of the part in it, and a wall of the house opposite."""
OPPOSITE = -2.0
"""The wall of that house, y in metres."""
Picture = Callable[[PixelSamples], np.ndarray]


def window_room(house_opposite: bool = False) -> Mesh:
    sides = dict(enumerate(box(np.zeros(3), SIZE)))
    del sides[SOUTH]
    around = (
        ([0, 0, 0], LEFT, SIZE[2]),
        ([RIGHT, 0, 0], SIZE[0] - RIGHT, SIZE[2]),
        ([LEFT, 0, 0], RIGHT - LEFT, LOW),
        ([LEFT, 0, HIGH], RIGHT - LEFT, SIZE[2] - HIGH),
    )
    pieces = [*sides.values(), *(quad(corner, [wide, 0, 0], [0, 0, high]) for corner, wide, high in around)]
    regions = [*sides, *[SOUTH] * 4]
    for y, region in ((0.002, INNER), (-0.002, OUTER)):
        pieces.append(quad([LEFT, y, LOW], [RIGHT - LEFT, 0, 0], [0, 0, HIGH - LOW]))
        regions.append(region)
    if house_opposite:
        pieces.append(quad([-3, OPPOSITE, -2], [10, 0, 0], [0, 0, 7]))
        regions.append(BEYOND)
    return assemble(pieces, regions)


def cameras(count: int = 8) -> list[Camera]:
    """Cameras that look at the window from different places."""
    places = np.random.default_rng(0).uniform([0.5, 1.2, 0.7], [3.5, 2.8, 2.0], (count, 3))
    poses = [look_at(place, np.array([2.0, 0.0, 1.4])) for place in places]
    return [Camera(width=64, height=48, fx=48, fy=48, cx=32, cy=24, c2w=pose) for pose in poses]


def panes_where_it_shows(picture: Picture, house_opposite: bool = False, clip: float = np.inf) -> set[int]:
    """Regions that are found to be panes where the part in the window shows ``picture`` and walls are matte.

    Args:
        clip: luminance from which on photos clip.
    """
    mesh = window_room(house_opposite)
    surface = surface_behind(mesh)
    tracer = Tracer(surface.mesh, surface.normals, surface.noise)
    samples = trace_pixels(tracer, cameras(), Progress())
    assert mesh.regions is not None
    on = mesh.regions[samples.face] == INNER
    luminance = np.where(on, picture(samples), 0.4 + 0.1 * np.sin(samples.position.sum(1)))
    luminance *= np.exp(0.01 * np.random.default_rng(1).standard_normal(len(luminance)))
    shown = ShownPixels(np.minimum(luminance, clip).astype(np.float32), luminance >= clip, np.ones(len(on), bool))
    return set(mesh.regions[find_panes(surface, tracer, samples, shown, Decisions())].tolist())


def meeting(samples: PixelSamples, along: np.ndarray, y: float) -> np.ndarray:
    """(n, 3) where lines from the pixels' places in the directions ``along`` meet a plane of constant y."""
    return samples.position + along * ((y - samples.position[:, 1]) / along[:, 1])[:, None]


def stripes(x: np.ndarray) -> np.ndarray:
    return np.where(np.sin(6 * x) > 0, 1.5, 0.5)


def landscape(samples: PixelSamples) -> np.ndarray:
    """Sky over hills, by the direction of the line of sight."""
    east, _, up = -samples.direction.T
    return np.where(up > 0.1 * np.sin(6 * east), 2.0 + up, 0.3)


def house(samples: PixelSamples) -> np.ndarray:
    return stripes(meeting(samples, -samples.direction, OPPOSITE)[:, 0])


def painting(samples: PixelSamples) -> np.ndarray:
    return stripes(2 * samples.position[:, 0])


def mirror(samples: PixelSamples) -> np.ndarray:
    """The wall of the room opposite, as a mirror shows it."""
    return stripes(meeting(samples, -samples.direction * np.array([1, -1, 1]), SIZE[1])[:, 0])


def lamp(samples: PixelSamples) -> np.ndarray:
    return np.full(len(samples.face), 20.0)


@pytest.mark.parametrize("clip", [np.inf, 1.0])
def test_a_part_that_shows_a_landscape_is_a_pane_with_both_sides(clip: float) -> None:
    """Also where the sky clips in all photos, as long as something else is seen."""
    assert panes_where_it_shows(landscape, clip=clip) == {INNER, OUTER}


def test_a_part_that_shows_the_wall_behind_it_is_a_pane() -> None:
    assert panes_where_it_shows(house, house_opposite=True) == {INNER, OUTER}


@pytest.mark.parametrize("house_opposite", [False, True])
@pytest.mark.parametrize("picture", [painting, mirror, lamp])
def test_what_has_a_picture_of_its_own_mirrors_or_shines_is_none(picture: Picture, house_opposite: bool) -> None:
    assert panes_where_it_shows(picture, house_opposite) == set()


def test_a_part_that_clips_everywhere_tells_nothing() -> None:
    assert panes_where_it_shows(lamp, clip=1.0) == set()


def test_rays_pass_the_faces_that_a_tracer_is_without() -> None:
    mesh = window_room(house_opposite=True)
    assert mesh.regions is not None
    panes = np.flatnonzero(np.isin(mesh.regions, (INNER, OUTER)))
    origin, toward = np.array([[2.0, 1.5, 1.4]]), np.array([[0.0, -1.0, 0.0]])
    assert mesh.regions[Tracer(mesh).closest(origin, toward).face[0]] == INNER
    through = Tracer(mesh, without=panes)
    hit = through.closest(origin, toward)
    assert mesh.regions[hit.face[0]] == BEYOND and hit.distance[0] == pytest.approx(1.5 - OPPOSITE, abs=1e-5)
    assert through.unoccluded(origin, toward, np.array([1.5 - OPPOSITE])).all()
    assert not through.normals[panes].any() and not through.areas[panes].any()
