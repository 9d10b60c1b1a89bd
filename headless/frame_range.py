"""Which frames of an animation are asked for. Imports nothing: the command line is read before packages are there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass


@dataclass(frozen=True)
class FrameRange:
    """Frames ``first`` … ``last``, counted from 1, both included."""

    first: int
    last: int

    @classmethod
    def parse(cls, text: str) -> FrameRange:
        """``"1-120"`` or ``"7"``; raises ValueError."""
        first, _, last = text.partition("-")
        frames = cls(int(first), int(last or first))
        if not 1 <= frames.first <= frames.last:
            raise ValueError(text)
        return frames

    def __iter__(self) -> Iterator[int]:
        return iter(range(self.first, self.last + 1))

    def __len__(self) -> int:
        return self.last - self.first + 1
