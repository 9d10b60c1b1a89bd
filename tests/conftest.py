"""Fixtures shared by the tests: a tiny synthetic capture in both layouts, and the folder of public captures."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.box_room import RoomCapture, write_fipt_room, write_nerfstudio_room


@pytest.fixture
def nerfstudio_room(tmp_path: Path) -> RoomCapture:
    return write_nerfstudio_room(tmp_path / "room")


@pytest.fixture
def fipt_room(tmp_path: Path) -> RoomCapture:
    return write_fipt_room(tmp_path / "fipt_room")


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of public captures beside the repository; skips where it is missing."""
    folder = Path(__file__).resolve().parents[2] / "shared"
    if not (folder / "captures").is_dir():
        pytest.skip("the folder shared/ with the public captures is not beside the repository")
    return folder
