"""Highlights: a floor that mirrors a window is no lamp, and windows that face each other are none of each other."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from iris_addon.lighting.highlights import without_highlights
from iris_addon.lighting.problem import LightProblem
from iris_addon.rays.tracer import Tracer
from iris_addon.surface.primary_rays import PixelSamples
from iris_addon.surface.topology import edge_adjacency
from tests.engine_room import assemble, quad

FLOOR, NEAR, FAR = range(3)
"""A floor of six metres between two windows."""


def hall(eyes: np.ndarray, scanned: bool = True) -> tuple[LightProblem, np.ndarray]:
    """A hall as ``eyes`` (n, 3) in it see it, and the region of each face."""
    along, across, up = [6.0, 0, 0], [0, 4.0, 0], [0, 0, 3.0]
    pieces = [quad([0, 0, 0], along, across, 0.5), quad([0, 0, 0], across, up, 0.5), quad([6, 0, 0], across, up, 0.5)]
    mesh = assemble(pieces, [FLOOR, NEAR, FAR])
    assert mesh.regions is not None
    tracer, n = Tracer(mesh), len(mesh.faces)
    centre = tracer.corners.mean(1)
    face, eye = (index.ravel() for index in np.meshgrid(np.arange(n), np.arange(len(eyes)), indexing="ij"))
    direction = eyes[eye] - centre[face]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    facing = np.sign((direction * tracer.normals[face]).sum(1, keepdims=True))
    samples = PixelSamples(
        view=eye.astype(np.int16),
        pixel=face.astype(np.int32),
        face=face.astype(np.int32),
        barycentric=np.full((len(face), 2), 1 / 3, np.float32),
        position=centre[face].astype(np.float32),
        normal=(tracer.normals[face] * facing).astype(np.float32),
        direction=direction.astype(np.float32),
        footprint=np.full(len(face), 0.01, np.float32),
    )
    surface = SimpleNamespace(normal=samples.normal, sample_patch=np.arange(len(face)))
    problem = SimpleNamespace(
        tracer=tracer,
        samples=samples,
        surface=surface,
        adjacency=edge_adjacency(mesh),
        scanned=np.full(n, scanned),
        seed=0,
    )
    return cast(LightProblem, problem), mesh.regions


EYES = np.array([[0.5, y, 1.5] for y in (1.0, 2.0, 3.0)])


def kept(levels: list[float], clipped: Any = False, scanned: bool = True) -> list[float]:
    """Share of the faces of each region that still count as emitting."""
    problem, region = hall(EYES, scanned)
    faces = np.ones(len(region), bool)
    left = without_highlights(problem, faces, np.array(levels)[region], faces & clipped)
    return [float(left[region == k].mean()) for k in range(3)]


def test_a_floor_that_mirrors_a_window_is_no_lamp_on_a_scan() -> None:
    floor, near, far = kept([0.5, 4.0, 4.0])
    assert floor < 0.8 and near == far == 1.0
    assert kept([0.5, 4.0, 4.0], scanned=False) == [1.0, 1.0, 1.0]


def test_what_is_brighter_than_any_mirror_image_stays_a_lamp() -> None:
    assert kept([4.0, 4.0, 4.0]) == [1.0, 1.0, 1.0]


def test_a_clipped_window_may_be_brighter_than_photos_show() -> None:
    assert kept([1.5, 4.0, 4.0])[FLOOR] > 0.9 > 0.8 > kept([1.5, 4.0, 4.0], clipped=True)[FLOOR]
