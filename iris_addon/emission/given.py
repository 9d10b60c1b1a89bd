"""Lamps that are known beforehand, from a file in the form of a result's emitters.json."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from ..json_files import from_ranges, json_object, read_json


def read_given_emitters(path: Path, areas: NDArray[np.floating]) -> list[NDArray[np.int64]]:
    """Faces of each lamp: ``{"emitters": [{"faces": [[first, last + 1], ...]}, ...]}``; no lamp is a valid answer.

    Args:
        areas: (F,) of the mesh's faces. Those without are left out, and one that two lamps name is the first one's.

    Raises:
        BadInput: unreadable, a face is not of this mesh, or a lamp has none with an area.
    """
    listed = read_json(path).get("emitters")
    if not isinstance(listed, list):
        raise BadInput("'emitters' is missing or not a list", "give an emitters.json with the faces of each lamp", path)
    emitters, taken = [], np.zeros(len(areas), bool)
    for k, entry in enumerate(listed):
        label = f"emitters[{k}].faces"
        faces = from_ranges(json_object(entry, f"emitters[{k}]", path).get("faces"), len(areas), label, path)
        faces = faces[areas[faces] > 0]
        if not len(faces):
            raise BadInput(f"{label} names no face that has an area", "leave that lamp out", path)
        own = faces[~taken[faces]]
        taken[own] = True
        if len(own):
            emitters.append(own)
    return emitters
