"""Sampling and light transport against closed forms: form factors, white furnace, escaping light."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
import pytest

from iris_addon.base.progress import Progress
from iris_addon.brdf.ggx import specular_integrals
from iris_addon.brdf.ggx_sampling import visible_normal_weights
from iris_addon.lighting.hidden import HiddenSources, dodecahedron, find_hidden, lobes
from iris_addon.model.capture import Mesh
from iris_addon.model.lamp_profile import profile_basis
from iris_addon.model.sphere import sh_basis
from iris_addon.rays.sampling import Origins, cosine_direction, ggx_direction, r2_sequence, tangent_frame
from iris_addon.rays.tracer import Tracer
from iris_addon.transport.form_factors import Pattern, emitter_form_factors, profile_form_factors
from iris_addon.transport.gather import gather
from iris_addon.transport.transport import Transport
from tests.engine_room import SIZE, WALLS, Room, assemble, box, cameras, furnished_room, patched, quad

UP = np.array([0.0, 0.0, 1.0])


def unit_vectors(n: int, seed: int = 0) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def patch_at(point, n: int) -> Origins:
    """The same small patch ``n`` times, facing up: ``n`` independent estimates."""
    position = np.tile(np.asarray(point, np.float32), (n, 1, 1))
    return Origins(position, np.tile(UP.astype(np.float32), (n, 1, 1)))


def form_factors(
    mesh: Mesh,
    emitters: list[np.ndarray],
    origins: Origins,
    n_rays: int,
    n_samples: int,
    seed: int = 3,
    patterns: Mapping[int, Pattern] = MappingProxyType({}),
):
    tracer, rng = Tracer(mesh), np.random.default_rng(seed)
    rays, _ = gather(tracer, origins, n_rays, rng, Progress())
    return emitter_form_factors(tracer, origins, rays, emitters, n_samples, rng, Progress(), patterns)[..., 0]


def corner_to_rectangle(a: float, b: float, h: float) -> float:
    """Differential patch to the parallel a x b rectangle at height h whose corner is above it (Howell, B-3)."""
    x, y = a / h, b / h
    p, q = np.sqrt(1 + x * x), np.sqrt(1 + y * y)
    return (x / p * np.arctan(y / p) + y / q * np.arctan(x / q)) / (2 * np.pi)


# Sampling ------------------------------------------------------------------------------------------------------------


def test_tangent_frames_are_orthonormal_and_right_handed() -> None:
    axes = np.concatenate([np.eye(3), -np.eye(3), [[0, 1e-5, -1]]])
    normal = np.concatenate([unit_vectors(2000), axes / np.linalg.norm(axes, axis=1, keepdims=True)])
    frame = np.array([[*tangent_frame(*n), n] for n in normal])
    assert np.abs(frame @ frame.transpose(0, 2, 1) - np.eye(3)).max() < 1e-3
    assert np.abs(np.cross(frame[:, 0], frame[:, 1]) - normal).max() < 1e-3


def test_cosine_directions_have_the_moments_of_their_density() -> None:
    normal = np.repeat(unit_vectors(50), 400, 0)
    u = np.random.default_rng(1).random((len(normal), 2))
    direction = np.array([cosine_direction(*n, *point) for n, point in zip(normal, u, strict=True)])
    assert np.linalg.norm(direction, axis=1) == pytest.approx(1, abs=2e-3)
    cosine = (direction * normal).sum(1)
    assert cosine.min() > 0
    assert cosine.mean() == pytest.approx(2 / 3, abs=0.006)
    assert (cosine**2).mean() == pytest.approx(1 / 2, abs=0.008)
    mean = direction.reshape(50, 400, 3).mean(1)
    assert np.abs(mean - 2 / 3 * normal[::400]).max() < 0.12


def test_r2_rows_are_spread_evenly_and_differ() -> None:
    points = r2_sequence(20, 256, np.random.default_rng(2))
    assert points.min() >= 0 and points.max() < 1
    quadrants = (points[..., 0] > 0.5) * 2 + (points[..., 1] > 0.5)
    counts = np.stack([(quadrants == k).sum(1) for k in range(4)])
    assert np.abs(counts - 64).max() <= 6  # random points would stray by 20
    assert len(np.unique(points[:, 0, 0])) == 20


@pytest.mark.parametrize("roughness", [0.1, 0.3, 0.7, 1.0])
@pytest.mark.parametrize("cosine", [0.3, 0.7, 1.0])
def test_visible_normals_give_the_directional_albedo_of_the_table(roughness: float, cosine: float) -> None:
    n, alpha = 60_000, roughness**2
    rng = np.random.default_rng(3)
    weights = np.zeros(2)
    for normal in unit_vectors(30, 4):
        tangent, bitangent = np.array(tangent_frame(*normal))
        for angle, *u in rng.random((n // 30, 3)):
            side = np.cos(2 * np.pi * angle) * tangent + np.sin(2 * np.pi * angle) * bitangent
            outgoing = cosine * normal + np.sqrt(1 - cosine**2) * side
            *incoming, half = ggx_direction(tuple(normal), tuple(outgoing), alpha, *u)
            assert np.dot(incoming, incoming) == pytest.approx(1, abs=4e-3)
            weights += visible_normal_weights(np.dot(incoming, normal), half, alpha)
    weights /= n
    f0, f1 = specular_integrals(np.array([roughness]), np.array([cosine]))
    assert weights[0] == pytest.approx(f0[0], abs=0.01)
    assert weights[1] == pytest.approx(f1[0], abs=0.005)


def test_reflection_off_a_smooth_surface_is_a_mirror() -> None:
    outgoing = unit_vectors(100, 6)
    outgoing[:, 2] = np.abs(outgoing[:, 2]) + 0.2
    outgoing /= np.linalg.norm(outgoing, axis=1, keepdims=True)
    u = np.random.default_rng(7).random((100, 2))
    incoming = [ggx_direction(tuple(UP), tuple(o), 1e-4, *point)[:3] for o, point in zip(outgoing, u, strict=True)]
    assert np.array(incoming) == pytest.approx(outgoing * [-1, -1, 1], abs=5e-3)


# Form factors --------------------------------------------------------------------------------------------------------

ESTIMATORS = [(8, 4), (128, 4), (8, 96), (64, 64)]
"""Gather rays and shadow rays: whichever of both does the work, the mean must be the same."""


@pytest.mark.parametrize(("n_rays", "n_samples"), ESTIMATORS)
def test_parallel_unit_squares(n_rays: int, n_samples: int) -> None:
    mesh = assemble([quad([0, 0, 1], [1, 0, 0], [0, 1, 0])], [0])
    rng = np.random.default_rng(8)
    position = np.concatenate([rng.random((3000, 8, 2)), np.zeros((3000, 8, 1))], -1).astype(np.float32)
    origins = Origins(position, np.broadcast_to(UP.astype(np.float32), position.shape))
    factors = form_factors(mesh, [np.arange(2)], origins, n_rays, n_samples)
    assert factors.mean() == pytest.approx(0.199825, rel=0.01)


@pytest.mark.parametrize(("n_rays", "n_samples"), ESTIMATORS)
@pytest.mark.parametrize(("a", "b", "h"), [(1.0, 1.0, 1.0), (4.0, 0.5, 0.5), (0.1, 0.1, 2.0)])
def test_patch_under_the_corner_of_a_rectangle(a: float, b: float, h: float, n_rays: int, n_samples: int) -> None:
    mesh = assemble([quad([0, 0, h], [a, 0, 0], [0, b, 0])], [0])
    factors = form_factors(mesh, [np.arange(2)], patch_at([0, 0, 0], 3000), n_rays, n_samples)
    error = factors.std() / np.sqrt(len(factors))
    assert abs(factors.mean() - corner_to_rectangle(a, b, h)) < 4 * error + 0.005 * corner_to_rectangle(a, b, h)
    assert error < 0.02 * corner_to_rectangle(a, b, h)


@pytest.mark.parametrize(("n_rays", "n_samples"), [(256, 1), (1, 128), (48, 48)])
def test_a_lamp_shines_with_its_pattern_however_it_is_found(n_rays: int, n_samples: int) -> None:
    """A window that is dark at one half and twice as bright at the other, by gather rays, by shadow rays, and both."""
    a, b, h = 1.2, 0.8, 0.6
    mesh = assemble([quad([0, 0, h], [a, 0, 0], [0, b, 0])], [0])
    patch, lamp = patch_at([0, 0, 0], 3000), [np.arange(2)]

    def bright(points):
        return np.where(points[:, 0] > a / 2, 2.0, 0.0).astype(np.float32)

    found = form_factors(mesh, lamp, patch, n_rays, n_samples, patterns={0: bright})
    expected = 2 * (corner_to_rectangle(a, b, h) - corner_to_rectangle(a / 2, b, h))
    assert found.mean() == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize(("n_rays", "n_samples"), [(256, 1), (1, 128), (48, 48)])
def test_a_lamp_shines_by_the_angle_to_its_normal_however_it_is_found(n_rays: int, n_samples: int) -> None:
    """A disc whose radiance is the square of the cosine, on its axis: of c² over the disc, c = h / √(h² + r²), the form
    factor is ½ (1 − (h² / (h² + R²))²)."""
    radius, height, n = 0.7, 1.3, 96
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    rim = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(n, height)])
    fan = np.column_stack([np.full(n, n), np.arange(n), (np.arange(n) + 1) % n])
    mesh = Mesh(np.concatenate([rim, [[0, 0, height]]]), fan)
    tracer, patch, rng = Tracer(mesh), patch_at([0, 0, 0], 1500), np.random.default_rng(3)
    rays, _ = gather(tracer, patch, n_rays, rng, Progress())
    factors = profile_form_factors(
        tracer, patch, rays, np.arange(n), n_samples, rng, lambda cosine: np.square(cosine)[:, None]
    )[:, 0, 0]
    expected = 0.5 * (1 - (height**2 / (height**2 + radius**2)) ** 2)
    assert factors.mean() == pytest.approx(expected, rel=0.01)


def test_the_parts_of_a_profile_add_up_to_an_even_lamp() -> None:
    mesh = assemble([quad([-0.5, -0.5, 0.8], [1, 0, 0], [0, 1, 0])], [0])
    tracer, patch = Tracer(mesh), patch_at([0.4, 0.1, 0], 50)
    rays, _ = gather(tracer, patch, 16, np.random.default_rng(1), Progress())
    of_all = [profile_basis, lambda cosine: np.ones((len(cosine), 1))]
    parts, even = (
        profile_form_factors(tracer, patch, rays, np.arange(2), 32, np.random.default_rng(2), profiles)
        for profiles in of_all
    )
    np.testing.assert_allclose(parts.sum(1), even[:, 0], rtol=1e-5)
    assert (parts.mean(0) > 0).all(1).sum() >= 3, "the lamp is seen at several angles"


def test_patch_under_the_centre_of_a_disc() -> None:
    radius, height, n = 0.7, 1.3, 96
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    rim = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(n, height)])
    fan = np.column_stack([np.full(n, n), np.arange(n), (np.arange(n) + 1) % n])
    mesh = Mesh(np.concatenate([rim, [[0, 0, height]]]), fan)
    factors = form_factors(mesh, [np.arange(n)], patch_at([0, 0, 0], 1500), 32, 32)
    assert factors.mean() == pytest.approx(radius**2 / (radius**2 + height**2), rel=0.01)


def test_emitters_add_up() -> None:
    mesh = assemble([quad([-1, -1, 1], [2, 0, 0], [0, 2, 0])], [0])
    origins = patch_at([0.2, -0.3, 0], 2000)
    halves = form_factors(mesh, [np.array([0]), np.array([1])], origins, 32, 32)
    whole = form_factors(mesh, [np.array([0, 1])], origins, 32, 32)
    assert halves.sum(1).mean() == pytest.approx(whole.mean(), rel=0.01)


@pytest.mark.parametrize(("n_rays", "n_samples"), ESTIMATORS)
def test_an_occluder_takes_half(n_rays: int, n_samples: int) -> None:
    lamp = quad([-1, -0.5, 1], [2, 0, 0], [0, 1, 0])
    screen = quad([-3, -3, 0.5], [3, 0, 0], [0, 6, 0])  # everything with x < 0
    origins = patch_at([0, 0, 0], 3000)
    free = form_factors(assemble([lamp], [0]), [np.arange(2)], origins, n_rays, n_samples)
    screened = form_factors(assemble([lamp, screen], [0, 1]), [np.arange(2)], origins, n_rays, n_samples)
    assert screened.mean() / free.mean() == pytest.approx(0.5, abs=0.01)


def test_a_lamp_that_touches_the_patch_does_not_blow_up() -> None:
    """A wall lamp that stands on the floor: close to it the form factor tends to 1/2, area sampling alone to 1/0."""
    mesh = assemble([quad([0, -1, 0], [0, 2, 0], [0, 0, 1])], [0])
    for distance in (1e-5, 1e-3, 0.1):
        # Perpendicular rectangles that share an edge, patch on the axis: two corner forms (Howell, B-5).
        b, c = 1.0, 1.0
        reach = np.sqrt(c * c + distance**2)
        expected = (np.arctan(b / distance) - distance / reach * np.arctan(b / reach)) / np.pi
        factors = form_factors(mesh, [np.arange(2)], patch_at([distance, 0, 0], 1500), 64, 16)
        assert np.isfinite(factors).all() and factors.max() < 1
        assert factors.mean() == pytest.approx(expected, rel=0.03)


def test_a_patch_on_the_lamp_or_in_its_plane_gets_nothing_from_it() -> None:
    mesh = assemble([quad([0, 0, 0], [1, 0, 0], [0, 1, 0])], [0])
    for point in ([0.5, 0.5, 0], [2, 2, 0]):
        assert form_factors(mesh, [np.arange(2)], patch_at(point, 50), 16, 16).max() == 0


# Whole rooms ---------------------------------------------------------------------------------------------------------


def transport_of(room: Room, n_rays: int = 96) -> tuple[Tracer, Transport]:
    seen = patched(room, cameras(), 3000, n_rays, seed=9)
    return seen.tracer, seen.transport


def test_white_furnace() -> None:
    """In a closed room where everything glows alike, every patch receives just that, whichever way it is counted."""
    tracer, transport = transport_of(furnished_room(np.inf))
    everywhere = np.tile([1.0, 2.0, 3.0], (transport.n_patches, 1))
    none = np.zeros(len(tracer.areas), bool)
    gathered = transport.gather_radiance(everywhere, everywhere[0], none)
    assert transport.escaped().max() == 0
    assert gathered == pytest.approx(everywhere, rel=1e-5)


def test_what_photos_leave_out_is_the_light_that_it_would_send() -> None:
    """Where only what no photo shows glows, what photos show receives just the share of it; fewer photos leave more."""
    room, shares = furnished_room(np.inf), []
    for count in (8, 2, 1):
        seen = patched(room, cameras(8)[:count], 3000, 96, seed=9)
        transport, none = seen.transport, np.zeros(len(seen.tracer.areas), bool)
        unseen = np.arange(transport.n_patches) >= transport.n_seen
        received = transport.gather_radiance(np.tile(unseen[:, None], 3) * 1.0, np.ones(3), none)[: transport.n_seen]
        assert transport.unseen() == pytest.approx(received.mean(), rel=1e-5)
        shares.append(transport.unseen())
    assert shares[0] < 0.2 < 0.4 < shares[2] and shares == sorted(shares)


def test_lamps_and_walls_share_the_furnace() -> None:
    room = furnished_room(np.inf)
    tracer, transport = transport_of(room)
    lamps = room.lamps()
    mask = np.isin(np.arange(len(tracer.areas)), np.concatenate(lamps))
    ones = np.ones((transport.n_patches, 3))
    walls = transport.gather_radiance(ones, ones[0], mask)[: transport.n_seen, 0]
    rng = np.random.default_rng(10)
    direct = emitter_form_factors(tracer, transport.origins, transport.rays, lamps, 64, rng, Progress())[..., 0].sum(1)
    assert (walls + direct).mean() == pytest.approx(1, abs=2e-3)
    assert (walls + direct).std() < 0.03


def test_radiosity_loses_no_energy() -> None:
    """Albedo a everywhere and emission 1: the radiance of a furnace is 1 / (1 - a)."""
    tracer, transport = transport_of(furnished_room(np.inf))
    none, albedo = np.zeros(len(tracer.areas), bool), 0.5
    radiance = np.zeros((transport.n_patches, 3))
    for _ in range(25):
        radiance = 1 + albedo * transport.gather_radiance(radiance, radiance.mean(0), none)
    assert radiance == pytest.approx(np.full_like(radiance, 2.0), rel=1e-4)


@pytest.mark.parametrize("one_region", [False, True])
def test_surfaces_that_no_photo_sees_come_in_the_order_of_the_rays_that_meet_them(one_region: bool) -> None:
    """Ceiling and a box that nobody sees, as regions of their own and as components of a single region."""
    room = furnished_room(np.inf)
    tracer, transport = transport_of(room)
    ceiling, furniture = WALLS.index("ceiling"), 7
    components = room.regions.astype(np.int32)
    seen = ~np.isin(components, [ceiling, furniture])
    rng, regions = np.random.default_rng(0), np.zeros_like(components) if one_region else components
    hidden = find_hidden(tracer, transport, regions, components, seen, rng)
    assert [np.unique(room.regions[faces]).tolist() for faces in hidden.surfaces] == [[ceiling], [furniture]]
    assert find_hidden(tracer, transport, components, components, np.ones_like(seen), rng).surfaces == ()


def test_a_convex_body_in_uniform_light_sees_nothing_but_it() -> None:
    mesh = assemble(box(SIZE / 2 - 0.4, SIZE / 2 + 0.4), [0] * 6)
    tracer, transport = transport_of(Room(mesh, np.zeros((1, 3)), np.zeros((1, 3))))
    assert transport.escaped().min() == 1
    n_faces = len(mesh.faces)
    one = np.zeros(n_faces, np.int32)
    hidden = find_hidden(tracer, transport, one, one, np.ones(n_faces, bool), np.random.default_rng(0))
    assert len(hidden.directions) == 12
    light = np.tile([0.7, 0.8, 0.9], (12, 1))
    irradiance = hidden.form_factors[..., 0] @ light
    assert irradiance == pytest.approx(np.tile(light[0], (transport.n_patches, 1)), rel=1e-4)  # directions are halves
    sh = hidden.outside_sh(light)
    assert sh is not None
    assert sh[0] * 0.28209479 == pytest.approx(light[0], rel=1e-6)
    assert np.abs(sh[1:]).max() < 1e-6
    nothing = np.zeros((transport.n_patches, 3))
    dark = transport.gather_radiance(nothing, np.ones(3), np.zeros(len(tracer.areas), bool))
    assert dark.max() == 0


def test_light_from_outside_is_the_same_in_the_balance_and_in_cycles() -> None:
    """The lobes of the balance, and the harmonics that the result hands on, along any direction; none is negative."""
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(500, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    brightness = rng.uniform(0, 5, (12, 3)) ** 2
    sources = HiddenSources((), dodecahedron(), np.zeros((0, 12, 2), np.float32))
    sh = sources.outside_sh(brightness)
    assert sh is not None
    radiance = lobes(direction, dodecahedron()) @ brightness
    assert sh_basis(direction) @ sh == pytest.approx(radiance, rel=1e-9)
    assert radiance.min() > 0
    assert lobes(direction, dodecahedron()).sum(1) == pytest.approx(np.ones(500), rel=1e-12)


def test_unseen_patches_gather_from_points_that_rays_met() -> None:
    """One point of a cell of 32 cm says little: half of it may lie in the shade."""
    transport = patched(furnished_room(), cameras(3, 20, 15), 800, 64).transport
    met = np.bincount(transport.target[transport.target >= transport.n_seen] - transport.n_seen)
    often = np.flatnonzero(met >= 16)
    origins, grid = transport.unseen_origins, transport.grid
    assert len(often) > 100
    k = origins.position.shape[1]
    region = np.repeat(transport.region[transport.n_seen :][often], k)
    patch = grid.patches(origins.position[often].reshape(-1, 3), origins.normal[often].reshape(-1, 3), region)
    np.testing.assert_array_equal(patch, np.repeat(often + transport.n_seen, k))
    reach = np.ptp(origins.position[often], axis=1).max(1)
    assert np.median(reach) > 0.15 and all(len(np.unique(points, axis=0)) == k for points in origins.position[often])
