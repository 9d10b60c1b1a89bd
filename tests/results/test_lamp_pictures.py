"""The picture of a lamp is cut from the photo that shows it, where it shows it."""

from dataclasses import replace

import numpy as np
import pytest

from iris_addon.base.images import read_image, write_png
from iris_addon.capture.reader import read_capture
from iris_addon.model.capture import Camera, Mesh
from iris_addon.model.recovered import Emitter, LightState
from iris_addon.rays.tracer import Tracer
from iris_addon.results.files import lamp_picture
from iris_addon.results.lamp_pictures import LAMP_SIDE, best_view, write_lamp_pictures
from tests.box_room import WALL_COLORS, look_at
from tests.result_room import room


def lamp(number: int, faces: list[int]) -> Emitter:
    return Emitter(id=number, faces=np.array(faces), radiance=np.ones(3), area=1.0, confidence=1.0)


def test_each_lamp_is_shown_in_the_color_that_it_has_in_the_photos(fipt_room, tmp_path):
    """Two walls of the room as lamps; and one that no photo shows gets no picture."""
    capture = read_capture(fipt_room.root)
    mesh = capture.mesh
    shut = Mesh(0.01 * mesh.vertices + [1.0, 1.0, 9.0], mesh.faces)  # far above the ceiling
    both = Mesh(np.concatenate([mesh.vertices, shut.vertices]), np.concatenate([mesh.faces, shut.faces + 8]))
    emitters = (lamp(0, [0, 1]), lamp(3, [6, 7]), lamp(7, [12, 13]))
    result = replace(room(), mesh=both, emitters=emitters)
    (tmp_path / "report").mkdir()
    write_png(lamp_picture(tmp_path, 99), np.zeros((8, 8, 3), np.uint8))  # of an earlier result
    written = write_lamp_pictures(result, capture.views, Tracer(both), tmp_path)
    assert sorted(written) == [0, 3] and sorted(path.name for path in (tmp_path / "report").iterdir()) == [
        "lamp-00.png",
        "lamp-03.png",
    ]
    for number, wall in ((0, 0), (3, 3)):
        picture = read_image(written[number])
        assert picture.shape == (LAMP_SIDE, LAMP_SIDE, 3)
        middle = picture[LAMP_SIDE // 4 : -LAMP_SIDE // 4, LAMP_SIDE // 4 : -LAMP_SIDE // 4]
        same = np.abs(middle.astype(int) - WALL_COLORS[wall].astype(int)).max(-1) < 6
        assert same.mean() > 0.5, number


def test_a_lamp_is_shown_where_it_is_on(fipt_room, tmp_path):
    capture = read_capture(fipt_room.root)
    result = replace(room(), mesh=capture.mesh, emitters=(lamp(0, [0, 1]), lamp(1, [2, 3])))
    (tmp_path / "report").mkdir()
    tracer = Tracer(capture.mesh)
    shown = best_view([view.camera for view in capture.views], np.array([0, 1]), tracer)[0]
    states = ["second" if k == shown else "first" for k in range(len(capture.views))]
    views = [replace(view, light_state=state) for view, state in zip(capture.views, states, strict=True)]
    others = views[:shown] + views[shown + 1 :]
    on, off = np.ones(3), np.zeros(3)
    told = tuple(LightState(name, (), np.array(each)) for name, each in (("first", [on, off]), ("second", [off, on])))
    write_lamp_pictures(replace(result, light_states=told), views, tracer, tmp_path)
    found = read_image(lamp_picture(tmp_path, 0))
    write_lamp_pictures(result, others, tracer, tmp_path)
    assert np.array_equal(found, read_image(lamp_picture(tmp_path, 0)))
    write_lamp_pictures(result, views, tracer, tmp_path)
    assert not np.array_equal(found, read_image(lamp_picture(tmp_path, 0)))


def square(at: float, side: float = 0.2) -> np.ndarray:
    half = side / 2
    return np.array([[-half, at, -half], [half, at, -half], [half, at, half], [-half, at, half]])


def camera(eye, target) -> Camera:
    return Camera(
        320, 240, 250.0, 250.0, cx=160.0, cy=120.0, c2w=look_at(np.array(eye, float), np.array(target, float))
    )


def test_the_photo_is_one_that_sees_all_of_the_lamp_and_is_near():
    """A lamp of 20 cm at y = 0; a board hides it from one side."""
    mesh = Mesh(np.concatenate([square(0.0), square(0.5, 1.0)]), np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]))
    hidden, far, near = camera((0, 2, 0), (0, 0, 0)), camera((0, -6, 0), (0, 0, 0)), camera((0.1, -2, 0), (0, 0, 0))
    away, cut_off = camera((0, -2, 0), (0, -4, 0)), camera((0, -1, 0), (0.62, 0, 0))
    index, (left, top, side) = best_view([hidden, far, near, away, cut_off], np.array([0, 1]), Tracer(mesh))
    assert index == 2
    centre = near.project(near.local(np.zeros((1, 3))))[0]
    assert left < centre[0] < left + side and top < centre[1] < top + side
    assert side == pytest.approx(2.5 * 0.2 / 2 * 250, rel=0.15)
    assert best_view([hidden, away], np.array([0, 1]), Tracer(mesh)) is None


def test_a_lamp_at_the_border_of_a_photo_is_cut_within_it():
    mesh = Mesh(square(0.0), np.array([[0, 1, 2], [0, 2, 3]]))
    _, (left, top, side) = best_view([camera((0, -2, 0), (1.1, 0, 0.75))], np.array([0, 1]), Tracer(mesh))
    assert left >= 0 and top >= 0 and left + side <= 320 and top + side <= 240
