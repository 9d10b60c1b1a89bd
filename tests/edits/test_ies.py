"""Photometric files of lamps whose intensity has a closed form."""

import numpy as np
import pytest
import trimesh

from iris_addon.edits.ies import HORIZONTAL, VERTICAL, ies_file, seen_areas, total_flux
from iris_addon.model.capture import Mesh
from iris_addon.model.lamp_profile import LampProfile
from iris_addon.rays.tracer import Tracer


def hits(*meshes: Mesh):
    """Distances along rays to the first of some meshes."""
    tracers = [Tracer(mesh) for mesh in meshes]
    return lambda o, d: np.min([tracer.closest(o, d).distance for tracer in tracers], axis=0)


def square(z: float, side: float = 0.6, at: tuple[float, float] = (0.0, 0.0)) -> Mesh:
    half = side / 2
    corners = np.array([[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]]) + [*at, 0]
    return Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))


def areas(lamp: Mesh, *others: Mesh, profile: LampProfile | None = None) -> np.ndarray:
    return seen_areas(lamp.vertices[lamp.faces], hits(lamp, *others), hits(lamp), profile)


def read(text: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[float]]:
    """Angles and candela (V, H) of a file, and the numbers of its two lines of facts."""
    assert text.startswith("IESNA:LM-63-2002\r\n") and max(map(len, text.split("\r\n"))) < 256
    numbers = [float(word) for word in text.split("TILT=NONE")[1].split()]
    facts, numbers = numbers[:13], numbers[13:]
    v, h = int(facts[3]), int(facts[4])
    vertical, horizontal, rest = numbers[:v], numbers[v : v + h], numbers[v + h :]
    assert len(rest) == v * h
    return np.array(vertical), np.array(horizontal), np.array(rest).reshape(h, v).T, facts


def integral(vertical, horizontal, candela) -> float:
    """Lumens by another way than ours: a dense grid."""
    t, p = np.radians(np.arange(0.25, 180, 0.5)), np.arange(0.5, 360, 1)
    by_h = np.array([np.interp(np.degrees(t), vertical, column) for column in candela.T])
    dense = np.array([np.interp(p, horizontal, column) for column in by_h.T])
    return float((dense * np.sin(t)[:, None]).sum() * np.radians(0.5) * np.radians(1))


def test_a_panel_under_the_ceiling_is_lamberts_law_to_one_side():
    found = areas(square(2.48), square(2.5, 4.0))
    expected = 0.36 * np.maximum(np.cos(np.radians(VERTICAL)), 0)
    np.testing.assert_allclose(found, np.repeat(expected[:, None], len(HORIZONTAL), 1), atol=1e-9)
    assert total_flux(found) == pytest.approx(np.pi * 0.36, rel=0.003), "π · area for radiance 1"


def test_a_spot_sends_its_profile_and_as_much_light_as_an_even_lamp():
    spot = LampProfile.of(np.array([1, 0.8, 0.4, 0.1, 0.02, 0.01]))
    found = areas(square(2.48), square(2.5, 4.0), profile=spot)
    down = np.cos(np.radians(VERTICAL))
    expected = 0.36 * np.maximum(down, 0) * spot.at(down)
    np.testing.assert_allclose(found, np.repeat(expected[:, None], len(HORIZONTAL), 1), atol=1e-9)
    assert total_flux(found) == pytest.approx(np.pi * 0.36, rel=0.005)


def test_a_hanging_panel_shines_to_both_sides_and_a_ball_to_all():
    assert total_flux(areas(square(1.5), square(2.5, 4.0))) == pytest.approx(2 * np.pi * 0.36, rel=0.003)
    ball = trimesh.creation.icosphere(3, radius=0.1)
    found = areas(Mesh(ball.vertices, ball.faces))
    np.testing.assert_allclose(found[1:-1].mean(), np.pi * 0.1**2, rtol=0.02)
    assert np.ptp(found) < 0.25 * found.mean(), "as large from everywhere"


def test_a_lamp_hides_parts_of_itself():
    """Two panels one above the other: the upper one's light down is held off by the lower one, but for the rim."""
    both = Mesh(
        np.concatenate([square(1.0).vertices, square(1.1).vertices]),
        np.concatenate([square(1.0).faces, square(1.1).faces + 4]),
    )
    found = areas(both)
    assert found[0, 0] == pytest.approx(0.36, rel=0.01), "straight down one sees the lower one alone"
    assert found[-1, 0] == pytest.approx(0.36, rel=0.01)


def test_the_compass_of_the_file_is_that_of_the_room():
    """A panel on a wall, facing +x, and one facing +y."""
    for turn, peak in ((0, 0.0), (1, 90.0)):
        flat = square(0.0)
        upright = flat.vertices[:, [2, 0, 1]] + [0.02, 0, 1.5]
        wall = square(0.0, 6).vertices[:, [2, 0, 1]] + [0, 0, 1.5]
        if turn:
            upright, wall = (np.stack([-points[:, 1], points[:, 0], points[:, 2]], -1) for points in (upright, wall))
        found = areas(Mesh(upright, flat.faces), Mesh(wall, flat.faces))
        level = found[list(VERTICAL).index(90.0)]
        assert HORIZONTAL[np.argmax(level[:-1])] == peak and level.max() == pytest.approx(0.36, rel=1e-6)
        assert level[(list(HORIZONTAL).index(peak) + 12) % 24] == 0


@pytest.mark.parametrize("lumens", [3.0, 800.0, 12_345.0])
def test_the_file_integrates_to_the_lumens_of_the_lamp(lumens):
    text = ies_file(areas(square(2.48), square(2.5, 4.0)), lumens, np.array([0.6, 0.6, 0.0]), "Küche — lamp\n1")
    vertical, horizontal, candela, facts = read(text)
    assert integral(vertical, horizontal, candela) == pytest.approx(lumens, rel=2e-3)
    assert candela[0, 0] == pytest.approx(lumens / np.pi, rel=5e-3), "of Lambert's law"
    assert facts[:3] == [1, -1, 1] and facts[5:10] == [1, 2, 0.6, 0.6, 0] and facts[10:] == [1, 1, 0]
    assert text.isascii() and text.index("TILT") > text.index("[LUMCAT] K?che")
    assert (vertical[0], vertical[-1], horizontal[0], horizontal[-1]) == (0, 180, 0, 360)


def test_a_lamp_that_sends_nothing_is_refused():
    with pytest.raises(ValueError, match="sends no light"):
        ies_file(np.zeros((len(VERTICAL), len(HORIZONTAL))), 800, np.zeros(3), "dark")
