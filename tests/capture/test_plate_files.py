"""Image sequences by frame number, as film programs name them."""

import pytest

from iris_addon.base.errors import BadInput
from iris_addon.capture.plate_files import frame_number, plate_files


def touch(folder, *names):
    folder.mkdir(exist_ok=True)
    for name in names:
        (folder / name).touch()
    return folder


@pytest.mark.parametrize("plate", [".", "sh010.####.png", "sh010.%04d.png", "sh010.*.png", "sh010.1003.png"])
def test_a_sequence_is_named_by_folder_pattern_or_one_picture(tmp_path, plate):
    folder = touch(tmp_path / "plate", *(f"sh010.{n}.png" for n in (1003, 998, 1001)), ".sh010.1002.png", "notes.txt")
    assert {n: path.name for n, path in plate_files(folder / plate).items()} == {
        n: f"sh010.{n}.png" for n in (998, 1001, 1003)
    }
    assert list(plate_files(folder / plate)) == [998, 1001, 1003]


def test_the_number_is_the_last_one_of_the_name():
    assert frame_number("take2_v3.0007") == 7
    assert frame_number("take2_0012_graded") == 12
    assert frame_number("plate") is None


def test_two_sequences_in_a_folder_are_told_apart_by_a_pattern(tmp_path):
    folder = touch(tmp_path / "plates", "a.0001.png", "b.0001.png", "a.0001.exr")
    with pytest.raises(BadInput, match=r"several sequences.*a.####.png"):
        plate_files(folder)
    assert [path.name for path in plate_files(folder / "a.####.png").values()] == ["a.0001.png"]


@pytest.mark.parametrize(
    ("names", "plate", "told"),
    [
        ((), ".", "no numbered pictures"),
        (("plate.png",), "plate.png", "no numbered picture"),
        (("a.1.png", "a.01.png"), ".", "is frame 1, as"),
        (("a.1.png",), "b.####.png", "no numbered pictures"),
        ((), "nowhere/a.####.png", "no such folder"),
    ],
)
def test_what_is_no_sequence_is_refused(tmp_path, names, plate, told):
    folder = touch(tmp_path / "plate", *names)
    with pytest.raises(BadInput, match=told):
        plate_files(folder / plate)
