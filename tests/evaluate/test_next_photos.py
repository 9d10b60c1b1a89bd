"""Suggested photos in rooms where one knows from where the badly seen surface is seen."""

from dataclasses import replace

import numpy as np
import pytest

from iris_addon.evaluate.next_photos import BadlySeen, SuggestedPhoto, next_photos
from iris_addon.model.capture import Camera, Mesh
from iris_addon.rays.tracer import Tracer
from tests.box_room import box_mesh, look_at

UP = (0.0, 0.0, 1.0)


def camera(eye, target) -> Camera:
    return Camera(64, 48, 32.0, 32.0, cx=32.0, cy=24.0, c2w=look_at(np.array(eye, float), np.array(target, float)))


def atlas(mesh: Mesh, unseen) -> tuple[Mesh, np.ndarray]:
    """``mesh`` with one texel per face in rows of 16, and a map on which the faces ``unseen`` have coverage 0."""
    n = len(mesh.faces)
    centre = (np.stack([np.arange(n) % 16, 15 - np.arange(n) // 16], -1) + 0.5) / 16
    uv = (centre[:, None] + np.array([[-0.01, -0.01], [0.01, 0], [0, 0.01]])).astype(np.float32)
    coverage = np.ones((16, 16), np.float32)
    coverage.flat[list(unseen)] = 0
    return mesh.with_uv(uv), coverage


def suggest(mesh: Mesh, unseen, taken, count=5) -> tuple[list[SuggestedPhoto], BadlySeen]:
    textured, coverage = atlas(mesh, unseen)
    badly = BadlySeen.of(textured, coverage)
    tracer = Tracer(mesh)
    return next_photos(badly, taken, UP, lambda o, d: tracer.closest(o, d).distance, count), badly


def shown(photo: SuggestedPhoto, mesh: Mesh) -> np.ndarray:
    """Share of the frame's pixels that each face fills."""
    face = Tracer(mesh).closest(*photo.camera.rays()).face
    return np.bincount(face[face >= 0], minlength=len(mesh.faces)) / len(face)


AROUND = [camera((2 + x, 1.5 + y, 1.4), (4, 1.5, 1.4)) for x in (-1, 0, 1) for y in (-0.8, 0, 0.8)]


def test_the_one_wall_that_no_photo_shows_is_looked_at():
    (first, *_), badly = suggest(box_mesh(), [0, 1], AROUND)
    assert badly.need.sum() == pytest.approx(3 * 2.5, rel=0.02), "the area of that wall"
    assert np.abs(badly.position[:, 0]).max() < 1e-9
    assert first.camera.c2w[:3, 2] @ [1, 0, 0] > 0.75, "it looks along -x"
    assert abs(first.camera.c2w[2, 0]) < 1e-9 and first.camera.c2w[2, 1] > 0, "upright"
    filled = shown(first, box_mesh())
    assert filled[:2].sum() > 0.35 and filled[:2].sum() > filled[2:].max()


def test_two_opposite_walls_take_two_photos():
    photos, _ = suggest(box_mesh(), [0, 1, 2, 3], AROUND, count=2)
    views = sorted(float(photo.camera.c2w[0, 2]) for photo in photos)
    assert len(photos) == 2 and views[0] < -0.7 and views[1] > 0.7
    assert sum(photo.share for photo in photos) > 0.6 and photos[0].share >= photos[1].share


def partition() -> Mesh:
    """The box with a wall at x = 2 that leaves a door of one metre at y = 2 to 3."""
    room = box_mesh()
    wall = np.array([[2.0, 0, 0], [2, 2, 0], [2, 2, 2.5], [2, 0, 2.5]])
    faces = np.array([[0, 1, 2], [0, 2, 3]]) + len(room.vertices)
    return Mesh(np.concatenate([room.vertices, wall]), np.concatenate([room.faces, faces]))


def test_what_stands_behind_a_partition_is_photographed_from_behind_it():
    """The wall x = 0 behind the partition: from the front room one sees a strip of it through the door at best."""
    taken = [camera((3.2, y, 1.4), (4, y, 1.4)) for y in (0.5, 1.5, 2.5)] + [camera((1.8, 2.6, 1.4), (3, 2.6, 1.4))]
    (first, *_), _ = suggest(partition(), [0, 1], taken)
    assert first.camera.position[0] < 2 and first.camera.c2w[0, 2] > 0.7
    assert shown(first, partition())[:2].sum() > 0.3


def test_nobody_is_sent_where_a_surface_is_seen_from_nowhere():
    """The inside of a closed box in the room is badly seen and needs no photo; nor does a room that is seen."""
    room = box_mesh()
    small = Mesh(room.vertices * 0.1 + [2.0, 2.4, 0.0], room.faces)
    both = Mesh(np.concatenate([room.vertices, small.vertices]), np.concatenate([room.faces, small.faces + 8]))
    bottom = [12 + 8, 12 + 9]  # stands on the floor
    photos, badly = suggest(both, bottom, AROUND)
    assert len(badly.need) and photos == []
    assert suggest(room, [], AROUND)[0] == [] and suggest(room, [0, 1], [])[0] == []


def test_places_are_in_the_room_clear_of_walls_and_the_lens_is_that_of_the_photos():
    wide = [replace(view, fx=20.0, fy=20.0) for view in AROUND]
    photos, _ = suggest(box_mesh(), range(12), wide, count=8)
    assert len(photos) >= 4
    for photo in photos:
        assert (photo.camera.position > 0.2).all() and (photo.camera.position < [3.8, 2.8, 2.3]).all()
        assert photo.camera.fx == 20 and np.linalg.det(photo.camera.c2w[:3, :3]) == pytest.approx(1)
    shares = [photo.share for photo in photos]
    assert shares == sorted(shares, reverse=True) and sum(shares) <= 1 + 1e-9


def test_which_side_the_faces_are_wound_for_does_not_matter():
    flipped = Mesh(box_mesh().vertices, box_mesh().faces[:, ::-1].copy())
    first, other = (suggest(mesh, [0, 1], AROUND)[0][0] for mesh in (box_mesh(), flipped))
    assert first.share == pytest.approx(other.share, abs=0.05)
    assert first.camera.c2w[:3, 2] @ other.camera.c2w[:3, 2] > 0.8
