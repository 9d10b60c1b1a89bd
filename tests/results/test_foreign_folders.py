"""Folders of a stranger, who put links into them: nothing outside is written, moved or deleted."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from iris_addon.base.errors import BadInput
from iris_addon.base.files import is_own_file, is_own_folder, require_own_folder
from iris_addon.base.progress import Progress
from iris_addon.blender.worker.process import Worker
from iris_addon.results.checkpoints import Checkpoints
from iris_addon.results.files import FILES, MATERIAL_FILES, WHOLE
from iris_addon.results.folder import load_result, save_result
from iris_addon.results.report import write_report
from tests.result_room import room

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege there")


@pytest.fixture
def victim(tmp_path: Path) -> Path:
    """Somebody's folder, with files called as ours are."""
    folder = tmp_path / "victim"
    for name in (*FILES, "authorized_keys", "data.npz", "lights.npz", "preview-albedo.png", "mesh.obj", "solve.log"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(f"precious {name}")
    return folder


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    save_result(room(), tmp_path / "r")
    return tmp_path / "r"


def contents(folder: Path) -> dict[str, bytes]:
    """Every file below ``folder``, links not followed."""
    files = (path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def whole_is_a_link(result: Path, victim: Path) -> None:
    (result / WHOLE).symlink_to(victim)


def whole_materials_is_a_link(result: Path, victim: Path) -> None:
    (result / WHOLE).mkdir()
    (result / WHOLE / "materials").symlink_to(victim / "materials")


def a_folder_of_the_result_is_a_link(result: Path, victim: Path) -> None:
    (result / WHOLE / "ssh").mkdir(parents=True)
    (result / WHOLE / "ssh" / "authorized_keys").write_text("evil key")
    (result / "ssh").symlink_to(victim)


def materials_is_a_link(result: Path, victim: Path) -> None:
    shutil.copytree(result / "materials", result / WHOLE / "materials")
    shutil.rmtree(result / "materials")
    (result / "materials").symlink_to(victim / "materials")


def files_are_links(result: Path, victim: Path) -> None:
    (result / WHOLE / "materials").mkdir(parents=True)
    for name in FILES:
        (result / WHOLE / name).symlink_to(victim / name)
        (result / name).unlink(missing_ok=True)
        (result / name).symlink_to(victim / name)


TRAPS = [
    whole_is_a_link,
    whole_materials_is_a_link,
    a_folder_of_the_result_is_a_link,
    materials_is_a_link,
    files_are_links,
]
Trap = Callable[[Path, Path], None]


@pytest.mark.parametrize("trap", TRAPS)
def test_reading_a_result_changes_nothing_anywhere(saved: Path, victim: Path, tmp_path: Path, trap: Trap) -> None:
    trap(saved, victim)
    before, listed = contents(tmp_path), sorted(tmp_path.rglob("*"))
    try:
        load_result(saved)
    except BadInput:  # some of these hold no result
        pass
    assert contents(tmp_path) == before and sorted(tmp_path.rglob("*")) == listed


@pytest.mark.parametrize("trap", TRAPS)
def test_saving_over_a_result_stays_in_its_folder(saved: Path, victim: Path, trap: Trap) -> None:
    trap(saved, victim)
    before = contents(victim)
    try:
        save_result(room(seed=1), saved)
    except BadInput as error:
        assert trap in (whole_is_a_link, materials_is_a_link)
        assert str(saved) in str(error) and "is a link" in str(error) and "delete it" in str(error)
    else:
        assert load_result(saved).exposures.keys() == room().exposures.keys()
        assert not (saved / WHOLE).exists() and not any((saved / name).is_symlink() for name in MATERIAL_FILES)
    assert contents(victim) == before


def test_only_files_of_a_result_are_taken_into_it(saved: Path) -> None:
    for name in ("evil.py", "materials/evil.py"):
        (saved / WHOLE / name).parent.mkdir(parents=True, exist_ok=True)
        (saved / WHOLE / name).write_text("import os")
    save_result(room(seed=1), saved)
    assert not list(saved.rglob("evil.py")) and not (saved / WHOLE).exists()


def test_checkpoints_that_are_a_link_are_left_alone(tmp_path: Path, victim: Path) -> None:
    before = contents(victim)
    out = tmp_path / "out"
    out.mkdir()
    (out / "checkpoints").symlink_to(victim)
    Checkpoints(out / "checkpoints", "key", False).clear()
    assert contents(victim) == before and (out / "checkpoints").is_symlink()


def test_clearing_checkpoints_takes_its_own_files_alone(tmp_path: Path) -> None:
    folder = tmp_path / "checkpoints"
    checkpoints = Checkpoints(folder, "key", False)
    checkpoints.stage("lights", lambda: {"values": np.ones(2)})
    left = (".lights-0123abcd.npz", ".preview-albedo-0123abcd.png", "preview-error.png")
    for name in (*left, "data.npz", "preview-holiday.png", ".lights-old.npz"):
        (folder / name).write_bytes(b"")
    checkpoints.clear()
    assert sorted(path.name for path in folder.iterdir()) == [".lights-old.npz", "data.npz", "preview-holiday.png"]


@pytest.mark.parametrize("name", ["checkpoints", "report", "materials", WHOLE])
def test_a_solve_refuses_a_linked_folder_before_it_begins(tmp_path: Path, victim: Path, name: str) -> None:
    from iris_addon import pipeline as solving

    before = contents(victim)
    out = tmp_path / "out"
    out.mkdir()
    (out / name).symlink_to(victim)
    with pytest.raises(BadInput, match="is a link or a file where a folder is written — delete it") as caught:
        solving.solve(SimpleNamespace(mismatch=None), None, out)  # type: ignore[arg-type] - nothing else is looked at
    assert str(out / name) in str(caught.value)
    assert contents(victim) == before


def test_the_report_and_the_check_refuse_linked_folders(tmp_path: Path, victim: Path) -> None:
    from iris_addon.capture.inspection import inspect

    before = contents(victim)
    for name in ("report", "photos"):
        (tmp_path / name).symlink_to(victim)
    with pytest.raises(BadInput, match="report: is a link"):
        write_report(room(), None, tmp_path, {})  # type: ignore[arg-type] - not looked at
    with pytest.raises(BadInput, match="photos: is a link"):
        inspect(None, tmp_path, Progress())  # type: ignore[arg-type]
    assert contents(victim) == before


def test_a_log_that_is_a_link_is_replaced(tmp_path: Path, victim: Path) -> None:
    (tmp_path / "solve.log").symlink_to(victim / "solve.log")
    worker = Worker([sys.executable, "-c", "print('said')"], tmp_path / "solve.log")
    worker.wait()
    worker.close()
    assert (tmp_path / "solve.log").read_text() == "said\n" and is_own_file(tmp_path / "solve.log")
    assert (victim / "solve.log").read_text() == "precious solve.log"


def test_links_and_files_are_no_own_folders(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "folder")
    (tmp_path / "dangling").symlink_to(tmp_path / "nothing")
    (tmp_path / "file").write_text("")
    assert is_own_folder(tmp_path / "folder") and not is_own_file(tmp_path / "folder")
    require_own_folder(tmp_path / "folder")
    require_own_folder(tmp_path / "missing")
    for name in ("link", "dangling", "file"):
        assert not is_own_folder(tmp_path / name)
        with pytest.raises(BadInput, match=f"{name}: is a link or a file"):
            require_own_folder(tmp_path / name)
