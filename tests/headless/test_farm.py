"""Farm bundles: the template is one that farms accept, its tasks do what a batch does, and paths follow the host."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from headless import cli
from headless.job_file import read_jobs
from headless.side_by_side import JOB_BYTES
from iris_addon.base.errors import BadInput
from tests.blender_home import ROOT
from tests.box_room import write_nerfstudio_room

LAMPS = json.dumps({"lights": [{"type": "point", "position": [0, 0, 1], "intensity": [5, 5, 5]}]})
JOBS = """
[[job]]
capture = "one"
preset = "draft"

[[job.frames]]
name = "still"
views = "one"
frames = "1-8"
chunk = 4
samples = 1

[[job.frames]]
command = "relight"
lights = "lamps.json"
views = "one"
frames = "1-4"
samples = 1

[[job]]
capture = "two"
preset = "draft"

[[job]]
capture = "bad"
"""


@pytest.fixture
def rooms(tmp_path) -> Path:
    """Two captures, one that is none, and a job file for all three."""
    for name in ("one", "two"):
        write_nerfstudio_room(tmp_path / name)
    (tmp_path / "bad").mkdir()
    (tmp_path / "lamps.json").write_text(LAMPS)
    (tmp_path / "jobs.toml").write_text(JOBS)
    return tmp_path


def bundle(rooms: Path) -> dict:
    assert cli.main(["farm", str(rooms / "jobs.toml"), "--out", str(rooms / "bundle")]) == 0
    return json.loads((rooms / "bundle" / "template.json").read_text())


def test_the_template_is_valid_and_its_steps_wait_for_what_they_need(rooms):
    model = pytest.importorskip("openjd.model", reason="openjd-model is not installed")
    template = bundle(rooms)
    job = model.decode_job_template(template=template)
    waits = {s["name"]: [d["dependsOn"] for d in s.get("dependencies", [])] for s in template["steps"]}
    assert waits["Frames one/still"] == ["Solve one"] and waits["Solve two"] == []
    assert waits["First frame one/relight"] == ["Solve one"]
    assert waits["Frames one/relight"] == ["First frame one/relight"]  # all share the exposure of the first
    assert set(waits["Summary"]) == set(waits) - {"Summary"}
    assert job.name == "IRIS jobs"
    chunks = next(s for s in template["steps"] if s["name"] == "Frames one/still")["parameterSpace"]
    assert chunks["taskParameterDefinitions"][0]["range"] == "0-1"
    assets = json.loads((rooms / "bundle" / "asset_references.json").read_text())["assetReferences"]
    assert str(rooms / "lamps.json") in assets["inputs"]["filenames"]
    assert str(rooms / "one") in assets["inputs"]["directories"]


def test_chunks_cover_every_frame_once(rooms):
    frames = read_jobs(rooms / "jobs.toml")[0].frames[0]
    covered = [f for chunk in range(frames.chunks) for f in range(*_half_open(frames.frames_of(chunk)))]
    assert covered == list(range(frames.first, frames.last + 1))


def _half_open(frames: tuple[int, int]) -> tuple[int, int]:
    return frames[0], frames[1] + 1


def test_absolute_paths_follow_the_mapping_of_the_host(tmp_path):
    (tmp_path / "jobs.toml").write_text('[[job]]\ncapture = "Z:\\\\rooms\\\\a"\n[[job]]\ncapture = "/mnt/rooms/b"\n')
    rules = [
        {"source_path_format": "WINDOWS", "source_path": "Z:\\rooms", "destination_path": "/srv/rooms"},
        {"source_path_format": "POSIX", "source_path": "/mnt", "destination_path": "/wrong"},
        {"source_path_format": "POSIX", "source_path": "/mnt/rooms", "destination_path": "/srv/rooms"},
    ]
    (tmp_path / "rules.json").write_text(json.dumps({"version": "pathmapping-1.0", "path_mapping_rules": rules}))
    jobs = read_jobs(tmp_path / "jobs.toml", tmp_path / "rules.json")
    assert [job.capture for job in jobs] == [Path("/srv/rooms/a"), Path("/srv/rooms/b")]
    (tmp_path / "rules.json").write_text('{"path_mapping_rules": [1]}')
    with pytest.raises(BadInput, match="path mapping rules"):
        read_jobs(tmp_path / "jobs.toml", tmp_path / "rules.json")


PLATE = """
[[job]]
capture = "one"

[[job.frames]]
command = "onto-plate"
plate = "sh010"
camera = "sh010.json"
objects = "ball.json"
frames = "1001-1024"
name = "sh010"
"""


def test_the_frames_of_a_plate_are_chunks_that_wait_for_the_solve_alone(rooms):
    (rooms / "sh010").mkdir()
    (rooms / "jobs.toml").write_text(PLATE)
    steps = {step["name"]: step for step in bundle(rooms)["steps"]}
    assert list(steps) == ["Solve one", "Frames one/sh010", "Summary"]
    chunks = steps["Frames one/sh010"]["parameterSpace"]["taskParameterDefinitions"][0]
    assert chunks["range"] == "0-2" and read_jobs(rooms / "jobs.toml")[0].frames[0].frames_of(2) == (1021, 1024)
    inputs = json.loads((rooms / "bundle" / "asset_references.json").read_text())["assetReferences"]["inputs"]
    assert str(rooms / "sh010") in inputs["directories"] and str(rooms / "sh010.json") in inputs["filenames"]


def test_a_chunk_of_a_plate_is_a_command_of_its_own(rooms, monkeypatch):
    ran = []
    monkeypatch.setattr("headless.batch.run_command", lambda words, _progress: ran.append(words) or {})
    (rooms / "jobs.toml").write_text(PLATE)
    assert cli.main(["batch", str(rooms / "jobs.toml"), "--only", "one/sh010", "--chunk", "1"]) == 0
    command = ran[0]
    assert command[0] == "onto-plate" and command[command.index("--frames") + 1] == "1011-1020"
    cli.make_parser().parse_args([*command, "--json"])  # nothing but options that the command has


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ('camera = "a.json"', None),
        ('views = "a.json"', "views is not for onto-plate"),
        ("onto_photos = true", "onto_photos is not for onto-plate"),
    ],
)
def test_a_plate_has_its_own_keys(rooms, line, told):
    (rooms / "jobs.toml").write_text(PLATE.replace('camera = "sh010.json"', line) + ("" if told is None else CAMERA))
    if told is None:
        assert read_jobs(rooms / "jobs.toml")[0].frames[0].command == "onto-plate"
        return
    with pytest.raises(BadInput, match=told):
        read_jobs(rooms / "jobs.toml")


CAMERA = 'camera = "sh010.json"\n'


SCENE = """
[[job]]
capture = "one"

[[job.frames]]
command = "composite"
scene = "sh020.blend"
frames = "0-11"
chunk = 6
samples = 4
name = "sh020"
"""


@pytest.mark.parametrize("plate", [True, False])
def test_the_frames_of_a_blend_travel_with_it(rooms, monkeypatch, plate):
    """Onto a plate each frame has an exposure of its own; without one all share that of the first."""
    (rooms / "sh020.blend").write_bytes(b"BLENDER")
    (rooms / "jobs.toml").write_text(SCENE + ("" if plate else 'exposure = "auto"\n'))
    steps = [step["name"] for step in bundle(rooms)["steps"]]
    first = [] if plate else ["First frame one/sh020"]
    assert steps == ["Solve one", *first, "Frames one/sh020", "Summary"]
    inputs = json.loads((rooms / "bundle" / "asset_references.json").read_text())["assetReferences"]["inputs"]
    assert str(rooms / "sh020.blend") in inputs["filenames"]
    ran = []
    monkeypatch.setattr("headless.batch.run_command", lambda words, _progress: ran.append(words) or {})
    assert cli.main(["batch", str(rooms / "jobs.toml"), "--only", "one/sh020", "--chunk", "1"]) == 0
    args = cli.make_parser().parse_args([*ran[0], "--json"])  # nothing but options that the command has
    assert (args.blend, args.result) == (rooms / "sh020.blend", rooms / "jobs" / "one")
    assert list(args.frames) == list(range(6, 12)) and args.resume and args.samples == 4


def test_frames_of_a_blend_that_has_changed_are_not_kept_beside_new_ones(rooms, monkeypatch, capsys):
    """A task that is run again keeps what is there; after another export it says so, and renders nothing."""
    ran = []
    monkeypatch.setattr("headless.batch.run_command", lambda words, _progress: ran.append(words) or {})
    (rooms / "sh020.blend").write_bytes(b"BLENDER as it was")
    (rooms / "jobs.toml").write_text(SCENE)
    task = ["batch", str(rooms / "jobs.toml"), "--only", "one/sh020", "--chunk", "0"]
    assert cli.main(task) == 0
    out = read_jobs(rooms / "jobs.toml")[0].frames[0].out
    (out / "frame_0001.png").write_bytes(b"finished")
    assert cli.main(task) == 0 and len(ran) == 2
    (rooms / "sh020.blend").write_bytes(b"BLENDER as it is")
    assert cli.main(task) == 3 and len(ran) == 2
    assert "frames of sh020.blend as it was before" in capsys.readouterr().err
    (out / "frame_0001.png").unlink()
    assert cli.main(task) == 0 and len(ran) == 3


def test_what_a_blend_links_to_goes_with_it(rooms):
    (rooms / "sh020.blend").write_bytes(b"BLENDER")
    (rooms / "sh020.files").mkdir()
    (rooms / "jobs.toml").write_text(SCENE)
    bundle(rooms)
    inputs = json.loads((rooms / "bundle" / "asset_references.json").read_text())["assetReferences"]["inputs"]
    assert str(rooms / "sh020.files") in inputs["directories"]


@pytest.mark.parametrize("line", ['views = "one"', "linear = true", "fps = 24", 'exposure = "photo"', 'plate = "a"'])
def test_a_blend_has_its_own_views_and_rate(rooms, line):
    (rooms / "jobs.toml").write_text(f"{SCENE}{line}\n")
    with pytest.raises(BadInput, match=line.split()[0]):
        read_jobs(rooms / "jobs.toml")


def test_layers_are_of_plates_alone(rooms):
    (rooms / "jobs.toml").write_text(PLATE + "layers = true\n")
    frames = read_jobs(rooms / "jobs.toml")[0].frames[0]
    cli.make_parser().parse_args([frames.command, "result", *frames.options, "--out", "out"])
    assert "--layers" in frames.options
    insert = (
        PLATE.replace("onto-plate", "insert").replace('plate = "sh010"\n', "").replace('camera = "sh010.json"\n', "")
    )
    (rooms / "jobs.toml").write_text(insert + "layers = true\n")
    with pytest.raises(BadInput, match="layers is not for insert"):
        read_jobs(rooms / "jobs.toml")


def test_only_names_a_job_of_the_file(rooms, capsys):
    assert cli.main(["batch", str(rooms / "jobs.toml"), "--only", "three"]) == 3
    assert "its jobs are one, one/still" in capsys.readouterr().err
    assert cli.main(["batch", str(rooms / "jobs.toml"), "--only", "one", "--chunk", "0"]) == 3
    assert cli.main(["batch", str(rooms / "jobs.toml"), "--only", "one/still", "--chunk", "2"]) == 3


def test_one_job_runs_whatever_the_memory_and_a_second_one_only_with_enough(monkeypatch):
    from argparse import Namespace

    from headless import side_by_side

    args = Namespace(parallel=2)
    monkeypatch.setattr(side_by_side, "free_bytes", lambda: JOB_BYTES - 1)
    assert side_by_side._room(args, 0) and not side_by_side._room(args, 1)
    monkeypatch.setattr(side_by_side, "free_bytes", lambda: JOB_BYTES)
    assert side_by_side._room(args, 1) and not side_by_side._room(args, 2)


STUB = """
const fs = require("fs");
const author = {
    Task: (name, type) => ({name, type, commands: [], after: [],
        addCommand(command) { this.commands.push(command); }, addDependency(task) { this.after.push(task.name); }}),
    Command: (name, parameters) => ({name, ...parameters}),
};
const tasks = [];
const job = JSON.parse(fs.readFileSync(process.argv[3]));
eval(fs.readFileSync(process.argv[2], "utf8") + "; compileJob({settings: job.settings, addTask: t => tasks.push(t)});");
console.log(JSON.stringify(tasks));
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="there is no Node.js to run the job type")
def test_flamenco_gets_the_same_tasks(rooms):
    bundle(rooms)
    (rooms / "stub.js").write_text(STUB)
    files = [ROOT / "assets" / "farm" / "iris-rooms.js", rooms / "bundle" / "flamenco_job.json"]
    ran = subprocess.run(
        ["node", str(rooms / "stub.js"), *map(str, files)], capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr
    tasks = {task["name"]: task for task in json.loads(ran.stdout)}
    second = tasks["Frames one/still 2"]
    assert second["after"] == ["Solve one"] and second["type"] == "blender-render"
    (command,) = second["commands"]
    assert command["name"] == "exec" and command["exe"] == "iris"
    assert command["args"] == ["batch", str(rooms / "jobs.toml"), "--only", "one/still", "--chunk", "1"]
    assert cli.make_parser().parse_args(command["args"]).chunk == 1  # a command line that iris takes
    assert set(tasks["Summary"]["after"]) == set(tasks) - {"Summary"}


# ---- run -----------------------------------------------------------------------------------------------------------


def openjd_command(rooms: Path, step: str, *more: str) -> list[str]:
    """``openjd run`` of one step, with a program iris of its own that writes its process id into a file."""
    iris = rooms / "iris"
    iris.write_text(
        f"#!{sys.executable}\nimport os, sys\nsys.path.insert(0, {str(ROOT)!r})\n"
        f"with open({str(rooms / 'pid')!r}, 'w') as file:\n    file.write(str(os.getpid()))\n"
        "from headless.cli import main\nsys.exit(main())\n"
    )
    iris.chmod(0o755)
    command = [sys.executable, "-m", "openjd", "run", str(rooms / "bundle" / "template.json"), "--step", step]
    return [*command, "-p", f"Jobs={rooms / 'jobs.toml'}", "-p", f"Iris={iris}", *more]


def openjd(rooms: Path, step: str, *more: str) -> subprocess.CompletedProcess:
    command = openjd_command(rooms, step, *more)
    return subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)


def openjd_killed(rooms: Path, step: str, there: Callable[[], bool], *more: str) -> None:
    """Run one step until something is ``there``, and kill iris as the system does that runs out of memory."""
    (rooms / "pid").unlink(missing_ok=True)
    command = openjd_command(rooms, step, *more)
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as farm:
        while not there():
            assert farm.poll() is None, f"{step} ended before it could be killed"
            time.sleep(0.01)
        os.kill(int((rooms / "pid").read_text()), signal.SIGKILL)
        assert farm.wait(timeout=120) != 0


def contents(folder: Path, pattern: str) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.glob(pattern))}


@pytest.mark.slow
@pytest.mark.bpy
@pytest.mark.skipif(os.name == "nt", reason="the program is a script with a #! line")
def test_a_farm_writes_the_bytes_of_a_batch_also_when_killed_and_a_bad_capture_fails_alone(rooms):
    pytest.importorskip("openjd.cli", reason="openjd-cli is not installed")
    assert cli.main(["batch", str(rooms / "jobs.toml"), "--parallel", "2"]) == 1
    summary = json.loads((rooms / "jobs" / "summary.json").read_text())["jobs"]
    status = {line["name"]: line["status"] for line in summary}
    assert status == {"one": "done", "one/still": "done", "one/relight": "done", "two": "done", "bad": "failed"}
    (rooms / "jobs").rename(rooms / "by batch")

    bundle(rooms)
    assert openjd(rooms, "Solve bad").returncode != 0
    out = rooms / "jobs" / "one"
    openjd_killed(rooms, "Solve one", lambda: any((out / "checkpoints").glob("lights.npz")))
    assert not (out / "report.json").exists()
    for step in ("Solve two", "Solve one", "First frame one/relight", "Frames one/relight"):
        ran = openjd(rooms, step)
        assert ran.returncode == 0, ran.stdout + ran.stderr
        assert "openjd_progress: 100.0" in ran.stdout
    still = out / "still"
    openjd_killed(rooms, "Frames one/still", lambda: (still / "frame_0006.png").exists(), "--task-param", "Chunk=1")
    one = openjd(rooms, "Frames one/still", "--task-param", "Chunk=1")
    assert one.returncode == 0 and len(contents(still, "frame_*.png")) == 4
    assert openjd(rooms, "Frames one/still").returncode == 0  # retried: the frames that are there are kept
    for name in ("one/still", "one/relight"):
        expected = contents(rooms / "by batch" / name, "frame_*.png")
        assert expected and contents(rooms / "jobs" / name, "frame_*.png") == expected
    for name in ("one", "two"):
        for pattern in ("materials/*", "emitters.json", "response.json"):
            expected = contents(rooms / "by batch" / name, pattern)
            assert expected and contents(rooms / "jobs" / name, pattern) == expected, (name, pattern)
    assert cli.main(["batch", str(rooms / "jobs.toml"), "--summary"]) == 1
    lines = json.loads((rooms / "jobs" / "summary.json").read_text())["jobs"]
    assert {line["name"]: line["status"] for line in lines} == status
    assert "frames" in lines[1]["figures"] and "has not run" not in lines[0]["error"]
