"""A hidden emitter under a shade that fills a ten-thousandth of the hemisphere of the room."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from iris_addon.config import preset
from iris_addon.lighting import selection
from iris_addon.lighting.selection import promising_surfaces
from iris_addon.model.response import gamma
from iris_addon.pipeline import solve
from iris_addon.rays.tracer import Tracer
from tests.engine_room import ALBEDO, SIZE, Room, assemble, box, cameras, photograph, quad, render

LAMP, SHADE = 8, 7
RADIANCE = np.array([240.0, 200.0, 150.0])


def shaded_room() -> Room:
    """The walls, a box, and a lamp of 8 by 8 cm in a shade that is open below."""
    surfaces, regions = box(np.zeros(3), SIZE, 0.25), list(range(6))
    surfaces += box([0.5, 0.4, 0], [1.1, 1.2, 0.7], 0.25)
    regions += [6] * 6
    shade = box([1.8, 1.3, 0.55], [2.1, 1.6, 0.85])
    surfaces += [side for k, side in enumerate(shade) if k != 4]
    regions += [SHADE] * 5
    surfaces += [quad([1.91, 1.41, 0.75], [0.08, 0, 0], [0, 0.08, 0])]
    albedo, emission = ALBEDO.copy(), np.zeros_like(ALBEDO)
    albedo[SHADE], albedo[LAMP], emission[LAMP] = 0.4, 0.0, RADIANCE
    return Room(assemble(surfaces, [*regions, LAMP]), albedo, emission)


def test_the_first_unseen_surface_tried_is_the_lamp_under_its_shade(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Other unseen surfaces, the undersides of a box, meet a hundred times as many rays."""
    room = shaded_room()
    tracer, views = Tracer(room.mesh), cameras(12, 64, 48)
    lamp = np.flatnonzero(room.regions == LAMP)
    assert not any(np.isin(tracer.closest(*view.rays()).face, lamp).any() for view in views)
    radiance = render(room, tracer, views)
    exposures = 0.5 * 2.0 ** -np.array([0, 3, 5] * 4) / np.median(radiance)
    capture = photograph(room, views, radiance, exposures, gamma(), tmp_path / "photos")
    tried: list[list[list[np.ndarray]]] = []

    def spy(*args: Any) -> list[list[np.ndarray]]:
        tried.append(promising_surfaces(*args))
        assert len(args[0].hidden.surfaces) > 1
        return tried[-1]

    monkeypatch.setattr(selection, "promising_surfaces", spy)
    solve(capture, preset("draft", max_patches=10_000), tmp_path / "out")
    assert tried and all(np.array_equal(first[0][0], lamp) for first in tried)
