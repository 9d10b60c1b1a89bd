"""Sums over groups and their transpose: values, derivatives in both modes, and under vmap."""

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


def test_derivatives_are_right_in_both_modes(segments: Segments) -> None:
    generator = torch.Generator().manual_seed(0)
    values = torch.randn((3, 7), generator=generator, dtype=torch.float64, requires_grad=True)
    each = torch.randn((3, N_GROUPS), generator=generator, dtype=torch.float64, requires_grad=True)
    for function, at in ((segments.sums, values), (segments.spread, each)):
        assert torch.autograd.gradcheck(lambda x, f=function: f(x) ** 2, (at,), check_forward_ad=True)
        assert torch.autograd.gradgradcheck(lambda x, f=function: f(x) ** 2, (at,))


def test_columns_of_a_jacobian_are_computed_together(segments: Segments) -> None:
    def centred(x: torch.Tensor) -> torch.Tensor:
        entries = torch.arange(7.0).double() * x[:1] + x[1:] ** 2
        return (entries - segments.spread(segments.means(entries, torch.ones(7).double()).nan_to_num())).exp()

    x = torch.tensor([0.1, 0.2], dtype=torch.float64)
    assert torch.allclose(torch.func.jacfwd(centred)(x), torch.func.jacrev(centred)(x))
