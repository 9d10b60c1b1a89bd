"""Whether photos that are taken for one light were taken under several: other lamps, or another sky.

Two photos of one place under one light differ by a function of brightness alone, whatever exposure and response; under
two they differ from place to place as well. So photos are grouped by how much their ratios scatter at one brightness,
over every second patch, and the groups are judged on the other patches: within a group photos agree, across any two
they do not. Gloss, wrong poses and noise set photos apart too, but from neighbour to neighbour, not in groups.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from ..base.group_by import MAD
from ..decide import UNLIKE_LIGHT_LEAST_SCATTER, Decisions
from ..model.light_states import LightStates
from ..model.response import LUMINANCE
from . import family
from .clipping import FLAT_SPREAD
from .observations import Observations

MAX_PHOTOS = 48
"""Photos that are compared, evenly over those of a light state."""
MIN_COMMON, BRIGHTNESS_BINS = 40, 6
"""Patches of either half that two photos must share, and groups of equal number by brightness in which these are
compared."""
MAX_GROUPS, MIN_GROUP = 8, 3
"""Groups that photos are divided into at most, and photos of a group that says something."""
MIN_GROUPED = 0.75
"""Share of the photos that are in such groups; where others are left out, what lies between two groups may be."""
MIN_PAIRS = 4
"""Compared pairs of photos that say something, across two groups; within a group each counts from both sides."""
MIN_COMPARED = 0.6
"""Share of the pairs across two groups that show enough in common, over that share within them: two ends of a room
that hardly see each other differ by gloss and by what few patches they share."""
ACROSS, WITHIN = 0.35, 0.65
"""Quantiles of the scatter of pairs: most photos of two lights disagree, also those that look from the same side, and
most of one agree, also those that do not."""
DISPLAY_RANGE = (0.02, 0.98)
"""Display values that are neither noise nor cut off."""
NAMED_PHOTOS = 3
"""Photos of a group that a warning names."""

Floats = NDArray[np.floating]


@dataclass(frozen=True)
class UnlikeLights:
    """Two groups of photos under different light.

    Attributes:
        groups: names of the photos of each.
        across, within: scatter of log luminance between photos of both groups, and of one.
    """

    groups: tuple[tuple[str, ...], tuple[str, ...]]
    across: float
    within: float

    @property
    def warning(self) -> str:
        """What a user should know."""
        one, other = (
            ", ".join(names[:NAMED_PHOTOS]) + (" …" if len(names) > NAMED_PHOTOS else "") for names in self.groups
        )
        return (
            f"photos that are taken for one light seem to show the room under several: {one} and {other} differ by "
            f"{self.across:.0%} from place to place, photos of either group by {self.within:.0%}; if lamps or daylight "
            "changed, give each photo its light_state (docs/formats.md, Light states) or solve those of one light"
        )


def find_unlike_lights(
    observations: Observations, names: Sequence[str], states: LightStates, hdr: bool, decisions: Decisions
) -> list[UnlikeLights]:
    """The groups of photos of one light state that were not taken under one light; one pair per state at most.

    Args:
        names: of the V photos.
        hdr: whether photos are radiance.
        decisions: where it is decided whether two groups have lights of their own.
    """
    found = []
    for state, state_name in enumerate(states.names):
        photos = np.flatnonzero(states.photos(state))
        photos = photos[np.unique(np.linspace(0, len(photos) - 1, MAX_PHOTOS).astype(int))]
        shown = _log_luminance(observations, photos, len(names), hdr)
        best = max(divisions(shown), key=lambda pair: pair.gain, default=None)
        if best is None or best.across < UNLIKE_LIGHT_LEAST_SCATTER:
            continue
        if decisions.accept("unlike_lights", best.across, best.within, subject=state_name):
            one, other = (tuple(names[int(k)] for k in photos[own]) for own in best.groups)
            found.append(UnlikeLights((one, other), best.across, best.within))
    return found


def _log_luminance(o: Observations, photos: NDArray[np.integer], n_photos: int, hdr: bool) -> Floats:
    """(V, P) log luminance of the patches that at least two of ``photos`` (V,) show evenly lit and unclipped, but for
    exposure and response; NaN where one does not show a patch."""
    row = np.full(n_photos, -1)
    row[photos] = np.arange(len(photos))
    usable = (row[o.view] >= 0) & (o.count >= 2) & (o.saturated.max(1) == 0) & (o.black.max(1) == 0)
    if hdr:
        usable &= o.z.min(1) > 0
    else:
        usable &= (o.spread.max(1) < FLAT_SPREAD) & (o.z.min(1) > DISPLAY_RANGE[0]) & (o.z.max(1) < DISPLAY_RANGE[1])
    z = o.z[usable].astype(np.float64)
    # Not by the response that was found: photos of several lights bend it.
    light = z if hdr else family.to_response(family.PRIOR_MEAN[None]).invert(z)
    shown = np.full((len(photos), int(o.patch.max(initial=0)) + 1), np.nan, np.float32)
    shown[row[o.view[usable]], o.patch[usable]] = np.log(np.maximum(light @ LUMINANCE, 1e-9))
    return shown[:, np.isfinite(shown).sum(0) >= 2]


@dataclass(frozen=True)
class _Pair:
    """Two groups of photos, and the scatter across and within."""

    groups: tuple[NDArray[np.intp], NDArray[np.intp]]
    across: float
    within: float

    @property
    def gain(self) -> float:
        """How much of the scatter across is none within: 0 for one light."""
        return 1 - self.within / max(self.across, 1e-9)


def divisions(shown: Floats) -> Iterator[_Pair]:
    """By every number of groups that photos are divided into, the two groups that are least apart."""
    scatter, held_out = (pair_scatter(shown[:, half::2]) for half in (0, 1))
    if np.isfinite(scatter).sum() < 2 * MIN_PAIRS:
        return
    apart = np.where(np.isfinite(scatter), scatter, np.nanmedian(scatter))
    np.fill_diagonal(apart, 0.0)
    tree = linkage(squareform(apart, checks=False), "average")
    for n_groups in range(2, MAX_GROUPS + 1):
        label = fcluster(tree, n_groups, "maxclust")
        groups = [own for k in np.unique(label) if len(own := np.flatnonzero(label == k)) >= MIN_GROUP]
        pairs = []
        for one, other in combinations(groups, 2) if sum(map(len, groups)) >= MIN_GROUPED * len(shown) else ():
            across, *within = (_known(held_out[np.ix_(a, b)]) for a, b in ((one, other), (one, one), (other, other)))
            possible = sum(len(own) * (len(own) - 1) for own in (one, other))
            usual = sum(map(len, within)) / possible
            compared = len(across) >= max(MIN_PAIRS, MIN_COMPARED * usual * len(one) * len(other))
            if compared and min(map(len, within)) >= MIN_PAIRS:
                high = max(float(np.quantile(own, WITHIN)) for own in within)
                pairs.append(_Pair((one, other), float(np.quantile(across, ACROSS)), high))
        if pairs:
            yield min(pairs, key=lambda pair: pair.gain)


def _known(scatter: Floats) -> Floats:
    return scatter[np.isfinite(scatter)]


def pair_scatter(shown: Floats) -> Floats:
    """(V, V) robust standard deviation of the log ratio of two photos over their common patches of one brightness; NaN
    where they have few in common, and of a photo with itself.

    Args:
        shown: (V, P) log luminance, NaN where a photo does not show a patch.
    """
    scatter = np.full((len(shown), len(shown)), np.nan)
    for a, b in combinations(range(len(shown)), 2):
        both = np.isfinite(shown[a]) & np.isfinite(shown[b])
        if both.sum() < MIN_COMMON:
            continue
        ratio, brightness = shown[a, both] - shown[b, both], shown[a, both] + shown[b, both]
        ratio = ratio[np.argsort(brightness, kind="stable")]
        off = np.concatenate([part - np.median(part) for part in np.array_split(ratio, BRIGHTNESS_BINS)])
        scatter[a, b] = scatter[b, a] = MAD * np.median(np.abs(off))
    return scatter
