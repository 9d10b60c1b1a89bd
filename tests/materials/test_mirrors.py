"""A metal plate on the wall of a box room whose walls have a pattern: is it a mirror?"""

from __future__ import annotations

import numpy as np
import pytest

from iris_addon.base.progress import Progress
from iris_addon.decide import Decisions
from iris_addon.materials.gloss import Gloss, rough_everywhere
from iris_addon.materials.mirrors import with_mirrors
from iris_addon.model.capture import Camera
from iris_addon.rays.sampling import dot
from iris_addon.rays.tracer import Tracer, points_on_faces
from iris_addon.surface.photo_samples import ShownPixels
from iris_addon.surface.primary_rays import PixelSamples, trace_pixels
from tests.box_room import look_at
from tests.engine_room import assemble, box, quad

SIZE = np.array([4.0, 3.0, 2.5])
PLATE = 6
"""Region of the plate, in front of the wall y = 0."""
MESH = assemble([*box(np.zeros(3), SIZE), quad([1.0, 0.01, 0.5], [2.0, 0, 0], [0, 0, 1.5])], [*range(6), PLATE])


def pattern(place: np.ndarray) -> np.ndarray:
    """(n,) luminance of walls at (n, 3), with a period of a quarter of a metre."""
    return 0.5 + 0.4 * np.sin(2 * np.pi * place.sum(-1) / 0.25)


def cameras() -> list[Camera]:
    places = np.random.default_rng(0).uniform([0.8, 1.5, 0.7], [3.2, 2.8, 2.0], (8, 3))
    targets = np.tile([[2.0, 0.0, 1.2], [2.0, 3.0, 1.2]], (4, 1))  # half of them show what the plate reflects
    poses = [look_at(place, target) for place, target in zip(places, targets, strict=True)]
    return [Camera(width=96, height=72, fx=60, fy=60, cx=48, cy=36, c2w=pose) for pose in poses]


def reflected_pattern(tracer: Tracer, pixels: PixelSamples, width: float, rng: np.random.Generator) -> np.ndarray:
    """(n,) pattern in the plate, whose normals are spread by ``width`` (a standard deviation of their slope)."""
    shown = []
    for _ in range(1 if width == 0 else 64):
        half = pixels.normal + width * rng.standard_normal(pixels.normal.shape)
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        along = 2 * dot(half, pixels.direction)[:, None] * half - pixels.direction
        hits = tracer.closest(pixels.position + 1e-3 * pixels.normal, along)
        shown.append(pattern(points_on_faces(tracer.corners, hits.face, hits.barycentric)))
    return np.mean(shown, axis=0)


def solved(width: float, matte: bool = False, decisions: Decisions | None = None) -> tuple[Gloss, Decisions]:
    """What becomes of a metal plate of roughness 0.1, or of a matte one, that reflects the walls with a spread."""
    tracer, rng = Tracer(MESH), np.random.default_rng(1)
    samples = trace_pixels(tracer, cameras(), Progress())
    assert MESH.regions is not None
    region = MESH.regions[samples.face]
    luminance, on = pattern(samples.position), np.flatnonzero(region == PLATE)
    luminance[on] = 0.9 * reflected_pattern(tracer, samples.take(on), width, rng)
    luminance *= np.exp(0.02 * rng.standard_normal(len(luminance)))
    usable = np.ones(len(luminance), bool)
    shown = ShownPixels(luminance.astype(np.float32), luminance > 0.88, usable)
    gloss = rough_everywhere(7)
    if not matte:
        gloss.metallic[PLATE], gloss.roughness[PLATE] = 1.0, 0.1
    decisions = decisions or Decisions()
    return with_mirrors(gloss, tracer, samples, shown, region, rng, decisions), decisions


def test_a_plate_that_shows_the_walls_sharply_is_a_mirror() -> None:
    gloss, decisions = solved(0.0)
    assert gloss.roughness.tolist() == [1.0] * 6 + [0.0]
    (decision,) = decisions.report()
    assert decision["refinement"] == "mirror" and decision["accepted"]


@pytest.mark.parametrize("width", [0.007, 0.03])
def test_a_plate_that_blurs_them_as_its_roughness_says_or_more_is_none(width: float) -> None:
    """GGX of roughness 0.1 has normals of slope 0.01 in root mean square, but for its tail."""
    gloss, decisions = solved(width)
    assert gloss.roughness[PLATE] == 0.1
    assert [decision["accepted"] for decision in decisions.report()] == [False]


def test_nothing_but_smooth_metal_is_asked() -> None:
    gloss, decisions = solved(0.0, matte=True)
    assert gloss.roughness[PLATE] == 1.0 and decisions.report() == []


def test_mirrors_may_be_forbidden() -> None:
    gloss, decisions = solved(0.0, decisions=Decisions({"mirror": False}))
    assert gloss.roughness[PLATE] == 0.1 and decisions.report() == []
