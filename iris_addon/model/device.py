"""A camera as what turns light into display values: its curve, and what it does to exposure from place to place."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .capture import View
from .local_exposure import UNIFORM, LocalSettings
from .response import Response

MAX_DEVICES, MIN_DEVICE_PHOTOS = 4, 3
"""Cameras that may have a curve of their own, and the photos that each must have taken."""


@dataclass(frozen=True)
class Devices:
    """The cameras that took photos, where there were several.

    Attributes:
        index: (V,) device of each photo, 0 to D - 1; 0 is the one with most photos.
        names: maker and model of each.
    """

    index: NDArray[np.int64]
    names: tuple[str, ...]


def devices_of(views: Sequence[View]) -> Devices | None:
    """The cameras behind ``views``, by maker and model; None where there is one.

    Those with few photos count as the one with most: a curve takes some overlap at many brightnesses.
    """
    photos = Counter(view.device for view in views)
    names = [name for name, count in photos.most_common(MAX_DEVICES) if count >= MIN_DEVICE_PHOTOS]
    if len(names) < 2:
        return None
    index = [names.index(view.device) if view.device in names else 0 for view in views]
    return Devices(np.array(index), tuple(names))


@dataclass(frozen=True)
class Device:
    """One of the cameras that took the photos of a capture.

    Attributes:
        name: maker and model as EXIF has them; "" where they are not recorded.
        response: its curve from exposure (radiance · exposure) to display values in [0, 1].
        local: its local exposure.
        photos: names of the training photos that it took; those of the first device need no list.
        exposure_factor: per channel, by which it exposes more than the first device at the same recorded exposure.
    """

    name: str
    response: Response
    local: LocalSettings = UNIFORM
    photos: tuple[str, ...] = ()
    exposure_factor: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def gain(self, photo: NDArray[np.floating]) -> NDArray[np.float64]:
        """(H, W, 1) factor of the exposure that the camera gave places of ``photo`` (H, W, 3), or (1, 1, 1) of 1."""
        return self.local.gain(photo, self.response)


def device_of_photo(first: Device, others: Sequence[Device], photo: str) -> Device:
    """What took the training photo of that name; the first device took all that no other did."""
    return next((device for device in others if photo in device.photos), first)


def device_of_view(first: Device, others: Sequence[Device], view: View) -> Device:
    """What took the photo of ``view``: as it was when the room was solved, or by its EXIF."""
    if view.split == "train" and (found := device_of_photo(first, others, view.name)) is not first:
        return found
    return next((device for device in others if view.device and device.name == view.device), first)
