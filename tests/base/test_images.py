"""Image files: exact round trips, limits, damage named, writes that leave the old file alone when they fail."""

from __future__ import annotations

import errno
import os
import struct
import zlib
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from iris_addon.base import image_headers
from iris_addon.base import images as imaging
from iris_addon.base.errors import BadInput, IrisError
from iris_addon.base.files import atomic_write


@pytest.fixture
def radiance() -> np.ndarray:
    return np.random.default_rng(0).gamma(0.5, 20.0, (12, 16, 3)).astype(np.float32)


def test_float_exr_is_exact(tmp_path: Path, radiance: np.ndarray) -> None:
    imaging.write_exr(tmp_path / "a.exr", radiance)
    np.testing.assert_array_equal(imaging.read_exr(tmp_path / "a.exr"), radiance)


def test_half_exr_keeps_eleven_bits_and_does_not_overflow(tmp_path: Path, radiance: np.ndarray) -> None:
    radiance[0, 0] = 1e9
    imaging.write_exr(tmp_path / "a.exr", radiance, half=True)
    read = imaging.read_exr(tmp_path / "a.exr")
    assert np.isfinite(read).all()
    np.testing.assert_allclose(read[1:], radiance[1:], rtol=2**-11, atol=1e-7)


def test_single_channel_exr(tmp_path: Path, radiance: np.ndarray) -> None:
    imaging.write_exr(tmp_path / "y.exr", radiance[..., 0])
    np.testing.assert_array_equal(imaging.read_exr(tmp_path / "y.exr"), radiance[..., :1])


def test_multi_part_exr_gives_the_part_with_colour(tmp_path: Path, radiance: np.ndarray) -> None:
    header = {"type": OpenEXR.scanlineimage}
    depth = {"Depth.Z": radiance[..., 0].copy()}
    combined = {f"Combined.{name}": radiance[..., k].copy() for k, name in enumerate("RGB")}
    parts = [
        OpenEXR.Part({**header, "name": "Depth"}, depth),
        OpenEXR.Part({**header, "name": "Combined"}, combined),
    ]
    OpenEXR.File(parts).write(str(tmp_path / "multi.exr"))
    np.testing.assert_array_equal(imaging.read_exr(tmp_path / "multi.exr"), radiance)


def test_16_bit_map_is_exact(tmp_path: Path) -> None:
    values = np.arange(12 * 16, dtype=np.uint16).reshape(12, 16) * 331
    imaging.write_png(tmp_path / "m.png", values)
    np.testing.assert_array_equal(imaging.read_map(tmp_path / "m.png"), values)


def test_8_bit_png_is_exact_and_alpha_is_dropped(tmp_path: Path) -> None:
    values = np.random.default_rng(1).integers(0, 256, (12, 16, 4), np.uint8)
    imaging.write_png(tmp_path / "rgb.png", values[..., :3])
    Image.fromarray(values).save(tmp_path / "rgba.png")
    np.testing.assert_array_equal(imaging.read_image(tmp_path / "rgb.png"), values[..., :3])
    np.testing.assert_array_equal(imaging.read_image(tmp_path / "rgba.png"), values[..., :3])


def test_16_bit_photo_is_refused_rather_than_clipped(tmp_path: Path) -> None:
    imaging.write_png(tmp_path / "m.png", np.full((4, 4), 40_000, np.uint16))
    with pytest.raises(BadInput, match=r"m\.png: has more than 8 bits"):
        imaging.read_image(tmp_path / "m.png")
    row = b"\0" + bytes(4 * 3 * 2)  # no filter, then four pixels of three channels of two bytes
    chunks = [
        (b"IHDR", struct.pack(">IIBBBBB", 4, 2, 16, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(2 * row)),
        (b"IEND", b""),
    ]
    packed = [struct.pack(">I", len(c)) + name + c + struct.pack(">I", zlib.crc32(name + c)) for name, c in chunks]
    (tmp_path / "rgb.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(packed))
    with pytest.raises(BadInput, match=r"rgb\.png: has more than 8 bits"):
        imaging.read_image(tmp_path / "rgb.png")


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".exr"])
def test_truncated_file_is_named(tmp_path: Path, suffix: str, radiance: np.ndarray) -> None:
    path = tmp_path / f"photo{suffix}"
    if suffix == ".exr":
        imaging.write_exr(path, radiance)
    else:
        noise = np.random.default_rng(2).integers(0, 256, (64, 64, 3), np.uint8)
        Image.fromarray(noise).save(path)
        imaging.check_image(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    read = imaging.read_exr if suffix == ".exr" else imaging.check_image
    with pytest.raises(BadInput, match=rf"photo\{suffix}: is damaged") as caught:
        read(path)
    assert caught.value.exit_code == 3


def test_complete_jpeg_with_a_trailer_is_fine(tmp_path: Path) -> None:
    Image.new("RGB", (32, 32), (9, 99, 199)).save(tmp_path / "a.jpg")
    with (tmp_path / "a.jpg").open("ab") as file:
        file.write(b"maker notes after the end marker")
    assert imaging.check_image(tmp_path / "a.jpg") == (32, 32)


@pytest.mark.parametrize("content", [b"", b"not an image at all", b"\x89PNG\r\n\x1a\n"])
def test_not_an_image(tmp_path: Path, content: bytes) -> None:
    for name in ("x.png", "x.exr"):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(BadInput, match="damaged or not an image"):
            imaging.check_image(tmp_path / name)


def test_oversized_image_is_refused_before_decoding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    imaging.write_png(tmp_path / "big.png", np.zeros((40, 30), np.uint8))
    imaging.write_exr(tmp_path / "big.exr", np.zeros((40, 30, 3)))
    monkeypatch.setattr(image_headers, "MAX_PIXELS", 1000)
    for read, name in ((imaging.read_map, "big.png"), (imaging.read_exr, "big.exr")):
        with pytest.raises(BadInput, match=r"big\.\w+: is 30x40 pixels"):
            read(tmp_path / name)


def test_full_disk_leaves_the_old_file_and_no_litter(tmp_path: Path, radiance: np.ndarray) -> None:
    path = tmp_path / "a.exr"
    imaging.write_exr(path, radiance)

    def write_until_full(temporary: Path) -> None:
        temporary.write_bytes(b"half of i")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(
        IrisError, match=r"a\.exr: cannot be written \(No space left on device\) — free some space"
    ) as e:
        atomic_write(path, write_until_full)
    assert e.value.exit_code == 1
    np.testing.assert_array_equal(imaging.read_exr(path), radiance)
    assert list(tmp_path.iterdir()) == [path]


def test_any_failure_while_writing_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "sub" / "report.json"
    atomic_write(path, lambda temporary: temporary.write_text("first"))

    def interrupted(temporary: Path) -> None:
        temporary.write_text("second")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        atomic_write(path, interrupted)
    assert path.read_text() == "first"
    assert list(path.parent.iterdir()) == [path]
