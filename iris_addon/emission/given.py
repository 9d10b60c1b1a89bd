"""Lamps that are known beforehand, from a file in the form of a result's emitters.json."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from ..result.json_files import from_ranges, json_object, read_json


def read_given_emitters(path: Path, n_faces: int) -> list[NDArray[np.int64]]:
    """Faces of each lamp: ``{"emitters": [{"faces": [[first, last + 1], ...]}, ...]}``; no lamp is a valid answer.

    Raises:
        BadInput: unreadable, or a face is not of this mesh.
    """
    listed = read_json(path).get("emitters")
    if not isinstance(listed, list):
        raise BadInput("'emitters' is missing or not a list", "give an emitters.json with the faces of each lamp", path)
    return [
        from_ranges(json_object(entry, f"emitters[{k}]", path).get("faces"), n_faces, f"emitters[{k}].faces", path)
        for k, entry in enumerate(listed)
    ]
