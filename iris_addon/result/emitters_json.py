"""emitters.json: the lamps of a result, light from outside its mesh, and the shell that its backdrop is painted on."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..capture.types import Mesh
from ..errors import BadInput
from ..json_files import MEND, from_ranges, json_object, numbers, read_json, to_ranges
from .folder import EMITTERS, result_file
from .types import Backdrop, Emitter, OutsideLight, Result

SH_SIZES = (1, 4, 9)
MAX_SHELL = 100_000


class StoredShell(NamedTuple):
    """Vertices (V, 3) and faces (F, 3) of a backdrop, and whether it has an albedo."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    reflects: bool


def emitters_json(result: Result) -> dict[str, Any]:
    """The content of emitters.json."""
    backdrop = result.backdrop
    return {
        "emitters": [
            {
                "id": emitter.id,
                "faces": to_ranges(emitter.faces),
                "radiance": emitter.radiance,
                "area": emitter.area,
                "confidence": emitter.confidence,
            }
            for emitter in result.emitters
        ],
        "outside": None if result.outside is None else {"sh": result.outside.sh},
        "backdrop": None if backdrop is None else _shell_json(backdrop),
    }


def _shell_json(backdrop: Backdrop) -> dict[str, Any]:
    reflects = backdrop.albedo is not None
    return {"vertices": backdrop.vertices, "faces": backdrop.faces, "reflects": reflects}


def read_emitters(folder: Path, mesh: Mesh) -> tuple[tuple[Emitter, ...], OutsideLight | None, StoredShell | None]:
    """Lamps, light from outside and the backdrop's shell of the result in ``folder``.

    Raises:
        BadInput: the file is missing or damaged.
    """
    path = result_file(folder, EMITTERS)
    content = read_json(path)
    listed = content.get("emitters")
    if not isinstance(listed, list):
        raise BadInput("'emitters' is missing or not a list", MEND, path)
    emitters = tuple(_read_emitter(entry, f"emitters[{number}]", mesh, path) for number, entry in enumerate(listed))
    outside, backdrop = content.get("outside"), content.get("backdrop")
    return (
        emitters,
        None if outside is None else _read_outside(json_object(outside, "outside", path), path),
        None if backdrop is None else _read_shell(json_object(backdrop, "backdrop", path), path),
    )


def _read_emitter(entry: object, where: str, mesh: Mesh, path: Path) -> Emitter:
    content = json_object(entry, where, path)
    radiance = numbers(content.get("radiance"), (3,), f"{where}.radiance", path)
    if radiance.min() < 0:
        raise BadInput(f"'{where}.radiance' is negative", MEND, path)
    return Emitter(
        int(numbers(content.get("id"), (), f"{where}.id", path)),
        from_ranges(content.get("faces"), len(mesh.faces), f"{where}.faces", path),
        radiance,
        float(numbers(content.get("area"), (), f"{where}.area", path)),
        float(numbers(content.get("confidence"), (), f"{where}.confidence", path)),
    )


def _read_outside(content: dict[str, Any], path: Path) -> OutsideLight:
    sh = numbers(content.get("sh"), (None, 3), "outside.sh", path)
    if len(sh) not in SH_SIZES:
        raise BadInput(f"'outside.sh' has {len(sh)} coefficients, not 1, 4 or 9", MEND, path)
    return OutsideLight(sh)


def _read_shell(content: dict[str, Any], path: Path) -> StoredShell:
    vertices = numbers(content.get("vertices"), (None, 3), "backdrop.vertices", path)
    faces = numbers(content.get("faces"), (None, 3), "backdrop.faces", path)
    if not 4 <= len(vertices) <= MAX_SHELL or not 4 <= len(faces) <= MAX_SHELL:
        raise BadInput("'backdrop' is no shell, or too large", MEND, path)
    if (faces != np.floor(faces)).any() or faces.min() < 0 or faces.max() >= len(vertices):
        raise BadInput("'backdrop.faces' names vertices that it does not have", MEND, path)
    return StoredShell(vertices, faces.astype(np.int64), content.get("reflects") is True)
