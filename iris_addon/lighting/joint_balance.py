"""The light balance of several light states together.

Photos that were taken with different lamps on show one set of materials. Equation (18) holds in each state, with the
radiance of its own lamps; the albedos of the regions are the same. So the unknowns are solved for at once: the patches
of all states stand one below the other, those of a state are reached by its emitters alone, and the lamps that one
state leaves undetermined are told by the albedo that the others determine. A lamp may have one radiance in all states
in which it is on, or one in each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..surface.topology import component_labels
from .balance import Balance, Evidence, ShadedPatches, solve_balance

MIN_WEIGHT = 1e-12
"""Sum of weights below which there is nothing to average."""


@dataclass(frozen=True)
class BalanceInput:
    """What :func:`solve_balance` balances in one light state.

    Attributes:
        patches: the shading.
        evidence: on the E emitters.
        start: (E, 3) radiance to start from.
        lamps: (L,) number of each of the first emitters, the lamps, among those of the room: lamps of one number have
            one radiance in all states. None where each state has its own.
    """

    patches: ShadedPatches
    evidence: Evidence
    start: NDArray[np.floating]
    lamps: NDArray[np.int64] | None = None


def solve_joined(posed: Sequence[BalanceInput], robust_log: float, warm_start: bool, iterations: int) -> list[Balance]:
    """:func:`solve_balance` of several light states with emitters of their own, under one albedo per region.

    Returns:
        The balance of each, with the albedo of all together and the held-out loss of its own patches.
    """
    if len(posed) == 1:
        own = posed[0]
        return [solve_balance(own.patches, own.evidence, own.start, robust_log, warm_start, iterations)]
    start = np.concatenate([own.start for own in posed])
    patches, evidence = _stacked([own.patches for own in posed]), _joined(posed)
    balance = solve_balance(patches, evidence, start, robust_log, warm_start, iterations)
    ends = np.cumsum([len(own.start) for own in posed])[:-1]
    rows = np.cumsum([0, *(len(own.patches.region) for own in posed)])
    return [
        _of_state(balance, slice(*columns), slice(*own_rows))
        for columns, own_rows in zip(pairwise([0, *ends, len(start)]), pairwise(rows), strict=True)
    ]


def _of_state(balance: Balance, columns: slice, rows: slice) -> Balance:
    """The emitters ``columns`` of the joint ``balance``, and the loss of the held-out patches ``rows``."""
    losses = balance.losses
    own = np.flatnonzero((losses.observation >= rows.start) & (losses.observation < rows.stop))
    weight = losses.weight[own]
    return replace(
        balance,
        radiance=balance.radiance[columns],
        log_std=balance.log_std[columns],
        held_out=float(weight @ losses.loss[own] / max(weight.sum(), MIN_WEIGHT)),
        losses=replace(losses, observation=losses.observation[own] - rows.start, loss=losses.loss[own], weight=weight),
    )


def _stacked(states: Sequence[ShadedPatches]) -> ShadedPatches:
    """The patches of all states one after the other; those of one are reached by its own emitters alone."""
    columns = np.cumsum([0, *(own.form_factors.shape[1] for own in states)])
    rows = np.cumsum([0, *(len(own.region) for own in states)])
    form_factors = np.zeros((rows[-1], columns[-1]), states[0].form_factors.dtype)
    for k, own in enumerate(states):
        form_factors[rows[k] : rows[k + 1], columns[k] : columns[k + 1]] = own.form_factors
    bounded = [np.zeros(own.radiance.shape, bool) if own.bounded is None else own.bounded for own in states]
    return ShadedPatches(
        radiance=np.concatenate([own.radiance for own in states]),
        indirect=np.concatenate([own.indirect for own in states]),
        form_factors=form_factors,
        region=np.concatenate([own.region for own in states]),
        weight=np.concatenate([own.weight for own in states]),
        bounded=np.concatenate(bounded),
    )


def _joined(states: Sequence[BalanceInput]) -> Evidence:
    """The evidence on the emitters of all states; what shares a radiance within a state, or by its number, does."""
    each = [own.evidence for own in states]
    first = np.cumsum([0, *(len(own.tie) for own in each)])
    within = np.concatenate([own.tie + offset for own, offset in zip(each, first[:-1], strict=True)])
    between = -1 - np.arange(first[-1])  # a number of its own for what has none
    for own, offset in zip(states, first[:-1], strict=True):
        if own.lamps is not None:
            between[offset : offset + len(own.lamps)] = own.lamps
    links = [_same(within), _same(between)]
    tie = component_labels(first[-1], *(np.concatenate(ends) for ends in zip(*links, strict=True)))
    return Evidence(
        bound=np.concatenate([own.bound for own in each]),
        measured=np.concatenate([own.measured for own in each]),
        tie=tie.astype(np.int64),
        expected=np.concatenate([own.expected for own in each]),
    )


def _same(label: NDArray[np.integer]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs of entries of one ``label`` (n,) that link all entries of it."""
    order = np.argsort(label, kind="stable")
    alike = label[order[1:]] == label[order[:-1]]
    return order[:-1][alike], order[1:][alike]
