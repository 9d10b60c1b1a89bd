"""Brackets of one pose, several photos of different exposure from one tripod, as a capture on disk."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image

from iris_addon.base.progress import Progress
from iris_addon.capture.inspection import inspect
from iris_addon.capture.reader import read_capture
from iris_addon.config import preset
from iris_addon.model.response import gamma
from iris_addon.pipeline import solve
from iris_addon.rays.tracer import Tracer
from iris_addon.textures.atlas import rasterise_atlas
from tests.engine_room import LAMP_REGIONS, cameras, furnished_room, photograph, render, write_capture

TINY = preset("draft", max_patches=4000, gather_rays=64, shadow_rays=64, max_atlas_size=128, rounds=1)
STOPS = np.array([-3.0, 0.0, 2.0])
POSES = 8


@pytest.fixture(scope="module")
def bracketed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray]:
    """Eight poses in three exposures each, their times in EXIF alone, and the exposures."""
    folder = tmp_path_factory.mktemp("bracketed")
    fine, poses = furnished_room(), cameras(POSES, 48, 36)
    radiance = render(fine, Tracer(fine.mesh), poses, 128)
    middle = 0.25 / np.median(radiance.mean(-1).reshape(POSES, -1), 1)
    seconds = np.repeat(2.0 ** np.round(np.log2(middle)), len(STOPS)) * np.tile(2.0**STOPS, POSES)
    views = [pose for pose in poses for _ in STOPS]
    room = furnished_room(np.inf)
    write_capture(photograph(room, views, radiance.repeat(len(STOPS), 0), seconds, gamma(), folder))
    meta = json.loads((folder / "transforms.json").read_text())
    for frame, time in zip(meta["frames"], seconds, strict=True):
        del frame["exposure"]
        exif = Image.Exif()
        exif[ExifTags.Base.Make] = "made for a test"
        exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.ExposureTime] = float(time)
        with Image.open(folder / frame["file_path"]) as image:
            image.load()
        image.save(folder / frame["file_path"], exif=exif)
    (folder / "transforms.json").write_text(json.dumps(meta))
    return folder, seconds


def test_a_bracket_is_read_whole(bracketed: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    """Photos of one pose are no copies, none is exchanged, and bright ones need no darker ones: they are there."""
    folder, seconds = bracketed
    capture = read_capture(folder)
    assert len(capture.views) == POSES * len(STOPS) and capture.warnings == () and capture.mismatch is None
    found = np.array([view.exposure for view in capture.views], float)
    assert found / found[0] == pytest.approx(seconds / seconds[0], rel=1e-3)
    content = inspect(capture, tmp_path / "look", Progress())
    assert max(row["saturated"] for row in content["views"]) > 0.25
    assert content["warnings"] == [] and not any(row["problem"] for row in content["views"])


def _clipped(folder: Path) -> list[np.ndarray]:
    """(H, W) whether a channel is clipped, of each photo."""
    return [(np.asarray(Image.open(path)) == 255).any(-1) for path in sorted(folder.glob("*.png"))]


@pytest.mark.slow
@pytest.mark.parametrize("exposures", ["auto", "none"])
def test_a_bracket_is_solved(
    exposures: str, bracketed: tuple[Path, np.ndarray], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Lamps, albedo and exposures, told or estimated; a unit of light is open where exposures are."""
    monkeypatch.setenv("IRIS_CACHE", str(tmp_path / "cache"))
    folder, seconds = bracketed
    result = solve(read_capture(folder, exposures=exposures), TINY, tmp_path / "out")
    room = furnished_room(np.inf)
    assert np.linalg.norm(result.response.samples - gamma().samples) < 1.4
    # The brightest photo of a pose may clip all, so that its exposure is only bounded from below.
    told = np.array([row.mean() < 0.9 for row in _clipped(folder)])
    stops = np.log2([result.exposures[name].mean() for name in sorted(result.exposures)]) - np.log2(seconds)
    assert np.std(stops[told]) < (1e-6 if exposures == "auto" else 0.15)
    assert np.abs(stops - stops[told].mean()).max() < 1.0
    face, _ = rasterise_atlas(result.mesh.uv, len(result.textures.base_color))
    seen = (face >= 0) & (result.textures.confidence > 0)
    region, color = room.regions[face[seen]], result.textures.base_color[seen]
    means, truth = np.array([color[region == label].mean(0) for label in range(8)]), room.albedo[:8]
    assert np.abs(means * truth.mean() / means.mean() - truth).mean() < 0.03
    lamps = {int(room.regions[emitter.faces[0]]): emitter.radiance.mean() for emitter in result.emitters}
    assert sorted(lamps) == list(LAMP_REGIONS)
    first, second = LAMP_REGIONS
    ratio = room.emission[first].mean() / room.emission[second].mean()
    assert lamps[first] / lamps[second] == pytest.approx(ratio, rel=0.15)
    assert result.report["holdout_psnr"] > 30
