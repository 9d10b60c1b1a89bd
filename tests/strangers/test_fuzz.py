"""Damaged files of every format: no raw exception, no hang, no gigabyte, and one line that names the file."""

from __future__ import annotations

import mmap
from pathlib import Path

import pytest

from tests.strangers.checks import Target, check
from tests.strangers.fuzz import CORPUS, fuzz
from tests.strangers.mutations import DAMAGE, Edit
from tests.strangers.readers import targets

SECONDS = 120.0


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Target]:
    """Every target by name."""
    return {target.name: target for target in targets(tmp_path_factory.mktemp("targets"))}


def test_good_files_are_read(known: dict[str, Target]) -> None:
    for target in known.values():
        target.read()
        assert check(target, target.good) is None


def test_everything_ever_found_stays_mended(known: dict[str, Target]) -> None:
    wrong = {}
    for path in sorted(CORPUS.glob("*")):
        name = path.stem.rpartition("-")[0]
        wrong[path.name] = check(known[name], path.read_bytes())
    assert {name: how for name, how in wrong.items() if how is not None} == {}


def test_a_reader_that_fails_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.strangers.checks.LARGE_BYTES", 100 << 20)
    path = tmp_path / "a.json"
    path.write_bytes(b"{}")

    def read() -> None:
        raise ValueError("raw")

    broken = Target(name="broken", root=tmp_path, path=path, read=read, good=b"{}")
    assert check(broken, b"{}") == "raises ValueError: raw"

    def fill() -> None:  # not from the heap, which may keep what earlier tests have freed
        memory = mmap.mmap(-1, 200 << 20)
        memory[:: mmap.PAGESIZE] = b"x" * (len(memory) // mmap.PAGESIZE)

    large = Target(name="large", root=tmp_path, path=path, read=fill, good=b"{}")
    assert (check(large, b"{}") or "").endswith("MiB")


def test_damage_changes_every_kind_of_file(known: dict[str, Target]) -> None:
    for target in known.values():
        damaged = {DAMAGE[target.path.suffix](target.good, Edit(how, 7919 * how, 104729 * how)) for how in range(12)}
        assert len(damaged - {target.good}) > 4, target.name


@pytest.mark.slow
def test_damaged_files_are_refused_by_one_line(tmp_path: Path) -> None:
    found: list[str] = []
    tried = fuzz(SECONDS, 1, tmp_path, lambda target, data, wrong: found.append(f"{target.name}: {wrong}"))
    assert sum(tried.values()) > 500 and found == []
