"""What earns its place: the rule, the table behind it, and that nothing decided is lost."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from iris_addon import decide
from iris_addon.config import Refinements
from iris_addon.decide import REFINEMENTS, Decisions, HeldOutLosses, accept, paired_error

EXPERIMENTS = Path(__file__).resolve().parents[1] / "docs" / "experiments"


@pytest.mark.parametrize("name", REFINEMENTS)
def test_a_model_that_gains_just_what_is_needed_is_the_border(name: str) -> None:
    row = REFINEMENTS[name]
    error = 0.01
    border = 1 - row.gain - row.errors * error
    assert accept(name, 1.0, border - 1e-9, error)
    assert not accept(name, 1.0, border + 1e-9, error)


def test_more_gain_is_asked_where_the_share_is_larger() -> None:
    gain = REFINEMENTS["metal"].gain
    assert accept("metal", 1.0, 1 - 1.5 * gain) and not accept("metal", 1.0, 1 - 1.5 * gain, share=2.0)


@pytest.mark.parametrize("larger", [np.nan, np.inf])
def test_a_loss_that_is_no_number_is_refused(larger: float) -> None:
    assert not accept("outside_light", 1.0, larger)
    assert accept("outside_light", np.inf, 1.0)


def test_the_paired_error_is_that_of_the_mean_difference() -> None:
    """Losses that differ by a constant and by noise of 0.1, whatever the noise that both have in common."""
    rng = np.random.default_rng(0)
    n, common = 40_000, rng.normal(0, 5.0, 40_000)
    error = paired_error(common, common - 0.3 + rng.normal(0, 0.1, n), np.ones(n))
    assert error == pytest.approx(0.1 / np.sqrt(n), rel=0.03)
    assert paired_error(common, common - 0.3, np.ones(n)) == pytest.approx(0, abs=1e-12)


def test_the_paired_error_counts_observations_by_their_weight() -> None:
    rng = np.random.default_rng(1)
    smaller, larger = rng.normal(size=(2, 100))
    twice = np.repeat(np.arange(100), 2)
    half = paired_error(smaller[twice], larger[twice], np.ones(200)) * np.sqrt(2)
    assert paired_error(smaller, larger, np.full(100, 3.0)) == pytest.approx(half)


def test_losses_are_paired_by_observation_and_count_no_more_than_err_independently() -> None:
    rng = np.random.default_rng(2)
    n, ids = 900, np.arange(900)
    common = rng.normal(0, 3.0, n)
    smaller = HeldOutLosses(ids, common, np.ones(n), 100)
    larger = HeldOutLosses(ids[300:], common[300:] + rng.normal(0, 0.1, 600), np.ones(600), 100)
    assert smaller.paired_error(larger) == pytest.approx(0.1 / np.sqrt(100), rel=0.1)
    assert smaller.paired_error(HeldOutLosses.none()) == 0.0


def test_what_is_forced_is_taken_and_what_is_forbidden_is_not_and_both_are_written_down() -> None:
    decisions = Decisions({"burley": True, "screen": False, "gloss": None})
    assert decisions.forces("burley") and decisions.forbids("screen")
    assert not decisions.forces("gloss") and not decisions.forbids("gloss")
    assert decisions.accept("burley", 1.0, 2.0) and not decisions.accept("screen", 1.0, 0.1)
    assert decisions.accept("gloss", 1.0, 0.5)
    assert [(entry["accepted"], entry["forced"]) for entry in decisions.report()] == [
        (True, True),
        (False, True),
        (True, False),
    ]


def test_decisions_come_back_from_a_checkpoint_with_those_before_it() -> None:
    before = Decisions()
    before.accept("lamp", 1.0, 0.9, subject="lamp of 2 faces from 7")
    before.accept("outside_light", np.inf, 0.9)
    after = Decisions()
    after.accept("burley", 1.0, 0.5)
    after.restore(before.array())
    assert after.report() == before.report()


def test_many_subjects_are_summed_up_with_their_mean_losses() -> None:
    decisions = Decisions()
    for k in range(decide.LISTED + 1):
        decisions.accept("gloss", 1.0, k / decide.LISTED, subject=f"region {k}")
    (entry,) = decisions.report()
    assert entry["subjects"] == decide.LISTED + 1 and entry["accepted"] == decide.LISTED
    assert entry["smaller"] == 1.0 and entry["larger"] == pytest.approx(0.5)


def test_every_row_names_the_experiment_behind_it_and_what_is_lost_is_no_number() -> None:
    for name, row in REFINEMENTS.items():
        assert (EXPERIMENTS / f"{row.experiment}.md").is_file(), name
        assert row.adds and row.loss and abs(row.gain) < 1 and row.errors >= 0


def test_what_a_configuration_can_force_is_a_row_or_a_stage() -> None:
    stages = {"exponent", "hidden_light"}
    assert {field.name for field in fields(Refinements)} <= set(REFINEMENTS) | stages
