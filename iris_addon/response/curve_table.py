"""Response curves as tables, differentiable in the table and in what is looked up."""

from __future__ import annotations

from collections.abc import Callable
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

    @property
    def tables(self) -> tuple[CurveTable, ...]:
        """This one, as :class:`DeviceCurves` has several."""
        return (self,)

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


@dataclass(frozen=True)
class DeviceCurves:
    """A table for each of several devices; what is looked up, (3, m), was taken with one or another.

    Attributes:
        tables: of the devices.
        device: (m,) index of the table of each column.
    """

    tables: tuple[CurveTable, ...]
    device: Tensor

    def at(self, x: Tensor) -> Tensor:
        """As :meth:`CurveTable.at`."""
        return self._each(CurveTable.at, x)

    def slope(self, x: Tensor) -> Tensor:
        """As :meth:`CurveTable.slope`."""
        return self._each(CurveTable.slope, x)

    def inverse(self, z: Tensor) -> Tensor:
        """As :meth:`CurveTable.inverse`."""
        return self._each(CurveTable.inverse, z)

    def _each(self, look_up: Callable[[CurveTable, Tensor], Tensor], values: Tensor) -> Tensor:
        parts = [
            look_up(table, values.index_select(-1, columns))
            for table, columns in zip(self.tables, self._columns, strict=True)
        ]
        return torch.cat(parts, -1).index_select(-1, self._back)

    @cached_property
    def _columns(self) -> list[Tensor]:
        return [torch.nonzero(self.device == index)[:, 0] for index in range(len(self.tables))]

    @cached_property
    def _back(self) -> Tensor:
        """(m,) where each column lies among those of :attr:`_columns`, one device after another."""
        return torch.argsort(torch.cat(self._columns))


Curves = CurveTable | DeviceCurves
"""One curve for all observations, or one for those of each device."""


def _between(rows: Tensor, x: Tensor) -> Tensor:
    """``rows`` (C, N), sampled evenly over [0, 1], at ``x`` (3, m), linearly interpolated."""
    last = rows.shape[1] - 1
    position = x.clamp(0.0, 1.0) * last
    left = position.detach().nan_to_num().long().clamp(max=last - 1)  # NaN has no place and stays NaN
    channel = torch.arange(len(x))[:, None] if len(rows) > 1 else 0
    index, flat = (left + channel * (last + 1)).reshape(-1), rows.reshape(-1)
    low, high = (flat.index_select(0, at).reshape(x.shape) for at in (index, index + 1))
    return low + (position - left) * (high - low)
