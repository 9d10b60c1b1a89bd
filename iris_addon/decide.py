"""Does a larger model earn its place? One rule, and one table of what every refinement has to earn.

A refinement is a part of the model that a scene may do without. It is fitted to some of the data and judged by a loss
over data it was not fitted to, with and without it. The rule (equation (34) of docs/design.md): the larger model is
accepted if

    larger < (1 − share · gain) · smaller − errors · σ

with σ the standard error of the paired difference of the two losses where it is known. ``gain`` and ``errors`` are
those of the row of :data:`REFINEMENTS`; a negative gain accepts a model that explains slightly less, because it has
nothing that is unknown. No other module holds a threshold of this kind.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Refinement:
    """What one part of the model must earn.

    Attributes:
        adds: what the larger model has and the smaller one has not.
        loss: what the two losses measure, and over which data.
        gain: acceptance gain, the relative fall of the loss that it must bring.
        errors: standard errors of the paired difference that it must bring beside.
        experiment: the file of docs/experiments that set the figure.
    """

    adds: str
    loss: str
    gain: float
    errors: float = 0.0
    experiment: str = ""


BALANCE = "robust deviation of log albedo within regions, over every eighth patch, which the balance is not fitted to"
OVERLAP = "disagreement of views in display values, over the fifth of the patches that the curve is not fitted to"

REFINEMENTS: Mapping[str, Refinement] = {
    # ---- cameras
    "cameras": Refinement(
        "focal length, principal point and offset common to all photos",
        "disagreement of photos painted onto the mesh, over pixels beside the fitted ones",
        gain=0.05,
        experiment="0013-are-the-cameras-of-a-scan-right",
    ),
    # Wrong cameras gain 13 % and more; what plain and polished rooms take for better ones loses 50 %.
    "cameras_by_contrast": Refinement(
        'focal length, principal point and offset common to all photos, where "cameras" is accepted too',
        "disagreement of local contrast at points that the corrected cameras see",
        gain=0.05,
        experiment="0145-may-a-plain-room-change-the-focal-length",
    ),
    "poses": Refinement(
        "a pose of its own for each photo",
        "disagreement of local contrast, over the half of the surface points that is not fitted",
        gain=0.2,
        experiment="0038-does-each-photo-need-its-own-pose",
    ),
    # Given poses that are right leave 0.40 to 0.48 of the points worse, such as are 4 mrad off 0.15 to 0.35.
    "poses_of_most": Refinement(
        'a pose of its own for each photo, where "poses" is accepted too',
        "share of the held-out surface points at which photos agree worse, against one in two of chance",
        gain=0.3,
        experiment="0144-do-reflections-move-right-poses",
    ),
    # ---- surface
    # Nothing of it is fitted to photos, which agree 0.1 to 0.5 % better; what is flattened away costs as much and more.
    "scan_surface": Refinement(
        "the smooth surface behind a scan in place of its triangles",
        "disagreement of local contrast between photos, over points behind the same pixels",
        gain=-0.005,
        experiment="0110-what-is-lost-on-scans",
    ),
    # Of a pane a tenth of the loss is left; of what shines, and of small parts in few photos, no less than half.
    "pane": Refinement(
        "a flat part that photos look through, in place of one that they show",
        "robust deviation of log luminance of its pixels from what other photos show there",
        gain=0.6,
        errors=1.0,
        experiment="0121-does-a-photo-look-through-a-pane",
    ),
    # ---- response
    "device_curves": Refinement(
        "a response curve, a gain per channel and local exposure per camera model",
        OVERLAP,
        gain=0.05,
        experiment="0161-do-two-cameras-have-two-curves",
    ),
    "channel_curves": Refinement(
        "a response curve per colour channel", OVERLAP, gain=0.03, experiment="0004-which-family-for-the-response"
    ),
    "local_exposure": Refinement(
        "local tone mapping or vignetting", OVERLAP, gain=0.05, experiment="0042-can-local-tone-mapping-be-undone"
    ),
    "corrected_exposures": Refinement(
        "exposures, then white balance, per photo in place of the recorded ones",
        OVERLAP,
        gain=0.2,
        experiment="0017-can-wrong-recorded-exposures-be-corrected",
    ),
    "white_balance": Refinement(
        "an exposure factor per channel where exposures are unknown",
        "median disagreement of views about log radiance",
        gain=0.1,
        experiment="0017-can-wrong-recorded-exposures-be-corrected",
    ),
    # Photos under three sets of lamps gain 40 %, rooms under one light 16 % at most, few photos of one 20 to 50 %.
    "unlike_lights": Refinement(
        "a light of its own for a group of photos of one light state; nothing is solved so, but it is said",
        "scatter of the ratio of two photos from place to place, over the half of the patches they are not grouped by",
        gain=0.35,
        experiment="0167-do-photos-without-names-show-one-light",
    ),
    # ---- lighting
    "outside_light": Refinement(
        "light from beyond the mesh, constant, then by direction",
        BALANCE,
        gain=0.02,
        experiment="0006-when-is-light-from-outside-modelled",
    ),
    # About twice the standard error: that all light of a room is the same from everywhere was never likely. Beside
    # lamps, directions would make up for what those get wrong.
    "directions_without_lamps": Refinement(
        "light from beyond the mesh by direction, in a room without lamps",
        BALANCE,
        gain=0.0025,
        experiment="0006-when-is-light-from-outside-modelled",
    ),
    # A sun explains 13 to 35 %, other light 0.7 to 2.8 %, on scans 1.7 at most: it saves the search half of its time.
    "sun_candidate": Refinement(
        "a direction of some thousand that is looked at closer as one of the sun",
        "robust deviation of log luminance from what light and albedo without a sun explain, over some patches",
        gain=0.02,
        experiment="0120-where-does-the-sun-stand",
    ),
    # A direction that was chosen out of thousands explains a little of any light: two standard errors beside.
    "sun": Refinement(
        "the sun: parallel light through the openings, in the best of some thousand directions",
        BALANCE,
        gain=0.02,
        errors=2.0,
        experiment="0120-where-does-the-sun-stand",
    ),
    # Fitted light also makes up for shadows that are lost with what the mesh lacks.
    "light_through_holes": Refinement(
        "light through holes as photos show it, of which nothing is unknown, in place of fitted light",
        BALANCE,
        gain=-0.1,
        experiment="0081-is-a-hole-a-wall-that-photos-show",
    ),
    "light_of_unseen": Refinement(
        "light from parts of the backdrop that no photo shows, beside the light that photos show",
        BALANCE,
        gain=0.01,
        errors=1.0,
        experiment="0111-what-lights-a-scan-where-no-photo-looks",
    ),
    "lamp": Refinement(
        "a lamp, or a side of one, that its own pixels do not prove; per stop that it is brighter than they show",
        BALANCE,
        gain=0.005,
        experiment="0032-what-does-choosing-lamps-cost",
    ),
    # No surface is so bright; only where the balance clearly falls without it may the light be wrong instead.
    "bright_lamp": Refinement(
        "a lamp that, left out, would be too bright for the light that reaches it",
        BALANCE,
        gain=-0.02,
        experiment="0111-what-lights-a-scan-where-no-photo-looks",
    ),
    "unconstrained_lamp": Refinement(
        "a lamp where photos say nothing against one: clipped in all, or shown by none",
        BALANCE,
        gain=0.01,
        experiment="0016-are-overexposed-and-rarely-seen-lamps-lost",
    ),
    "unconstrained_lamp_in_place": Refinement(
        "such a lamp in place of lamps that are pieces of it, at no more unknowns",
        BALANCE,
        gain=-0.01,
        experiment="0016-are-overexposed-and-rarely-seen-lamps-lost",
    ),
    "hidden_emitter": Refinement(
        "a surface that no photo shows as a candidate for a lamp: a first look on few patches and rays",
        "robust deviation of log albedo with and without its light, the albedo kept",
        gain=0.01,
        experiment="0047-can-a-lamp-under-its-shade-be-found",
    ),
    # A screen hardly moves the balance; what took the light of a lamp would.
    "screen": Refinement(
        "a surface whose picture changes as a lamp",
        BALANCE,
        gain=-0.005,
        experiment="0068-can-a-changing-picture-tell-a-screen",
    ),
    "lamp_pattern": Refinement(
        "a pattern on a lamp in place of one radiance",
        "robust deviation of log luminance that half of the photos show on it from what the other half shows there",
        gain=0.2,
        errors=2.0,
        experiment="0133-has-a-lamp-a-pattern",
    ),
    # Spots and shielded panels gain 66 to 87 %, even lamps 3 %, and 14 % beside spots whose errors they take over.
    "lamp_profile": Refinement(
        "a profile of a lamp by angle in place of one radiance",
        BALANCE,
        gain=0.1,
        errors=3.0,
        experiment="0136-does-a-lamp-shine-alike-in-all-directions",
    ),
    # Globes at a half of the other gain 25 %, panels of little light 6 to 8 % and two errors; equal lamps, which take
    # over errors of the light, 1.4 % and two errors at most.
    "unlike_copies": Refinement(
        "a radiance of each of several lamps of one model in place of one that they share",
        BALANCE,
        gain=0.03,
        errors=1.0,
        experiment="0171-do-lamps-of-one-model-shine-alike",
    ),
    # A lamp at half its radiance in one state gains 95 %, lamps that are only switched -2 to 1 %.
    "dimmed_lamps": Refinement(
        "a radiance of each lamp in each light state in place of one in all states in which it is on",
        BALANCE,
        gain=0.1,
        errors=3.0,
        experiment="0166-what-do-light-states-tell-together",
    ),
    # ---- materials
    "burley": Refinement(
        "Burley's diffuse lobe in place of Lambert's",
        "disagreement of views about the log brightness of a patch",
        gain=0.02,
        experiment="0011-which-diffuse-lobe",
    ),
    # Losses are negative logs of likelihoods, and the error 1: twelve to one, more than regions of its kind can give.
    "highlights": Refinement(
        "a roughness below 1, as a region and its like show its highlights",
        "how unlikely the share of its highlights that photos show is if they exist, and if not: 0",
        gain=0.0,
        errors=2.5,
        experiment="0135-is-a-predicted-highlight-there",
    ),
    # A region without highlights of its own gains with its like, in proportion: less than this is a like in name only.
    "gloss": Refinement(
        "a roughness below 1 whose highlights are likelier to exist than not",
        "robust residual of view dependence, products of two halves of the reflected rays",
        gain=0.002,
        errors=2.0,
        experiment="0135-is-a-predicted-highlight-there",
    ),
    # Metals bring 0.12 and more, what is none and has a metal's colour 0.08 at most.
    "metal": Refinement(
        "a metal in place of the best dielectric",
        "robust residual of view dependence, products of two halves of the reflected rays",
        gain=0.1,
        experiment="0141-what-tells-a-metal",
    ),
    # Metals whose neighbours say otherwise gain 0.2 and 4.1 errors, what has a metal's colour and is none 0.08 or less,
    # or 3.1 errors.
    "metal_alone": Refinement(
        "a metal in place of the best dielectric, where regions that may be of one material with it disagree",
        "robust residual of view dependence of the region alone",
        gain=0.05,
        errors=3.0,
        experiment="0141-what-tells-a-metal",
    ),
    # Mirrors gain 26 to 29 % of the loss, steel of roughness 0.1 loses 48 %.
    "mirror": Refinement(
        "a mirror in place of a metal of the roughness found",
        "robust deviation of log luminance of its pixels from what photos show directly where their reflection ends",
        gain=0.0,
        errors=2.0,
        experiment="0132-is-a-smooth-metal-a-mirror",
    ),
}
"""Every refinement that held-out losses decide, by name."""

METAL_COLOURS = (0.3, 1.05)
"""Reflectance at normal incidence of the brightest channel of metals, from worn iron to silver, with the error of the
light."""

TOO_BRIGHT_REFLECTANCE = 2.5
"""Reflectance that a lamp would need if it were none, above which it is judged as "bright_lamp", not as "lamp"."""

UNLIKE_LIGHT_LEAST_SCATTER = 0.05
"""Scatter of log luminance between two groups of photos below which it is not asked whether they have one light."""

MAX_NOISE = 0.04
"""Noise of display values above which a report warns of it: photos by a phone have 0.007, three times as noisy ones,
which lose 1 dB, 0.028, and eight times as noisy ones, which lose 15, 0.059 (experiment 0168)."""

MAX_FLATTENED = 0.17
"""Share of patches without any shading in a photo above which a report warns of compression: JPEG of quality 15, which
loses 20 dB, leaves 0.24 to 0.34, of quality 40, which loses 2 dB, 0.12 (experiment 0168)."""

MAX_UNSEEN_LIGHT = 0.2
"""Share of the light paths from what photos show that end on surfaces that no photo shows, above which a report warns
of it: captures of whole rooms have 0.04 to 0.15, six photos of half a room 0.25 (experiment 0143)."""

PANE_LEAST_LOSS = 0.3
"""Loss of a flat part that shows the same in all photos below which it is not asked whether it is a pane."""

LISTED = 40
"""Decisions of one refinement up to which report.json lists each."""


@dataclass(frozen=True)
class Decision:
    """One answer, with the two losses behind it.

    Attributes:
        refinement: its row in :data:`REFINEMENTS`.
        smaller, larger: held-out loss without and with it.
        error: standard error of their paired difference, 0 where it is not known.
        accepted: whether the larger model stands.
        forced: whether the configuration said so, whatever the losses say.
        subject: what it is about where a refinement is decided more than once, such as a lamp or a region.
    """

    refinement: str
    smaller: float
    larger: float
    error: float
    accepted: bool
    forced: bool = False
    subject: str = ""


def accept(name: str, smaller: float, larger: float, error: float = 0.0, share: float = 1.0) -> bool:
    """Whether the larger model of refinement ``name`` earns its place.

    Args:
        smaller, larger: held-out loss without and with it, in the same unit. NaN or infinite losses of the larger
            model are refused.
        error: standard error of the paired difference, see :func:`paired_error`.
        share: factor on the acceptance gain, where more is asked of some subjects than of others.

    Example:
        >>> accept("burley", smaller=1.0, larger=0.9)
        True
        >>> accept("burley", smaller=1.0, larger=0.99)
        False
    """
    row = REFINEMENTS[name]
    return bool(larger < (1.0 - share * row.gain) * smaller - row.errors * error)


def share_of_rise(name: str, times: float = 1.0) -> float:
    """The ``share`` of :func:`accept` with which the loss has to rise by ``times`` the gain without the refinement.

    A rise of r is a fall of r / (1 + r) of the larger loss.
    """
    return times / (1.0 + times * REFINEMENTS[name].gain)


def paired_error(smaller: NDArray[np.floating], larger: NDArray[np.floating], weight: NDArray[np.floating]) -> float:
    """Standard error of the weighted mean of ``larger - smaller``, the losses (n,) of the same n held-out observations.

    The losses of one observation under two models have its noise in common, so that their difference is known far
    better than either (the paired test of Student 1908).
    """
    norm = float(weight.sum())
    if norm <= 0:
        return 0.0
    difference = larger - smaller
    off = weight * (difference - float(weight @ difference) / norm)
    return float(np.sqrt(off @ off)) / norm


@dataclass(frozen=True)
class HeldOutLosses:
    """Losses of n held-out observations under one model.

    Attributes:
        observation: (n,) what each is a loss of, the same number under any model.
        loss, weight: (n,) of each; the held-out loss is their weighted mean.
        independent: observations that err independently, at most: neighbouring patches err together.
    """

    observation: NDArray[np.integer]
    loss: NDArray[np.floating]
    weight: NDArray[np.floating]
    independent: int

    @staticmethod
    def none() -> HeldOutLosses:
        """Of a model that no observation was held out from."""
        return HeldOutLosses(np.zeros(0, np.int64), np.zeros(0), np.zeros(0), 1)

    def paired_error(self, larger: HeldOutLosses) -> float:
        """:func:`paired_error` over the observations that both have; 0 where they have none in common."""
        common, here, there = np.intersect1d(self.observation, larger.observation, return_indices=True)
        if not len(common):
            return 0.0
        error = paired_error(self.loss[here], larger.loss[there], self.weight[here])
        return error * float(np.sqrt(len(common) / min(len(common), self.independent)))


class Decisions:
    """What a solve decided, in order, and what its configuration decided for it.

    Args:
        forced: refinements that the configuration forces (True) or forbids (False), by name; names that are no row of
            the table stand for parts of the model that no losses decide.
    """

    def __init__(self, forced: Mapping[str, bool | None] | None = None) -> None:
        self._forced = {name: value for name, value in (forced or {}).items() if value is not None}
        self._made: list[Decision] = []

    def forces(self, name: str) -> bool:
        """Whether ``name`` is taken whatever it earns."""
        return self._forced.get(name) is True

    def forbids(self, name: str) -> bool:
        """Whether ``name`` is left out, so that it need not be tried."""
        return self._forced.get(name) is False

    def accept(
        self, name: str, smaller: float, larger: float, error: float = 0.0, share: float = 1.0, subject: str = ""
    ) -> bool:
        """:func:`accept`, unless the configuration decides; written down either way."""
        forced = self._forced.get(name)
        accepted = accept(name, smaller, larger, error, share) if forced is None else forced
        self._made.append(
            Decision(
                refinement=name,
                smaller=float(smaller),
                larger=float(larger),
                error=float(error),
                accepted=accepted,
                forced=forced is not None,
                subject=subject,
            )
        )
        return accepted

    def report(self) -> list[dict[str, Any]]:
        """For report.json: decisions with their two losses and what was needed, in the order they were made.

        A refinement decided for more than :data:`LISTED` subjects, as gloss is for the regions of a scan, has one entry
        with their number and their mean losses.
        """
        entries: list[dict[str, Any]] = []
        for name in dict.fromkeys(made.refinement for made in self._made):
            row, made = REFINEMENTS[name], [each for each in self._made if each.refinement == name]
            needed = {"gain_needed": row.gain, "errors_needed": row.errors}
            if len(made) <= LISTED:
                entries += [{**asdict(each), **needed} for each in made]
                continue
            losses = np.array([(each.smaller, each.larger, each.error) for each in made])
            means = dict(zip(("smaller", "larger", "error"), losses.mean(0).tolist(), strict=True))
            accepted = sum(each.accepted for each in made)
            entries.append({"refinement": name, "subjects": len(made), "accepted": accepted, **means, **needed})
        return entries

    def array(self) -> NDArray[np.str_]:
        """All decisions so far as text, for a checkpoint."""
        return np.array(json.dumps([asdict(made) for made in self._made]))

    def restore(self, array: NDArray[np.str_]) -> None:
        """Take the decisions of a checkpoint, those before it included, in place of one's own; inverse of
        :meth:`array`."""
        self._made = [Decision(**content) for content in json.loads(str(array))]
