"""response.json: the recovered camera of a result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from ..json_files import json_object, numbers, read_json
from ..response.curve import N_SAMPLES, Response
from ..response.local_exposure import ALIKE, LocalSettings
from .folder import RESPONSE, result_file
from .types import Result

LOCAL_BOUNDS = {"strength": (0.0, 0.99), "scale": (1e-3, 10.0), "headroom": (1.0, 1e6), "falloff": (0.0, 20.0)}


def response_json(result: Result) -> dict[str, Any]:
    """The content of response.json."""
    samples = result.response.samples
    same = bool((samples == samples[0]).all())
    return {
        "family": result.response.family,
        "coefficients": list(result.response.coefficients),
        "samples": samples[0] if same else samples,
        "exposures": {
            name: {"factor": value, "exposure": value[1], "white_balance": value / value[1] if value[1] else value}
            for name, value in ((name, np.asarray(value, float)) for name, value in result.exposures.items())
        },
        "local_exposure": asdict(result.local),
    }


def read_response(folder: Path) -> tuple[Response, dict[str, NDArray[np.float64]], LocalSettings]:
    """The recovered camera of the result in ``folder``: its response, (3,) exposure × white balance by photo, and what
    it did to exposure from place to place.

    Raises:
        BadInput: it is missing or damaged.
    """
    path = result_file(folder, RESPONSE)
    content = read_json(path)
    samples = content.get("samples")
    if isinstance(samples, list) and len(samples) == 3:
        table = numbers(samples, (3, N_SAMPLES), "samples", path)
    else:
        table = np.tile(numbers(samples, (N_SAMPLES,), "samples", path), (3, 1))
    coefficients = numbers(content.get("coefficients", []), (None,), "coefficients", path)
    exposures = {
        name: numbers(json_object(value, name, path).get("factor"), (3,), f"exposures of {name}", path)
        for name, value in json_object(content.get("exposures"), "exposures", path).items()
    }
    response = Response(table, str(content.get("family", "")), tuple(coefficients.tolist()))
    local = json_object(content.get("local_exposure", {}), "local_exposure", path)
    return response, exposures, _read_local(local, path)


def exposure_of(photo: str, exposures: Mapping[str, NDArray[np.floating]]) -> NDArray[np.floating]:
    """(3,) exposure × white balance of ``photo``, or the median of the photos where it is none of them."""
    return exposures[photo] if photo in exposures else median_exposure(exposures)


def median_exposure(exposures: Mapping[str, NDArray[np.floating]]) -> NDArray[np.float64]:
    """(3,) exposure × white balance that is typical of the photos; 1 where none is known."""
    return np.median(np.stack(list(exposures.values())), axis=0) if exposures else np.ones(3)


def _read_local(content: Mapping[str, Any], path: Path) -> LocalSettings:
    """Settings of local exposure; those that are missing are none."""
    settings = {**asdict(ALIKE), **content}
    for name, (low, high) in LOCAL_BOUNDS.items():
        value = settings[name]
        if not isinstance(value, int | float) or not low <= value <= high:
            raise BadInput(f"'local_exposure.{name}' is {value!r}", f"a number from {low:g} to {high:g}", path)
    return LocalSettings(**{name: float(settings[name]) for name in LOCAL_BOUNDS})
