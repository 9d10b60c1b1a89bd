"""Tables of rooms that we render ourselves, and captures that are rendered once."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from benchmarks import made_rooms, rooms
from benchmarks.made_rooms_section import describe_mirrors, describe_sunlit


def record(room: str, metrics: dict[str, float]) -> dict:
    return {
        "run": {"capture": f"x/{room}", "configuration": "ours", "preset": "draft", "seed": 0, "axis": "", "level": 0},
        "seconds_total": 61.4,
        "lamps": 2,
        "metrics": metrics,
        "machine": {"processor": "test", "cores": 2, "commit": "0"},
    }


def test_rooms_stand_above_what_is_asked_of_them(tmp_path: Path) -> None:
    found = record("blind", {"sun_degrees": 0.144, "sun_irradiance": 1.07, "nvs_psnr": 27.6})
    text = describe_sunlit([record("pane", {"kd_psnr_8x8": 15.9}), found], tmp_path)
    rows = [line.split(" | ") for line in text.splitlines() if line.startswith("| ")]
    assert [row[0] for row in rows] == ["| room", "| ---", "| blind", "| pane", "| **mark**"]
    assert rows[2][2:5] == ["2", "0.14", "1.07"] and rows[2][8] == "27.60"
    assert rows[3][3:6] == ["–", "–", "15.90"], "no sun was found"
    assert len({len(row) for row in rows}) == 1


def test_rooms_without_marks_have_no_row_of_them(tmp_path: Path) -> None:
    text = describe_mirrors([record("steel", {"nvs_psnr": 31.234})], tmp_path)
    rows = [line for line in text.splitlines() if line.startswith("| ")]
    assert len(rows) == 3 and "steel" in rows[2] and "31.23" in rows[2]


def test_rooms_of_another_set_and_sets_that_do_not_exist_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    for wrong in (["mirrors", "pane"], ["moonlit"], []):
        with pytest.raises(SystemExit) as refused:
            made_rooms.main(wrong)
        assert refused.value.code == 2
    assert "sunlit" in capsys.readouterr().err


def test_a_room_is_rendered_where_it_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []

    def run(command: list[str], **_settings: object) -> None:
        made.append(command[3])
        capture = Path(command[command.index("--out") + 1])
        capture.mkdir(parents=True)
        (capture / "meta.json").write_text("{}")

    monkeypatch.setattr(subprocess, "run", run)
    for _ in range(2):
        assert rooms.rendered("sunlit_room", "pane", tmp_path) == tmp_path / "pane"
    assert made == ["pane"]
