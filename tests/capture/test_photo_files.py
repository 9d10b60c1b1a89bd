"""What photo files hold: alpha, masks, colour profiles, orientation, bit depth and formats."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageCms, ImageFilter

from iris_addon.base.errors import BadInput
from iris_addon.base.images import write_exr, write_png
from iris_addon.capture.color_profiles import ColorProfile
from iris_addon.capture.photo_files import read_photo
from iris_addon.capture.photos import load_photo
from iris_addon.capture.reader import read_capture
from iris_addon.model.capture import Camera, View
from tests.box_room import RoomCapture
from tests.demo_capture import demo_capture

RNG = np.random.default_rng(0)
CODES = RNG.integers(0, 256, (24, 32, 3), np.uint8)
SMOOTH = np.stack(np.meshgrid(np.linspace(60, 220, 32), np.linspace(70, 200, 24)), -1)
SMOOTH = np.concatenate([SMOOTH, np.full((24, 32, 1), 90.0)], -1).astype(np.uint8)


# ---- pixels that are no picture ------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["rgba", "palette", "exr"])
def test_transparent_pixels_are_no_picture(kind: str, tmp_path: Path) -> None:
    opaque = np.zeros((24, 32), bool)
    opaque[4:-4, 4:-4] = True
    path = tmp_path / "a.png"
    if kind == "exr":
        # OpenEXR writes RGBA where the channels are named so.
        import OpenEXR

        path = tmp_path / "a.exr"
        rgba = np.concatenate([np.ones((24, 32, 3)), opaque[..., None]], -1).astype(np.float32)
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, {"RGBA": rgba}).write(str(path))
    elif kind == "rgba":
        Image.fromarray(np.dstack([CODES, opaque.astype(np.uint8) * 255])).save(path)
    else:
        image = Image.fromarray(np.where(opaque, 1, 0).astype(np.uint8), "P")
        image.putpalette([0, 0, 0, 200, 10, 10])
        image.save(path, transparency=0)
    np.testing.assert_array_equal(read_photo(path).valid, opaque)


def test_an_alpha_that_is_nowhere_opaque_means_nothing(tmp_path: Path) -> None:
    Image.fromarray(np.dstack([CODES, np.zeros((24, 32), np.uint8)])).save(tmp_path / "a.png")
    assert read_photo(tmp_path / "a.png").valid.all()


def test_masks_of_a_capture_are_honoured(nerfstudio_room: RoomCapture) -> None:
    mask = np.zeros((24, 32), np.uint8)
    mask[:, 16:] = 255
    write_png(nerfstudio_room.root / "images" / "m.png", mask)
    nerfstudio_room.meta["frames"][1]["mask_path"] = "images/m.png"
    first, second, *_ = read_capture(nerfstudio_room.save()).views
    assert load_photo(first).valid.all()
    np.testing.assert_array_equal(load_photo(second).valid, mask > 0)
    write_png(nerfstudio_room.root / "images" / "m.png", mask[:12])
    with pytest.raises(BadInput, match=r"m\.png: is 32x12 pixels, its photo is 32x24"):
        load_photo(second)


# ---- colour --------------------------------------------------------------------------------------------------------


def matrix_profile(primaries: list[tuple[float, float]], gamma: float | bytes) -> bytes:
    """An ICC profile of a matrix and a curve (a power, or a tag): D65 white, adapted to D50 by Bradford's matrix."""

    def xyz(x: float, y: float) -> np.ndarray:
        return np.array([x / y, 1, (1 - x - y) / y])

    white, d50 = xyz(0.3127, 0.3290), np.array([0.9642, 1, 0.8249])
    columns = np.stack([xyz(*p) for p in primaries], 1)
    columns = columns * np.linalg.solve(columns, white)
    bradford = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
    columns = np.linalg.inv(bradford) @ np.diag(bradford @ d50 / (bradford @ white)) @ bradford @ columns

    def fixed(values: np.ndarray) -> bytes:
        return b"".join(struct.pack(">i", round(v * 65536)) for v in values)

    power = b"" if isinstance(gamma, bytes) else struct.pack(">IH", 1, round(gamma * 256))
    curve = gamma if isinstance(gamma, bytes) else b"curv\0\0\0\0" + power + b"\0\0"
    text = b"made by a test\0"
    description = b"desc\0\0\0\0" + struct.pack(">I", len(text)) + text + b"\0" * 78
    tags = [(b"desc", description), (b"cprt", b"text\0\0\0\0none\0"), (b"wtpt", b"XYZ \0\0\0\0" + fixed(d50))]
    for name, column in zip((b"r", b"g", b"b"), columns.T, strict=True):
        tags += [(name + b"XYZ", b"XYZ \0\0\0\0" + fixed(column)), (name + b"TRC", curve)]
    offset, table, data = 128 + 4 + 12 * len(tags), struct.pack(">I", len(tags)), b""
    for signature, content in tags:
        content += b"\0" * (-len(content) % 4)
        table += signature + struct.pack(">II", offset + len(data), len(content))
        data += content
    head = struct.pack(">I4sI4s4s4s", 128 + len(table) + len(data), b"lcms", 0x02400000, b"mntr", b"RGB ", b"XYZ ")
    head += struct.pack(">6H", 2026, 1, 1, 0, 0, 0) + b"acsp" + b"\0" * 28 + fixed(d50) + b"\0" * 48
    return head + table + data


PROFILES = {
    "Display P3": matrix_profile([(0.680, 0.320), (0.265, 0.690), (0.150, 0.060)], 2.2),
    "Adobe RGB": matrix_profile([(0.64, 0.33), (0.21, 0.71), (0.15, 0.06)], 2.2),
}


@pytest.mark.parametrize("name", PROFILES)
def test_embedded_profiles_are_converted_to_the_primaries_of_srgb(name: str, tmp_path: Path) -> None:
    profile = ImageCms.ImageCmsProfile(io.BytesIO(PROFILES[name]))
    srgb = ImageCms.createProfile("sRGB")
    image = ImageCms.profileToProfile(Image.fromarray(SMOOTH), srgb, profile, renderingIntent=1)
    assert image is not None and np.abs(np.asarray(image).astype(int) - SMOOTH).max() > 8
    image.save(tmp_path / "a.png", icc_profile=PROFILES[name])
    found = read_photo(tmp_path / "a.png").values * 255
    assert np.abs(found - SMOOTH).max() <= 2.01
    assert (np.abs(found - np.rint(found)) > 0.1).any()  # not rounded once more


def test_sixteen_bits_in_another_space_keep_them(tmp_path: Path) -> None:
    """A step of a sixteenth of a code is there in sRGB too, and a profile of a table as littleCMS reads it."""
    grey = np.linspace(0.2, 0.6, 4096).reshape(64, 64)
    fine = np.rint(np.stack([grey, 0.8 * grey, 0.9 * grey], -1) * 65535).astype(">u2")
    write_png_16(tmp_path / "a.png", fine.astype(np.uint16), PROFILES["Display P3"])
    values = read_photo(tmp_path / "a.png").values
    assert len(np.unique(values[..., 0])) > 2000
    eight = Image.fromarray((fine >> 8).astype(np.uint8))
    profile = ImageCms.ImageCmsProfile(io.BytesIO(PROFILES["Display P3"]))
    known = ImageCms.profileToProfile(eight, profile, ImageCms.createProfile("sRGB"), renderingIntent=1)
    assert known is not None and np.abs(values * 255 - np.asarray(known)).max() < 1.6


def curve_of(kind: int, *numbers: float) -> bytes:
    return (
        b"para\0\0\0\0" + struct.pack(">HH", kind, 0) + b"".join(struct.pack(">i", round(65536 * x)) for x in numbers)
    )


SRGB_PARAMETRIC = curve_of(3, 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)


@pytest.mark.parametrize(
    "curve",
    [
        SRGB_PARAMETRIC,
        curve_of(4, 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045, 0.0, 0.0),
        curve_of(2, 2.0, 0.9, -0.1, 0.1),
        curve_of(1, 2.0, 1.1, -0.1),
        curve_of(0, 1.8),
        b"curv\0\0\0\0" + struct.pack(">I3H", 3, 0, 14000, 65535) + b"\0\0",
        b"curv\0\0\0\0" + struct.pack(">I", 0),
    ],
)
def test_curves_of_every_kind_are_those_of_little_cms(curve: bytes, tmp_path: Path) -> None:
    content = matrix_profile([(0.680, 0.320), (0.265, 0.690), (0.150, 0.060)], curve)
    Image.fromarray(SMOOTH).save(tmp_path / "a.png", icc_profile=content)
    profile = ImageCms.ImageCmsProfile(io.BytesIO(content))
    known = ImageCms.profileToProfile(Image.fromarray(SMOOTH), profile, ImageCms.createProfile("sRGB"), 1)
    assert known is not None and np.abs(read_photo(tmp_path / "a.png").values * 255 - np.asarray(known)).max() < 1.6


@pytest.mark.parametrize(
    "curve",
    [
        b"curv\0\0\0\0" + struct.pack(">IH", 1, 0) + b"\0\0",
        curve_of(0, -2.2),
        curve_of(0, 0.0),
        curve_of(1, -1.0, 1.0, 0.0),
        curve_of(1, 20_000.0, 30_000.0, 0.0),
        curve_of(3, 90.0, 30_000.0, 0.0, 1.0, 0.0),
    ],
)
def test_damaged_curves_are_left_to_little_cms(curve: bytes, tmp_path: Path) -> None:
    """A power of zero or below has no value at black, and others none that a number holds."""
    content = matrix_profile([(0.680, 0.320), (0.265, 0.690), (0.150, 0.060)], curve)
    Image.fromarray(SMOOTH).save(tmp_path / "a.png", icc_profile=content)
    profile = ImageCms.ImageCmsProfile(io.BytesIO(content))
    try:
        known = ImageCms.profileToProfile(Image.fromarray(SMOOTH), profile, ImageCms.createProfile("sRGB"), 1)
    except ImageCms.PyCMSError:
        with pytest.raises(BadInput, match=r"a\.png: has a color profile that cannot be used"):
            read_photo(tmp_path / "a.png")
        return
    assert known is not None
    given = np.asarray(known)
    np.testing.assert_array_equal(np.rint(read_photo(tmp_path / "a.png").values * 255), given + (given == 254))


def test_photos_of_more_than_a_block_of_rows_are_converted_whole(tmp_path: Path) -> None:
    """By codes of 8 bits as by numbers of 16."""
    codes = np.random.default_rng(0).integers(0, 256, (150, 1000, 3)).astype(np.uint8)
    Image.fromarray(codes).save(tmp_path / "a.png", icc_profile=PROFILES["Display P3"])
    profile = ColorProfile(PROFILES["Display P3"], tmp_path / "a.png")
    values = read_photo(tmp_path / "a.png").values
    np.testing.assert_array_equal(values, profile.converted(codes / 255))
    np.testing.assert_array_equal(values[100:], profile.converted(codes[100:]))


def test_a_clipped_pixel_stays_clipped_through_a_profile(tmp_path: Path) -> None:
    Image.new("RGB", (4, 4), (255, 255, 255)).save(tmp_path / "a.png", icc_profile=PROFILES["Display P3"])
    assert (read_photo(tmp_path / "a.png").values == 1).all()


def test_a_photo_in_srgb_is_not_touched(tmp_path: Path) -> None:
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    Image.fromarray(CODES).save(tmp_path / "a.png", icc_profile=profile)
    np.testing.assert_array_equal(np.rint(read_photo(tmp_path / "a.png").values * 255), CODES)


# ---- depth and formats ---------------------------------------------------------------------------------------------


def write_png_16(path: Path, pixels: np.ndarray, profile: bytes = b"") -> None:
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in pixels)
    kind = 2 if pixels.shape[2] == 3 else 6
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", pixels.shape[1], pixels.shape[0], 16, kind, 0, 0, 0))]
    if profile:
        chunks.append((b"iCCP", b"p\0\0" + zlib.compress(profile)))
    chunks += [(b"IDAT", zlib.compress(rows)), (b"IEND", b"")]
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + b"".join(struct.pack(">I", len(d)) + t + d + struct.pack(">I", zlib.crc32(t + d)) for t, d in chunks)
    )


@pytest.mark.parametrize("channels", [3, 4])
def test_sixteen_bits_of_a_png_are_kept(channels: int, tmp_path: Path) -> None:
    """Given as floors of 8 bits, to which the response adds half a step."""
    pixels = RNG.integers(300, 65535, (24, 32, channels), np.uint16)
    if channels == 4:
        pixels[..., 3] = 65535
    write_png_16(tmp_path / "a.png", pixels)
    found = read_photo(tmp_path / "a.png")
    np.testing.assert_allclose(found.values, pixels[..., :3] / 65535 - 0.5 / 255, atol=1e-7)
    assert found.valid.all()


def test_sixteen_bits_of_a_tiff_are_kept(tmp_path: Path) -> None:
    pixels = RNG.integers(300, 65535, (24, 32, 3), np.uint16)
    entries = [
        (256, 32),
        (257, 24),
        (259, 1),
        (262, 2),
        (277, 3),
        (278, 24),
        (279, pixels.nbytes),
        (258, 150),
        (273, 156),
    ]
    ifd = struct.pack("<H", len(entries))
    for tag, value in sorted(entries):
        ifd += struct.pack("<HHII", tag, 3 if tag == 258 else 4, 3 if tag == 258 else 1, value)
    head = (b"II*\0" + struct.pack("<I", 8) + ifd + b"\0" * 4).ljust(150, b"\0")
    (tmp_path / "a.tif").write_bytes(head + struct.pack("<3H", 16, 16, 16) + pixels.astype("<u2").tobytes())
    np.testing.assert_allclose(read_photo(tmp_path / "a.tif").values, pixels / 65535 - 0.5 / 255, atol=1e-7)


def test_the_top_of_the_range_is_clipped_at_any_depth(tmp_path: Path) -> None:
    write_png_16(tmp_path / "a.png", np.full((4, 4, 3), 65535, np.uint16))
    assert (read_photo(tmp_path / "a.png").values == 1).all()


@pytest.mark.parametrize(
    ("name", "form", "options"),
    [
        ("a.webp", "WEBP", {"lossless": True}),
        ("a.tif", "TIFF", {"compression": "tiff_lzw"}),
        ("a.bmp", "BMP", {}),
        ("a.jpg", "WEBP", {"lossless": True}),
        ("a.png", "TIFF", {}),
    ],
)
def test_lossless_formats_are_read_by_their_content(name: str, form: str, options: dict, tmp_path: Path) -> None:
    Image.fromarray(CODES).save(tmp_path / name, format=form, **options)
    np.testing.assert_array_equal(np.rint(read_photo(tmp_path / name).values * 255), CODES)


@pytest.mark.parametrize(("name", "form"), [("a.avif", "AVIF"), ("a.heic", "HEIF"), ("a.jpg", "HEIF")])
def test_lossy_formats_of_phones(name: str, form: str, tmp_path: Path) -> None:
    if form == "HEIF":
        pytest.importorskip("pillow_heif").register_heif_opener()
    smooth = Image.fromarray(SMOOTH).resize((128, 96)).filter(ImageFilter.GaussianBlur(3))
    smooth.save(tmp_path / name, format=form, quality=95)
    assert np.abs(read_photo(tmp_path / name).values * 255 - np.asarray(smooth)).mean() < 2


def write_dng(path: Path, linear: np.ndarray, neutral: tuple[float, float, float], white: int = 60000) -> None:
    """Camera raw (RGGB, 16 bits) of a camera whose colours are those of sRGB, before its white balance."""
    height, width, _ = linear.shape
    sensor = np.clip(linear * neutral, 0, 1) * (white - 1000) + 1000
    mosaic = sensor[..., 1].copy()
    mosaic[::2, ::2], mosaic[1::2, 1::2] = sensor[::2, ::2, 0], sensor[1::2, 1::2, 2]
    data = np.rint(mosaic).astype("<u2").tobytes()
    to_xyz = np.array(
        [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
    )

    def ratios(values: np.ndarray | tuple[float, ...], form: str) -> bytes:
        return b"".join(struct.pack(f"<{2 * form}", round(x * 10000), 10000) for x in np.ravel(values))

    long, short, byte = (lambda *x, f=f: struct.pack(f"<{len(x)}{f}", *x) for f in ("I", "H", "B"))
    tags = {
        254: (4, 1, long(0)), 256: (4, 1, long(width)), 257: (4, 1, long(height)), 258: (3, 1, short(16)),
        259: (3, 1, short(1)), 262: (3, 1, short(32803)), 271: (2, 5, b"Test\0"), 272: (2, 4, b"One\0"),
        273: (4, 1, b"data"), 274: (3, 1, short(1)), 277: (3, 1, short(1)), 278: (4, 1, long(height)),
        279: (4, 1, long(len(data))), 284: (3, 1, short(1)), 33421: (3, 2, short(2, 2)),
        33422: (1, 4, byte(0, 1, 1, 2)),
        50706: (1, 4, byte(1, 4, 0, 0)), 50708: (2, 9, b"Test One\0"), 50714: (4, 1, long(1000)),
        50717: (4, 1, long(white)), 50721: (10, 9, ratios(np.linalg.inv(to_xyz), "i")),
        50728: (5, 3, ratios(neutral, "I")),
        50778: (3, 1, short(21)),
    }  # fmt: skip
    offset, table, more = 8 + 2 + 12 * len(tags) + 4, b"", b""
    where = offset + sum(len(value) + len(value) % 2 for _, _, value in tags.values() if len(value) > 4)
    for tag, (kind, count, value) in tags.items():
        content = long(where) if tag == 273 else value
        if len(content) > 4:
            content, value = long(offset + len(more)), content
            more += value + b"\0" * (len(value) % 2)
        table += struct.pack("<HHI", tag, kind, count) + content.ljust(4, b"\0")
    path.write_bytes(b"II*\0" + long(8) + short(len(tags)) + table + long(0) + more + data)


def test_camera_raw_is_linear_with_its_white_balance_and_clips_where_the_file_says(tmp_path: Path) -> None:
    pytest.importorskip("rawpy")
    linear = np.empty((96, 128, 3))
    patches = {0: (0.05, 0.1, 0.2), 32: (0.4, 0.2, 0.1), 64: (0.3, 0.3, 0.3), 96: (1.5, 1.5, 1.5)}
    for left, color in patches.items():
        linear[:, left : left + 32] = color
    write_dng(tmp_path / "a.dng", linear, (0.5, 1.0, 0.7))
    found = read_photo(tmp_path / "a.dng")
    assert not found.hdr and found.valid.all()
    for left, color in patches.items():
        middle = found.values[8:-8, left + 8 : left + 24].reshape(-1, 3)
        if left == 96:
            assert (middle == 1).all()
        else:
            np.testing.assert_allclose(middle + 0.5 / 255, np.broadcast_to(color, middle.shape), rtol=0.02, atol=0.002)


def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.jpg").write_bytes(b"\0\0\0\x18ftypheic" + b"\0" * 40)
    (tmp_path / "a.dng").write_bytes(b"II*\0")
    for package in ("pillow_heif", "rawpy"):
        monkeypatch.setitem(__import__("sys").modules, package, None)
    with pytest.raises(BadInput, match=r"a\.jpg: is a HEIC photo — install the package pillow-heif"):
        read_photo(tmp_path / "a.jpg")
    with pytest.raises(BadInput, match=r"a\.dng: is a camera raw file — install the package rawpy"):
        read_photo(tmp_path / "a.dng")


# ---- orientation ---------------------------------------------------------------------------------------------------


def saved_turned(orientation: int, turns: int):
    def save(image: Image.Image, path: Path, index: int) -> None:
        exif = Image.Exif()
        exif[0x112] = orientation
        image.rotate(90 * turns, expand=True).save(path, exif=exif)

    return save


@pytest.mark.parametrize(("orientation", "turns"), [(6, 1), (8, 3), (3, 2)])
def test_photos_are_turned_where_only_that_fits(orientation: int, turns: int, tmp_path: Path) -> None:
    """By 90 degrees the size tells, by 180 the edges of the mesh."""
    right = read_capture(demo_capture(tmp_path / "right").save())
    turned = read_capture(demo_capture(tmp_path / "turned", save=saved_turned(orientation, turns)).save())
    assert turned.mismatch is None and any("EXIF orientation" in warning for warning in turned.warnings)
    for view, other in zip(right.views, turned.views, strict=True):
        np.testing.assert_array_equal(load_photo(other).values, load_photo(view).values)
    assert turned.up == right.up


def test_up_is_found_of_photos_that_are_stored_on_their_side(nerfstudio_room: RoomCapture) -> None:
    """Poses are about the pixels as stored; the world lies at will."""
    from iris_addon.capture.listing import mean_up

    exif = Image.Exif()
    exif[0x112] = 6
    views = []
    for photo, frame in zip(nerfstudio_room.photos, nerfstudio_room.meta["frames"], strict=True):
        with Image.open(photo) as image:
            stored = image.rotate(90, expand=True)
        stored.save(photo, exif=exif)
        pose = np.array(frame["transform_matrix"])
        # The stored camera lies on its side: what the held camera calls up is its left.
        sideways = np.column_stack([-pose[:3, 1], pose[:3, 0], pose[:3, 2]])
        pose[:3, :3] = sideways
        camera = Camera(width=24, height=32, fx=20, fy=20, cx=12, cy=16, c2w=pose)
        views.append(View(photo.stem, camera, photo))
    up = mean_up(views)
    assert up is not None
    np.testing.assert_allclose(up, (0, 0, 1), atol=0.3)


def test_a_size_that_only_turning_explains_names_the_orientation(nerfstudio_room: RoomCapture) -> None:
    Image.new("RGB", (24, 32)).save(nerfstudio_room.photos[1])
    with pytest.raises(BadInput, match="the photo or its pose was turned"):
        read_capture(nerfstudio_room.root)


def test_negative_radiance_is_zero(tmp_path: Path) -> None:
    write_exr(tmp_path / "a.exr", np.full((4, 4, 3), -1.0))
    assert (read_photo(tmp_path / "a.exr").values == 0).all()
