"""Response curves as tables, differentiable in the table and in what is looked up."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from ..model.response import Response

RAMP = 1e-9
"""Slope added to a curve, under which the inverse of a flat stretch is its middle."""
MIN_SLOPE = 1e-4
"""Of f, for the derivative of its inverse."""


@dataclass(frozen=True)
class CurveTable:
    """One curve for all channels or one for each.

    Attributes:
        samples: (C, N) f at x = linspace(0, 1, N), float64; C is 1 or the number of channels.
    """

    samples: Tensor

    @staticmethod
    def of(response: Response) -> CurveTable:
        """The table of a response."""
        return CurveTable(torch.from_numpy(response.samples))

    def at(self, x: Tensor) -> Tensor:
        """Display values (3, m) of relative exposures (3, m); constant outside [0, 1]."""
        return _between(self.samples, x)

    def slope(self, x: Tensor) -> Tensor:
        """f' (3, m) at relative exposures (3, m)."""
        return _between(self.slopes, x)

    @cached_property
    def slopes(self) -> Tensor:
        """(C, N) f' where ``samples`` are."""
        steps = self.samples.diff() * (self.samples.shape[1] - 1)
        return torch.cat([steps[:, :1], (steps[:, 1:] + steps[:, :-1]) / 2, steps[:, -1:]], 1)

    def inverse(self, z: Tensor) -> Tensor:
        """Relative exposures (3, m) of display values (3, m); the middle of a stretch where a curve is flat."""
        fixed, last = self.samples.detach(), self.samples.shape[1] - 1
        rising = (fixed + RAMP * torch.linspace(0, 1, last + 1, dtype=torch.float64)).expand(len(z), -1).contiguous()
        right = torch.searchsorted(rising, z.contiguous(), right=True).clamp(1, last)
        low, high = rising.gather(1, right - 1), rising.gather(1, right)
        x = (right - 1 + ((z - low) / (high - low)).clamp(0, 1)) / last
        # The derivative is that of one step of Newton's method from there: dx = -df(x) / f'(x).
        return x - (self.at(x) - CurveTable(fixed).at(x)) / ((high - low) * last).clamp(min=MIN_SLOPE)


def _between(rows: Tensor, x: Tensor) -> Tensor:
    """``rows`` (C, N), sampled evenly over [0, 1], at ``x`` (3, m), linearly interpolated."""
    last = rows.shape[1] - 1
    position = x.clamp(0.0, 1.0) * last
    left = position.detach().nan_to_num().long().clamp(max=last - 1)  # NaN has no place and stays NaN
    channel = torch.arange(len(x))[:, None] if len(rows) > 1 else 0
    index, flat = (left + channel * (last + 1)).reshape(-1), rows.reshape(-1)
    low, high = (flat.index_select(0, at).reshape(x.shape) for at in (index, index + 1))
    return low + (position - left) * (high - low)
