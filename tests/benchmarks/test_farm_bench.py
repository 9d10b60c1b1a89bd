"""Jobs per hour: the batch that is measured solves each capture anew, and the table says what side by side is worth."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import farm, farm_section
from headless.job_file import read_jobs
from tests.box_room import write_nerfstudio_room


def test_jobs_take_turns_and_share_no_seed(tmp_path: Path) -> None:
    """Two jobs of one seed would share traced transport."""
    rooms = [tmp_path / "a", tmp_path / "b"]
    path = tmp_path / "jobs.toml"
    path.write_text(farm.job_file(rooms, 5, "draft", repeat=1))
    jobs = read_jobs(path)
    assert [job.capture.name for job in jobs] == ["a", "b", "a", "b", "a"]
    assert [job.config.seed for job in jobs] == [5, 6, 7, 8, 9]


def record(parallel: int, seconds: float) -> dict:
    return {
        "run": {"captures": ["x/a"], "jobs": 6, "parallel": parallel, "preset": "draft", "repeat": 0},
        "seconds_total": seconds,
        "jobs_per_hour": 6 * 3600 / seconds,
        "job_seconds": [seconds / 6 * parallel] * 6,
        "machine": {"processor": "test", "cores": 2, "commit": "0"},
    }


def test_the_gain_is_against_one_at_a_time(tmp_path: Path) -> None:
    text = farm_section.describe([record(2, 144.0), record(1, 180.0)], tmp_path)
    assert "| draft | 6 | 1 | 180 | 30 | 120 | 1.00 |" in text
    assert "| draft | 6 | 2 | 144 | 48 | 150 | 1.25 |" in text


@pytest.mark.slow
def test_a_batch_is_measured(tmp_path: Path) -> None:
    room = write_nerfstudio_room(tmp_path / "room").root
    found = farm.measure([room], 2, 2, "draft", 0)
    assert len(found["job_seconds"]) == 2 and found["rays_traced"] > 0
    assert found["jobs_per_hour"] == pytest.approx(7200 / found["seconds_total"])
