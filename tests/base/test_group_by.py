"""Rows of equal keys, against numpy's own."""

from __future__ import annotations

import numpy as np
import pytest

from iris_addon.base.group_by import group_equal, group_quantiles, order_in_groups, rank_in_group, stable_order


@pytest.mark.parametrize("dtype", [np.uint64, np.int64])
def test_rows_of_equal_keys_are_grouped_as_numpy_groups_them(dtype: type[np.integer]) -> None:
    """Over all 64 bits: the largest unsigned keys are those that, read as signed, would be negative."""
    rng = np.random.default_rng(0)
    distinct = rng.integers(0, 1 << 64, 40, dtype=np.uint64).astype(dtype)
    keys = distinct[rng.integers(0, 40, 3000)]
    found = group_equal(keys)
    unique, first, inverse, count = np.unique(keys, return_index=True, return_inverse=True, return_counts=True)
    assert found.keys.dtype == dtype
    for ours, theirs in (
        (found.keys, unique),
        (found.order[found.start], first),
        (found.group, inverse),
        (found.count, count),
        (found.order, np.argsort(inverse, kind="stable")),
        (stable_order(keys), np.argsort(keys, kind="stable")),
    ):
        np.testing.assert_array_equal(ours, theirs)


def test_no_rows_make_no_groups() -> None:
    found = group_equal(np.zeros(0, np.int64))
    assert [len(column) for column in (found.keys, found.group, found.order, found.start, found.count)] == [0] * 5


def test_one_sort_orders_values_within_their_groups() -> None:
    rng = np.random.default_rng(0)
    values = np.concatenate([rng.normal(0, 10, 500), [-1e30, 1e30, 0.0]]).astype(np.float32)
    group = rng.integers(0, 5, len(values))
    order = order_in_groups(values, group)
    assert np.array_equal(group[order], np.sort(group))
    assert np.array_equal(values[order], values[np.lexsort((values, group))])


def test_quantiles_of_groups_are_those_of_each_alone() -> None:
    rng = np.random.default_rng(3)
    group, values = rng.choice([0, 1, 3], 200), rng.normal(size=(200, 2)).astype(np.float32)
    found = group_quantiles(values, group, 4, 0.75)
    for k in (0, 1, 3):
        expected = np.quantile(values[group == k], 0.75, axis=0, method="lower")
        assert found[k] == pytest.approx(expected)
    assert not found[2].any()


def test_rows_are_numbered_within_their_group() -> None:
    np.testing.assert_array_equal(rank_in_group(np.array([2, 2, 5, 7, 7, 7])), [0, 1, 0, 0, 1, 2])
    assert len(rank_in_group(np.zeros(0, np.int64))) == 0
