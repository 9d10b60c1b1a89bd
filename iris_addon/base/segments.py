"""Differentiable sums over groups of entries, and their transpose, which gives each entry the value of its group.

Each is the derivative of the other. Where a scatter would take single entries to memory here and there, the transposed
index list (the entries of each group) makes both a pass in order, whose result does not depend on threads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.autograd import Function


@dataclass(frozen=True)
class Segments:
    """m entries in n groups.

    Attributes:
        group: (m,) int64 group of each entry.
        order: (m,) entries by group; None where they lie so.
        ends: (n + 1,) where the entries of each group begin in ``order``, and the last ends.
    """

    group: Tensor
    order: Tensor | None
    ends: Tensor

    @staticmethod
    def of(group: Tensor, n_groups: int) -> Segments:
        """Entries of the groups (m,), each 0 to ``n_groups`` - 1."""
        ends = torch.zeros(n_groups + 1, dtype=torch.int64)
        ends[1:] = torch.bincount(group, minlength=n_groups).cumsum(0)
        ascending = bool((group[1:] >= group[:-1]).all())
        return Segments(group, None if ascending else torch.argsort(group, stable=True), ends)

    def sums(self, values: Tensor) -> Tensor:
        """(..., n) sums of ``values`` (..., m) per group."""
        return _Sums.apply(values, self)  # type: ignore[no-any-return]

    def spread(self, values: Tensor) -> Tensor:
        """(..., m) of ``values`` (..., n): that of its group for each entry."""
        return _Spread.apply(values, self)  # type: ignore[no-any-return]

    def means(self, values: Tensor, weight: Tensor) -> Tensor:
        """(..., n) weighted means of ``values`` (..., m) per group; all groups need some weight (..., m)."""
        return self.sums(weight * values) / self.sums(weight)


class _Linear(Function):
    """A linear map along the last axis; leading axes are independent."""

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor, Segments], output: Tensor) -> None:
        ctx.segments = inputs[1]


class _Sums(_Linear):
    @staticmethod
    def forward(values: Tensor, segments: Segments) -> Tensor:
        if not values.shape[-1]:
            return values.new_zeros((*values.shape[:-1], len(segments.ends) - 1))
        rows = values.reshape(-1, values.shape[-1])
        if segments.order is not None:
            rows = rows.index_select(1, segments.order)
        ends = segments.ends.expand(len(rows), -1).contiguous()
        sums = torch.segment_reduce(rows.contiguous(), "sum", offsets=ends, axis=1, unsafe=True, initial=0.0)
        return sums.reshape(*values.shape[:-1], -1)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
        return ctx.segments.spread(gradient), None


class _Spread(_Linear):
    @staticmethod
    def forward(values: Tensor, segments: Segments) -> Tensor:
        return values.index_select(-1, segments.group)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
        return ctx.segments.sums(gradient), None
