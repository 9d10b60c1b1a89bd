"""Poses in a frame and unit of their own are moved to the mesh by their sparse points, where the photos then fit."""

from __future__ import annotations

import shutil
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial import cKDTree

from iris_addon.base.errors import BadInput
from iris_addon.capture.colmap import read_colmap_points
from iris_addon.capture.common_frame import Together
from iris_addon.capture.points_to_mesh import find_similarities
from iris_addon.capture.reader import read_capture, read_views
from iris_addon.capture.seen_points import seen_points
from iris_addon.capture.similarity import Similarity
from iris_addon.model.camera_height import CameraHeight
from iris_addon.model.capture import Capture, Mesh, View, moved_by
from tests.colmap_model import camera_of, poses, write_text
from tests.demo_capture import demo_capture
from tests.program_cameras import write_metashape
from tests.sparse_points import random_similarity, sparse_points, write_points

CENTIMETRE, HALF_DEGREE, PERCENT = 0.01, np.radians(0.5), 0.01


@pytest.fixture(scope="module")
def right(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    return read_capture(demo_capture(tmp_path_factory.mktemp("right") / "room", count=8).save())


def as_colmap(capture: Capture, root: Path, similarity: np.ndarray, points: np.ndarray | None) -> Path:
    """The capture as a COLMAP model whose poses and points are moved by ``similarity``; the mesh stays."""
    model = root / "sparse" / "0"
    model.mkdir(parents=True)
    shutil.copytree(capture.root / "images", root / "images")
    shutil.copy(capture.root / "mesh.ply", root / "mesh.ply")
    moved = replace(capture, views=tuple(moved_by(view, similarity) for view in capture.views))
    write_text(model, camera_of(capture), poses(moved))
    if points is not None:
        write_points(model / "points3D.txt", points @ similarity[:3, :3].T + similarity[:3, 3])
    return root


def positions(capture: Capture) -> np.ndarray:
    return np.array([view.camera.position for view in sorted(capture.views, key=lambda view: view.name)])


def turn_between(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.arccos(np.clip((np.trace(a[:3, :3].T @ b[:3, :3]) - 1) / 2, -1, 1)))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_poses_of_any_frame_and_unit_are_moved_to_the_mesh(right: Capture, tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, similarity = sparse_points(right, rng), random_similarity(rng)
    root = as_colmap(right, tmp_path / "room", similarity, points)
    capture = read_capture(root)
    assert capture.mismatch is None and capture.metres_per_unit == 1
    np.testing.assert_allclose(capture.mesh.vertices, right.mesh.vertices)
    off = np.linalg.norm(positions(capture) - positions(right), axis=1)
    assert np.median(off) < CENTIMETRE and off.max() < 2 * CENTIMETRE
    by_name = {view.name: view.camera.c2w for view in right.views}
    assert max(turn_between(view.camera.c2w, by_name[view.name]) for view in capture.views) < HALF_DEGREE
    assert capture.poses_to_mesh is not None
    both = capture.poses_to_mesh @ similarity
    assert np.cbrt(np.linalg.det(both[:3, :3])) == pytest.approx(1, abs=PERCENT)
    assert capture.up == pytest.approx((0, 0, 1))
    (said,) = [warning for warning in capture.warnings if "different frames" in warning]
    assert all(word in said for word in ("turned by", "scaled by", "shifted by"))
    for found, view in zip(
        read_views(root, {"poses_to_mesh": capture.poses_to_mesh.tolist()}), capture.views, strict=True
    ):
        np.testing.assert_allclose(found.camera.c2w, view.camera.c2w, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["Metashape", "nerfstudio"])
def test_without_points_those_that_photos_show_in_common_are_taken(kind: str, tmp_path: Path) -> None:
    """A chunk that was never scaled, or the poses of structure from motion in a transforms.json, and a scan."""
    demo = demo_capture(tmp_path / "room", count=14)
    right, similarity = read_capture(demo.save()), random_similarity(np.random.default_rng(0))
    demo.poses = np.array([moved_by(view, similarity).camera.c2w for view in right.views])
    demo.save()
    if kind == "Metashape":
        write_metashape(demo.root, replace(right, views=tuple(moved_by(view, similarity) for view in right.views)))
        (demo.root / "transforms.json").unlink()
    capture = read_capture(demo.root)
    assert capture.mismatch is None and capture.poses_to_mesh is not None
    assert any("the unit of the mesh is taken as one meter" in warning for warning in capture.warnings)
    np.testing.assert_allclose(capture.mesh.vertices, right.mesh.vertices, atol=1e-6)
    assert np.linalg.norm(positions(capture) - positions(right), axis=1).max() < 4 * CENTIMETRE
    by_name = {view.name: view.camera.c2w for view in right.views}
    assert max(turn_between(view.camera.c2w, by_name[view.name]) for view in capture.views) < 2 * HALF_DEGREE
    report = {"poses_to_mesh": capture.poses_to_mesh.tolist(), "mended_poses": capture.mended_poses}
    for found, view in zip(read_views(demo.root, report), capture.views, strict=True):
        np.testing.assert_allclose(found.camera.c2w, view.camera.c2w, atol=1e-6)


def test_points_that_three_photos_show_lie_on_the_room(right: Capture) -> None:
    points = seen_points(right.views)
    samples = trimesh.Trimesh(right.mesh.vertices, right.mesh.faces, process=False).sample(100_000)
    off, _ = cKDTree(samples).query(points)
    assert len(points) > 30 and np.median(off) < 0.06


def test_poses_that_mean_something_else_have_no_points_in_common(right: Capture) -> None:
    """Else any wrong pose would find a place in the mesh."""
    down = np.diag([1.0, -1.0, -1.0, 1.0])
    wrong = [replace(view, camera=replace(view.camera, c2w=view.camera.c2w @ down)) for view in right.views]
    assert len(seen_points(wrong)) < 0.5 * len(seen_points(right.views))


def test_photos_without_a_corner_give_no_points_and_those_beside_them_theirs(right: Capture, tmp_path: Path) -> None:
    """One plain photo among others; and photos too low for the squares around a corner."""
    camera = right.views[0].camera
    plain = tmp_path / "plain.png"
    Image.new("RGB", (camera.width, camera.height), (120, 120, 120)).save(plain)
    assert len(seen_points([replace(right.views[0], photo=plain), *right.views[1:]])) > 0
    assert seen_points([replace(view, photo=plain) for view in right.views]).shape == (0, 3)
    low = replace(camera, height=40, cy=20.0)
    Image.new("RGB", (camera.width, 40), (120, 120, 120)).save(plain)
    lowered = [replace(view, photo=plain, camera=replace(low, c2w=view.camera.c2w)) for view in right.views]
    assert len(seen_points(lowered)) == 0


def test_poses_that_fit_stay_where_they_are(right: Capture, tmp_path: Path) -> None:
    points = sparse_points(right, np.random.default_rng(0))
    capture = read_capture(as_colmap(right, tmp_path / "room", np.eye(4), points))
    assert capture.poses_to_mesh is None and not any("frames" in warning for warning in capture.warnings)
    np.testing.assert_allclose(positions(capture), positions(right), atol=1e-6)


def test_photos_and_points_of_another_room_are_refused(right: Capture, tmp_path: Path) -> None:
    """Its points find a place in any box-shaped room; the photos do not."""
    rng = np.random.default_rng(3)
    root = as_colmap(right, tmp_path / "room", random_similarity(rng), sparse_points(right, rng))
    low, high = right.mesh.vertices.min(0), right.mesh.vertices.max(0)
    boxes = [trimesh.creation.box(bounds=(low, low + (high - low) * (1.3, 0.8, 1.0)))]
    for corner in rng.uniform(low, high - 0.8, (12, 3)):
        boxes.append(trimesh.creation.box(bounds=(corner, corner + rng.uniform(0.2, 0.8, 3))))
    other = trimesh.util.concatenate(boxes)
    other.export(root / "mesh.ply")
    try:
        capture = read_capture(root)
    except BadInput as error:
        assert "the photos do not fit the mesh" in str(error) and "show in common" in str(error)
    else:
        assert capture.poses_to_mesh is None
        assert capture.mismatch is not None and "show in common" in capture.mismatch.what


def test_more_is_tried_for_points_of_photos_than_for_those_of_a_reconstruction(right: Capture) -> None:
    points = sparse_points(right, np.random.default_rng(0))
    tried = []
    for of_photos in (False, True):
        steps: list[None] = []
        found = find_similarities(
            points, right.views, right.mesh, lambda to=steps: to.append(None), of_photos=of_photos
        )
        assert min(np.abs(one.matrix() - np.eye(4)).max() for one in found) < 2 * CENTIMETRE
        tried.append(len(steps))
    assert tried[0] < 0.7 * tried[1]


def test_few_points_find_nothing(right: Capture) -> None:
    assert find_similarities(np.zeros((20, 3)), right.views, right.mesh) == []
    assert find_similarities(np.zeros((500, 3)), right.views, right.mesh) == []


def test_binary_points_are_those_of_the_text(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(7, 3))
    write_points(tmp_path / "points3D.txt", points)
    np.testing.assert_allclose(read_colmap_points(tmp_path), points)
    data = struct.pack("<Q", len(points))
    for index, point in enumerate(points):
        data += struct.pack("<Q3d3Bd", index, *point, 1, 2, 3, 0.5) + struct.pack("<Q", index) + bytes(8 * index)
    (tmp_path / "points3D.bin").write_bytes(data)
    (tmp_path / "points3D.txt").unlink()
    np.testing.assert_allclose(read_colmap_points(tmp_path), points)


def test_a_camera_height_gives_a_unit_where_none_is_known(right: Capture, tmp_path: Path) -> None:
    """Poses and mesh of a model in half metres: the cameras are 1.45 m over the floor."""
    half = np.diag([2.0, 2.0, 2.0, 1.0])
    root = as_colmap(right, tmp_path / "room", half, None)
    mesh = trimesh.load(root / "mesh.ply", process=False)
    mesh.apply_scale(2.0).export(root / "mesh.ply")
    height = float(np.median(positions(right)[:, 2]) - right.mesh.vertices[:, 2].min())
    capture = read_capture(root, metres_per_unit=CameraHeight(height))
    assert capture.metres_per_unit == pytest.approx(0.5, rel=0.02)
    np.testing.assert_allclose(positions(capture), positions(right), atol=0.08)
    np.testing.assert_allclose(np.ptp(capture.mesh.vertices, axis=0), np.ptp(right.mesh.vertices, axis=0), rtol=0.02)
    assert any(f"{height:g} m over the floor" in warning for warning in capture.warnings)


def test_poses_in_metres_that_are_moved_to_a_mesh_do_not_tell_its_unit(
    right: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A transforms.json is in metres; a mesh from elsewhere, onto which its poses are laid, may be in anything."""
    said = "mesh.ply tells no unit: the unit of the mesh is taken as one meter"
    assert not any(said in warning for warning in right.warnings)

    def laid_onto(views: tuple[View, ...], val_views: tuple[View, ...], mesh: Mesh, *_: object, **__: object):
        return Together(tuple(views), tuple(val_views), mesh, similarity=Similarity(np.eye(3), 1.0, np.zeros(3)))

    monkeypatch.setattr("iris_addon.capture.reader.bring_together", laid_onto)
    assert any(said in warning for warning in read_capture(right.root).warnings)
    assert not any(said in warning for warning in read_capture(right.root, metres_per_unit=1.0).warnings)
    height = float(np.median(positions(right)[:, 2]) - right.mesh.vertices[:, 2].min())
    assert read_capture(right.root, metres_per_unit=CameraHeight(2 * height)).metres_per_unit == pytest.approx(
        2, rel=0.05
    )


def test_a_camera_height_yields_to_a_unit_that_is_known(right: Capture) -> None:
    capture = read_capture(right.root, metres_per_unit=CameraHeight(3.0))
    assert capture.metres_per_unit == 1
    assert any("--camera-height is not used" in warning for warning in capture.warnings)
