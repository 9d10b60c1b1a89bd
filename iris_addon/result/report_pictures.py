"""Pictures of report.html: arrays as PNG files with their caption, and the two ways of colouring them."""

from __future__ import annotations

from html import escape
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..imaging import to_codes, write_png
from ..parallel import over_each

FloatArray = NDArray[np.floating]
WIDEST = 1280
"""Pixels in a row of a picture of the report; larger ones are shrunk."""
ERROR_GAIN = 4.0
"""By which differences of display values are shown."""


class Pictures:
    """Gives the HTML that shows arrays, which :meth:`save` writes as PNG."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._codes: dict[str, NDArray[np.uint8]] = {}

    def figure(self, name: str, image: FloatArray, caption: str) -> str:
        """``image`` (H, W, 3) or (H, W), display values."""
        stem = "".join(c if c.isalnum() or c in "-_" else "-" for c in name)[:80]
        while stem in self._codes:
            stem += "_"
        self._codes[stem] = to_codes(image)
        height, width = image.shape[:2]
        return (
            f'<figure><img src="{self._folder.name}/{stem}.png" width="{width}" height="{height}" loading="lazy" '
            f'alt="{escape(caption)}"><figcaption>{escape(caption)}</figcaption></figure>'
        )

    def save(self) -> None:
        """Write all pictures."""
        over_each(list(self._codes), lambda stem: write_png(self._folder / f"{stem}.png", self._codes[stem]))


def heat(values: FloatArray) -> FloatArray:
    """(..., 3) black, blue, magenta, orange, white for values 0 to 1; increases in lightness throughout."""
    stops = np.array([[0.0, 0.0, 0.02], [0.2, 0.1, 0.5], [0.75, 0.2, 0.45], [1.0, 0.6, 0.2], [1.0, 1.0, 0.9]])
    position = np.linspace(0, 1, len(stops))
    return np.stack([np.interp(values, position, stops[:, c]) for c in range(3)], -1)
