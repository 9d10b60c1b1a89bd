from __future__ import annotations

import json
import subprocess
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from benchmarks import runs, tables
from benchmarks.configurations import CONFIGURATIONS, Configuration
from benchmarks.mitsuba_scene import share_into_room
from benchmarks.perturb import AXES
from benchmarks.profile_floor import StageProgress, counted
from benchmarks.profile_section import Counts, Floors, floor_table
from benchmarks.runs import Run, run_all
from iris_addon.base.errors import BadInput
from iris_addon.base.progress import Progress
from iris_addon.rays.tracer import Tracer
from iris_addon.transport.aimed_rays import SparseRays
from tests.box_room import box_mesh
from tests.truth_room import write_truth_room


def record(run: Run, **metrics: float) -> dict:
    return {
        "run": asdict(run), "seconds_total": 10.0, "seconds_run": 12.0, "seconds": {"photos": 1.0},
        "peak_memory_bytes": 2**30,
        "rays_traced": 10**6, "n_patches": 1000, "machine": {"processor": "test", "cores": 2, "commit": "0"},
        "metrics": metrics,
    }  # fmt: skip


# ---- runs ----------------------------------------------------------------------------------------------------------


def test_a_finished_run_is_not_repeated_and_a_failed_one_is(tmp_path, monkeypatch):
    started = []

    def fake(command: list[str], **_options) -> subprocess.CompletedProcess:
        run = json.loads(command[4])
        started.append(run["seed"])
        if run["seed"] == 1:
            return subprocess.CompletedProcess(command, 3, "", "warning\nerror: no lamps — add some\n")
        Path(command[3]).parent.mkdir(parents=True, exist_ok=True)
        Path(command[3]).write_text(json.dumps(record(Run(**run))))
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(runs.subprocess, "run", fake)
    todo = [Run("room", seed=seed) for seed in range(3)]
    first = run_all(todo, tmp_path, Progress())
    assert [r["run"]["seed"] for r in first] == [0, 1, 2] and started == [0, 1, 2]
    assert first[1]["error"] == "no lamps — add some"
    run_all(todo, tmp_path, Progress(), jobs=2)
    assert started == [0, 1, 2, 1]
    run_all([Run("room", seed=0, samples=8)], tmp_path, Progress())
    assert started[-1] == 0, "other settings are another run"


def test_every_run_has_a_record_of_its_own():
    one = Run("a/room")
    others = [Run("a/hall"), Run("a/room", "gamma"), Run("a/room", preset="draft"), Run("a/room", seed=1),
              Run("a/room", axis="pose", level=1), Run("a/room", axis="pose", level=2)]  # fmt: skip
    assert len({run.key for run in (one, *others)}) == 7
    assert Run("a/room", axis="pose").key == one.key, "level 0 of every axis is the capture as it is"


# ---- configurations ------------------------------------------------------------------------------------------------


def test_a_switch_the_engine_lacks_is_named(tmp_path):
    odd = Configuration("odd", "", lambda _capture, _scratch: {"seed": 1, "warp": 9})
    with pytest.raises(BadInput, match="warp"):
        odd.solve_config("draft", 0, tmp_path, tmp_path)


def test_the_mask_is_that_of_the_true_lamps_unless_a_sweep_put_one(tmp_path):
    root = write_truth_room(tmp_path / "room")
    settings = CONFIGURATIONS["iris-like"].settings
    with pytest.raises(BadInput, match="not recorded"):
        settings(root, tmp_path)
    (root / "gt" / "emitters.json").write_text(json.dumps([{"faces": [10, 11]}]))
    written = settings(root, tmp_path)["emitters"]
    assert json.loads(Path(str(written)).read_text()) == {"emitters": [{"faces": [[10, 11]]}]}
    (root / "mask.json").write_text('{"emitters": []}')
    assert settings(root, tmp_path)["emitters"] == root / "mask.json"


def test_the_mean_response_is_a_curve_the_engine_reads(tmp_path):
    from iris_addon.response.photometry import read_response

    path = CONFIGURATIONS["mean-response"].settings(tmp_path, tmp_path)["response"]
    samples = read_response(Path(str(path))).samples
    assert (np.diff(samples) >= 0).all() and 0.4 < samples[0, 256] < 0.8


# ---- tables --------------------------------------------------------------------------------------------------------


def test_the_failure_point_is_the_first_level_three_decibels_down():
    values = np.array([[20, 22], [19, 21], [17.5, 18.4], [10, 12.0]])
    assert tables.failure_level(values) == 2
    assert tables.failure_level(values[:2]) is None
    values[1] = np.nan
    assert tables.failure_level(values) == 1, "a level where every seed crashed has failed"
    assert tables.failure_level(np.array([[20, 22], [21, np.nan]])) is None


def test_slopes_are_exponents():
    x = np.array([1e4, 1e5, 1e6])
    assert tables.loglog_slope(x.tolist(), (3 * x**1.5).tolist()) == pytest.approx(1.5)


def test_rows_of_failed_runs_are_left_out_of_means():
    good = [record(Run("room", seed=s), kd_psnr=20.0 + s) for s in range(3)]
    groups = tables.group([*good, {"run": asdict(Run("room")), "error": "x"}], lambda row: row["configuration"])
    assert tables.cell(groups["ours"], "kd_psnr") == "21.00 ± 1.00"
    assert tables.cell(groups["ours"], "nvs_psnr") == "–"


# ---- profile -------------------------------------------------------------------------------------------------------


def test_rays_are_counted_in_the_stage_that_casts_them():
    progress, tracer = StageProgress(), Tracer(box_mesh())
    ray = np.array([[1.0, 1.0, 1.0]]), np.array([[0.0, 0.0, 1.0]])
    with counted(progress) as counts:
        with progress.stage("transport"):
            tracer.hit_faces(np.repeat(ray[0], 5, 0), np.repeat(ray[1], 5, 0))
        with progress.stage("lights"):
            tracer.visible(ray[0], ray[0] + 0.5)
            tracer.closest(*ray)
    tracer.closest(*ray)
    assert counts.closest == {"transport": 5, "lights": 1} and counts.occluded == {"lights": 1}


def test_bytes_are_counted_of_every_sparse_product():
    progress, n = StageProgress(), 3
    kernel = csr_matrix(np.eye(n, dtype=np.float32))
    index = np.zeros(5, np.int32)
    rays = SparseRays(n_rows=n, row=index, weight=np.ones((5, 1), np.float32), target=index, face=index)
    with counted(progress) as counts, progress.stage("lights"):
        assert np.array_equal(kernel @ np.ones(n, np.float32), np.ones(n))
        assert counts.moved["lights"] == 4 * (n * (2 + 1) + n)
        rays.gather_radiance(np.ones((n, 3)), np.zeros(3), np.zeros(1, bool))
        assert counts.moved["lights"] == 4 * (n * (2 + 1) + n) + 4 * (5 * 6 + n * 3)


def test_the_floor_is_rays_over_throughput_plus_bytes_over_bandwidth():
    counts = Counts()
    counts.closest["transport"], counts.occluded["transport"], counts.moved["transport"] = 4_000_000, 1_000_000, 10**10
    floors = Floors(2e6, 1e6, 1e10)
    assert counts.floor("transport", floors) == pytest.approx(2 + 1 + 1)
    text = floor_table({"photos": 2.0, "transport": 10.0}, counts, floors, "test")
    assert (
        "| transport | 10.0 | 5.00 | 10.00 | 4.00 | 2.5 |" in text and "| **all** | 12.0 |  |  | 4.00 | 3.0 |" in text
    )


# ---- charts --------------------------------------------------------------------------------------------------------


def test_the_pareto_front_rises():
    charts = pytest.importorskip("benchmarks.charts", reason="matplotlib is not installed")
    assert charts.pareto_front([10, 5, 20, 20], [21, 20, 20.5, np.nan]) == [1, 0]
    assert charts.pareto_front([10, 10], [21, 22]) == [1]


def test_a_sweep_is_collected_drawn_and_summed_up(tmp_path):
    stability = pytest.importorskip("benchmarks.stability", reason="matplotlib is not installed")
    from benchmarks import stability_section as section

    axes = ["pose", "mask_missed"]
    measured = []
    for run in stability.planned(Path("room"), axes, 2):
        drop = (6.0 if run.configuration == "iris-like" else 1.0) * run.level + run.seed
        measured.append(record(run, kd_psnr_all_valid=25 - drop, relight_psnr=22 - drop, emission_log_l2=0.1))
    # Ours searches for lamps: a wrong mask is nothing to it, and no run is spent on that.
    assert not any(r["run"]["axis"] == "mask_missed" and r["run"]["configuration"] == "ours" for r in measured)
    values = section.collect(measured, axes, 2)
    assert values["mask_missed", "ours", "kd_psnr_all_valid"].std(0).max() == 0
    assert section.failure(values, "pose", "ours") == 4 and section.failure(values, "pose", "iris-like") == 1
    summary = section.describe([stability.slim(entry) for entry in measured], tmp_path)
    pose = "[error of the poses](images/benchmarks/stability-pose.png)"
    assert f"| {pose} | 2 cm and half degrees | 4.0 | 4.0 | 0.25 cm and half degrees | 24.0 | 24.0 |" in summary
    missed = "[given mask: lamps missed](images/benchmarks/stability-mask_missed.png)"
    assert f"| {missed} | never | 0.0 | 0.0 | 0.25 share | 24.0 | 24.0 |" in summary
    assert summary.index("error of the poses") < summary.index("lamps missed"), "what breaks first stands first"
    assert (tmp_path / "stability-pose.png").stat().st_size > 10_000


def bench_room(tmp_path: Path, name: str) -> Path:
    """A folder that looks like a capture with ground truth."""
    root = tmp_path / name
    (root / "gt" / "train" / "DiffCol").mkdir(parents=True)
    return root


def bench_records(planned: list[Run]) -> list[dict]:
    measured = []
    for run in planned:
        scores = {"kd_psnr": 20.0 + run.seed, "crf_l2": 1.5}
        measured.append(record(run, **(scores if run.scored == "maps" else scores | {"relight_psnr": 22.0})))
    return measured


def test_a_benchmark_is_charted_and_tabled(tmp_path):
    section = pytest.importorskip("benchmarks.speed_section", reason="matplotlib is not installed")
    from benchmarks import bench

    planned = bench.planned([bench_room(tmp_path, "room"), tmp_path / "scan"], bench.STUDIES, 3, 8)
    assert {run.configuration for run in planned} == set(CONFIGURATIONS)
    assert {run.configuration for run in planned if run.capture.endswith("scan")} == {"ours"}
    assert all(run.scored == "maps" for run in planned if run.seed), "further seeds render nothing"
    measured = bench_records(planned)
    (ours,) = [p for p in section.speed_points(measured[:7], "kd_psnr") if p.name == "ours"]
    assert len(ours.seconds) == 3 and ours.spread[0] == (20.0, 22.0) and ours.line
    measured += [record(Run("room", "mitsuba-prb", "60 s"), kd_psnr=15.0, relight_psnr=21.0)]
    text = section.describe(measured, tmp_path / "images")
    assert (tmp_path / "images" / "room.png").is_file() and (tmp_path / "images" / "summary.svg").is_file()
    assert "| ours balanced | 10 ± 0 | 21.00 ± 1.00 |" in text
    assert "![Speed against accuracy, summary](images/benchmarks/summary.png)" in text


@pytest.mark.parametrize(("reached", "said"), [(21.0, "the speed-up is over 120"), (23.0, "120.0 times as long")])
def test_the_speed_up_over_mitsuba_is_at_equal_relighting(reached, said):
    section = pytest.importorskip("benchmarks.speed_section", reason="matplotlib is not installed")

    peer = record(Run("room", "mitsuba-prb", "1200 s"), relight_psnr=reached) | {"seconds_total": 1200.0}
    text = section.all_tables([record(Run("room"), relight_psnr=22.0), peer])
    assert said in text and "relight 22.00 dB after 10 s" in text


def test_captures_count_the_same_whatever_their_seeds():
    rows = [{"capture": "a", "x": 1.0}, {"capture": "a", "x": 3.0}, {"capture": "b", "x": 4.0}]
    assert tables.mean_over_captures(rows, "x") == 3.0
    assert tables.number(tables.mean_over_captures([], "x")) == "–"


def test_the_page_is_filled_from_the_committed_records_alone(tmp_path):
    report = pytest.importorskip("benchmarks.report", reason="matplotlib is not installed")
    from benchmarks.records import pack

    page, readme = tmp_path / "page.md", tmp_path / "readme.md"
    page.write_text("before\n<!-- measured: bench -->\nold\n<!-- end -->\nafter\n")
    readme.write_text("<!-- measured: balanced -->\nold\n<!-- end -->\n")

    def write() -> str:
        report.write(["bench"], tmp_path, tmp_path / "images", page, readme)
        return page.read_text()

    assert write() == f"before\n<!-- measured: bench -->\n{report.NOT_MEASURED}\n<!-- end -->\nafter\n"
    pack("bench", [record(Run("room"), kd_psnr=20.0), record(Run("hall"), kd_psnr=21.0)], tmp_path)
    first = write()
    assert "#### room" in first and "old" not in first and first.startswith("before\n") and first.endswith("after\n")
    assert write() == first, "the same records give the same page"
    assert "| `kd_psnr`, dB | higher | 21.0 | 20.0 |" in readme.read_text()
    assert "| `crf_l2` | lower | n/a | n/a |" in readme.read_text()


def test_the_page_of_the_repository_has_a_place_for_every_section():
    report = pytest.importorskip("benchmarks.report", reason="matplotlib is not installed")
    text = report.PAGE.read_text(encoding="utf-8")
    assert all(f"<!-- measured: {name} -->" in text for name in report.SECTIONS)
    assert "<!-- measured: balanced -->" in report.README.read_text(encoding="utf-8")


def test_scaling_prints_slopes_and_the_limiting_stage(tmp_path):
    scaling = pytest.importorskip("benchmarks.scaling_section", reason="matplotlib is not installed")
    measured = [
        {
            "run": {"sweep": "triangles", "preset": "balanced"}, "actual_size": n,
            "seconds_total": 10 + n / 1e4, "peak_memory_bytes": 2**30,
            "rays_traced": 10**7, "seconds": {"surface": 1.0, "textures": n / 1e4},
        }
        for n in (10_000, 100_000, 1_000_000)
    ]  # fmt: skip
    text = scaling.describe(measured, tmp_path)
    assert "Limiting stage at 10⁷ triangles: textures." in text and "| textures | 100.0 | 1.00 | 1000 |" in text


def test_curves_are_spread_to_both_ends_and_summed_up_by_percentile(tmp_path):
    curves = pytest.importorskip("benchmarks.curves", reason="matplotlib is not installed")
    from benchmarks.curves_section import describe

    ranks = curves.spread(94, 5)
    assert ranks[0] == 0 and ranks[-1] == 93 and np.ptp(np.diff(ranks)) <= 1
    assert curves.spread(3, 24) == [0, 1, 2]
    measured = [
        {
            "run": {"capture": "assets/demo_room", "rank": rank, "exposures": "known", "preset": "draft"},
            "metrics": {"crf_l2": 0.1 * number, "kd_psnr": 30.0 + number},
        }
        for number, rank in enumerate(ranks)
    ]  # fmt: skip
    text = describe(measured[::-1], tmp_path)
    assert "| known | 5 | 0.20 | 0.36 | 0.40 | 32.0 | 30.4 | 30.0 |" in text and "withheld" not in text
    assert (tmp_path / "curves.png").stat().st_size > 10_000


def test_axes_start_at_the_capture_and_have_five_levels():
    for axis in AXES.values():
        assert len(axis.levels) >= 5 and len(set(axis.levels)) == len(axis.levels)


# ---- Mitsuba -------------------------------------------------------------------------------------------------------


def test_only_the_side_of_a_lamp_that_faces_the_room_shines():
    tracer = Tracer(box_mesh())
    room = np.ones(12, bool)
    room[10] = False
    inside = 1.0 if tracer.normals[10, 2] < 0 else -1.0
    shares = [share_into_room(tracer, np.array([10]), sign, room) for sign in (inside, -inside)]
    assert shares[0] > 0.95 and shares[1] == 0


def test_the_target_of_a_photo_is_the_radiance_behind_it():
    from benchmarks.peer_mitsuba import Target, stops_until
    from iris_addon.model.response import gamma

    exposed = np.linspace(0.02, 0.95, 24).reshape(2, 4, 3)
    target = Target.of((np.floor(255 * gamma().apply(exposed)) / 255).astype(np.float32), gamma())
    assert target.exposed == pytest.approx(exposed, rel=0.03) and not target.clipped.any()
    assert Target.of(np.ones((1, 1, 3), np.float32), gamma()).clipped.all()
    assert stops_until(100) == (30, 60, 100) and stops_until(1200)[-1] == 1200


@pytest.mark.slow
def test_mitsuba_asks_of_clipped_pixels_only_that_they_clip():
    pytest.importorskip("mitsuba")
    from benchmarks.mitsuba_scene import load_mitsuba
    from benchmarks.peer_mitsuba import Target, photo_loss
    from iris_addon.base.errors import SolverEnvironmentMissing
    from iris_addon.model.response import gamma

    try:
        mi = load_mitsuba()
    except SolverEnvironmentMissing as error:
        pytest.skip(str(error))
    import drjit as dr

    def loss(exposed: float, photo: float) -> float:
        image = mi.TensorXf(np.full((1, 1, 3), exposed, np.float32))
        target = Target.of(np.full((1, 1, 3), photo, np.float32), gamma())
        return float(photo_loss(dr, mi, image, target).array[0])

    assert loss(2.0, 1.0) == 0 and loss(0.5, 1.0) > 0.01
    assert loss(2.0, 0.9) > 0.1 and loss(0.5, 0.5 ** (1 / 2.2)) < 1e-4


@pytest.mark.parametrize("said", [[], ["scaling"]])
def test_all_sections_are_written_unless_some_are_named(monkeypatch, said):
    report = pytest.importorskip("benchmarks.report", reason="matplotlib is not installed")
    written = []
    monkeypatch.setattr(report, "write", written.extend)
    assert report.main(said) == 0
    assert written == (said or list(report.SECTIONS))


def test_what_was_published_stands_in_the_chart_and_on_the_page_with_its_caveat():
    """Figures of other rooms and protocols would pass for points of ours."""
    charts = pytest.importorskip("benchmarks.charts", reason="matplotlib is not installed")
    page = (runs.ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8")
    for source, name in (("2512.13157", "IIF"), ("2601.23065", "EAG-PT"), ("2601.15283", "LuxRemix")):
        (row,) = [line for line in page.splitlines() if source in line]
        *_, caveat = [cell.strip() for cell in row.strip("| ").split("|")]
        assert name in row and len(caveat) > 20
        drawn = [p for figures in charts.PUBLISHED.values() for p in figures if p.name.startswith(name)]
        assert drawn and all("," in figure.name and f"{figure.value:g}" in row for figure in drawn)
