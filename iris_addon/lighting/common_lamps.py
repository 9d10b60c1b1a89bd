"""The lamps of a room that was photographed in several light states.

Each state is searched for lamps by itself, and a lamp is where it is in all of them: its faces are told by all states,
and each state says whether it is on. Two lamps that one state shows lit together, as one, are two if another state
tells them apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..base.progress import Progress
from ..decide import HeldOutLosses
from ..surface.topology import component_labels
from ..transport.form_factors import emitter_of_face
from .lamp_evidence import lamp_of_cell
from .lamp_radiance import LitState, form_factors_of, solve_together
from .problem import Lights
from .selection import UNCONSTRAINED_MIN_REFLECTANCE, certainty

MIN_OVERLAP = 0.5
"""Share of the area of a lamp, or of what a state found in its place if that is smaller, that a state must have found
for the lamp to be on."""

Faces = NDArray[np.int64]


def solve_states(states: Sequence[LitState], progress: Progress) -> list[Lights]:
    """The lights of all ``states`` together, each with those of the common lamps that are on in it.

    Switches are more common than dimmers: a lamp has one radiance in all states in which it is on, unless the held-out
    loss tells that some lamp has not.

    Args:
        states: with the lamps that each was found to have, whose form factors ``before`` knows.
    """
    areas = states[0].problem.tracer.areas
    lamps, on = common_lamps([_lit(state) for state in states], areas)
    # Copies that one state tells apart are two lamps in all: a state that takes them for one has no say.
    apart = [faces for state in states for faces in state.before.emitters_apart]
    posed = []
    for state, lit in zip(states, on, strict=True):
        emitters = [lamps[k] for k in np.flatnonzero(lit)]
        factors = form_factors_of(state.problem, emitters, progress, known=state.before)
        before = state.before.told_apart(apart)
        posed.append(replace(state, emitters=emitters, form_factors=factors, before=before))
    # Not from the lights of each state: what their unseen patches pass on would speak for a radiance in each state.
    dimmed = solve_together(posed, progress)
    if not (on.sum(0) > 1).any():
        return dimmed
    steady = [replace(state, numbers=np.flatnonzero(lit)) for state, lit in zip(posed, on, strict=True)]
    switched = solve_together(steady, progress)
    one, each = _pooled(switched), _pooled(dimmed)
    losses = [float(np.average(own.loss, weights=own.weight)) if len(own.loss) else np.inf for own in (one, each)]
    accepted = states[0].problem.decisions.accept("dimmed_lamps", losses[0], losses[1], one.paired_error(each))
    return dimmed if accepted else switched


def _pooled(lights: Sequence[Lights]) -> HeldOutLosses:
    """The held-out losses of the patches of all states."""
    observation = [own.losses.observation * len(lights) + k for k, own in enumerate(lights)]
    return HeldOutLosses(
        np.concatenate(observation),
        np.concatenate([own.losses.loss for own in lights]),
        np.concatenate([own.losses.weight for own in lights]),
        max(own.losses.independent for own in lights),
    )


def _lit(state: LitState) -> list[Faces]:
    """The lamps of a state without those that the user named and photos show dark: these may reflect all they show."""
    problem, lights = state.problem, state.before
    if problem.given_emitters is None:
        return state.emitters
    lamp = lamp_of_cell(problem, state.emitters)
    needed = certainty(problem, lights, lamp, len(state.emitters))
    seen = np.bincount(lamp[lamp >= 0], minlength=len(state.emitters)) > 0
    return [state.emitters[k] for k in np.flatnonzero(~seen | (needed >= UNCONSTRAINED_MIN_REFLECTANCE))]


def common_lamps(
    found: Sequence[Sequence[Faces]], areas: NDArray[np.floating]
) -> tuple[list[Faces], NDArray[np.bool_]]:
    """The lamps of a room from those ``found`` in each of S states.

    Lamps of different states that share faces are one lamp, of all their faces. Where one of them shares faces with
    several of another state, it is divided as the state with most lamps there has them.

    Args:
        areas: (F,) of the faces.

    Returns:
        Faces of each of E lamps, and whether each is on in each state, (S, E).
    """
    numbered = [(state, faces) for state, lamps in enumerate(found) for faces in lamps]
    if not numbered:
        return [], np.zeros((len(found), 0), bool)
    one, other = np.triu_indices(len(numbered), 1)
    share = np.array([np.isin(numbered[a][1], numbered[b][1]).any() for a, b in zip(one, other, strict=True)], bool)
    place = component_labels(len(numbered), one[share], other[share])
    lamps: list[Faces] = []
    for label in np.unique(place):
        own = [numbered[k] for k in np.flatnonzero(place == label)]
        per_state = [[faces for state, faces in own if state == each] for each in range(len(found))]
        lamps += _divided(max(per_state, key=len), np.unique(np.concatenate([faces for _, faces in own])), areas)
    on = np.array([[_is_on(lamp, of_state, areas) for lamp in lamps] for of_state in found], bool)
    return lamps, on.reshape(len(found), len(lamps))


def _divided(parts: Sequence[Faces], whole: Faces, areas: NDArray[np.floating]) -> list[Faces]:
    """The faces ``whole`` (k,) divided into as many lamps as there are ``parts`` of it; what lies in none of them goes
    to the largest."""
    if len(parts) == 1:
        return [whole]
    label = emitter_of_face(list(parts), len(areas))[whole]
    largest = int(np.argmax([areas[faces].sum() for faces in parts]))
    label = np.where(label < 0, largest, label)
    return [whole[label == k] for k in range(len(parts)) if (label == k).any()]


def _is_on(lamp: Faces, found: Sequence[Faces], areas: NDArray[np.floating]) -> bool:
    """Whether a state in which the lamps ``found`` are on has ``lamp`` on."""
    shared = [areas[faces[np.isin(faces, lamp)]].sum() for faces in found]
    if not shared or not max(shared) > 0:
        return False
    smaller = min(areas[lamp].sum(), areas[found[int(np.argmax(shared))]].sum())
    return bool(sum(shared) > MIN_OVERLAP * smaller)
