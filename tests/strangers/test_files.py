"""The one place that opens, decodes and checks files that somebody else made."""

from __future__ import annotations

import io
import json
import os
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from iris_addon.base.errors import BadInput, IrisError
from iris_addon.base.files import atomic_write, flush_to_disk, remove_abandoned, write_json
from iris_addon.base.untrusted import decoding, finite, open_file, parse_json, read_arrays, read_json, read_npy
from iris_addon.results.files import result_file
from iris_addon.results.folder import load_result, save_result
from tests.result_room import room


def refused(call, *arguments) -> str:
    """The message of the refusal: one line that says what to do."""
    with pytest.raises(BadInput) as caught:
        call(*arguments)
    message = str(caught.value)
    assert " — " in message and message.isprintable()
    return message


# ---- opening --------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(sys.platform == "win32", reason="no named pipes in folders")
def test_a_pipe_a_device_and_a_folder_are_no_files(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "lights.json")
    (tmp_path / "zero.json").symlink_to("/dev/zero")
    (tmp_path / "folder.json").mkdir()
    for name in ("lights.json", "zero.json", "folder.json"):
        assert f"{name}: is a folder, pipe or device" in refused(read_json, tmp_path / name)


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    with (tmp_path / "a.json").open("wb") as file:
        file.truncate(1 << 40)
    assert "a.json: is larger than 256 MiB" in refused(read_json, tmp_path / "a.json")


def test_names_that_cannot_be_are_refused() -> None:
    for name in ("a\0b", "x" * 5000):
        refused(open_file, Path(name), 10)


@pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege there")
def test_a_result_shows_no_file_from_outside_of_its_folder(tmp_path: Path) -> None:
    save_result(room(), tmp_path / "r")
    (tmp_path / "r" / "response.json").rename(tmp_path / "response.json")
    (tmp_path / "r" / "response.json").symlink_to(tmp_path / "response.json")
    assert "response.json: is a link that leads out" in refused(load_result, tmp_path / "r")
    (tmp_path / "again").symlink_to(tmp_path / "r")  # the folder itself may be one
    assert result_file(tmp_path / "again", "report.json").is_file()


# ---- decoding -------------------------------------------------------------------------------------------------------


class Surprise(Exception):
    """What no decoder has raised yet."""


@pytest.mark.parametrize("error", [Surprise("one\ntwo\x1b[2J"), KeyError("a"), MemoryError(), OverflowError()])
def test_any_failure_of_a_decoder_is_an_error_of_its_file(error: Exception) -> None:
    def decode() -> None:
        with decoding(Path("photo.png")):
            raise error

    assert refused(decode).startswith("photo.png: is damaged (")


def test_messages_are_one_line_whatever_they_quote() -> None:
    error = BadInput("key 'a\nerror: spoofed\x1b]0;title\x07\u202e\ud800'", "mend\n it", Path("a\nb"))
    assert str(error).isprintable() and "a error: spoofed" in str(error)
    assert len(str(BadInput("x" * 10**6, "y" * 10**6, "p"))) < 1100


def test_json_of_any_depth_and_integers_of_any_length_are_refused_or_read(tmp_path: Path) -> None:
    for depth in (100, 900, 100_000):
        text = b'{"a":' + b"[" * depth + b"]" * depth + b"}"
        assert "a.json" in refused(parse_json, text, Path("a.json"))
    assert parse_json(b'{"a": 1%s}' % (b"0" * 400), Path("a.json"))["a"] == float("inf")
    assert "a.json" in refused(parse_json, b'{"name": "\\ud800"}', Path("a.json"))
    assert parse_json(b'{"name": "\\ud83d\\ude00"}', Path("a.json"))["name"] == "😀"


@pytest.mark.parametrize(
    "value", [10**400, [1, 10**400], [[1], [1, 2]], "1", True, None, {}, float("nan"), -float("inf"), 1e31, ["1"]]
)
def test_what_is_no_finite_number_is_none(value: object) -> None:
    for shape in ((), (None,), (None, None)):
        assert finite(value, shape) is None


def test_numbers_have_the_shape_that_is_wanted() -> None:
    assert finite(3) == 3.0
    assert finite([1, 2.5], (2,)) is not None and finite([1, 2.5], (3,)) is None
    assert finite([], (None,)) is not None


# ---- .npy and .npz --------------------------------------------------------------------------------------------------


def npy(header: str, data: bytes = b"", magic: bytes = b"\x93NUMPY\x01\x00") -> bytes:
    text = header.encode() + b"\n"
    return magic + len(text).to_bytes(2, "little") + text + data


@pytest.mark.parametrize(
    "content",
    [
        b"PK\x03\x04 not a zip",
        npy("{'descr': '<f8', 'fortran_order': False, 'shape': (100000000000000,)}"),
        npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1%s,)}" % ("0" * 400)),
        npy("{'descr': '<f8', 'fortran_order': False, 'shape': (-1,)}"),
        npy("{'descr': '<f8', 'fortran_order': False, 'shape': (("),
        npy("{'descr': '<f8', 'fortran_order': False, 'shape': None}"),
        npy("{'descr': '|O', 'fortran_order': False, 'shape': (1,)}", b"\x80\x04N."),
        npy("{'descr': '<U4', 'fortran_order': False, 'shape': (1,)}", b"a\0\0\0" * 4),
        npy("{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (1,)}", b"\0" * 8),
        b"",
    ],
)  # fmt: skip
def test_an_npy_that_is_none_is_named(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.npy").write_bytes(content)
    assert "a.npy: is not a .npy file of numbers" in refused(read_npy, tmp_path / "a.npy", 1 << 20)


def test_an_archive_renamed_to_npy_is_named(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", x=np.ones(3))
    (tmp_path / "a.npz").rename(tmp_path / "a.npy")
    refused(read_npy, tmp_path / "a.npy", 1 << 20)


def test_arrays_of_numbers_come_back(tmp_path: Path) -> None:
    for values in (
        np.arange(6.0).reshape(2, 3),
        np.asfortranarray(np.arange(6).reshape(2, 3)),
        np.float32(3),
        np.empty(0),
    ):
        np.save(tmp_path / "a.npy", values)
        again = read_npy(tmp_path / "a.npy", 1 << 20)
        assert again.dtype == np.asarray(values).dtype and np.array_equal(again, values)


def damaged_archives() -> dict[str, bytes]:
    """An archive with one byte of its directory changed, which no checksum covers."""
    plain, compressed = io.BytesIO(), io.BytesIO()
    np.savez(plain, a=np.arange(100.0))
    np.savez_compressed(compressed, a=np.arange(100.0))
    found = {}
    for name, archive, offset, value in (
        ("method", plain, 10, 99),
        ("encrypted", plain, 8, 1),
        ("deflate", compressed, 10, 12),
        ("size", plain, 24, 255),
    ):
        data = bytearray(archive.getvalue())
        data[data.rindex(b"PK\x01\x02") + offset] = value
        found[name] = bytes(data)
    data = bytearray(compressed.getvalue())
    data[60:70] = b"\xff" * 10
    return {**found, "zlib": bytes(data), "cut": plain.getvalue()[:-40]}


@pytest.mark.parametrize("kind", ["method", "encrypted", "deflate", "size", "zlib", "cut"])
def test_a_damaged_cache_file_is_made_again(tmp_path: Path, kind: str) -> None:
    (tmp_path / "a.npz").write_bytes(damaged_archives()[kind])
    assert read_arrays(tmp_path / "a.npz") is None


def test_an_archive_that_decompresses_without_end_is_not_read(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        header = npy("{'descr': '|u1', 'fortran_order': False, 'shape': (200000000,)}")
        archive.writestr("a.npy", header + bytes(200_000_000))
    assert (tmp_path / "a.npz").stat().st_size < 1_000_000
    assert read_arrays(tmp_path / "a.npz") is None


# ---- writing --------------------------------------------------------------------------------------------------------


def test_a_file_is_on_the_disk_before_it_is_moved_and_its_name_after(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps: list[str] = []
    replace = os.replace
    monkeypatch.setattr(
        os, "fsync", lambda descriptor: steps.append(Path(f"/proc/self/fd/{descriptor}").readlink().name)
    )
    monkeypatch.setattr(os, "replace", lambda a, b: (steps.append("move"), replace(a, b)))
    if not Path("/proc/self/fd").is_dir():
        pytest.skip("descriptors have no names here")
    write_json(tmp_path / "a.json", {})
    assert steps[0].startswith(".a-") and steps[1:] == ["move", tmp_path.name]
    steps.clear()
    save_result(room(), tmp_path / "r")
    whole = steps.index("r")  # the folder after the save as a whole was moved there
    assert steps[whole - 1] == "move" and {"report.json", "mesh.glb", "materials"} <= set(steps[:whole])
    assert steps[-1] == "r"


def test_flushing_fails_as_the_disk_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    (tmp_path / "a").write_text("old")
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(IrisError, match="free some space"):
        atomic_write(tmp_path / "a", lambda path: path.write_text("new"))
    assert (tmp_path / "a").read_text() == "old" and len(list(tmp_path.iterdir())) == 1
    with pytest.raises(OSError, match="No space"):
        flush_to_disk(tmp_path / "a")


def test_what_a_killed_write_left_goes_and_nothing_else(tmp_path: Path) -> None:
    left = [".preview-albedo-0123abcd.png", ".x-89abcdef.json", ".log-01234567"]
    kept = ["a-0123abcd.png", ".hidden", ".x-0123abc.png", ".bashrc-0123ABCD"]
    for name in left + kept:
        (tmp_path / name).touch()
    remove_abandoned(tmp_path)  # they may be of a write that goes on
    assert len(list(tmp_path.iterdir())) == len(left + kept)
    for name in left + kept:
        os.utime(tmp_path / name, (0, 0))
    remove_abandoned(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(kept)


def test_a_name_that_cannot_be_is_an_error_of_its_path(tmp_path: Path) -> None:
    with pytest.raises(IrisError, match="not a usable path"):
        atomic_write(Path(f"{tmp_path}/a\0b"), lambda path: path.touch())


def test_readers_of_json_keep_to_objects(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(json.dumps([1]))
    assert "is not a JSON object" in refused(read_json, tmp_path / "a.json")
