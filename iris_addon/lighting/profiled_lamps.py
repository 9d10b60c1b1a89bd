"""Lamps with a profile: spots, shades and shielded panels, which do not shine alike in all directions.

The light balance gives a lamp one radiance. One with a profile is, to the balance, six lamps in one place, each of
which shines at one of PROFILE_DEGREES to its normal and fades out to the next. They are solved for together with what
photos show of the lamp itself from each angle, for all lamps that bring a share of the light at once. Copies of one
model share a profile, as they share a radiance. A lamp keeps its profile if the held-out loss of the light balance,
solved with it, falls by enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..base.progress import Progress
from ..base.random_streams import stream
from ..brdf.diffuse import under_lobe
from ..model.lamp_profile import EVEN_PROFILE, FLUX_SHARES, LampProfile, profile_basis
from ..model.response import LUMINANCE
from ..response.radiance import GroupRadiance
from ..transport.form_factors import profile_form_factors
from .balance import Evidence, solve_balance
from .brightness import least_radiance
from .candidates import tie_fixtures
from .lamp_evidence import lamp_evidence, lamp_of_patch, with_hidden
from .lamp_radiance import PatchFit, fitted_shading, patches_on, solve_lights
from .problem import LightProblem, Lights
from .screens import Shown

MIN_SHARE = 0.02
"""Share of the light at the seen patches that a lamp and its copies bring, below which no profile is asked for."""
MAX_ASKED = 8
"""Lamps that are asked at most, the brightest; copies count as one."""
SHADOW_RAYS, LEAST_RAYS = 64, 8
"""Shadow rays from a patch to a lamp that is asked and its copies together, and to each at the least: few directions at
each angle would be noise."""
LEAST_SHARE = 1e-3
"""Radiance of a profile over its mean, at the least."""


def with_profiles(
    problem: LightProblem, observed: GroupRadiance, lights: Lights, shown: Shown, fit: PatchFit, progress: Progress
) -> Lights:
    """``lights`` with the profiles that lamps need, and solved for again under them.

    Profiles that lamps have already are forgotten first: they were found under other materials.

    Args:
        observed, fit: as of :func:`solve_lights`.
    """
    decisions = problem.decisions
    if decisions.forbids("lamp_profile") or not lights.emitters:
        return lights
    asked = [_Asked(numbers, _form_factors(problem, lights, numbers)) for numbers in _brightest(problem, lights)]
    if not asked:
        return lights

    def solved(before: Lights, asked: Sequence[_Asked]) -> Lights:
        free = tuple(lights.emitters[k] for lamp in asked for k in lamp.numbers)
        posed, factors = replace(problem, asked=free), before.form_factors
        return solve_lights(posed, observed, before.emitters, before, progress, factors, fit, warm_start=True)

    even = lights
    for lamp in asked:
        even = lamp.under(even, LampProfile(EVEN_PROFILE), lights.radiance[lamp.numbers[0]])
    even = solved(even, asked)
    fitted = even
    for lamp, found in zip(asked, _fitted_profiles(problem, observed, even, asked, shown, fit), strict=True):
        fitted = lamp.under(fitted, *found)
    best = solved(fitted, asked)
    error = even.paired_error(best)
    if not decisions.accept("lamp_profile", even.held_out, best.held_out, error, subject="all lamps together"):
        return lights if lights.profiles is None else solved(even, ())
    for lamp in reversed(asked) if len(asked) > 1 else ():
        without = solved(lamp.under(best, LampProfile(EVEN_PROFILE), best.radiance[lamp.numbers[0]]), asked)
        error, subject = without.paired_error(best), f"lamp {lamp.numbers[0]}"
        if not decisions.accept("lamp_profile", without.held_out, best.held_out, error, subject=subject):
            best = without
    return solved(best, ())  # lamps that are even after all are as bright as photos show them


@dataclass(frozen=True)
class _Asked:
    """A lamp that is asked for a profile, with its copies.

    Attributes:
        numbers: of the k lamps, among the emitters.
        columns: (k, N, 6, 2) form factors of each where it shines at one of PROFILE_DEGREES alone.
    """

    numbers: NDArray[np.int64]
    columns: NDArray[np.float32]

    def under(self, lights: Lights, profile: LampProfile, radiance: NDArray[np.float64]) -> Lights:
        """``lights`` with that ``profile`` and mean ``radiance`` (3,) of this lamp and its copies, as a start."""
        n = len(lights.emitters)
        profiles = np.tile(EVEN_PROFILE, (n, 1)) if lights.profiles is None else lights.profiles.copy()
        factors = lights.form_factors.copy()
        profiles[self.numbers] = profile.values
        factors[:, self.numbers] = np.einsum("knas,a->nks", self.columns, profile.values)
        changed = lights.with_radiance(self.numbers, [radiance] * len(self.numbers))
        return replace(changed, profiles=profiles, form_factors=factors)


def _brightest(problem: LightProblem, lights: Lights) -> list[NDArray[np.int64]]:
    """Numbers of the lamps that bring most of the light, copies together; and of all that have a profile now."""
    seen = problem.transport.n_seen
    direct = under_lobe(lights.form_factors[:seen], problem.transport.kappa[:seen]).mean(0)
    share = direct * (lights.radiance @ LUMINANCE) / max(float((lights.irradiance[:seen] @ LUMINANCE).mean()), 1e-9)
    label = tie_fixtures(lights.emitters, problem.tracer.areas, lights.apart, problem.tracer.corners)
    share = np.bincount(label, share)
    chosen = np.argsort(-share, kind="stable")[:MAX_ASKED]
    profiled = [label[k] for k, faces in enumerate(lights.emitters) if lights.profile_of(faces) is not None]
    asked = dict.fromkeys([*chosen[share[chosen] >= MIN_SHARE].tolist(), *profiled])
    return [np.flatnonzero(label == each) for each in asked]


def _form_factors(problem: LightProblem, lights: Lights, numbers: NDArray[np.int64]) -> NDArray[np.float32]:
    """(k, N, 6, 2) form factors of lamps that shine at one of PROFILE_DEGREES alone."""
    t, rng = problem.transport, stream(problem.seed, "lighting.profiles")
    rays = max(SHADOW_RAYS // len(numbers), LEAST_RAYS)
    of_patches = (t.origins, t.rays, rays), (t.unseen_origins, t.unseen_rays, max(rays // 4, 4))

    def of_lamp(faces: NDArray[np.int64]) -> NDArray[np.float32]:
        parts = [
            profile_form_factors(problem.tracer, origins, gathered, faces, n_samples, rng, profile_basis)
            for origins, gathered, n_samples in of_patches
        ]
        return np.concatenate(parts)

    return np.stack([of_lamp(lights.emitters[k]) for k in numbers])


def _fitted_profiles(
    problem: LightProblem,
    observed: GroupRadiance,
    lights: Lights,
    asked: list[_Asked],
    shown: Shown,
    fit: PatchFit,
) -> list[tuple[LampProfile, NDArray[np.float64]]]:
    """The profile and mean radiance (3,) of each lamp that is ``asked``, under which the balance holds best.

    Args:
        lights: under which these lamps are even.
    """
    seen, kappa, n = problem.transport.n_seen, problem.transport.kappa, len(EVEN_PROFILE)
    shading = fitted_shading(problem, observed, patches_on(problem, lights.mask), fit)
    if shading is None:
        return [(LampProfile(EVEN_PROFILE), lights.radiance[lamp.numbers[0]]) for lamp in asked]
    numbers = np.concatenate([lamp.numbers for lamp in asked])
    others = np.setdiff1d(np.arange(len(lights.emitters)), numbers)
    direct, outside = under_lobe(lights.form_factors, kappa), under_lobe(problem.hidden.columns, kappa)
    columns = [under_lobe(lamp.columns.sum(0), kappa) for lamp in asked]
    if problem.bounce is not None:  # it is told by the flux of a lamp, whatever its profile
        passed_on = problem.bounce.form_factors(lights.emitters, len(problem.regions))
        direct += passed_on
        for own, lamp in zip(columns, asked, strict=True):
            own += passed_on[:, lamp.numbers].sum(1)[:, None] * FLUX_SHARES
    rest = lights.irradiance - direct @ lights.radiance - outside @ lights.hidden_radiance
    factors = np.concatenate([*columns, direct[:, others], outside], 1)
    of_asked = np.repeat(lights.radiance[[lamp.numbers[0] for lamp in asked]], n, 0)
    of_lamps = _together(
        _by_angle(problem, lights, asked, of_asked, shown),
        lamp_evidence(problem, [lights.emitters[k] for k in others], lights),
    )
    start = np.concatenate([of_asked, lights.radiance[others], lights.hidden_radiance])
    light = shading.kernel @ rest[:seen], shading.kernel @ factors[:seen].astype(np.float32)
    evidence = with_hidden(of_lamps, lights.hidden_radiance)
    balance = solve_balance(shading.under(*light), evidence, start, problem.robust_log, warm_start=True)
    by_angle = balance.radiance[: n * len(asked)].reshape(-1, n, 3)
    level = by_angle @ LUMINANCE
    level = np.maximum(level, LEAST_SHARE * (level @ FLUX_SHARES)[:, None] + 1e-9)
    return [(LampProfile.of(each), FLUX_SHARES @ radiance) for each, radiance in zip(level, by_angle, strict=True)]


def _together(first: Evidence, second: Evidence) -> Evidence:
    """The evidence on two sets of lamps, of which none of one shares a radiance with one of the other."""
    pairs = ((getattr(first, name), getattr(second, name)) for name in ("bound", "measured", "expected"))
    bound, measured, expected = (np.concatenate(pair) for pair in pairs)
    tie = np.concatenate([first.tie, first.tie.max() + 1 + second.tie])
    return Evidence(bound=bound, measured=measured, tie=tie, expected=expected)


def _by_angle(
    problem: LightProblem, lights: Lights, asked: list[_Asked], radiance: NDArray[np.float64], shown: Shown
) -> Evidence:
    """What photos show of each of the lamps ``asked`` at each of PROFILE_DEGREES, of which ``radiance`` is expected."""
    bound, measured = np.zeros(radiance.shape), np.full(radiance.shape, np.nan)
    o, linear = shown.observations, shown.linear
    faces = [np.concatenate([lights.emitters[k] for k in lamp.numbers]) for lamp in asked]
    lamp = lamp_of_patch(problem, faces)[o.patch]
    nearest = profile_basis(problem.samples.cosine[o.sample]).argmax(-1)
    row = np.where(lamp >= 0, lamp * len(EVEN_PROFILE) + nearest, -1)
    unclipped = linear.unclipped.all(1) & problem.inner_cells[o.patch]  # the first cells are the patches
    least = least_radiance(linear, None)
    for k in np.unique(row[row >= 0]):
        measures, bounds = (np.flatnonzero((row == k) & some) for some in (unclipped, ~unclipped))
        if len(measures) > len(bounds):
            measured[k] = np.median(linear.radiance[measures], axis=0)
        else:
            bound[k] = np.median(least[bounds], axis=0)
    return Evidence(bound=bound, measured=measured, tie=np.arange(len(radiance)), expected=radiance)
