"""Rays by Warp, here on its CPU, are those of Embree, but where a ray grazes an edge or two faces lie in one place."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from iris_addon.base.errors import IrisError
from iris_addon.capture.reader import read_capture
from iris_addon.model.capture import Mesh
from iris_addon.rays.engines import RayEngine, warp_engine
from iris_addon.rays.tracer import Hits, Tracer, points_on_faces
from tests.demo_capture import ROOM
from tests.engine_room import assemble, quad

pytest.importorskip("warp", reason="Warp is not installed: the extra cuda of pyproject.toml")

N = 60_000
"""Rays of one comparison."""
ROUNDING = 1e-6
"""Of a place in float32, over the size of the mesh."""


@pytest.fixture(scope="module")
def warp() -> RayEngine:
    engine = warp_engine("cpu")
    assert (engine.name, engine.warning) == ("warp-cpu", "")
    return engine


def soup() -> Mesh:
    rng = np.random.default_rng(0)
    corners = rng.random((3000, 1, 3)) * 4 + rng.normal(0, 0.15, (3000, 3, 3))
    return Mesh(corners.reshape(-1, 3), np.arange(9000).reshape(-1, 3))


def demo() -> Mesh:
    return read_capture(ROOM).mesh


@pytest.fixture(scope="module", params=[soup, demo])
def pair(request: pytest.FixtureRequest, warp: RayEngine) -> tuple[Tracer, Tracer]:
    """The same mesh by Embree and by Warp."""
    make: Callable[[], Mesh] = request.param
    mesh = make()
    return Tracer(mesh), Tracer(mesh, engine=warp)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def in_the_room(tracer: Tracer, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays of all directions from all over the mesh, and some along the axes, float32."""
    rng = np.random.default_rng(seed)
    low, high = tracer.corners.min((0, 1)), tracer.corners.max((0, 1))
    direction = unit(rng.normal(size=(N, 3)))
    direction[::50] = np.eye(3)[rng.integers(3, size=N // 50)] * rng.choice([-1.0, 1.0], (N // 50, 1))
    return (low + rng.random((N, 3)) * (high - low)).astype(np.float32), direction.astype(np.float32)


def off_surfaces(tracer: Tracer, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays that start an epsilon above random faces, to the side of their normal."""
    rng = np.random.default_rng(seed)
    face = rng.choice(np.flatnonzero(tracer.areas > 1e-9), N)
    weights = rng.dirichlet(np.ones(3), N)[:, 1:]
    normal, direction = tracer.normals[face], unit(rng.normal(size=(N, 3)))
    direction *= np.sign((direction * normal).sum(1, keepdims=True))
    start = points_on_faces(tracer.corners, face, weights) + tracer.epsilon * normal
    return start.astype(np.float32), direction.astype(np.float32)


def margin(tracer: Tracer, face: np.ndarray, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(n,) metres from where a ray meets the plane of a face to the border of that face, seen along the ray."""
    a, b, c = (tracer.corners[face, k] - origins for k in range(3))
    distance = np.full(len(face), np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        # The edge as the ray sees it: projected onto the plane across the ray.
        p, q = (x - (x * directions).sum(1, keepdims=True) * directions for x in (start, end))
        along = np.clip(-(p * (q - p)).sum(1) / np.maximum(((q - p) ** 2).sum(1), 1e-30), 0, 1)
        distance = np.minimum(distance, np.linalg.norm(p + along[:, None] * (q - p), axis=1))
    return distance


def unexplained(tracers: tuple[Tracer, Tracer], hits: tuple[Hits, Hits], rays: tuple[np.ndarray, np.ndarray]) -> int:
    """Number of rays whose faces differ although neither is grazed at its border nor both lie in one place."""
    one, other = hits
    differ = np.flatnonzero(one.face != other.face)
    rounding = ROUNDING * np.ptp(tracers[0].corners, axis=(0, 1)).max()
    tie = np.abs(one.distance[differ] - other.distance[differ]) < tracers[0].epsilon
    grazed = np.zeros(len(differ), bool)
    for hit in hits:
        face = hit.face[differ]
        found = np.flatnonzero(face >= 0)
        o, d = (values[differ][found].astype(float) for values in rays)
        grazed[found] |= margin(tracers[0], face[found], o, d) < 3 * rounding
    return int((~tie & ~grazed).sum())


def same_place(one: Hits, other: Hits, epsilon: float) -> np.ndarray:
    """(n,) whether both hits are at the same place: the same face, another in its plane, or none."""
    with np.errstate(invalid="ignore"):  # infinity less infinity
        tie = np.abs(one.distance - other.distance) < epsilon
    return (one.face == other.face) | tie


@pytest.mark.parametrize("rays", [in_the_room, off_surfaces])
def test_closest_hits_are_those_of_embree(pair: tuple[Tracer, Tracer], rays: Callable) -> None:
    embree, warp = pair
    origins, directions = rays(embree, 1)
    one, other = embree.closest(origins, directions), warp.closest(origins, directions)
    assert 0.001 < (one.face < 0).mean() < 0.9
    assert same_place(one, other, embree.epsilon).mean() > 0.999
    assert unexplained(pair, (one, other), (origins, directions)) == 0
    assert (warp.hit_faces(origins, directions) == other.face).all()
    both = np.flatnonzero((one.face == other.face) & (one.face >= 0))
    # Along a ray that grazes its face, the rounding of places is as much larger as its angle is smaller.
    cosine = np.abs((embree.normals[one.face[both]] * directions[both]).sum(1))
    rounding = ROUNDING * np.ptp(embree.corners, axis=(0, 1)).max() / np.maximum(cosine, 1e-12)
    off = np.abs(one.distance[both] - other.distance[both])
    assert (off <= 1e-4 * one.distance[both] + rounding).all()
    missed = other.face < 0
    assert np.isinf(other.distance[missed]).all() and (other.barycentric[missed] == 0).all()


def test_barycentric_weights_rebuild_the_hit_point(pair: tuple[Tracer, Tracer]) -> None:
    _, warp = pair
    origins, directions = in_the_room(warp, 2)
    hits = warp.closest(origins, directions)
    found = hits.face >= 0
    points = points_on_faces(warp.corners, hits.face[found], hits.barycentric[found])
    along = origins[found] + hits.distance[found, None].astype(float) * directions[found]
    assert np.linalg.norm(points - along, axis=1).max() < 1e-4
    assert (hits.barycentric > -1e-6).all() and (hits.barycentric.sum(1) < 1 + 1e-6).all()


def test_occlusion_is_that_of_embree(pair: tuple[Tracer, Tracer]) -> None:
    """But for rays that graze an edge or end at a face: of 400 000 there were none or one."""
    origins, directions = off_surfaces(pair[0], 3)
    lengths = np.random.default_rng(4).random(N) * 3
    one, other = (tracer.unoccluded(origins, directions, lengths) for tracer in pair)
    assert 0.01 < one.mean() < 0.99
    assert (one != other).sum() <= 3
    seen = [tracer.visible(origins.astype(np.float64), origins[::-1].astype(np.float64)) for tracer in pair]
    assert 0.01 < seen[0].mean() < 0.99
    assert (seen[0] != seen[1]).sum() <= 3
    ended = [tracer.unoccluded(origins, directions, np.zeros(N)).all() for tracer in pair]
    assert all(ended)


def test_a_ray_meets_the_face_in_which_it_starts_from_either_side(warp: RayEngine) -> None:
    mesh = assemble([quad([0, 0, 0], [1, 0, 0], [0, 1, 0]), quad([0, 0, 1], [1, 0, 0], [0, 1, 0])], [0, 1])
    start, up = np.array([[0.3, 0.2, 0.0]]), np.array([[0, 0, 1.0]])
    for tracer in (Tracer(mesh), Tracer(mesh, engine=warp)):
        hits = tracer.closest(np.repeat(start, 2, 0), np.concatenate([up, -up]))
        assert (hits.face == hits.face[0]).all() and hits.face[0] in (0, 1)
        assert (hits.distance == 0).all()
        above = tracer.closest(start + tracer.epsilon * up, up)
        assert above.face[0] in (2, 3) and above.distance[0] == pytest.approx(1, abs=1e-3)


def test_degenerate_faces_and_panes_are_passed_and_numbers_stay(warp: RayEngine) -> None:
    rng, good = np.random.default_rng(5), soup()
    point, line = np.tile(rng.random(3), (3, 1)), rng.random(3) + np.outer([0.0, 1.0, 2.0], rng.random(3))
    vertices = np.concatenate([point, good.vertices[:900], line, good.vertices[900:]])
    mesh, panes = Mesh(vertices, np.arange(len(vertices)).reshape(-1, 3)), np.arange(100, 1500)
    embree, tracer = Tracer(mesh, without=panes), Tracer(mesh, without=panes, engine=warp)
    origins, directions = in_the_room(embree, 6)
    face = tracer.hit_faces(origins, directions)
    assert not np.isin(face, [0, 301, *panes]).any() and face.max() > 1500
    assert (face == embree.hit_faces(origins, directions)).mean() > 0.999


def test_no_ray_is_no_hit_and_one_that_is_not_finite_is_refused(warp: RayEngine) -> None:
    tracer, none = Tracer(soup(), engine=warp), np.zeros((0, 3))
    hits = tracer.closest(none, none)
    assert hits.face.shape == (0,) and hits.barycentric.shape == (0, 2)
    assert tracer.unoccluded(none, none, np.zeros(0)).shape == (0,)
    directions = np.array([[0, 0, 1.0], [0, np.nan, 1]])
    with pytest.raises(FloatingPointError, match="degenerate"):
        tracer.closest(np.zeros((2, 3)), directions)


def test_rays_are_the_same_in_pieces_from_many_threads(warp: RayEngine, monkeypatch: pytest.MonkeyPatch) -> None:
    tracer = Tracer(soup(), engine=warp)
    origins, directions = in_the_room(tracer, 7)
    whole = tracer.closest(origins, directions)
    from iris_addon.rays.warp_mesh import WarpTriangles

    monkeypatch.setattr(WarpTriangles, "chunk", 1000)
    parts = np.array_split(np.arange(N), 16)
    with ThreadPoolExecutor(4) as pool:
        pieces = list(pool.map(lambda part: tracer.closest(origins[part], directions[part]), parts))
    for name in ("face", "distance", "barycentric"):
        joined = np.concatenate([getattr(piece, name) for piece in pieces])
        assert joined.tobytes() == getattr(whole, name).tobytes()
    assert tracer.rays_traced == 2 * N


def test_a_card_whose_memory_is_full_is_an_error_with_a_mend(warp: RayEngine, monkeypatch: pytest.MonkeyPatch) -> None:
    tracer = Tracer(soup(), engine=warp)

    def full(*_arguments: object, **_options: object) -> None:
        raise RuntimeError("Failed to allocate 40 bytes on device 'cuda:0'")

    monkeypatch.setattr("warp.zeros", full)
    with pytest.raises(IrisError, match=r"Failed to allocate.*--device cpu"):
        tracer.hit_faces(np.zeros((1, 3)), np.eye(3)[:1])


def test_warp_leaves_stdout_to_the_worker_and_the_current_folder_alone(tmp_path: Path) -> None:
    """The worker speaks JSON lines there: no banner, and no word of kernels that are compiled."""
    current = tmp_path / "current"
    current.mkdir()
    script = (
        "from iris_addon.rays.engines import warp_engine; from iris_addon.rays.tracer import Tracer;"
        "from tests.rays.test_warp_mesh import soup; import numpy as np;"
        "t = Tracer(soup(), engine=warp_engine('cpu')); assert t.engine.name == 'warp-cpu', t.engine;"
        "t.hit_faces(np.zeros((1, 3)), np.eye(3)[:1])"
    )
    ran = run(script, current, WARP_CACHE_PATH=tmp_path / "kernels")
    assert (ran.returncode, ran.stdout) == (0, ""), ran.stderr
    assert not list(current.iterdir())
    assert list((tmp_path / "kernels").rglob("*.o")), "nothing was compiled"


def test_without_a_folder_for_kernels_rays_run_by_embree(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.touch()
    script = (
        "from iris_addon.rays.engines import warp_engine; e = warp_engine('cpu'); print(e.name, e.warning, sep='; ')"
    )
    ran = run(script, tmp_path, HOME=blocked, XDG_CACHE_HOME=blocked / "cache")
    assert ran.stdout.startswith("embree; rays run on the CPU: Warp does not start"), ran.stderr
    assert "WARP_CACHE_PATH" in ran.stdout


def run(script: str, current: Path, **variables: Path) -> subprocess.CompletedProcess[str]:
    """Run ``script`` in a Python of its own, with some environment variables and none of the user's for Warp."""
    kept = {name: value for name, value in os.environ.items() if name != "WARP_CACHE_PATH"}
    given = {name: str(value) for name, value in variables.items()}
    environment = kept | given | {"PYTHONPATH": str(Path(__file__).resolve().parents[2])}
    command = [sys.executable, "-c", script]
    return subprocess.run(command, env=environment, cwd=current, capture_output=True, text=True, check=False)
