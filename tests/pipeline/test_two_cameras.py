"""Two cameras of different curves in one capture: the demo room, every second photo as another camera shows it."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image

from iris_addon.capture.reader import read_capture
from iris_addon.config import preset
from iris_addon.evaluate.evaluation import evaluate
from iris_addon.pipeline import solve
from iris_addon.results.folder import load_result
from tests.demo_capture import ROOM

SMALL = preset("draft", max_patches=8000, max_atlas_size=512)
EXPONENT = 1.4
"""Of display values, by which the curve of the second camera differs from that of the first."""
Bend = Callable[[np.ndarray], np.ndarray]


def by_two_cameras(root: Path, bend: Bend) -> Path:
    """The demo room with EXIF, the codes of every second photo changed by ``bend`` as those of another camera, whose
    recorded exposures are 0.8 of what they are beside those of the first."""
    shutil.copytree(ROOM, root)
    for index, path in enumerate(sorted((root / "train" / "Image").glob("*.png"))):
        codes = np.asarray(Image.open(path).convert("RGB"))
        exif = Image.Exif()
        exif[ExifTags.Base.Make], exif[ExifTags.Base.Model] = "Acme", ("One", "Two")[index % 2]
        Image.fromarray(bend(codes) if index % 2 else codes).save(path, exif=exif)
    exposures = np.load(root / "cam" / "exposure.npy")
    np.save(root / "cam" / "exposure.npy", exposures * np.where(np.arange(len(exposures)) % 2, 0.8, 1.0))
    return root


def bent(codes: np.ndarray) -> np.ndarray:
    """Codes of 8 bits of the steeper curve; what is clipped stays so, and what is black."""
    steeper = np.minimum(np.floor(255 * ((codes + 0.5) / 255) ** EXPONENT), 254)
    return np.where((codes == 0) | (codes == 255), codes, steeper).astype(np.uint8)


@pytest.mark.slow
def test_a_room_of_two_cameras_is_solved_as_that_of_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IRIS_CACHE", str(tmp_path / "cache"))
    roots = {"one": ROOM, "two": by_two_cameras(tmp_path / "room", bent)}
    found = {name: solve(read_capture(root), SMALL, tmp_path / name) for name, root in roots.items()}
    scores = {name: evaluate(result, roots[name]) for name, result in found.items()}
    assert scores["two"]["kd_psnr"] > scores["one"]["kd_psnr"] - 0.5
    assert found["two"].report["holdout_psnr"] > found["one"].report["holdout_psnr"] - 0.5
    assert not found["one"].devices and found["two"].report["model"]["response"]["devices"] == 2
    (second,) = load_result(tmp_path / "two").devices
    assert second.name == "Acme Two" and len(second.photos) == 14
    truth = np.load(ROOM / "gt" / "cam" / "crf_gt.npy")
    assert second.exposure_factor == pytest.approx((1.25, 1.25, 1.25), rel=0.02)
    assert scores["two"]["crf_l2"] < 1.0
    assert np.linalg.norm(second.response.samples - truth**EXPONENT) < 1.0
