"""Sums over groups and their transpose: values, first and second derivatives."""

from __future__ import annotations

import pytest
import torch

from iris_addon.base.segments import Segments

N_GROUPS = 5


@pytest.fixture(params=["ascending", "in any order"])
def segments(request: pytest.FixtureRequest) -> Segments:
    group = torch.tensor([0, 0, 1, 3, 3, 3, 4])  # none in group 2
    return Segments.of(group if request.param == "ascending" else group[torch.tensor([4, 0, 6, 2, 1, 3, 5])], N_GROUPS)


def test_sums_and_spread_are_those_of_a_matrix_and_its_transpose(segments: Segments) -> None:
    matrix = torch.nn.functional.one_hot(segments.group, N_GROUPS).T.double()
    values, each = torch.arange(14.0).double().reshape(2, 7), torch.arange(10.0).double().reshape(2, 5)
    assert torch.equal(segments.sums(values), values @ matrix.T)
    assert torch.equal(segments.spread(each), each @ matrix)
    some = torch.tensor([0, 1, 3, 4])
    means = segments.means(values, values + 1)
    assert torch.allclose(means[:, some], (((values + 1) * values) @ matrix.T / ((values + 1) @ matrix.T))[:, some])


def test_first_and_second_derivatives_are_right(segments: Segments) -> None:
    generator = torch.Generator().manual_seed(0)
    values = torch.randn((3, 7), generator=generator, dtype=torch.float64, requires_grad=True)
    each = torch.randn((3, N_GROUPS), generator=generator, dtype=torch.float64, requires_grad=True)
    for function, at in ((segments.sums, values), (segments.spread, each)):
        assert torch.autograd.gradcheck(lambda x, f=function: f(x) ** 2, (at,))
        assert torch.autograd.gradgradcheck(lambda x, f=function: f(x) ** 2, (at,))
