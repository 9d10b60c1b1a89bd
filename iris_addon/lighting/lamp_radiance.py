"""The radiance of given lamps: the light balance, and the light that unseen surfaces pass on."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from ..base.progress import Progress
from ..base.random_streams import stream
from ..brdf.diffuse import under_lobe
from ..response.radiance import GroupRadiance
from ..transport.form_factors import emitter_form_factors
from .balance import (
    ITERATIONS,
    MAX_ALBEDO,
    Balance,
    ShadedPatches,
    fitted_patches,
    noticeable_radiance,
)
from .joint_balance import BalanceInput, solve_joined
from .lamp_evidence import columns_of, lamp_evidence, with_hidden
from .problem import LightProblem, Lights
from .sun import Sun

SEARCH_SHADOW_RAYS, SHADOW_RAYS = (6, 13), (13, 64)
"""Fewest and most shadow rays from a patch to a lamp, in the search and for the lamps that were found. Noise here makes
lamps too dim and walls too white."""
BALANCE_SMOOTHING = 1.0
"""Standard deviation, in patch sizes, of the kernel that averages neighbours for the light balance. Without it the
noise of rays makes direct light look less reliable than indirect light, lamps too dim and walls too white."""
NORMAL_SENSITIVITY = 0.5
"""Change of log irradiance per sine of the error of a normal, for light from one side as order 1 of spherical harmonics
describes it, E (1 + NORMAL_SENSITIVITY cos)."""
FIRST_ITERATIONS = 20
"""Iterations of the first light balance, after which the light that unseen surfaces pass on is found anew."""


@dataclass(frozen=True)
class PatchFit:
    """How the P seen patches enter the light balance.

    Attributes:
        weight: (P,) statistical weight, by default :func:`patch_weight`.
        diffuse: (P, 3) radiance without its specular part, once materials are known; by default that observed.
        fit_mask: (P,) bool, patches that are fitted, by default all; the others only average noise out.
    """

    weight: NDArray[np.float64] | None = None
    diffuse: NDArray[np.float64] | None = None
    fit_mask: NDArray[np.bool_] | None = None


def solve_lights(
    problem: LightProblem,
    observed: GroupRadiance,
    emitters: list[NDArray[np.int64]],
    before: Lights,
    progress: Progress,
    form_factors: NDArray[np.float32] | None = None,
    fit: PatchFit = PatchFit(),
    warm_start: bool = False,
) -> Lights:
    """Radiance of given emitters, and the irradiance (1) of all patches under it.

    Args:
        observed: radiance of the seen patches, which is what they cast on others.
        emitters: faces of each.
        before: lights of the previous pass, for the light that unseen patches reflect.
        form_factors: (N, E, 2) ``B`` if already known for these emitters.
        fit: how patches enter the balance.
        warm_start: whether the light is close to that of ``before``, so that one pass from there is enough.

    Returns:
        The lights; ``before`` where there is nothing to solve for or no patch to fit.
    """
    state = LitState(
        problem=problem, observed=observed, emitters=emitters, before=before, form_factors=form_factors, fit=fit
    )
    return solve_together([state], progress, warm_start)[0]


@dataclass(frozen=True)
class LitState:
    """What the light of one light state is solved from, as the arguments of :func:`solve_lights`.

    Attributes:
        numbers: (E,) of the emitters among the lamps of the room, which have one radiance in all states; None where
            they have their own in each.
    """

    problem: LightProblem
    observed: GroupRadiance
    emitters: list[NDArray[np.int64]]
    before: Lights
    form_factors: NDArray[np.float32] | None = None
    fit: PatchFit = PatchFit()
    numbers: NDArray[np.int64] | None = None


def solve_together(states: Sequence[LitState], progress: Progress, warm_start: bool = False) -> list[Lights]:
    """:func:`solve_lights` of the light states of one room, under one albedo per region.

    Each state has lamps, radiance and patches of its own; what a region reflects is the same in all.

    Returns:
        The lights of each state, with the held-out loss of its own patches.
    """
    solving = [_solving(state, progress, warm_start) for state in states]
    at = [_advanced(each, None) for each in solving]
    for from_solution in (True,) if warm_start else (False, True):
        posed = {k: each for k, each in enumerate(at) if isinstance(each, BalanceInput)}
        if not posed:
            break
        iterations = ITERATIONS if from_solution else FIRST_ITERATIONS
        balances = solve_joined([*posed.values()], states[0].problem.robust_log, from_solution, iterations)
        for k, balance in zip(posed, balances, strict=True):
            at[k] = _advanced(solving[k], balance)
    return [each for each in at if isinstance(each, Lights)]


Solving = Generator[BalanceInput, Balance | None, Lights]
"""Hands out what is to be balanced, takes the balance, and returns the lights in the end."""


def _advanced(solving: Solving, balance: Balance | None) -> BalanceInput | Lights:
    """What ``solving`` hands out, or returns, once it has the ``balance`` of what it handed out before."""
    try:
        return solving.send(balance)
    except StopIteration as ended:
        return ended.value


def _solving(state: LitState, progress: Progress, warm_start: bool) -> Solving:
    """The light of one state, from one balance if that starts from a solution, else from two."""
    problem, observed, emitters, before = state.problem, state.observed, state.emitters, state.before
    if not emitters and not len(before.hidden_radiance):
        return _without_lamps(problem, observed, before)
    n_faces = len(problem.regions)
    mask = np.zeros(n_faces, bool)
    for faces in emitters:
        mask[faces] = True
    form_factors = state.form_factors
    if form_factors is None:
        form_factors = form_factors_of(problem, emitters, progress)
    hidden = problem.hidden
    on_lamp = patches_on(problem, mask)
    was_lamp = patches_on(problem, before.mask) if warm_start else None
    radiance = _start_radiance(problem, observed, before, on_lamp, was_lamp)
    radiance[problem.transport.n_seen :] *= _light_kept(problem, before, emitters)[problem.transport.n_seen :]
    evidence = with_hidden(lamp_evidence(problem, emitters, before), before.hidden_radiance)
    kappa = problem.transport.kappa
    direct = under_lobe(form_factors, kappa)
    if problem.bounce is not None:
        direct += problem.bounce.form_factors(emitters, n_faces)
    all_factors = np.concatenate([direct, under_lobe(hidden.columns, kappa)], 1)
    level = noticeable_radiance(observed.radiance, all_factors[: problem.transport.n_seen])
    start = _first_finite(evidence.measured, evidence.expected, level)
    if warm_start:
        known = columns_of(emitters, before.emitters)
        start[np.flatnonzero(known >= 0)] = before.radiance[known[known >= 0]]
    n = problem.transport.n_seen
    fitted = fitted_shading(problem, observed, on_lamp, state.fit)
    if fitted is None:
        return before if emitters else _without_lamps(problem, observed, before)
    kernel, rows = fitted.kernel, fitted.rows
    smooth_factors = kernel @ all_factors[:n].astype(np.float32)
    albedo = before.region_albedo
    for _ in range(1 if warm_start else 2):
        unknown = mean_radiance(radiance, problem)
        factors, smooth, cast, passed_on = all_factors, smooth_factors, radiance, None
        if hidden.sun is not None and problem.sunlight_passed_on:
            sunlit = _sunlit(problem, observed, on_lamp, albedo, all_factors[:, -1])
            passed_on = _gathered(problem, np.repeat(sunlit.mean(1, keepdims=True), 3, axis=1), np.zeros(3), mask)[:, 0]
            factors, smooth = all_factors.copy(), smooth_factors.copy()
            factors[:, -1] += passed_on
            smooth[:, -1] += kernel @ passed_on[:n]
            cast = np.maximum(radiance, sunlit * start[-1])
        indirect = _gathered(problem, cast, unknown, mask)
        if passed_on is not None:  # the sun's column has it
            indirect = indirect - passed_on[:, None] * start[-1]
        if hidden.holes is not None:
            indirect = indirect + hidden.holes.irradiance(kappa)
        patches = fitted.under(kernel @ indirect[:n], smooth)
        balance = yield BalanceInput(patches=patches, evidence=evidence, start=start, lamps=state.numbers)
        assert balance is not None
        start = balance.radiance
        irradiance = indirect + factors @ balance.radiance
        albedo = dict(zip(balance.region_ids.tolist(), balance.region_albedo, strict=True))
        radiance = _infer_unseen(problem, observed, radiance, irradiance, albedo, on_lamp)
    lamps = len(emitters)
    return Lights(
        emitters=emitters,
        radiance=balance.radiance[:lamps],
        hidden_radiance=balance.radiance[lamps:],
        log_std=balance.log_std[:lamps],
        form_factors=form_factors,
        mask=mask,
        irradiance=irradiance,
        patch_radiance=radiance,
        region_albedo=albedo,
        held_out=balance.held_out,
        losses=replace(balance.losses, observation=rows[balance.losses.observation]),
        profiles=before.profiles_of(emitters),
        apart=before.apart_of(emitters),
    )


def _without_lamps(problem: LightProblem, observed: GroupRadiance, before: Lights) -> Lights:
    """The light of a state that has no lamps, ``before`` where that has none either."""
    return lights_without_lamps(problem, observed) if before.emitters else before


@dataclass(frozen=True)
class FittedShading:
    """The m patches that enter the light balance, averaged with their neighbours.

    Both sides of L = a (I + B e) are averaged over neighbours of one albedo alike, so that the balance still holds.

    Attributes:
        rows: (m,) their indices.
        kernel: (m, P) what averages.
        radiance, bounded: (m, 3) of :class:`ShadedPatches`.
        region, weight: (m,) of these.
    """

    rows: NDArray[np.int64]
    kernel: csr_matrix
    radiance: NDArray[np.floating]
    bounded: NDArray[np.bool_]
    region: NDArray[np.integer]
    weight: NDArray[np.float64]

    def under(self, indirect: NDArray[np.floating], form_factors: NDArray[np.floating]) -> ShadedPatches:
        """The same with their light, averaged too: ``indirect`` (m, 3) and ``form_factors`` (m, E)."""
        return ShadedPatches(
            radiance=self.radiance,
            bounded=self.bounded,
            indirect=indirect,
            form_factors=form_factors,
            region=self.region,
            weight=self.weight,
        )


def fitted_shading(
    problem: LightProblem, observed: GroupRadiance, on_lamp: NDArray[np.bool_], fit: PatchFit
) -> FittedShading | None:
    """The patches that enter the light balance; None if there are none.

    Args:
        on_lamp: (N,) patches on emitters.
    """
    n = problem.transport.n_seen
    bounded = ~observed.known & (observed.bound > 0) & problem.clipped_counts
    usable = (observed.known | bounded).all(1) & ~on_lamp[:n]
    if problem.hidden.sun is not None:
        usable &= ~half_shown(problem, observed, problem.hidden.sun)
    weight = usable * (patch_weight(problem, observed) if fit.weight is None else fit.weight)
    shaded = observed.radiance if fit.diffuse is None else fit.diffuse
    region = problem.transport.region
    rows = fitted_patches(shaded, weight if fit.fit_mask is None else weight * fit.fit_mask, bounded)
    if not len(rows):
        return None
    # Patches that clip are averaged among themselves: the mean of a measurement and a bound is no measurement.
    group = 2 * region[:n] + bounded.any(1)
    kernel = problem.field.kernel(BALANCE_SMOOTHING, rows, np.where(weight > 0, group, -1))
    return FittedShading(
        rows=rows,
        kernel=kernel,
        radiance=kernel @ shaded[:n].astype(np.float32),
        bounded=kernel @ bounded.astype(np.float32) > 0,
        region=region[rows],
        weight=weight[rows],
    )


def patch_weight(problem: LightProblem, observed: GroupRadiance) -> NDArray[np.float64]:
    """(P,) weight of each seen patch in the light balance, equation (19): by its pixels and the spread of its normals.

    On folds, leaves and noisy scans normals differ from point to point, and so does the irradiance. That is an error in
    a regressor of equation (18), which makes lamps too dim; flat patches do not have it.
    """
    off = NORMAL_SENSITIVITY * problem.surface.spread / problem.robust_log
    return np.sqrt(np.minimum(observed.weight, 50.0)) / (1 + off**2)


def _first_finite(*choices: NDArray[np.float64]) -> NDArray[np.float64]:
    """The first of the choices that is finite and positive, element by element; the last one where none is."""
    result = choices[-1]
    for choice in reversed(choices[:-1]):
        result = np.where(np.isfinite(choice) & (choice > 0), choice, result)
    return np.nan_to_num(result)


def lights_without_lamps(problem: LightProblem, observed: GroupRadiance) -> Lights:
    """The first guess of the light: every patch casts the radiance that was seen, lamps included."""
    n = problem.transport.n_patches
    radiance = np.zeros((n, 3))
    radiance[: len(observed.radiance)] = observed.radiance
    unknown = mean_radiance(radiance[: len(observed.radiance)][problem.shown], problem)
    radiance[len(observed.radiance) :] = unknown
    radiance[: len(observed.radiance)][~problem.shown] = unknown
    none = np.zeros(len(problem.regions), bool)
    hidden = problem.hidden.start(unknown)
    irradiance = problem.transport.gather_radiance(radiance, unknown, none)
    irradiance = irradiance + problem.hidden.irradiance(hidden, problem.transport.kappa)
    no_factors = np.zeros((n, 0, 2), np.float32)
    return Lights(
        emitters=[],
        radiance=np.zeros((0, 3)),
        hidden_radiance=hidden,
        log_std=np.zeros(0),
        form_factors=no_factors,
        mask=none,
        irradiance=irradiance,
        patch_radiance=radiance,
    )


def form_factors_of(
    problem: LightProblem,
    emitters: list[NDArray[np.int64]],
    progress: Progress,
    limits: tuple[int, int] = SHADOW_RAYS,
    known: Lights | None = None,
) -> NDArray[np.float32]:
    """(N, E, 2) form factors of lamps at all patches, seen and unseen.

    Args:
        limits: fewest and most shadow rays from a patch to a lamp; between them lamps share the budget evenly.
        known: lights from which the form factors of lamps among ``emitters`` are reused.
    """
    patterns = [problem.pattern_of(faces) for faces in emitters]
    columns = columns_of(emitters, known.emitters) if known else np.full(len(emitters), -1)
    columns[[pattern is not None for pattern in patterns]] = -1
    fresh = np.flatnonzero(columns < 0)
    lamps = [emitters[k] for k in fresh]
    shares = {n: pattern.at for n, k in enumerate(fresh) if (pattern := patterns[k]) is not None}
    rng = stream(problem.seed, "lighting.shadow_rays")
    t = problem.transport
    samples = int(np.clip(problem.shadow_rays // max(1, len(emitters)), *limits))
    seen = emitter_form_factors(problem.tracer, t.origins, t.rays, lamps, samples, rng, progress, shares)
    unseen = emitter_form_factors(
        problem.tracer, t.unseen_origins, t.unseen_rays, lamps, max(4, samples // 4), rng, progress, shares
    )
    traced = np.concatenate([seen, unseen])
    if known is None:
        return traced
    factors = np.empty((t.n_patches, len(emitters), 2), np.float32)
    factors[:, fresh] = traced
    factors[:, columns >= 0] = known.form_factors[:, columns[columns >= 0]]
    return factors


def patches_on(problem: LightProblem, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(N,) patches that lie on emitting faces."""
    on = np.zeros(problem.transport.n_patches, bool)
    pixels = problem.surface.sample_patch[mask[problem.samples.face]]
    count = np.bincount(pixels, minlength=problem.transport.n_seen)
    on[: problem.transport.n_seen] = count > 0.5 * problem.surface.count
    return on


def _start_radiance(
    problem: LightProblem,
    observed: GroupRadiance,
    before: Lights,
    on_lamp: NDArray[np.bool_],
    was_lamp: NDArray[np.bool_] | None,
) -> NDArray[np.float64]:
    """(N, 3) radiance that patches cast at the start.

    Args:
        on_lamp: (N,) patches on emitters, which reflect nothing.
        was_lamp: (N,) patches on the emitters of ``before``: with it only these take their observed radiance, and all
            others that of ``before``. None: all shown patches take their observed radiance.
    """
    n = len(observed.radiance)
    radiance = before.patch_radiance.copy()
    known = problem.shown if was_lamp is None else was_lamp[:n]
    radiance[:n][known] = observed.radiance[known]
    radiance[on_lamp] = 0.0
    return radiance


def _light_kept(problem: LightProblem, before: Lights, emitters: list[NDArray[np.int64]]) -> NDArray[np.float64]:
    """(N, 3) share of the light of ``before`` at each patch that remains without the lamps that were dropped."""
    lost = np.flatnonzero(columns_of(before.emitters, emitters) < 0)
    direct = under_lobe(before.form_factors[:, lost], problem.transport.kappa) @ before.radiance[lost]
    return np.clip(1 - direct / np.maximum(before.irradiance, 1e-9), 0.0, 1.0)


def mean_radiance(radiance: NDArray[np.float64], problem: LightProblem) -> NDArray[np.float64]:
    """(3,) stand-in for the radiance of surfaces without a patch: the median of the seen ones, darkened by 0.7 because
    hidden places are darker."""
    return 0.7 * np.median(radiance[: problem.transport.n_seen], axis=0)


def _infer_unseen(
    problem: LightProblem,
    observed: GroupRadiance,
    radiance: NDArray[np.float64],
    irradiance: NDArray[np.float64],
    albedo: dict[int, NDArray[np.float64]],
    on_lamp: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """(N, 3) radiance with that of unobserved patches inferred from ``irradiance`` (N, 3) and their region's albedo."""
    inferred = _albedo_table(problem, albedo) * irradiance
    result = radiance.copy()
    n = problem.transport.n_seen
    result[n:] = inferred[n:]
    # A clipped patch reflects at least its bound, and about as much as its region.
    result[:n] = np.where(_measured(problem, observed), result[:n], np.maximum(observed.radiance, inferred[:n]))
    result[on_lamp] = 0.0
    return result


def _albedo_table(problem: LightProblem, albedo: dict[int, NDArray[np.float64]]) -> NDArray[np.float64]:
    """(N, 3) albedo of each patch: that of its region, or a typical one."""
    typical = np.median(np.stack(list(albedo.values())), axis=0) if albedo else np.full(3, 0.5)
    table = np.tile(np.clip(typical, 0.05, 0.9), (int(problem.regions.max()) + 1, 1))
    for region, value in albedo.items():
        table[region] = np.clip(value, 0.0, MAX_ALBEDO)
    return table[problem.transport.region]


def _gathered(
    problem: LightProblem, radiance: NDArray[np.floating], unknown: NDArray[np.floating], mask: NDArray[np.bool_]
) -> NDArray[np.floating]:
    """(N, 3) irradiance / pi by the radiance (N, 3) of patches, and (3,) of surfaces without one, but for lamps."""
    gathered = problem.transport.gather_radiance(radiance, unknown, mask)
    for more in (problem.bounce, problem.aimed):
        if more is not None:
            gathered = gathered + more.gather_radiance(radiance, unknown, mask)
    return gathered


# ---- Sunlight that clips --------------------------------------------------------------------------------------------


def half_shown(problem: LightProblem, observed: GroupRadiance, sun: Sun) -> NDArray[np.bool_]:
    """(P,) patches on a border of the light of ``sun`` where it clips, too dark in what photos measure of them.

    Those beside a patch that clips are among them, because the balance averages neighbours.
    """
    return sun.border & _clips(problem, observed)[problem.field.neighbours].any(1)


def _sunlit(
    problem: LightProblem,
    observed: GroupRadiance,
    on_lamp: NDArray[np.bool_],
    albedo: dict[int, NDArray[np.float64]],
    direct: NDArray[np.floating],
) -> NDArray[np.floating]:
    """(N, 3) radiance of patches under a sun of unit irradiance, where no photo measures it.

    Args:
        direct: (N,) irradiance / pi of each under that sun.
    """
    n = len(observed.known)
    inferred = np.ones((problem.transport.n_patches, 3), bool)
    inferred[:n] = ~_measured(problem, observed)
    inferred[on_lamp] = False
    return inferred * _albedo_table(problem, albedo) * direct[:, None]


def _measured(problem: LightProblem, observed: GroupRadiance) -> NDArray[np.bool_]:
    """(P, 3) patches whose radiance photos measure: of those that sunlight covers in part, where it clips, photos
    measure only the darker part."""
    sun = problem.hidden.sun
    return observed.known if sun is None else observed.known & ~(sun.border & _clips(problem, observed))[:, None]


def _clips(problem: LightProblem, observed: GroupRadiance) -> NDArray[np.bool_]:
    """(P,) patches of which something clips in a photo, brighter than what others measure."""
    return (~observed.known | (observed.bound > observed.radiance)).any(1) & problem.shown
