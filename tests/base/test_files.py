"""Files replaced in one step, also while another program holds them for a moment."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from iris_addon.base import files
from iris_addon.base.errors import IrisError
from iris_addon.base.files import atomic_write


def held(monkeypatch: pytest.MonkeyPatch, times: int) -> list[int]:
    """os.replace as Windows has it while a scanner holds the target: it fails so many times."""
    replace, count = os.replace, [0]

    def flaky(source: Path, target: Path) -> None:
        count[0] += 1
        if count[0] <= times:
            raise PermissionError(13, "Access is denied")
        replace(source, target)

    monkeypatch.setattr(files.os, "replace", flaky)
    return count


def test_a_file_held_for_a_moment_is_replaced_after_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.txt").write_text("old")
    count = held(monkeypatch, 3)
    atomic_write(tmp_path / "a.txt", lambda path: path.write_text("new"))
    assert (tmp_path / "a.txt").read_text() == "new" and count == [4]


def test_a_file_held_for_longer_stays_what_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.txt").write_text("old")
    held(monkeypatch, 10**6)
    monkeypatch.setattr(files, "REPLACE_SECONDS", 0.05)
    with pytest.raises(IrisError, match="cannot be written"):
        atomic_write(tmp_path / "a.txt", lambda path: path.write_text("new"))
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"] and (tmp_path / "a.txt").read_text() == "old"
