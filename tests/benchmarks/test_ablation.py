"""Leave-one-out: what is left out exists, is left out, and comes back."""

from __future__ import annotations

import importlib

import pytest

from benchmarks.ablation_section import NOTHING, describe
from benchmarks.ablation_worker import MECHANISMS, accepted_refinements, left_out, variants
from iris_addon import decide


def attribute(module: str, name: str) -> object:
    owner = importlib.import_module(f"iris_addon.{module}")
    for part in name.split("."):
        owner = getattr(owner, part)
    return owner


@pytest.mark.parametrize("name", MECHANISMS)
def test_a_mechanism_is_replaced_within_the_run_alone(name: str) -> None:
    before = [attribute(replaced.module, replaced.name) for replaced in MECHANISMS[name]]
    with left_out(name):
        for replaced, was in zip(MECHANISMS[name], before, strict=True):
            assert attribute(replaced.module, replaced.name) != was
    assert [attribute(replaced.module, replaced.name) for replaced in MECHANISMS[name]] == before


@pytest.mark.parametrize("name", decide.REFINEMENTS)
def test_a_refinement_that_is_left_out_earns_nothing_whatever_it_gains(name: str) -> None:
    assert decide.accept(name, 1.0, -10.0)
    with left_out(name):
        assert not decide.accept(name, 1.0, -10.0)
        assert not decide.Decisions().accept(name, -1.0, -10.0)
    assert decide.accept(name, 1.0, -10.0)


def test_what_was_accepted_is_collected() -> None:
    with accepted_refinements() as names:
        decide.accept("metal", 1.0, 2.0)
        decide.Decisions().accept("burley", 1.0, 0.1)
    decide.accept("gloss", 1.0, 0.1)
    assert names == {"burley"}


def test_nothing_is_the_first_variant_and_changes_nothing() -> None:
    assert variants()[0] == NOTHING
    before = dict(decide.REFINEMENTS)
    with left_out(NOTHING):
        assert before == decide.REFINEMENTS


def test_the_table_has_what_a_capture_loses_without_it_and_a_dash_where_nothing_was_measured(tmp_path) -> None:
    def record(capture: str, name: str, psnr: float) -> dict:
        return {
            "run": {"capture": f"captures/{capture}", "left_out": name, "preset": "draft"},
            "machine": {"processor": "a processor", "cores": 2, "commit": "abc"},
            "metrics": {"kd_psnr_all": psnr},
        }

    page = describe([record("a", NOTHING, 30.0), record("a", "burley", 28.5), record("b", NOTHING, 20.0)], tmp_path)
    assert "| burley | 1.50 | – |" in page
