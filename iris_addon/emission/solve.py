"""Find the lamps and their radiance: candidates, balance, and the test again under the light just found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..progress import Progress
from ..response.radiance import GroupRadiance
from ..surface.build import Surface
from ..surface.samples import PixelSamples
from ..transport.gather import emitter_form_factors
from ..transport.tracer import Tracer
from ..transport.transport import ESCAPED, Transport
from .balance import Evidence, solve_balance
from .candidates import (
    Brightness,
    emitting_faces,
    group_emitters,
    reflectance_needed,
    tie_fixtures,
    whole_parts,
)
from .hidden import HiddenSources

OUTSIDE_GAIN = 0.02
OPEN_SHARE = 0.15
NEGLIGIBLE_POWER = 2e-4
HYSTERESIS = 0.8
THRESHOLDS = (3.0, 1.6, 1.25)
"""Reflectance needed at which a face counts as a lamp, round by round, from the certain ones down."""


@dataclass(frozen=True)
class Lights:
    """Emitters and the light they cast.

    Attributes:
        emitters: faces of each.
        radiance: (E, 3).
        hidden_radiance: (H, 3) of the hidden sources (unseen parts, then directions of outside light).
        log_std: (E,) uncertainty of log radiance.
        form_factors: (N, E) ``B`` for all patches, seen and unseen.
        mask: (F,) bool, faces that emit.
        irradiance: (N, 3) irradiance / pi of every patch, all light.
        patch_radiance: (N, 3) reflected radiance of every patch, observed or inferred.
        part_albedo: albedo per part id, from the balance.
        held_out: robust loss of the balance on patches it was not fitted to.
    """

    emitters: list[NDArray[np.int64]]
    radiance: NDArray[np.float64]
    hidden_radiance: NDArray[np.float64]
    log_std: NDArray[np.float64]
    form_factors: NDArray[np.float32]
    mask: NDArray[np.bool_]
    irradiance: NDArray[np.floating]
    patch_radiance: NDArray[np.float64]
    part_albedo: dict[int, NDArray[np.float64]] = field(default_factory=dict)
    held_out: float = np.inf

    def arrays(self) -> dict[str, NDArray]:
        """Plain arrays for a checkpoint."""
        names = ("radiance", "hidden_radiance", "log_std", "form_factors", "mask", "irradiance", "patch_radiance")
        ids = np.array(list(self.part_albedo), np.int64)
        return {
            "lights.held_out": np.array(self.held_out),
            **{f"lights.{name}": getattr(self, name) for name in names},
            "lights.sizes": np.array([len(faces) for faces in self.emitters], np.int64),
            "lights.faces": np.concatenate([*self.emitters, np.zeros(0, np.int64)]),
            "lights.part_ids": ids,
            "lights.part_albedo": np.array(list(self.part_albedo.values())).reshape(len(ids), 3),
        }

    @staticmethod
    def from_arrays(arrays: dict[str, NDArray]) -> Lights:
        """Inverse of :meth:`arrays`."""
        a = {name.removeprefix("lights."): value for name, value in arrays.items() if name.startswith("lights.")}
        emitters = np.split(a.pop("faces"), np.cumsum(a.pop("sizes")))[:-1]
        albedo = dict(zip(a.pop("part_ids").tolist(), a.pop("part_albedo"), strict=True))
        held_out = float(a.pop("held_out"))
        return Lights(emitters=emitters, part_albedo=albedo, held_out=held_out, **a)

    def face_emission(self, n_faces: int) -> NDArray[np.float64]:
        """(F, 3) radiance each face emits."""
        emission = np.zeros((n_faces, 3))
        for faces, radiance in zip(self.emitters, self.radiance, strict=True):
            emission[faces] = radiance
        return emission


@dataclass(frozen=True)
class LightProblem:
    """All that does not change while lamps are searched for.

    Attributes:
        parts: (F,) part per face.
        adjacency: pairs of faces that share an edge.
        brightness: how bright each seen patch was.
        hidden: unknowns beside the lamps.
        bounce: once materials are known, what glossy surfaces pass on; patches then cast only their diffuse light.
    """

    tracer: Tracer
    samples: PixelSamples
    surface: Surface
    transport: Transport
    parts: NDArray[np.int32]
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]]
    brightness: Brightness
    hidden: HiddenSources
    shadow_rays: int
    seed: int
    bounce: Bounce | None = None


class Bounce(Protocol):
    """Light by way of glossy surfaces, see :mod:`iris_addon.reflectance.glossy_bounce`."""

    def gather_radiance(
        self, radiance: NDArray[np.floating], unknown: NDArray[np.floating], emitter_faces: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """(N, 3) irradiance / pi from other patches."""
        ...

    def form_factors(self, emitters: Sequence[NDArray[np.integer]], n_faces: int) -> NDArray[np.float32]:
        """(N, E) share of each emitter's radiance."""
        ...


def find_lights(problem: LightProblem, observed: GroupRadiance, progress: Progress) -> Lights:
    """Search for lamps from nothing: certain ones first, then those that stand out only under their light."""
    lights = _without_lamps(problem, observed)
    for threshold in THRESHOLDS:
        emitters = _candidates(problem, lights, threshold)
        if threshold == THRESHOLDS[0] or not same_emitters(emitters, lights.emitters):
            lights = solve_lights(problem, observed, emitters, lights, progress)
    return _without_negligible(problem, observed, lights, progress)


def choose_outside(problem: LightProblem, observed: GroupRadiance, progress: Progress) -> tuple[LightProblem, Lights]:
    """Lamps, with as much light from outside the mesh as earns its place: none, constant, or by direction.

    Each hypothesis is scored by the light balance of patches that it was not fitted to. The next larger one is taken
    only if it lowers that score by OUTSIDE_GAIN.
    """
    directions = len(problem.hidden.directions)
    best: tuple[LightProblem, Lights] | None = None
    # A mesh with large holes is not a closed room: without outside light everything in it would seem to glow.
    is_open = float((problem.transport.target == ESCAPED).mean()) > OPEN_SHARE
    for count in sorted({min(1, directions), directions} | (set() if is_open else {0})):
        tried = replace(problem, hidden=problem.hidden.with_directions(count))
        if best is None:
            lights = find_lights(tried, observed, progress)
        else:
            start = replace(best[1], hidden_radiance=_expected_hidden(tried, best[1]))
            lights = solve_lights(tried, observed, start.emitters, start, progress, start.form_factors)
        if best is None or lights.held_out < (1 - OUTSIDE_GAIN) * best[1].held_out:
            best = tried, lights
    assert best is not None
    return best


def _expected_hidden(problem: LightProblem, lights: Lights) -> NDArray[np.float64]:
    """(H, 3) radiance expected of the hidden sources: what was found for parts, a dim room for directions."""
    parts = lights.hidden_radiance[: len(problem.hidden.parts)]
    dim = _mean_radiance(lights.patch_radiance, problem)
    return np.concatenate([parts, np.tile(dim, (len(problem.hidden.directions), 1))])


def refine_lights(
    problem: LightProblem,
    observed: GroupRadiance,
    lights: Lights,
    weight: NDArray[np.float64],
    diffuse: NDArray[np.float64],
    progress: Progress,
) -> Lights:
    """Test and solve the lamps again, now that gloss is known.

    Args:
        weight: (P,) say of each seen patch.
        diffuse: (P, 3) radiance without its specular part.
    """
    emitters = _candidates(problem, lights, THRESHOLDS[-1])
    known = {faces.tobytes(): k for k, faces in enumerate(lights.emitters)}
    columns = [known.get(faces.tobytes(), -1) for faces in emitters]
    fresh = [faces for faces, k in zip(emitters, columns, strict=True) if k < 0]
    factors = np.empty((problem.transport.n_patches, len(emitters)), np.float32)
    traced = _form_factors(problem, fresh, progress)
    at = 0
    for index, k in enumerate(columns):
        factors[:, index] = lights.form_factors[:, k] if k >= 0 else traced[:, at]
        at += k < 0
    return solve_lights(problem, observed, emitters, lights, progress, factors, weight, diffuse)


def _candidates(problem: LightProblem, lights: Lights, threshold: float) -> list[NDArray[np.int64]]:
    """Lamps at one threshold under the light known so far."""
    n = problem.transport.n_seen
    needed = reflectance_needed(problem.brightness, lights.irradiance[:n])
    # What already counts as a lamp stays one unless the light found since explains it away.
    needed = np.where(_patches_on(problem, lights.mask)[:n], needed / HYSTERESIS, needed)
    patch, face, n_faces = problem.surface.sample_patch, problem.samples.face, len(problem.parts)
    emitting, count = emitting_faces(needed > threshold, patch, face, n_faces)
    certain, _ = emitting_faces(needed > THRESHOLDS[0], patch, face, n_faces)
    # Dimmer than what the room reflects anyway: unexplained light, but not a lamp.
    level = np.median(lights.irradiance[:n].mean(1))
    emitting &= emitting_faces(problem.brightness.floor.max(1) > level, patch, face, n_faces)[0]
    # A bright region of a part that otherwise reflects is a highlight or a caustic until it is far too bright for one.
    emitting &= certain | whole_parts(emitting, count, problem.parts)[problem.parts]
    return group_emitters(emitting, count, problem.tracer.areas, problem.parts, problem.adjacency)


def _without_negligible(problem: LightProblem, observed: GroupRadiance, lights: Lights, progress: Progress) -> Lights:
    """Leave out the lamps whose light nobody would miss: specks that mixed pixels at the edge of a real lamp make."""
    if not lights.emitters:
        return lights
    power = np.array([problem.tracer.areas[f].sum() for f in lights.emitters]) * lights.radiance.mean(1)
    kept = power > NEGLIGIBLE_POWER * power.sum()
    if kept.all():
        return lights
    emitters = [faces for faces, keep in zip(lights.emitters, kept, strict=True) if keep]
    return solve_lights(problem, observed, emitters, lights, progress, lights.form_factors[:, kept])


def same_emitters(a: list[NDArray[np.int64]], b: list[NDArray[np.int64]]) -> bool:
    """Whether two lists name the same lamps."""
    return len(a) == len(b) and all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


def solve_lights(
    problem: LightProblem,
    observed: GroupRadiance,
    emitters: list[NDArray[np.int64]],
    before: Lights,
    progress: Progress,
    form_factors: NDArray[np.float32] | None = None,
    weight: NDArray[np.float64] | None = None,
    diffuse: NDArray[np.float64] | None = None,
) -> Lights:
    """Radiance of given emitters.

    Args:
        observed: radiance of the seen patches, which is what they cast on others.
        before: lights of the previous pass, for the light that unseen patches reflect.
        form_factors: ``B`` when it is already known for these emitters.
        weight: (P,) say of each seen patch; by default the pixels behind it.
        diffuse: (P, 3) radiance without its specular part, once materials are known.
    """
    if not emitters and not len(before.hidden_radiance):
        return before
    n_faces = len(problem.parts)
    mask = np.zeros(n_faces, bool)
    for faces in emitters:
        mask[faces] = True
    if form_factors is None:
        form_factors = _form_factors(problem, emitters, progress)
    hidden = problem.hidden
    on_lamp = _patches_on(problem, mask)
    dark = on_lamp | hidden.on_hidden
    radiance = _start_radiance(observed, before, dark)
    evidence = _with_hidden(_lamp_evidence(problem, emitters), before.hidden_radiance)
    direct = form_factors
    if problem.bounce is not None:
        direct = form_factors + problem.bounce.form_factors(emitters, n_faces)
    all_factors = np.concatenate([direct, hidden.form_factors], 1)
    start = np.maximum(_first_finite(evidence.measured, 2.0 * evidence.bound, evidence.expected), 1e-3)
    usable = observed.known.all(1) & ~on_lamp[: problem.transport.n_seen]
    say = usable * (np.sqrt(np.minimum(observed.weight, 50.0)) if weight is None else weight)
    n = problem.transport.n_seen
    for _ in range(2):
        unknown = _mean_radiance(radiance, problem)
        indirect = problem.transport.gather_radiance(radiance, unknown, mask)
        if problem.bounce is not None:
            indirect = indirect + problem.bounce.gather_radiance(radiance, unknown, mask)
        shaded = radiance[:n] if diffuse is None else diffuse
        balance = solve_balance(shaded, indirect[:n], all_factors[:n], problem.transport.part[:n], say, evidence, start)
        start = balance.radiance
        irradiance = indirect + all_factors @ balance.radiance
        albedo = dict(zip(balance.part_ids.tolist(), balance.part_albedo, strict=True))
        radiance = _infer_unseen(problem, observed, radiance, irradiance, albedo, dark)
    lamps = len(emitters)
    return Lights(
        emitters,
        balance.radiance[:lamps],
        balance.radiance[lamps:],
        balance.log_std[:lamps],
        form_factors,
        mask,
        irradiance,
        radiance,
        albedo,
        balance.held_out,
    )


def _first_finite(*choices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Element-wise first choice that is finite and positive."""
    result = choices[-1]
    for choice in reversed(choices[:-1]):
        result = np.where(np.isfinite(choice) & (choice > 0), choice, result)
    return np.nan_to_num(result)


def _with_hidden(lamps: Evidence, expected: NDArray[np.float64]) -> Evidence:
    """Evidence on lamps and hidden sources together; nobody saw the latter, so they only have an expectation."""
    n, h = len(lamps.tie), len(expected)
    nothing = np.full((h, 3), np.nan)
    first_free = int(lamps.tie.max()) + 1 if n else 0
    return Evidence(
        np.concatenate([lamps.bound, np.zeros((h, 3))]),
        np.concatenate([lamps.measured, nothing]),
        np.concatenate([lamps.tie, first_free + np.arange(h)]),
        np.concatenate([lamps.expected, expected]),
    )


def _without_lamps(problem: LightProblem, observed: GroupRadiance) -> Lights:
    """The first guess of irradiance: everything glows as it was seen, lamps included."""
    n = problem.transport.n_patches
    radiance = np.zeros((n, 3))
    radiance[: len(observed.radiance)] = observed.radiance
    unknown = _mean_radiance(radiance, problem)
    radiance[len(observed.radiance) :] = unknown
    none = np.zeros(len(problem.parts), bool)
    hidden = np.tile(unknown, (problem.hidden.form_factors.shape[1], 1))
    irradiance = problem.transport.gather_radiance(radiance, unknown, none) + problem.hidden.form_factors @ hidden
    return Lights([], np.zeros((0, 3)), hidden, np.zeros(0), np.zeros((n, 0), np.float32), none, irradiance, radiance)


def _form_factors(problem: LightProblem, emitters: list[NDArray[np.int64]], progress: Progress) -> NDArray[np.float32]:
    rng = np.random.default_rng([problem.seed, 17])
    t = problem.transport
    samples = int(np.clip(problem.shadow_rays // max(1, len(emitters)), 6, 64))
    seen = emitter_form_factors(problem.tracer, t.origins, t.rays, emitters, samples, rng, progress)
    unseen = emitter_form_factors(
        problem.tracer, t.unseen_origins, t.unseen_rays, emitters, max(4, samples // 4), rng, progress
    )
    return np.concatenate([seen, unseen])


def _lamp_evidence(problem: LightProblem, emitters: list[NDArray[np.int64]]) -> Evidence:
    """Bounds and measurements per lamp, medians over the pixels on it."""
    seen, face, patch = problem.brightness, problem.samples.face, problem.surface.sample_patch
    label = np.full(len(problem.parts), -1)
    for index, faces in enumerate(emitters):
        label[faces] = index
    on_lamp = np.flatnonzero(label[face] >= 0)
    order = on_lamp[np.argsort(label[face[on_lamp]], kind="stable")]
    pieces = np.split(patch[order], np.cumsum(np.bincount(label[face[order]], minlength=len(emitters)))[:-1])
    bound = np.zeros((len(emitters), 3))
    measured = np.full((len(emitters), 3), np.nan)
    for index, piece in enumerate(pieces[: len(emitters)]):
        bound[index] = np.median(seen.bound[piece], axis=0)
        for channel in range(3):
            # An open pixel below what others saw clipped is the lamp's edge.
            values = seen.measured[piece, channel]
            open_ = values >= 0.98 * bound[index, channel]
            if open_.mean() > 0.3:
                measured[index, channel] = np.median(values[open_])
    return Evidence(bound, measured, tie_fixtures(emitters, problem.tracer.areas), np.full_like(bound, np.nan))


def _patches_on(problem: LightProblem, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(N,) patches that lie on emitting faces."""
    on = np.zeros(problem.transport.n_patches, bool)
    share = np.bincount(problem.surface.sample_patch, mask[problem.samples.face], problem.transport.n_seen)
    on[: problem.transport.n_seen] = share > 0.5 * problem.surface.count
    return on


def _start_radiance(observed: GroupRadiance, before: Lights, on_lamp: NDArray[np.bool_]) -> NDArray[np.float64]:
    radiance = before.patch_radiance.copy()
    radiance[: len(observed.radiance)] = observed.radiance
    radiance[on_lamp] = 0.0
    return radiance


def _mean_radiance(radiance: NDArray[np.float64], problem: LightProblem) -> NDArray[np.float64]:
    """(3,) stand-in for surfaces that have no patch: the mean of what is seen, darkened as hidden places are."""
    return 0.7 * np.median(radiance[: problem.transport.n_seen], axis=0)


def _infer_unseen(
    problem: LightProblem,
    observed: GroupRadiance,
    radiance: NDArray[np.float64],
    irradiance: NDArray[np.float64],
    albedo: dict[int, NDArray[np.float64]],
    on_lamp: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """Radiance of patches without an observation: the albedo of their part times the irradiance at them."""
    typical = np.median(np.stack(list(albedo.values())), axis=0) if albedo else np.full(3, 0.5)
    table = np.tile(np.clip(typical, 0.05, 0.9), (int(problem.parts.max()) + 1, 1))
    for part, value in albedo.items():
        table[part] = np.clip(value, 0.0, 0.95)
    inferred = table[problem.transport.part] * irradiance
    result = radiance.copy()
    n = problem.transport.n_seen
    result[n:] = inferred[n:]
    # A clipped patch reflects at least its bound and about what its part does.
    clipped = ~observed.known
    result[:n] = np.where(clipped, np.maximum(observed.bound, inferred[:n]), result[:n])
    result[on_lamp] = 0.0
    return result
