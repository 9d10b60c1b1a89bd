"""Folders and files as an attacker makes them: second names, pipes in the place of what is written, small bombs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import nullcontext, suppress
from pathlib import Path

import numpy as np
import pytest

from headless import cli
from headless.job_file import read_jobs
from iris_addon.base import untrusted
from iris_addon.base.errors import BadInput
from iris_addon.base.glb_chunks import pack_chunks
from iris_addon.blender.worker import process
from iris_addon.capture.mesh_files import read_mesh
from iris_addon.results import checkpoints
from iris_addon.results.folder import load_result, save_result
from tests.blender_home import ROOT
from tests.box_room import box_mesh, write_mesh, write_nerfstudio_room
from tests.result_room import room

BLOCKED_SECONDS = 120.0
posix = pytest.mark.skipif(os.name == "nt", reason="pipes and devices have no names there")


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    """A file of the user."""
    path = tmp_path / "home" / "authorized_keys"
    path.parent.mkdir()
    path.write_text("mine")
    return path


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


# ---- what is written into a result folder of a stranger -------------------------------------------------------------


@pytest.mark.parametrize("link", [os.symlink, os.link], ids=["symbolic", "hard"])
def test_a_log_is_a_new_file(secret: Path, tmp_path: Path, link: Callable) -> None:
    """Solve in the panel writes it into the folder of the result, which an archive may have filled."""
    log = tmp_path / "result" / "solve.log"
    log.parent.mkdir()
    link(secret, log)
    worker = process.Worker([sys.executable, "-c", "print('text of a worker')"], log)
    worker.wait()
    worker.close()
    assert secret.read_text() == "mine" and "text of a worker" in log.read_text()


@posix
def test_a_pipe_in_the_place_of_a_log_does_not_block_blender(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "solve.log")
    script = f"""
import sys; sys.path.insert(0, {str(ROOT)!r})
from pathlib import Path
from iris_addon.blender.worker import process
worker = process.Worker([sys.executable, "-c", "print(chr(97))"], Path({str(tmp_path / "solve.log")!r}))
worker.wait(); worker.close()
"""
    subprocess.run([sys.executable, "-c", script], timeout=BLOCKED_SECONDS, check=True)
    assert (tmp_path / "solve.log").read_text().strip() == "a"


def test_a_lock_that_is_another_file_too_is_not_emptied(secret: Path, tmp_path: Path) -> None:
    (tmp_path / "result").mkdir()
    os.link(secret, tmp_path / "result" / ".lock")
    with pytest.raises(BadInput, match="no file of this folder alone"), checkpoints.sole_writer(tmp_path / "result"):
        pass
    assert secret.read_text() == "mine"


@posix
@pytest.mark.parametrize("kind", ["loop", "pipe", "device", "folder"])
def test_a_lock_that_is_no_file_is_refused(kind: str, tmp_path: Path) -> None:
    lock = tmp_path / ".lock"
    make = {"loop": lambda: lock.symlink_to(lock), "pipe": lambda: os.mkfifo(lock), "folder": lock.mkdir}
    make.get(kind, lambda: lock.symlink_to("/dev/zero"))()
    with pytest.raises(BadInput, match=r"\.lock"), checkpoints.sole_writer(tmp_path):
        pass


def test_second_names_of_the_files_of_a_result_keep_their_content(secret: Path, tmp_path: Path) -> None:
    """A save replaces names; the file behind them stays."""
    folder = tmp_path / "result"
    save_result(room(), folder)
    for name in ("report.json", "response.json", "materials/roughness.png"):
        (folder / name).unlink()
        os.link(secret, folder / name)
    save_result(room(), folder)
    assert secret.read_text() == "mine" and load_result(folder).report


@posix
@pytest.mark.parametrize("name", [".whole", "materials", ".whole/materials"])
@pytest.mark.parametrize("target", ["../home", "sub/../../home", ".", "loop"])
def test_reading_moves_nothing_through_links_of_any_kind(secret: Path, tmp_path: Path, name: str, target: str) -> None:
    folder = tmp_path / "result"
    save_result(room(), folder)
    (folder / "sub").mkdir()
    place = folder / name
    place.parent.mkdir(exist_ok=True)
    if place.exists():
        place.rename(folder / "kept")
    place.symlink_to(place if target == "loop" else Path("../" * name.count("/") + target))
    before = contents(secret.parent)
    # Whether the rest is a result or not: it is read or refused, and nothing is moved.
    code = cli.main(["camera", str(folder), "--out", str(tmp_path / "out")])
    assert code in (0, 3) and contents(secret.parent) == before and place.is_symlink()
    with pytest.raises(BadInput) if name != ".whole/materials" else nullcontext():
        save_result(room(), folder)
    assert contents(secret.parent) == before


@posix
def test_a_folder_that_is_exchanged_for_a_link_between_check_and_use_loses_nothing_outside(
    secret: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The attacker wins the race for .whole: what is moved are files that the link shows under names of a result."""
    from iris_addon.results import files

    folder = tmp_path / "result"
    save_result(room(), folder)
    real = files.require_no_links

    def exchanged(path: Path) -> None:
        real(path)
        (path / files.WHOLE).symlink_to(secret.parent)

    monkeypatch.setattr(files, "require_no_links", exchanged)
    before = contents(secret.parent)
    with suppress(OSError):  # rmtree refuses links
        files.complete_save(folder)
    assert contents(secret.parent) == before


# ---- code beside a file ---------------------------------------------------------------------------------------------

TRAPS = ("sitecustomize.py", "usercustomize.py", "numpy.py", "torch.py", "headless.py", "iris_addon.py", "json.py")


@pytest.fixture
def trap(tmp_path: Path) -> Path:
    """A current folder full of code that leaves a file behind when it is run."""
    folder = tmp_path / "trap"
    folder.mkdir()
    code = f"open({str(tmp_path / 'PWNED')!r}, 'a').write(__name__ + '\\n')\n"
    for name in TRAPS:
        (folder / name).write_text(code)
    (folder / "evil.pth").write_text(f"import os; {code}")
    (folder / "pyvenv.cfg").write_text(f"home = {folder}\ninclude-system-site-packages = true\n")
    (folder / "lib").mkdir()
    for name in TRAPS:
        (folder / "lib" / name).write_text(code)
    return folder


@pytest.mark.parametrize("variables", [{}, {"PYTHONPATH": "."}, {"PYTHONPATH": "", "PYTHONSTARTUP": "numpy.py"}])
def test_no_command_runs_code_of_the_current_folder(
    trap: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variables: dict[str, str]
) -> None:
    """The worker leaves out what its own Python was told; its folder is the program's."""
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    monkeypatch.chdir(trap)
    worker = process.Worker([sys.executable, "-B", str(ROOT / "headless" / "run.py"), "camera", "x", "--out", "y"])
    worker.wait()
    worker.close()
    test = [sys.executable, "-I", "-B", str(ROOT / "headless" / "make_environment.py"), "--test", sys.executable]
    worker = process.Worker(test)
    worker.wait()
    worker.close()
    if "PYTHONPATH" not in variables:  # whoever sets it for a shell has asked for it
        run = [sys.executable, "-B", str(ROOT / "headless" / "run.py"), "camera", "x", "--out", "y"]
        assert subprocess.run(run, capture_output=True, check=False).returncode == 3
    assert not (tmp_path / "PWNED").exists(), (tmp_path / "PWNED").read_text()


@pytest.mark.bpy
@pytest.mark.parametrize("reader", ["synth", "composite", "probe"])
def test_a_blend_runs_no_code_whatever_the_preferences_say(tmp_path: Path, reader: str) -> None:
    """A text that registers itself, and a driver; whoever lets their own files run has not asked for this one."""
    script = f"""
import sys
sys.path.insert(0, {str(ROOT)!r})
from pathlib import Path
import bpy
folder = Path({str(tmp_path)!r})
text = bpy.data.texts.new("run.py")
text.write(f"open({{str(folder / 'PWNED')!r}}, 'a')")
text.use_module = True
thing = bpy.data.objects.new("thing", None)
bpy.context.scene.collection.objects.link(thing)
driver = thing.driver_add("location", 0).driver
driver.type, driver.expression = "SCRIPTED", f"[open({{str(folder / 'PWNED')!r}}, 'a'), 0.0][1]"
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "stranger.blend"))
(folder / "PWNED").unlink(missing_ok=True)
bpy.context.preferences.filepaths.use_scripts_auto_execute = True
from iris_addon.blender.insert import photo_composite, probe
from iris_addon.blender.synth import run
from iris_addon.model.render_settings import RenderSettings
blend = folder / "stranger.blend"
read = {{
    "synth": lambda: run._open(blend, (32, 24)),
    "composite": lambda: photo_composite.open_scene(blend),
    "probe": lambda: probe.probe_file(
        blend, (0, 0, 0), folder / "a.exr", width=8, settings=RenderSettings(samples=1)
    ),
}}[{reader!r}]
try:
    read()
except Exception as error:
    print(type(error).__name__)
bpy.context.view_layer.update()
assert "thing" in bpy.data.objects
print("RAN", (folder / "PWNED").exists())
"""
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert "RAN False" in ran.stdout, ran.stdout + ran.stderr


# ---- small files that cost much -------------------------------------------------------------------------------------

BOMBS = {
    "a name of many parts": ".".join("a" * 300_000) + " = 1\n",
    "a table of many parts": "[" + ".".join("a" * 300_000) + "]\n",
    "quoted parts": ".".join(['"a"'] * 200_000) + " = 1\n",
    "many names of some parts": "".join(f"a{k}{'.b' * 60} = 1\n" for k in range(20_000)),
    "lists in lists": "a = " + "[" * 200_000,
    "tables in tables": "a = " + "{a = " * 200_000,
    "a long number": f"a = {'9' * 400_000}\n",
}


@pytest.mark.parametrize("text", BOMBS.values(), ids=BOMBS.keys())
def test_a_job_file_that_is_a_bomb_is_refused_at_once(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "jobs.toml"
    path.write_text(text)
    if "." in text:  # the time that a parser takes for a name is the square of its parts: it is not asked
        monkeypatch.setattr(untrusted.tomllib, "loads", lambda _: pytest.fail("it is parsed"))
    with pytest.raises(BadInput, match=r"jobs\.toml"):
        read_jobs(path)


def test_a_long_list_of_photos_is_no_bomb(tmp_path: Path) -> None:
    path = tmp_path / "jobs.toml"
    names = [f"IMG.2026.{k}.jpg" for k in range(500)]
    path.write_text("".join(f'[[job]]\ncapture = "../a.b"\nname = "{k}"\nexclude = {names}\n' for k in range(3)))
    assert [len(job.exclude) for job in read_jobs(path)] == [500, 500, 500]


def test_a_bundle_of_millions_of_tasks_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = "".join(f'[[job.frames]]\nname = "{k}"\nframes = "1-1000000"\nchunk = 1\n' for k in range(50))
    (tmp_path / "jobs.toml").write_text(f'[[job]]\ncapture = "a"\n{frames}')
    assert cli.main(["farm", str(tmp_path / "jobs.toml"), "--out", str(tmp_path / "bundle")]) == 3
    assert "50000002 tasks" in capsys.readouterr().err


@pytest.mark.bpy
@pytest.mark.parametrize("name", ["chair.gltf", "chair.usda", "chair.glb"])
def test_what_an_importer_of_blender_prints_is_not_the_error(tmp_path: Path, name: str) -> None:
    """That of glTF prints every step of its parser; the error is a line at the end, and no other begins like it."""
    content = {
        "chair.gltf": b'{"asset": {"version": "2.0"}, "scenes": "x\\nerror: spoofed"}',
        "chair.usda": b"#usda 1.0\nerror: spoofed\n",
        "chair.glb": pack_chunks({"asset": {"version": "2.0"}, "scenes": "x\nerror: spoofed"}, b""),
    }
    (tmp_path / name).write_bytes(content[name])
    save_result(room(), tmp_path / "r")
    write_nerfstudio_room(tmp_path / "room")
    (tmp_path / "o.json").write_text(json.dumps({"objects": [{"file": name, "location": [0, 0, 0]}]}))
    command = [sys.executable, str(ROOT / "headless" / "run.py"), "insert", "r", "--objects", "o.json"]
    command += ["--views", "room", "--only", "000", "--out", "o"]
    ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    errors = [line for line in ran.stderr.splitlines() if line.startswith("error: ")]
    assert ran.returncode == 3 and len(errors) == 1 and name in errors[0] and ran.stderr.endswith(f"{errors[0]}\n")
    assert "Traceback" not in ran.stderr and "File " not in ran.stderr, ran.stderr


# ---- files within files ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", ["buffers", "images"])
@pytest.mark.parametrize(
    "uri",
    ["../secret.bin", "%2e%2e/secret.bin", "{folder}/secret.bin", "file://{folder}/secret.bin", "..%2fsecret.bin"],
)
def test_a_glb_does_not_read_what_lies_outside(tmp_path: Path, key: str, uri: str) -> None:
    """Its buffer lies in another file: what stands there would become the mesh, or hang if it were a pipe."""
    path = tmp_path / "capture" / "mesh.glb"
    path.parent.mkdir()
    write_mesh(path, box_mesh())
    data = path.read_bytes()
    length = int.from_bytes(data[12:16], "little")
    document, rest = json.loads(data[20 : 20 + length]), data[20 + length :]
    (tmp_path / "secret.bin").write_bytes(rest[8:])
    named = uri.format(folder=tmp_path.as_posix())
    if key == "buffers":
        document["buffers"][0]["uri"], rest = named, b""
    else:
        document["images"] = [{"uri": named}]
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    head = np.array([20 + len(text) + len(rest), len(text)], "<u4").tobytes()
    path.write_bytes(data[:8] + head + data[16:20] + text + rest)
    opened: list[str] = []

    def audit(event: str, arguments: tuple) -> None:
        if event == "open" and "secret.bin" in str(arguments[0]):
            opened.append(str(arguments[0]))

    sys.addaudithook(audit)
    if key == "buffers":
        with pytest.raises(BadInput, match=r"mesh\.glb"):
            read_mesh(path)
    else:
        assert len(read_mesh(path)[0].faces) == 12
    assert opened == []
