"""Random streams: reproducible by name, and independent of each other."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path

import numpy as np

import iris_addon
from iris_addon.base.random_streams import STREAMS, stream

PACKAGE = Path(iris_addon.__file__).parent
ENGINE = [
    path
    for path in sorted(PACKAGE.rglob("*.py"))
    if "blender" not in path.relative_to(PACKAGE).parts and path.name != "random_streams.py"
]


def calls(name: str) -> Iterator[tuple[str, ast.Call]]:
    """File and call of every call of a function ``name`` in the engine."""
    for path in ENGINE:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            called = node.func if isinstance(node, ast.Call) else None
            if getattr(called, "id", getattr(called, "attr", None)) == name:
                assert isinstance(node, ast.Call)
                yield str(path.relative_to(PACKAGE)), node


def test_the_same_seed_name_and_indices_give_the_same_numbers():
    for arguments in ((0, "surface.patches"), (7, "materials.aimed_rays", 3), (2**70, "materials.gloss", 1, 2)):
        assert np.array_equal(stream(*arguments).random(8), stream(*arguments).random(8))


def test_numbers_do_not_change_between_processes_and_versions():
    assert stream(0, "surface.patches").integers(1 << 32, size=3).tolist() == [2242647589, 3821399010, 4264680396]


def test_different_seeds_names_or_indices_give_different_streams():
    rounds = [(seed, "materials.aimed_rays", k) for seed in (0, 1, 2**32) for k in range(3)]
    names = [(seed, name) for seed in (0, 1) for name in STREAMS if name != "materials.aimed_rays"]
    drawn = [stream(*each).random(4) for each in [*rounds, *names]]
    assert all(not np.isclose(one, other).any() for one, other in combinations(drawn, 2))


def test_every_name_has_a_number_of_its_own_and_is_used():
    assert len(set(STREAMS.values())) == len(STREAMS)
    assert {call.args[1].value for _, call in calls("stream") if isinstance(call.args[1], ast.Constant)} == set(STREAMS)


def test_every_stream_of_the_engine_has_a_name_of_its_own():
    names = []
    for file, call in calls("stream"):
        name = call.args[1]
        assert isinstance(name, ast.Constant) and isinstance(name.value, str), f"{file}: not a literal name"
        names.append(name.value)
    assert names and max(Counter(names).values()) == 1, Counter(names).most_common(3)


def test_the_engine_makes_no_other_generators():
    assert [file for file, _ in calls("default_rng")] == []
