"""The commands that render: frames that resume, shares that mix, photos that stay, the camera for other programs."""

import json
from dataclasses import replace

import numpy as np
import OpenEXR
import pytest

from headless import cli
from headless.cli import FrameRange
from headless.frame_folder import open_frames, write_film
from iris_addon.base.color_spaces import ACESCG, REC709
from iris_addon.base.errors import BadInput
from iris_addon.base.images import read_exr, read_image, write_exr, write_png
from iris_addon.model.recovered import LightState
from iris_addon.model.response import gamma, identity
from iris_addon.results.folder import load_result, save_result
from tests.blender_room import camera, room

SIZE = {"w": 24, "h": 18, "fl_x": 15.0, "fl_y": 15.0, "cx": 12.0, "cy": 9.0}


@pytest.fixture
def solved(tmp_path):
    """A folder with a solved box room, two photos of it (noise: any will do), and their poses."""
    names = ["a", "b"]
    result = replace(
        room(emission={3: (8, 6, 4)}), response=gamma(), exposures={name: np.array([0.2, 0.25, 0.3]) for name in names}
    )
    save_result(result, tmp_path / "result")
    frames = []
    for k, name in enumerate(names):
        write_png(tmp_path / f"{name}.png", np.random.default_rng(k).integers(0, 256, (18, 24, 3), np.uint8))
        pose = camera(position=(0.3 * k, 0, 0.5)).c2w
        frames.append({"file_path": f"{name}.png", "transform_matrix": pose.tolist()})
    (tmp_path / "transforms.json").write_text(json.dumps({**SIZE, "frames": frames}))
    return tmp_path


def run(solved, command, *more, out="out", code=0):
    args = [command, str(solved / "result"), "--views", str(solved / "transforms.json"), "--samples", "2"]
    assert cli.main([*args, "--out", str(solved / out), *map(str, more)]) == code
    return solved / out


def write_job(folder, name, **job):
    (folder / name).write_text(json.dumps(job))
    return folder / name


# ---- light states --------------------------------------------------------------------------------------------------


@pytest.fixture
def in_states(solved):
    """The room with a green lamp, as photo "a" shows it, and with a red one, as photo "b" does."""
    green, red = np.array([0.0, 6.0, 0.0]), np.array([6.0, 0.0, 0.0])
    plain = replace(load_result(solved / "result"), emitters=room(emission={3: green, 2: np.zeros(3)}).emitters)
    states = (
        LightState("green", ("a",), np.array([green, np.zeros(3)])),
        LightState("red", ("b",), np.array([np.zeros(3), red])),
    )
    save_result(replace(plain, light_states=states), solved / "result")
    transforms = json.loads((solved / "transforms.json").read_text())
    for frame, state in zip(transforms["frames"], ("green", "red"), strict=True):
        frame["light_state"] = state
    (solved / "transforms.json").write_text(json.dumps(transforms))
    return solved


@pytest.mark.bpy
def test_views_are_rendered_in_the_light_state_that_is_asked_for_or_that_they_have(in_states):
    for more, channels in (
        (["--only", "b"], {"b": 0}),
        (["--only", "a"], {"a": 1}),
        (["--light-state", "red"], {"a": 0, "b": 0}),
        ([], {"a": 1, "b": 1}),
    ):
        out = run(in_states, "render", "--linear", *more, out="-".join(["out", *more]))
        for name, channel in channels.items():
            mean = read_exr(out / f"{name}.exr").mean((0, 1))
            assert mean[channel] > 1e-2 and mean[1 - channel] < 1e-2 * mean[channel]


def test_a_light_state_that_the_room_lacks_is_bad_input(in_states, capsys):
    run(in_states, "render", "--light-state", "blue", code=3)
    assert "no light state 'blue'" in capsys.readouterr().err


def test_things_are_put_onto_photos_of_one_light_state(in_states, capsys):
    job = write_job(in_states, "objects.json", views=[])
    run(in_states, "insert", "--objects", job, "--onto-photos", code=3)
    assert "photos of several light states" in capsys.readouterr().err


@pytest.mark.bpy
def test_frames_of_another_light_state_are_another_job(in_states, capsys):
    """Also where nobody asks for a state and the file of the views alone names another one."""
    again = ("render", "--only", "b", "--frames", "1")
    run(in_states, *again)
    listed = in_states / "transforms.json"
    as_it_was = listed.read_text()
    listed.write_text(as_it_was.replace("red", "green"))
    run(in_states, *again, code=3)
    assert "frames of another job" in capsys.readouterr().err
    listed.write_text(as_it_was)
    run(in_states, *again, "--light-state", "red")


# ---- frames --------------------------------------------------------------------------------------------------------


def test_ranges_of_frames():
    assert list(FrameRange.parse("3-5")) == [3, 4, 5]
    assert len(FrameRange.parse("7")) == 1
    for wrong in ("0-3", "5-3", "a", "-3", "1-x"):
        with pytest.raises(ValueError):
            FrameRange.parse(wrong)


def test_half_written_frames_are_not_finished_and_other_jobs_are_kept_out(tmp_path):
    frames = open_frames(tmp_path, 10, ".png", {"lights": 1})
    assert frames.time(1) == 0.0 and frames.time(6) == 0.5
    (tmp_path / ".frame_0001-8f3a.png").write_bytes(b"half")  # what a killed writer leaves
    frames.path(2).write_bytes(b"")
    assert not frames.finished(1) and not frames.finished(2)
    frames.path(3).write_bytes(b"whole")
    assert open_frames(tmp_path, 10, ".png", {"lights": 1}).finished(3)
    with pytest.raises(BadInput, match="another job"):
        open_frames(tmp_path, 10, ".png", {"lights": 2})
    (tmp_path / "frames.json").unlink()
    with pytest.raises(BadInput, match="another job"):
        open_frames(tmp_path, 10, ".png", {"lights": 1})


def test_a_job_that_made_no_frame_is_in_nobodys_way(tmp_path):
    open_frames(tmp_path, 10, ".png", {"lights": "wrong"}).remember(exposure=3.0)
    assert "exposure" not in open_frames(tmp_path, 10, ".png", {"lights": 2}).facts


def test_the_film_appears_whole_or_not_at_all(tmp_path, monkeypatch):
    frames = open_frames(tmp_path / "out", 2, ".png", {})
    write_png(frames.path(1), np.zeros((3, 3, 3), np.uint8))
    monkeypatch.setattr("headless.frame_folder.shutil.which", lambda _name: None)
    assert write_film(frames, 24) is None
    tool = tmp_path / "ffmpeg"
    tool.write_text('#!/bin/sh\nfor last; do :; done\necho film > "$last"\n')
    tool.chmod(0o755)
    monkeypatch.setattr("headless.frame_folder.shutil.which", lambda _name: str(tool))
    film = write_film(frames, 24)
    assert film is not None and film.read_text() == "film\n"
    tool.write_text("#!/bin/sh\necho broken >&2\nexit 1\n")
    with pytest.raises(Exception, match="broken"):
        write_film(frames, 24)
    assert {path.name for path in frames.folder.iterdir()} == {"frame_0001.png", "frames.json", "film.mp4"}
    gap = open_frames(tmp_path / "gap %d", 4, ".png", {})
    for frame in (1, 3):
        write_png(gap.path(frame), np.zeros((3, 3, 3), np.uint8))
    assert write_film(gap, 24) is None


@pytest.mark.bpy
def test_finished_frames_are_not_rendered_again_and_missing_ones_are(solved, monkeypatch):
    monkeypatch.setattr("headless.frame_folder.shutil.which", lambda _name: None)
    job = write_job(
        solved, "fade.json", recovered={"0": {"scale": {"keys": [[0, 1], [0.5, 0.01]]}}}, length=4, camera={"view": 1}
    )
    out = run(solved, "relight", "--lights", job, "--frames", "1-2")
    first = {path.name: path.stat().st_mtime_ns for path in out.glob("frame_*.png")}
    assert sorted(first) == ["frame_0001.png", "frame_0002.png"]
    (out / "frame_0002.png").unlink()
    run(solved, "relight", "--lights", job, "--frames", "1-3")
    assert (out / "frame_0001.png").stat().st_mtime_ns == first["frame_0001.png"]
    means = [read_image(out / f"frame_000{k}.png").mean() for k in (1, 2, 3)]
    assert means[0] > means[1] > means[2]  # one exposure for all, else a fade would not show
    other = write_job(solved, "other.json", recovered={}, length=4)
    run(solved, "relight", "--lights", other, "--frames", "1-3", code=3)


@pytest.mark.bpy
def test_a_camera_move_and_a_turning_object(solved, monkeypatch):
    monkeypatch.setattr("headless.frame_folder.shutil.which", lambda _name: None)
    out = run(solved, "render", "--frames", "1-3", "--linear", out="move")
    frames = [read_exr(out / f"frame_000{k}.exr") for k in (1, 2, 3)]
    assert np.abs(frames[0] - frames[2]).max() > 0.01
    bar = {"shape": "box", "size": [0.5, 0.05, 0.05], "location": [0, 0, -0.4], "base_color": 0, "turntable": {}}
    job = write_job(solved, "bar.json", objects=[bar], length=2)
    out = run(solved, "insert", "--objects", job, "--frames", "1-2", "--onto-photos", out="turn")
    photo = read_image(solved / "a.png").astype(int)
    for k in (1, 2):
        frame = read_image(out / f"frame_000{k}.png")
        assert np.abs(frame.astype(int) - photo)[7:11, 10:14].max() > 30


@pytest.mark.bpy
def test_renders_in_acescg_are_the_linear_ones_in_its_primaries(solved, monkeypatch):
    monkeypatch.setattr("headless.frame_folder.shutil.which", lambda _name: None)
    plain, aces = (run(solved, "render", option, out=option.strip("-")) for option in ("--linear", "--acescg"))
    expected = read_exr(plain / "a.exr") @ REC709.matrix_to(ACESCG).T
    np.testing.assert_allclose(read_exr(aces / "a.exr"), expected, rtol=1e-4, atol=1e-5)
    with OpenEXR.File(str(aces / "a.exr")) as file:
        np.testing.assert_allclose(np.ravel(file.header()["chromaticities"]), ACESCG.chromaticities, atol=1e-6)
    run(solved, "render", "--frames", "1-1", "--linear", out="film")
    run(solved, "render", "--frames", "1-2", "--acescg", out="film", code=3)  # no film of two color spaces


# ---- photos --------------------------------------------------------------------------------------------------------


@pytest.mark.bpy
def test_an_empty_list_of_objects_returns_the_photo(solved):
    job = write_job(solved, "none.json", views=[{"view": 0, "objects": []}, {"view": 1}])
    out = run(solved, "insert", "--objects", job, "--onto-photos")
    for name in ("a", "b"):
        np.testing.assert_array_equal(read_image(out / f"{name}.png"), read_image(solved / f"{name}.png"))


@pytest.mark.bpy
def test_a_photo_that_shows_nothing_of_its_objects_is_named(solved, capsys):
    """The first ball stands in front of its camera, the second behind it."""
    balls = [{"shape": "sphere", "radius": 0.1, "location": [0, 0, z]} for z in (0.0, 0.9)]
    job = write_job(solved, "balls.json", views=[{"view": view, "objects": [balls[view]]} for view in (0, 1)])
    run(solved, "insert", "--objects", job, "--onto-photos")
    told = capsys.readouterr().out
    assert "b.png shows none of its objects" in told and "a.png shows" not in told


@pytest.mark.bpy
def test_light_onto_a_photo_is_linear_on_request(solved):
    ball = {"shape": "sphere", "radius": 0.2, "pixel": [12, 17]}
    job = write_job(solved, "ball.json", objects=[ball])
    out = run(solved, "insert", "--objects", job, "--onto-photos", "--linear")
    radiance, photo = read_exr(out / "a.exr"), read_image(solved / "a.png") / 255
    expected = gamma().invert(photo) / np.array([0.2, 0.25, 0.3])
    np.testing.assert_allclose(radiance[0], expected[0], rtol=0.2, atol=0.02)


@pytest.mark.bpy
def test_layers_of_a_photo_add_up_to_it(solved):
    """A dark ball in the first photo; the second stays as it is."""
    ball = {"shape": "sphere", "radius": 0.2, "pixel": [12, 17], "base_color": 0.1}
    job = write_job(solved, "ball.json", views=[{"view": 0, "objects": [ball]}, {"view": 1, "objects": []}])
    out = run(solved, "insert", "--objects", job, "--onto-photos", "--layers", "--linear")

    def layer(file: dict, name: str) -> np.ndarray:
        return np.stack([file[f"{name}{channel}"].pixels for channel in "RGB"], -1)

    for view in ("a", "b"):
        with OpenEXR.File(str(out / f"{view}-layers.exr"), separate_channels=True) as file:
            held = dict(file.channels())
            picture, plate, catcher, thing = (layer(held, name) for name in ("", "plate.", "catcher.", "object."))
            alpha = held["object.A"].pixels[..., None].copy()
        np.testing.assert_allclose(plate * (1 - alpha) + catcher + thing, picture, rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(picture, read_exr(out / f"{view}.exr"), rtol=1e-5, atol=1e-6)
        if view == "a":
            assert alpha.max() == 1 and (alpha == 0).mean() > 0.5
            np.testing.assert_allclose(thing[alpha[..., 0] == 1], picture[alpha[..., 0] == 1], rtol=1e-5)
            assert catcher.min() < -1e-3, "the ball takes light from what it stands on"
        else:
            assert not alpha.any() and not catcher.any() and not thing.any()
    run(solved, "insert", "--objects", job, "--layers", code=3)


@pytest.mark.bpy
def test_photos_that_hold_radiance_are_changed_in_their_own_unit(solved):
    """EXR photos at an exposure: kept as they are without objects, and an object in them is as bright as they are."""
    result = replace(
        room(emission={3: (8, 6, 4)}), response=identity(), exposures={name: np.full(3, 4.0) for name in ("a", "b")}
    )
    save_result(result, solved / "result")
    poses = json.loads((solved / "transforms.json").read_text())
    for frame in poses["frames"]:
        name = frame["file_path"].removesuffix(".png")
        write_exr(solved / f"{name}.exr", np.full((18, 24, 3), 1.5, np.float32))
        frame.update(file_path=f"{name}.exr", exposure=4.0)
    lamp = {"shape": "sphere", "radius": 0.2, "location": [0, 0, -0.4], "base_color": 0, "emission": 30}
    nothing, job = write_job(solved, "none.json", objects=[]), write_job(solved, "lamp.json", objects=[lamp])
    run(solved, "insert", "--objects", job, "--onto-photos", code=3)  # photos of an unknown response
    (solved / "transforms.json").write_text(json.dumps(poses))
    np.testing.assert_array_equal(read_exr(run(solved, "insert", "--objects", nothing, "--onto-photos") / "a.exr"), 1.5)
    inserted = read_exr(run(solved, "insert", "--objects", job, "--onto-photos") / "a.exr")
    np.testing.assert_allclose(inserted[9, 12], 4.0 * 30.0, rtol=0.05)


@pytest.mark.parametrize(
    ("command", "options", "job", "told"),
    [
        ("render", ["--light-shares", "--frames", "1-2"], None, "leave out --light-shares or --frames"),
        ("relight", ["--shares", "shares", "--frames", "1-2"], {}, "leave out --shares or --frames"),
        ("render", ["--light-shares", "--exposure", "2"], None, "leave out --light-shares or --exposure"),
        ("insert", ["--onto-photos", "--exposure", "auto"], {}, "leave out --onto-photos or --exposure"),
        ("insert", [], {"views": [{"view": 1}, {"view": 0}, {"view": 1}]}, "names view 1 twice"),
        ("insert", ["--onto-photos", "--frames", "1-2"], {"camera": {"view": 1}}, "a photo stays where it is"),
    ],
)
def test_options_that_cannot_both_be_followed_are_refused(solved, capsys, command, options, job, told):
    if job is not None:
        option = {"relight": "--lights", "insert": "--objects"}[command]
        options = [*options, option, write_job(solved, "job.json", **job)]
    assert not run(solved, command, *options, code=3).exists()
    assert told in capsys.readouterr().err


# ---- shares, camera ------------------------------------------------------------------------------------------------


@pytest.mark.bpy
def test_shares_are_mixed_without_rendering(solved, monkeypatch):
    shares = run(solved, "render", "--light-shares", out="shares")
    whole = run(solved, "render", "--linear", out="whole")
    job = write_job(solved, "twice.json", recovered={"0": {"scale": 2}})
    monkeypatch.setattr("iris_addon.blender.render.cycles.render_views", None)
    out = run(solved, "relight", "--lights", job, "--shares", shares, "--linear", out="mixed")
    seen, before = read_exr(out / "a.exr"), read_exr(whole / "a.exr")
    assert seen.mean() == pytest.approx(2 * before.mean(), rel=0.02)


def test_the_camera_is_written_for_other_programs(solved):
    assert cli.main(["camera", str(solved / "result"), "--out", str(solved / "camera")]) == 0
    names = {path.name for path in (solved / "camera").iterdir()}
    assert names == {"camera.cube", "camera_log.cube", "camera_3d.cube", "config.ocio"}
    assert 'name: "a"' in (solved / "camera" / "config.ocio").read_text()
