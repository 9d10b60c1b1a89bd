"""Exposures in the spellings of EXIF that cameras use."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from iris_addon.base.errors import BadInput
from iris_addon.capture.exposures import exif_settings, from_exif, from_frame, metered_luminance

TIME, F_NUMBER, ISO, KIND, STANDARD, RECOMMENDED = 0x829A, 0x829D, 0x8827, 0x8830, 0x8831, 0x8832
SHUTTER_APEX, APERTURE_APEX = 0x9201, 0x9202


def photo(path: Path, tags: dict[int, Any]) -> Path:
    exif = Image.Exif()
    exif.get_ifd(0x8769).update(tags)
    Image.new("RGB", (8, 8)).save(path, exif=exif)
    return path


@pytest.mark.parametrize(
    ("tags", "iso"),
    [
        ({ISO: 200}, 200),
        ({KIND: 1, STANDARD: 400}, 400),
        ({KIND: 2, RECOMMENDED: 800}, 800),
        ({ISO: 65535, RECOMMENDED: 102400}, 102400),
        ({ISO: 200, STANDARD: 400}, 200),
    ],
)
def test_iso_is_found_in_every_place(tags: dict, iso: float, tmp_path: Path) -> None:
    assert exif_settings(photo(tmp_path / "a.jpg", tags))["iso"] == iso


def test_apex_values_stand_in_for_time_and_aperture(tmp_path: Path) -> None:
    settings = exif_settings(photo(tmp_path / "a.jpg", {SHUTTER_APEX: 6.0, APERTURE_APEX: 4.0, ISO: 100}))
    assert settings == pytest.approx({"seconds": 1 / 64, "f_number": 4.0, "iso": 100})


@pytest.mark.parametrize("rational", [IFDRational(1, 0), IFDRational(0, 0)])
def test_rationals_that_are_none_count_as_missing(rational: IFDRational, tmp_path: Path) -> None:
    assert exif_settings(photo(tmp_path / "a.jpg", {TIME: rational, ISO: 100})) == {"iso": 100}


def test_exposures_follow_an_iso_that_is_only_in_its_newer_place(tmp_path: Path) -> None:
    isos = (100, 400, 1600)
    photos = {
        str(iso): photo(tmp_path / f"{iso}.jpg", {TIME: 1 / 60, F_NUMBER: 1.8, KIND: 1, STANDARD: iso}) for iso in isos
    }
    found = from_exif(photos)
    assert [found[str(iso)] / found["100"] for iso in isos] == pytest.approx([1, 4, 16])


def test_settings_that_no_camera_has_count_as_none(tmp_path: Path) -> None:
    """Their squares and powers are no numbers."""
    tiny = IFDRational(1, 4294967295)
    found = exif_settings(photo(tmp_path / "a.jpg", {TIME: 0.01, F_NUMBER: tiny, ISO: 100}))
    assert found == {"seconds": pytest.approx(0.01), "iso": 100}
    for apex in (IFDRational(9_000_000, 1), IFDRational(-9_000_000, 1)):
        settings = exif_settings(photo(tmp_path / "a.jpg", {SHUTTER_APEX: apex, APERTURE_APEX: apex, ISO: 100}))
        assert all(1e-10 < value < 1e10 for value in settings.values()), settings


def test_an_f_number_whose_square_vanishes_is_refused(tmp_path: Path) -> None:
    frame = {"exposure_time": 0.1, "f_number": 1e-200}
    with pytest.raises(BadInput, match=r"t\.json: a: exposure"):
        from_frame(frame, "a", tmp_path / "t.json")


def test_a_photo_with_all_three_settings_was_exposed_for_a_luminance(tmp_path: Path) -> None:
    """Sunny 16: f/16 and 1/100 s at ISO 100 are for the 3200 cd/m² of a gray card in the sun."""
    sunny = {TIME: 0.01, F_NUMBER: 16.0, ISO: 100}
    assert metered_luminance(photo(tmp_path / "a.jpg", sunny)) == pytest.approx(3200)
    assert metered_luminance(photo(tmp_path / "b.jpg", {**sunny, ISO: 400})) == pytest.approx(800)
    assert metered_luminance(photo(tmp_path / "c.jpg", {TIME: 0.01, ISO: 100})) is None
