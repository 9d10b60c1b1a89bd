"""Light states: photos of one room that were taken with different lamps on, and which photo shows which."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .capture import View

MAX_NAME_BYTES = 63
"""Of the name of a light state, as Blender's custom properties have them at most."""
_NAME = re.compile(r"[\w+.](?:[\w+. -]{0,38}[\w+.-])?")


def is_state_name(name: object) -> bool:
    """Whether ``name`` can name a light state: short, without odd characters, and no option of a program."""
    return isinstance(name, str) and bool(_NAME.fullmatch(name)) and len(name.encode()) <= MAX_NAME_BYTES


@dataclass(frozen=True)
class LightStates:
    """The light states of V photos.

    Attributes:
        names: of the S states, that of most photos first; a single "" where photos name none.
        index: (V,) state of each photo, 0 to S - 1.
    """

    names: tuple[str, ...]
    index: NDArray[np.int64]

    @staticmethod
    def of(views: Sequence[View]) -> LightStates:
        """The states of ``views``; of two with as many photos the one that is named first comes first."""
        names = tuple(name for name, _ in Counter(view.light_state for view in views).most_common())
        return LightStates(names, np.array([names.index(view.light_state) for view in views], np.int64))

    def __len__(self) -> int:
        return len(self.names)

    def photos(self, state: int) -> NDArray[np.bool_]:
        """(V,) photos of that state."""
        return self.index == state


def joined_arrays(states: Sequence[Mapping[str, NDArray]]) -> dict[str, NDArray]:
    """The arrays of all states for one checkpoint, those of the first under their own names."""
    named = ((f"state{k}." if k else "", arrays) for k, arrays in enumerate(states))
    return {prefix + name: values for prefix, arrays in named for name, values in arrays.items()}


def split_arrays(arrays: Mapping[str, NDArray], n_states: int) -> list[dict[str, NDArray]]:
    """Inverse of :func:`joined_arrays`; the first state has all other arrays too."""
    prefixes = [f"state{k}." for k in range(1, n_states)]
    first = {name: values for name, values in arrays.items() if not name.startswith(tuple(prefixes))}
    others = [
        {name.removeprefix(prefix): values for name, values in arrays.items() if name.startswith(prefix)}
        for prefix in prefixes
    ]
    return [first, *others]
