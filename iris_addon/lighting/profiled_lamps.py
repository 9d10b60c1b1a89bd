"""Lamps with a profile: spots, shades and shielded panels, which do not shine alike in all directions.

The light balance gives a lamp one radiance. One with a profile is, to the balance, six lamps in one place, each of
which shines at one of PROFILE_DEGREES to its normal and fades out to the next. They are solved for together with what
photos show of the lamp itself from each angle, for all lamps that bring a share of the light at once. A lamp keeps its
profile if the held-out loss of the light balance, solved with it, falls by enough.
"""

from __future__ import annotations

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
from .lamp_evidence import lamp_of_patch, with_hidden
from .lamp_radiance import PatchFit, fitted_shading, patches_on, solve_lights
from .problem import LightProblem, Lights
from .screens import Shown

MIN_SHARE = 0.02
"""Share of the light at the seen patches that a lamp brings, below which it is not asked for a profile."""
MAX_ASKED = 8
"""Lamps that are asked at most, the brightest."""
SHADOW_RAYS = 64
"""Shadow rays from a patch to a lamp that is asked: few directions at each angle would be noise."""
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
    asked = [_Asked(int(k), _form_factors(problem, lights.emitters[k])) for k in _brightest(problem, lights)]
    if not asked:
        return lights

    def solved(before: Lights) -> Lights:
        factors = before.form_factors
        return solve_lights(problem, observed, before.emitters, before, progress, factors, fit, warm_start=True)

    even = lights
    for lamp in asked:
        even = lamp.under(even, LampProfile(EVEN_PROFILE), lights.radiance[lamp.number])
    even = solved(even)
    fitted = even
    for lamp, found in zip(asked, _fitted_profiles(problem, observed, even, asked, shown, fit), strict=True):
        fitted = lamp.under(fitted, *found)
    best = solved(fitted)
    together, error = f"{len(asked)} lamps together", even.paired_error(best)
    if not decisions.accept("lamp_profile", even.held_out, best.held_out, error, subject=together):
        return lights if lights.profiles is None else even
    for lamp in reversed(asked) if len(asked) > 1 else ():
        without = solved(lamp.under(best, LampProfile(EVEN_PROFILE), best.radiance[lamp.number]))
        error, subject = without.paired_error(best), f"lamp {lamp.number}"
        if not decisions.accept("lamp_profile", without.held_out, best.held_out, error, subject=subject):
            best = without
    return best


@dataclass(frozen=True)
class _Asked:
    """A lamp that is asked for a profile.

    Attributes:
        number: among the emitters.
        columns: (N, 6, 2) its form factors where it shines at one of PROFILE_DEGREES alone.
    """

    number: int
    columns: NDArray[np.float32]

    def under(self, lights: Lights, profile: LampProfile, radiance: NDArray[np.float64]) -> Lights:
        """``lights`` with that ``profile`` and mean ``radiance`` (3,) of this lamp, as a start."""
        n = len(lights.emitters)
        profiles = np.tile(EVEN_PROFILE, (n, 1)) if lights.profiles is None else lights.profiles.copy()
        factors = lights.form_factors.copy()
        profiles[self.number] = profile.values
        factors[:, self.number] = np.einsum("nks,k->ns", self.columns, profile.values)
        changed = lights.with_radiance(np.array([self.number]), [radiance])
        return replace(changed, profiles=profiles, form_factors=factors)


def _brightest(problem: LightProblem, lights: Lights) -> NDArray[np.int64]:
    """Numbers of the lamps that bring most of the light, but for those with a pattern."""
    seen = problem.transport.n_seen
    direct = under_lobe(lights.form_factors[:seen], problem.transport.kappa[:seen]).mean(0)
    share = direct * (lights.radiance @ LUMINANCE) / max(float((lights.irradiance[:seen] @ LUMINANCE).mean()), 1e-9)
    plain = np.array([problem.pattern_of(faces) is None for faces in lights.emitters])
    order = np.argsort(-share, kind="stable")
    return order[((share >= MIN_SHARE) & plain)[order]][:MAX_ASKED]


def _form_factors(problem: LightProblem, faces: NDArray[np.int64]) -> NDArray[np.float32]:
    """(N, 6, 2) form factors of a lamp that shines at one of PROFILE_DEGREES alone."""
    t, rng = problem.transport, stream(problem.seed, "lighting.profiles")
    seen, unseen = (
        profile_form_factors(problem.tracer, origins, rays, faces, n_samples, rng, profile_basis)
        for origins, rays, n_samples in (
            (t.origins, t.rays, SHADOW_RAYS),
            (t.unseen_origins, t.unseen_rays, SHADOW_RAYS // 4),
        )
    )
    return np.concatenate([seen, unseen])


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
    seen, kappa = problem.transport.n_seen, problem.transport.kappa
    shading = fitted_shading(problem, observed, patches_on(problem, lights.mask), fit)
    if shading is None:
        return [(LampProfile(EVEN_PROFILE), lights.radiance[lamp.number]) for lamp in asked]
    direct = under_lobe(lights.form_factors, kappa)
    if problem.bounce is not None:
        direct += problem.bounce.form_factors(lights.emitters, len(problem.regions))
    outside = under_lobe(problem.hidden.columns, kappa)
    rest = lights.irradiance - direct @ lights.radiance - outside @ lights.hidden_radiance
    numbers = [lamp.number for lamp in asked]
    others = np.setdiff1d(np.arange(len(lights.emitters)), numbers)
    columns = [under_lobe(lamp.columns, kappa) for lamp in asked]
    factors = np.concatenate([*columns, direct[:, others], outside], 1)
    n = len(EVEN_PROFILE)
    of_lamps = np.concatenate([np.repeat(lights.radiance[numbers], n, 0), lights.radiance[others]])
    evidence = with_hidden(_evidence(problem, lights, numbers, of_lamps, shown), lights.hidden_radiance)
    start = np.concatenate([of_lamps, lights.hidden_radiance])
    light = shading.kernel @ rest[:seen], shading.kernel @ factors[:seen].astype(np.float32)
    balance = solve_balance(shading.under(*light), evidence, start, problem.robust_log, warm_start=True)
    by_angle = balance.radiance[: n * len(asked)].reshape(-1, n, 3)
    level = by_angle @ LUMINANCE
    level = np.maximum(level, LEAST_SHARE * (level @ FLUX_SHARES)[:, None] + 1e-9)
    return [(LampProfile.of(each), FLUX_SHARES @ radiance) for each, radiance in zip(level, by_angle, strict=True)]


def _evidence(
    problem: LightProblem, lights: Lights, numbers: list[int], radiance: NDArray[np.float64], shown: Shown
) -> Evidence:
    """What photos show of each of the lamps ``numbers`` at each of PROFILE_DEGREES.

    Args:
        radiance: expected of these, angle by angle, and then of all other lamps.
    """
    bound, measured = np.zeros(radiance.shape), np.full(radiance.shape, np.nan)
    o, linear = shown.observations, shown.linear
    lamp = lamp_of_patch(problem, [lights.emitters[k] for k in numbers])[o.patch]
    nearest = profile_basis(problem.samples.cosine[o.sample]).argmax(-1)
    row = np.where(lamp >= 0, lamp * len(EVEN_PROFILE) + nearest, -1)
    unclipped = linear.unclipped.all(1)
    for k in np.unique(row[row >= 0]):
        measures, bounds = (np.flatnonzero((row == k) & some) for some in (unclipped, ~unclipped))
        if len(measures) > len(bounds):
            measured[k] = np.median(linear.radiance[measures], axis=0)
        else:
            bound[k] = np.median(linear.bound[bounds], axis=0)
    return Evidence(bound=bound, measured=measured, tie=np.arange(len(radiance)), expected=radiance)
