"""Values of a job file, checked one by one; every error names the key that is wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput

Json = Mapping[str, Any]
Choice = TypeVar("Choice")


def json_map(value: Any, where: str) -> Json:
    """``value`` if it is a JSON object; raises BadInput."""
    if not isinstance(value, Mapping):
        raise BadInput(f"'{where}' is {type(value).__name__}", "make it a JSON object in braces")
    return value


def json_list(value: Any, where: str) -> Sequence[Any]:
    """``value`` if it is a JSON list; raises BadInput."""
    if not isinstance(value, list | tuple):
        raise BadInput(f"'{where}' is {type(value).__name__}", "make it a JSON list in brackets")
    return value


def number(value: Any, where: str, *, above_zero: bool = False, at_most: float = np.inf) -> float:
    """``value`` as a finite number from 0 (or above it) to ``at_most``; raises BadInput."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool) and np.isfinite(value)
    if not is_number or not 0 <= value <= at_most or (above_zero and value == 0):
        upper = "" if np.isinf(at_most) else f" to {at_most:g}"
        raise BadInput(
            f"'{where}' is {value!r}", f"give a number {'above 0' if above_zero else 'from 0'}{upper or ' up'}"
        )
    return float(value)


def whole(value: Any, where: str) -> int:
    """``value`` as a whole number from 0 up; raises BadInput."""
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise BadInput(f"'{where}' is {value!r}", "give a whole number, counted from 0")
    return value


def flag(value: Any, where: str) -> bool:
    """``value`` if it is true or false; raises BadInput."""
    if not isinstance(value, bool):
        raise BadInput(f"'{where}' is {value!r}", "give true or false")
    return value


def one_of(value: Any, choices: Sequence[Choice], where: str) -> Choice:
    """``value`` if it is one of ``choices``; raises BadInput."""
    if value not in choices:
        raise BadInput(f"'{where}' is {value!r}", f"use one of {', '.join(map(str, choices))}")
    return value


def array(value: Any, shape: tuple[int | None, ...], where: str) -> NDArray[np.float64]:
    """``value`` as finite float64 of ``shape`` (None: any length); raises BadInput."""
    try:
        values = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        values = np.array(np.nan)
    fits = values.ndim == len(shape) and all(
        want in (None, have) for want, have in zip(shape, values.shape, strict=True)
    )
    if not fits or not np.isfinite(values).all():
        form = " x ".join("n" if side is None else str(side) for side in shape)
        raise BadInput(f"'{where}' is no list of {form} finite numbers", "correct it in the JSON file")
    return values


def vector(value: Any, where: str) -> tuple[float, float, float]:
    """``value`` as three finite numbers; raises BadInput."""
    x, y, z = array(value, (3,), where).tolist()
    return x, y, z


def color(value: Any, where: str) -> NDArray[np.float64]:
    """``value`` as (3,) numbers from 0 up, one number standing for three equal ones; raises BadInput."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        value = [value] * 3
    values = array(value, (3,), where)
    if values.min() < 0:
        raise BadInput(f"'{where}' is {values.tolist()}", "give numbers from 0 up")
    return values


def direction(value: Any, where: str) -> NDArray[np.float64]:
    """``value`` as a (3,) unit vector; raises BadInput."""
    values = array(value, (3,), where)
    if not values.any():
        raise BadInput(f"'{where}' is [0, 0, 0]", "give a direction")
    return values / np.linalg.norm(values)


def file_path(value: Any, folder: Path | None, where: str) -> Path:
    """``value`` as a path, relative ones below ``folder``; raises BadInput."""
    if not isinstance(value, str):
        raise BadInput(f"'{where}' is {value!r}", "give a path")
    return (folder or Path()) / Path(value).expanduser()


def known_keys(value: Json, known: set[str], where: str) -> None:
    """Raise BadInput if ``value`` has other keys than ``known``: a misspelt key must not be skipped in silence."""
    unknown = sorted(set(value) - known)
    if unknown:
        raise BadInput(f"'{where}' has the unknown key '{unknown[0]}'", f"known keys: {', '.join(sorted(known))}")
