"""The ray tracer behind its small interface: the hits of brute force, and none of the traps of bad triangles."""

from __future__ import annotations

import numpy as np
import pytest

from iris_addon.model.capture import Mesh
from iris_addon.rays.tracer import Tracer, points_on_faces
from tests.engine_room import assemble, furnished_room, quad


def triangle_soup(n: int, rng: np.random.Generator) -> Mesh:
    corners = rng.random((n, 1, 3)) * 4 + rng.normal(0, 0.6, (n, 3, 3))
    return Mesh(corners.reshape(-1, 3), np.arange(3 * n).reshape(n, 3))


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def brute_force(corners: np.ndarray, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, ...]:
    """Distance of every ray to every triangle (inf where missed) and the margin to its edges (Möller-Trumbore)."""
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(directions[:, None], edge2[None])
    determinant = (p * edge1).sum(-1)
    offset = origins[:, None] - corners[None, :, 0]
    u = (offset * p).sum(-1) / determinant
    q = np.cross(offset, edge1[None])
    v = (directions[:, None] * q).sum(-1) / determinant
    t = (q * edge2).sum(-1) / determinant
    margin = np.minimum(np.minimum(u, v), 1 - u - v)
    return np.where((margin > 0) & (t > 0), t, np.inf), np.where(t > 0, np.abs(margin), np.inf)


def test_closest_hits_are_those_of_brute_force() -> None:
    rng = np.random.default_rng(0)
    mesh = triangle_soup(200, rng)
    tracer = Tracer(mesh)
    origins, directions = rng.random((2000, 3)) * 6 - 1, unit(rng.normal(size=(2000, 3)))
    distance, margin = brute_force(mesh.vertices[mesh.faces], origins, directions)
    clear = margin.min(1) > 1e-4  # a ray through an edge may go either way
    expected = np.where(np.isfinite(distance.min(1)), distance.argmin(1), -1)
    hits = tracer.closest(origins, directions)
    assert clear.mean() > 0.9 and 0.2 < (expected >= 0).mean() < 0.98
    assert (hits.face == expected)[clear].all()
    assert hits.distance[clear] == pytest.approx(distance.min(1)[clear], rel=1e-4, abs=1e-4)
    assert (tracer.hit_faces(origins, directions) == hits.face).all()
    found = hits.face >= 0
    points = points_on_faces(tracer.corners, hits.face[found], hits.barycentric[found])
    along = origins[found] + directions[found] * hits.distance[found, None]
    assert np.abs(points - along).max() < 1e-4


def test_rays_are_counted() -> None:
    rng = np.random.default_rng(1)
    tracer = Tracer(triangle_soup(10, rng))
    tracer.closest(rng.random((70, 3)), unit(rng.normal(size=(70, 3))))
    tracer.visible(rng.random((30, 3)), rng.random((30, 3)))
    assert tracer.rays_traced == 100


def test_degenerate_triangles_are_dropped_and_face_numbers_stay() -> None:
    rng = np.random.default_rng(2)
    good = triangle_soup(40, rng)
    point, line = np.tile(rng.random(3), (3, 1)), rng.random(3) + np.outer([0.0, 1.0, 2.0], rng.random(3))
    vertices = np.concatenate([point, good.vertices[:60], line, good.vertices[60:]])
    mesh = Mesh(vertices, np.arange(len(vertices)).reshape(-1, 3))
    real = np.delete(np.arange(42), [0, 21])
    tracer, reference = Tracer(mesh), Tracer(good)
    origins, directions = rng.random((500, 3)) * 4, unit(rng.normal(size=(500, 3)))
    expected = reference.closest(origins, directions).face
    assert (tracer.closest(origins, directions).face == np.where(expected < 0, -1, real[expected])).all()
    assert np.isfinite(tracer.normals).all()
    assert (tracer.normals[[0, 21]] == 0).all()
    assert np.linalg.norm(tracer.normals[real], axis=1) == pytest.approx(1)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_ray_that_is_not_finite_is_refused(bad: float) -> None:
    tracer = Tracer(triangle_soup(5, np.random.default_rng(3)))
    origins, directions = np.zeros((4, 3)), np.tile([0.0, 0.0, 1.0], (4, 1))
    directions[2, 1] = bad
    with pytest.raises(FloatingPointError, match="degenerate"):
        tracer.closest(origins, directions)


def test_visibility_is_symmetric_and_blocked_by_faces_between() -> None:
    rng = np.random.default_rng(4)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    pieces = [
        quad([0, 0, 0], [1, 0, 0], [0, 1, 0]),
        quad([0, 0, 2], [1, 0, 0], [0, 1, 0]),
        quad([-1, -1, 1], [1.5, 0, 0], [0, 3, 0]),  # hides x < 0.5
    ]
    tracer = Tracer(assemble([(v @ turn.T, f) for v, f in pieces], [0, 1, 2]))
    low, high = (np.column_stack([rng.random((4000, 2)), np.full(4000, z)]) for z in (0.0, 2.0))
    up = tracer.epsilon * np.array([0, 0, 1.0])
    forth = tracer.visible((low + up) @ turn.T, (high - up) @ turn.T)
    back = tracer.visible((high - up) @ turn.T, (low + up) @ turn.T)
    halfway = 0.5 * (low + high)[:, 0]
    clear = np.abs(halfway - 0.5) > 1e-4
    assert (forth == back)[clear].all()
    assert (forth == (halfway > 0.5))[clear].all()


def test_epsilon_does_not_grow_with_a_far_backdrop() -> None:
    """A triangle a kilometre away leaves the origins of rays at tenths of millimetres from their surfaces."""
    room = furnished_room().mesh
    far = np.array([[-1e3, 1e3, -1e3], [1e3, 1e3, -1e3], [0, 1e3, 1e3]])
    n = len(room.vertices)
    both = Mesh(np.vstack([room.vertices, far]), np.vstack([room.faces, [[n, n + 1, n + 2]]]))
    assert 2e-5 < Tracer(room).epsilon < Tracer(both).epsilon < 5 * Tracer(room).epsilon


def test_a_shade_that_nearly_touches_its_lamp_occludes_it() -> None:
    """A tenth of a millimetre before a lamp in a room of four metres."""
    pieces = [quad([0, 0, z], [4, 0, 0], [0, 3, 0]) for z in (0.0, 2.0, 2.0001)]
    tracer = Tracer(assemble(pieces, [0, 1, 2]))
    at = np.random.default_rng(0).random((200, 2)) * [4, 3]
    low = np.column_stack([at, np.full(200, tracer.epsilon)])
    assert tracer.visible(low, np.column_stack([at[::-1], np.full(200, 2.0)])).all()
    assert not tracer.visible(low, np.column_stack([at[::-1], np.full(200, 2.0001)])).any()


def test_targets_do_not_occlude_themselves() -> None:
    rng = np.random.default_rng(5)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    pieces = [quad([0, 0, 0], [3, 0, 0], [0, 3, 0]), quad([0, 0, 2.5], [3, 0, 0], [0, 3, 0])]
    tracer = Tracer(assemble([(v @ turn.T, f) for v, f in pieces], [0, 1]))
    low, high = (np.column_stack([3 * rng.random((20_000, 2)), np.full(20_000, z)]) for z in (tracer.epsilon, 2.5))
    assert tracer.visible((low @ turn.T).astype(np.float32), (high @ turn.T).astype(np.float32)).all()
