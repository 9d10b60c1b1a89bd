"""What rays meet that escape through holes of the mesh: the surfaces that photos show there.

A varnished front beside a hole does not mirror the lamps that light from outside stands for, but the chair that the
scan missed. Cycles shows glossy rays the same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..result.types import Backdrop
from .shell import Shell


class Beyond:
    """A backdrop, or none, as rays from within meet it.

    Attributes:
        backdrop: None where the mesh has hardly any holes.
        radiance: (T, 3) float32 of its texels, row by row.
    """

    def __init__(self, backdrop: Backdrop | None) -> None:
        self.backdrop = backdrop
        self.radiance = np.zeros((0, 3), np.float32) if backdrop is None else backdrop.picture.reshape(-1, 3)
        self.shell = None if backdrop is None else Shell(backdrop.vertices, backdrop.faces)

    def texels(self, origins: NDArray[np.floating], directions: NDArray[np.floating]) -> NDArray[np.int32]:
        """(n,) texel that each ray meets, -1 for none; origins within the shell and unit directions (n, 3)."""
        if self.backdrop is None or self.shell is None:
            return np.full(len(origins), -1, np.int32)
        return self.shell.texels(origins, directions, self.backdrop.picture.shape)
