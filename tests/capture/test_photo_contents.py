"""Photos that show nothing, copies of one picture, and bars around the picture."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from iris_addon.base.errors import BadInput
from iris_addon.base.images import write_exr
from iris_addon.capture.photo_contents import content_of
from iris_addon.capture.photos import load_photo
from iris_addon.capture.reader import read_capture
from iris_addon.model.capture import Camera, View
from tests.demo_capture import demo_capture

RNG = np.random.default_rng(3)
ONE_NOISE = RNG.integers(0, 256, (480, 640, 3), np.uint8)
Change = Callable[[np.ndarray, int], np.ndarray]


def changed(root: Path, change: Change, count: int = 8, suffix: str = ".png") -> Path:
    """The demo room, the pixels (H, W, 3) of each photo replaced by ``change``."""

    def save(image: Image.Image, path: Path, index: int) -> None:
        Image.fromarray(change(np.array(image), index)).save(path)

    return demo_capture(root, count, suffix, save).save()


def filled(value: int) -> Change:
    return lambda pixels, _: np.full_like(pixels, value)


NOTHING: dict[str, tuple[Change, str]] = {
    "grey": (filled(128), "8 of 8 photos show nothing (one plain color)"),
    "black": (filled(0), "8 of 8 photos show nothing (black)"),
    "white": (filled(255), "8 of 8 photos show nothing (all clipped)"),
    "another grey in each": (lambda p, k: np.full_like(p, 60 + 9 * k), "8 of 8 photos show nothing (one plain color)"),
    "one noise": (lambda p, _: ONE_NOISE[: p.shape[0], : p.shape[1]], "8 of 8 photos show nothing (nothing but noise)"),
    "lens cap": (
        lambda p, k: np.clip(12 + np.random.default_rng(k).normal(0, 3, p.shape), 0, 255).astype(np.uint8),
        "8 of 8 photos show nothing",
    ),
}


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@pytest.mark.parametrize("kind", NOTHING)
def test_a_capture_that_shows_nothing_is_refused(kind: str, suffix: str, tmp_path: Path) -> None:
    change, said = NOTHING[kind]
    with pytest.raises(BadInput) as caught:
        read_capture(changed(tmp_path, change, suffix=suffix))
    assert caught.value.exit_code == 3 and said in str(caught.value) and "001_0001" not in str(caught.value)
    assert str(tmp_path / "images" / "000_0001") in str(caught.value)


def test_one_picture_under_all_poses_is_refused(tmp_path: Path) -> None:
    first: list[np.ndarray] = []

    def same(pixels: np.ndarray, _: int) -> np.ndarray:
        first.append(pixels)
        return first[0]

    with pytest.raises(BadInput, match="8 of 8 photos are the same picture as another"):
        read_capture(changed(tmp_path, same))


def test_photos_that_show_something_go_on_without_the_rest(tmp_path: Path) -> None:
    root = changed(tmp_path, lambda pixels, k: pixels if k % 2 else np.full_like(pixels, 255 * (k == 2)))
    capture = read_capture(root)
    assert len(capture.views) == 4
    assert any(
        text.startswith("4 of 8 photos show nothing (3 black, 1 all clipped) and are left out: 000_0001")
        for text in capture.warnings
    )
    with pytest.raises(BadInput, match="4 of 8 photos show nothing"):
        read_capture(root, strict=True)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_photos_without_color_are_named(suffix: str, tmp_path: Path) -> None:
    def grey(pixels: np.ndarray, index: int, count: int) -> np.ndarray:
        return np.repeat(pixels.mean(-1, keepdims=True).astype(np.uint8), 3, axis=-1) if index < count else pixels

    all_grey = changed(tmp_path / "all", lambda pixels, index: grey(pixels, index, 8), suffix=suffix)
    (said,) = [text for text in read_capture(all_grey).warnings if "color" in text]
    assert said.startswith("no photo has color") and "export the photos in color" in said
    some = changed(tmp_path / "some", lambda pixels, index: grey(pixels, index, 2), suffix=suffix)
    (said,) = [text for text in read_capture(some).warnings if "color" in text]
    assert said.startswith("2 of 8 photos have no color") and "000_0001" in said
    assert not [text for text in read_capture(demo_capture(tmp_path / "as it is").save()).warnings if "color" in text]


def test_two_copies_are_left_out(tmp_path: Path) -> None:
    kept: dict[int, np.ndarray] = {}

    def copied(pixels: np.ndarray, index: int) -> np.ndarray:
        kept[index] = pixels
        return kept[2] if index == 5 else pixels

    capture = read_capture(changed(tmp_path, copied))
    assert len(capture.views) == 6 and "2 of 8 photos are the same picture as another" in " ".join(capture.warnings)


def test_brackets_of_one_pose_are_no_copies(tmp_path: Path) -> None:
    room = demo_capture(tmp_path, 8)
    for index in (1, 3, 5, 7):
        room.poses[index] = room.poses[index - 1]
        (tmp_path / "images" / room.names[index]).write_bytes(
            (tmp_path / "images" / room.names[index - 1]).read_bytes()
        )
    assert len(read_capture(room.save()).views) == 8


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_bars_are_no_picture(suffix: str, tmp_path: Path) -> None:
    """Grey to the left and right; the pixels beside are used but for less than 2 % of the width."""

    def barred(pixels: np.ndarray, _: int) -> np.ndarray:
        pixels[:, :40], pixels[:, -61:] = 128, 128
        return pixels

    capture = read_capture(changed(tmp_path, barred, suffix=suffix))
    assert any("same plain bars around the picture" in text for text in capture.warnings)
    valid = load_photo(capture.views[0]).valid
    used = np.flatnonzero(valid.any(0))
    width = valid.shape[1]
    assert 40 <= used[0] <= 40 + 0.02 * width + 16 * (suffix == ".jpg")
    assert width - 61 - 0.02 * width - 16 * (suffix == ".jpg") <= used[-1] + 1 <= width - 61
    assert valid[:, used[0] : used[-1] + 1].all()


def test_whole_photos_have_no_bars(tmp_path: Path) -> None:
    capture = read_capture(changed(tmp_path, lambda pixels, _: pixels))
    assert capture.views[0].margins == (0, 0, 0, 0) and not any("bars" in text for text in capture.warnings)


def shown(path: Path, pixels: np.ndarray) -> str:
    height, width = pixels.shape[:2]
    if pixels.dtype == np.float32:
        write_exr(path, pixels)
    else:
        Image.fromarray(pixels).save(path)
    camera = Camera(width=width, height=height, fx=100, fy=100, cx=width / 2, cy=height / 2, c2w=np.eye(4))
    return content_of(View("a", camera, path)).nothing


def test_a_lamp_in_the_dark_is_something(tmp_path: Path) -> None:
    """The darkest photo of a bracket may show the lamp alone, and be the only one that does not clip it."""
    dark = np.zeros((960, 1280, 3), np.uint8)
    dark[100:103, 200:203] = 180
    assert shown(tmp_path / "a.png", dark) == ""


def test_a_faint_gradient_is_something(tmp_path: Path) -> None:
    wall = np.broadcast_to(np.linspace(100, 109, 640)[None, :, None], (480, 640, 3)).astype(np.uint8)
    assert shown(tmp_path / "a.png", wall) == ""


def test_fine_texture_is_no_noise(tmp_path: Path) -> None:
    carpet = RNG.integers(0, 256, (240, 320, 3), np.uint8).repeat(2, 0).repeat(2, 1)
    assert shown(tmp_path / "a.png", carpet) == ""


@pytest.mark.parametrize(("level", "why"), [(0.0, "black"), (7.0, "one plain color")])
def test_radiance_may_show_nothing(level: float, why: str, tmp_path: Path) -> None:
    assert shown(tmp_path / "a.exr", np.full((48, 64, 3), level, np.float32)) == why
