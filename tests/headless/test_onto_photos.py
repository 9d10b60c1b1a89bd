"""A photo with an edit in it: the exposure that is fitted where none is recorded, at every place of the photo."""

from dataclasses import replace

import numpy as np
import pytest

from headless.onto_photos import PhotoInsertion
from iris_addon.base.images import to_codes, write_png
from iris_addon.edits.scene_edit import SceneEdit, Sphere
from iris_addon.model.capture import View
from iris_addon.model.local_exposure import LocalSettings
from iris_addon.model.render_settings import RenderSettings
from iris_addon.model.response import gamma
from tests.blender_room import camera, room

WIDTH, HEIGHT = 64, 48
FALLOFF = np.log(3.0)
BALL = SceneEdit(
    spheres=(Sphere(center=np.zeros(3), radius=0.1, base_color=np.full(3, 0.5), roughness=1.0, metallic=0.0),)
)


@pytest.mark.bpy
@pytest.mark.parametrize("falloff", [0.0, FALLOFF])
def test_an_exposure_that_nobody_recorded_is_found_at_every_place(tmp_path, monkeypatch, falloff):
    """Corners at a third of the exposure of the middle: light added to the room is darkened as the room is."""
    from iris_addon.blender.insert import differential as insert

    rng = np.random.default_rng(0)
    radiance = rng.uniform(0.3, 1.0, (HEIGHT, WIDTH, 1)) * np.array([1.0, 0.8, 0.6])
    row, column = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    square = ((row - HEIGHT / 2) ** 2 + (column - WIDTH / 2) ** 2) / ((HEIGHT / 2) ** 2 + (WIDTH / 2) ** 2)
    places, exposure = np.exp(-falloff * square)[..., None], np.array([0.3, 0.35, 0.4])
    photo = tmp_path / "photo.png"
    write_png(photo, to_codes(gamma().apply(radiance * exposure * places)))

    change = insert.Differential(radiance, 2 * radiance, radiance, np.zeros((HEIGHT, WIDTH)))
    monkeypatch.setattr(insert, "render_pair", lambda *_a, **_k: (radiance, radiance))
    monkeypatch.setattr(insert, "render_change", lambda *_a, **_k: change)
    result = replace(room(), response=gamma(), exposures={}, local=LocalSettings(falloff=falloff))
    view = View("photo", camera(WIDTH, HEIGHT, fx=50.0, fy=50.0), photo)
    changed = PhotoInsertion(result, view, RenderSettings(samples=1)).picture(BALL)
    assert changed.display is not None
    np.testing.assert_allclose(changed.display, gamma().apply(2 * radiance * exposure * places), atol=2.5 / 255)
    np.testing.assert_allclose(changed.radiance, 2 * radiance, rtol=0.05)
