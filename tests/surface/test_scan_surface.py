"""The surface behind a scan: flat where the scanned thing is flat, curved where it is curved, in its place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import iris_addon.surface.scan_surface as scan_surface
from iris_addon.base.progress import Progress
from iris_addon.decide import Decisions
from iris_addon.model.capture import Camera, Capture, Mesh, View
from iris_addon.rays.engines import EMBREE
from iris_addon.surface.scan_surface import SCAN_MIN_FACES, ScanSurface, choose_surface, face_normals, surface_behind

SIDE, NOISE, RADIUS = 120, 0.002, 0.6
assert 2 * (SIDE - 1) ** 2 > SCAN_MIN_FACES


def _sheet(height: NDArray[np.floating], x: NDArray[np.floating], y: NDArray[np.floating]) -> Mesh:
    corner = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    a, b, c, d = corner[:-1, :-1].ravel(), corner[1:, :-1].ravel(), corner[1:, 1:].ravel(), corner[:-1, 1:].ravel()
    return Mesh(np.stack([x, y, height], -1).reshape(-1, 3), np.concatenate([np.c_[a, b, c], np.c_[a, c, d]]))


U, V = np.meshgrid(np.linspace(0, 1.2, SIDE), np.linspace(0, 1.2, SIDE), indexing="ij")
FOLDED = _sheet(np.maximum(U - 0.6, 0), np.minimum(U, 0.6), V)
"""A floor and a wall."""
ANGLE = (U - 0.6) / RADIUS
ROUND = _sheet(RADIUS * np.cos(ANGLE), RADIUS * np.sin(ANGLE), V)
"""A column's side."""


def _scanned(mesh: Mesh) -> Mesh:
    """``mesh`` with places off by NOISE, alike over a few vertices as a fused scan's are."""
    noise = np.random.default_rng(0).normal(0, 1, (SIDE, SIDE, 3))
    noise = noise + np.roll(noise, 1, 0) + np.roll(noise, 1, 1) + np.roll(noise, (1, 1), (0, 1))
    return Mesh(mesh.vertices + 0.5 * NOISE * noise.reshape(-1, 3), mesh.faces)


def _turned(normals: NDArray[np.floating], truth: Mesh) -> NDArray[np.floating]:
    """(F,) angle in degrees between ``normals`` and those of the true faces."""
    true = face_normals(truth.vertices, truth.faces)[0]
    return np.degrees(np.arccos(np.clip((normals * true).sum(1), -1, 1)))


def test_floor_and_wall_of_a_scan_become_planes() -> None:
    given = _scanned(FOLDED)
    found = surface_behind(given)
    assert found.scanned.all() and 0.5 * NOISE < found.noise < 2 * NOISE
    before, after = _turned(face_normals(given.vertices, given.faces)[0], FOLDED), _turned(found.normals, FOLDED)
    assert np.median(before) > 8 and np.median(after) < 0.3
    middle = FOLDED.vertices[FOLDED.faces].mean(1)
    at_fold = (middle[:, 0] > 0.58) & (middle[:, 2] < 0.02)
    assert np.quantile(after[~at_fold], 0.995) < 2, "no plane goes around the corner"
    for labels in (found.plane, found.pieces):
        floor, wall = (np.bincount(labels[where] + 1) for where in (middle[:, 2] == 0, middle[:, 2] > 0))
        assert floor.max() > 0.97 * floor.sum() and wall.max() > 0.97 * wall.sum()
        assert floor.argmax() != wall.argmax()


def test_vertices_of_a_scan_move_onto_the_surface() -> None:
    given = _scanned(FOLDED)
    found = surface_behind(given)
    off = np.minimum(np.abs(found.mesh.vertices[:, 2]), np.abs(found.mesh.vertices[:, 0] - 0.6))
    off_before = np.minimum(np.abs(given.vertices[:, 2]), np.abs(given.vertices[:, 0] - 0.6))
    assert np.sqrt(np.mean(off**2)) < 0.35 * np.sqrt(np.mean(off_before**2))
    assert np.array_equal(found.mesh.faces, given.faces)


def test_a_column_stays_round() -> None:
    given = _scanned(ROUND)
    found = surface_behind(given)
    before, after = _turned(face_normals(given.vertices, given.faces)[0], ROUND), _turned(found.normals, ROUND)
    assert np.median(after) < 0.4 * np.median(before)
    still = (found.mesh.vertices == given.vertices).all(1)
    assert still.mean() > 0.9, "off planes a vertex is best where the scanner saw it"
    assert (found.plane < 0).mean() > 0.9, "it is no plane"


@pytest.mark.parametrize("mesh", [FOLDED, ROUND])
def test_a_modelled_surface_is_itself(mesh: Mesh) -> None:
    flat = Mesh(mesh.vertices[: 40 * SIDE], mesh.faces[(mesh.faces < 40 * SIDE).all(1)]) if mesh is ROUND else mesh
    found = surface_behind(flat)
    assert found.mesh is flat and not found.scanned.any() and found.noise == 0
    assert (found.plane == -1).all()


@pytest.mark.parametrize(("loss", "taken"), [(0.9, True), (1.0, True), (1.1, False)])
def test_photos_decide_whether_a_scan_is_smoothed(monkeypatch: pytest.MonkeyPatch, loss: float, taken: bool) -> None:
    given = _scanned(FOLDED)
    monkeypatch.setattr(scan_surface, "photo_disagreement", lambda *_: [1.0, loss])
    camera = Camera(width=4, height=3, fx=4.0, fy=4.0, cx=2.0, cy=1.5, c2w=np.eye(4))
    view = View(name="0", camera=camera, photo=Path("unread.png"))
    capture = Capture(name="room", root=Path(), views=(view,), val_views=(), mesh=given)
    decisions = Decisions()
    surface, tracer = choose_surface(capture, np.random.default_rng(0), Progress(), decisions, EMBREE)
    assert isinstance(surface, ScanSurface) and surface.scanned.all()
    assert (surface.mesh is not given) == taken
    assert np.allclose(tracer.normals, surface.normals, atol=1e-6)
    assert [made["refinement"] for made in decisions.report()] == ["scan_surface"]
