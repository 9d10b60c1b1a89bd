"""A plate with a moving camera and changing exposure: objects in every frame, frames that fail, frames that resume."""

import json
from dataclasses import replace

import numpy as np
import OpenEXR
import pytest

from headless import cli
from iris_addon.base.images import read_exr, read_image, write_exr, write_png
from iris_addon.blender.synth.photos import develop
from iris_addon.model.render_settings import RenderSettings
from iris_addon.model.response import gamma
from iris_addon.results.folder import save_result
from tests.blender_room import camera, room

pytestmark = pytest.mark.bpy

NUMBERS, WIDTH, HEIGHT = (1001, 1002, 1003), 32, 24
EXPOSURES = {1001: np.array([0.05, 0.05, 0.05]), 1002: np.array([0.12, 0.1, 0.09]), 1003: np.array([0.06, 0.07, 0.08])}
BLACK = {"base_color": 0.0, "specular": 0.0, "roughness": 1.0}
BALL = {"shape": "sphere", "radius": 0.25, "location": [0.0, 0.0, -0.4], "emission": [9, 0, 9], **BLACK}


@pytest.fixture(scope="module")
def filmed():
    """The solved room, its plate as radiance and the cameras of it; the exposures of its own photos are others."""
    from iris_addon.blender.render.cycles import render_views

    result = replace(
        room(albedo=(0.5, 0.45, 0.4), emission={3: (12, 11, 10)}),
        response=gamma(),
        exposures={"a": np.ones(3), "frame_1001": np.full(3, 7.0)},
    )
    cameras = [camera(WIDTH, HEIGHT, fx=24.0, fy=24.0, position=(0.2 * k - 0.2, 0, 0.6)) for k in range(3)]
    plates = render_views(result, cameras, settings=RenderSettings(samples=128, seed=5))
    return result, dict(zip(NUMBERS, plates, strict=True)), dict(zip(NUMBERS, cameras, strict=True))


@pytest.fixture
def plate(tmp_path, filmed, monkeypatch):
    """A folder with result, plate, cameras and an object."""
    monkeypatch.setattr("headless.frame_folder.shutil.which", lambda _name: None)
    result, plates, cameras = filmed
    save_result(result, tmp_path / "result")
    for number, radiance in plates.items():
        write_png(tmp_path / "plate" / f"sh.{number}.png", develop(radiance, EXPOSURES[number], gamma()))
    lens = {"w": WIDTH, "h": HEIGHT, "fl_x": 24.0, "fl_y": 24.0}
    frames = [{"file_path": f"sh.{n}.png", "transform_matrix": view.c2w.tolist()} for n, view in cameras.items()]
    write_json(tmp_path / "track.json", {**lens, "frames": frames})
    write_json(tmp_path / "ball.json", {"objects": [BALL]})
    return tmp_path


def write_json(path, content):
    path.write_text(json.dumps(content))


def run(plate, *more, code=0, out="out"):
    args = ["onto-plate", plate / "result", "--plate", plate / "plate", "--camera", plate / "track.json"]
    args += ["--objects", plate / "ball.json", "--out", plate / out, "--samples", 8, *more]
    assert cli.main([str(arg) for arg in args]) == code
    return plate / out


def test_each_frame_has_its_exposure_and_the_object_where_its_camera_sees_it(plate):
    out = run(plate)
    for k, number in enumerate(NUMBERS):
        found = json.loads((out / "exposures" / f"frame_{number}.json").read_text())
        np.testing.assert_allclose(found["exposure"], EXPOSURES[number], rtol=0.02)
        frame = read_image(out / f"frame_{number}.png").astype(int)
        before = read_image(plate / "plate" / f"sh.{number}.png").astype(int)
        column = round(WIDTH / 2 - 24.0 * (0.2 * k - 0.2))  # the camera goes right, the ball a metre before it left
        lamp = develop(np.array([[[9.0, 0.0, 9.0]]]), EXPOSURES[number], gamma())[0, 0].astype(int)
        assert np.abs(frame[HEIGHT // 2, column] - lamp).max() <= 5  # of some 200: the exposure is found to 2 %
        assert np.abs(before[HEIGHT // 2, column] - lamp).max() > 20


def test_finished_frames_are_kept_and_half_of_a_file_is_made_again(plate):
    out = run(plate, "--frames", "1001-1002")
    assert sorted(path.name for path in out.glob("frame_*")) == ["frame_1001.png", "frame_1002.png"]
    whole, before = (out / "frame_1002.png").read_bytes(), read_image(out / "frame_1002.png").astype(int)
    times = {name: (out / name).stat().st_mtime_ns for name in ("frame_1001.png",)}
    (out / "frame_1002.png").write_bytes(whole[: len(whole) // 2])
    run(plate)
    assert all((out / name).stat().st_mtime_ns == time for name, time in times.items())
    assert np.abs(read_image(out / "frame_1002.png") - before).mean() < 1  # noise: Cycles sorts its lamps anew
    assert (out / "frame_1003.png").is_file()
    assert not list(out.glob(".frame*"))


def test_layers_of_a_frame_add_up_to_it_and_missing_ones_are_made(plate):
    out = run(plate, "--frames", "1001", "--linear")
    assert not (out / "layers").exists()
    run(plate, "--frames", "1001-1002", "--linear", "--layers")
    for number in (1001, 1002):
        with OpenEXR.File(str(out / "layers" / f"frame_{number}.exr"), separate_channels=True) as file:
            held = {name: channel.pixels.copy() for name, channel in file.channels().items()}
        picture, plate_layer, catcher, thing = (
            np.stack([held[f"{name}{channel}"] for channel in "RGB"], -1)
            for name in ("", "plate.", "catcher.", "object.")
        )
        alpha = held["object.A"][..., None]
        assert alpha.max() == 1 and (catcher < 0).any()
        np.testing.assert_allclose(plate_layer * (1 - alpha) + catcher + thing, picture, rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(picture, read_exr(out / f"frame_{number}.exr"), rtol=1e-5, atol=1e-6)
    whole = (out / "layers" / "frame_1002.exr").read_bytes()
    (out / "layers" / "frame_1002.exr").write_bytes(whole[: len(whole) // 3])
    run(plate, "--frames", "1001-1002", "--linear", "--layers")
    assert read_exr(out / "layers" / "frame_1002.exr").shape[:2] == (HEIGHT, WIDTH)


def test_a_frame_that_fails_is_named_and_the_others_go_on(plate, capsys):
    (plate / "plate" / "sh.1001.png").unlink()
    (plate / "plate" / "sh.1002.png").write_bytes(b"no picture")
    out = run(plate, "--frames", "1001-1004", code=1)
    told = capsys.readouterr().err
    assert "error: " in told and "3 of 4 frames failed (1001, 1002, 1004)" in told
    assert f"frame 1001: {plate / 'plate'}: has no frame 1001" in told
    assert f"frame 1002: {plate / 'plate' / 'sh.1002.png'}" in told
    assert f"frame 1004: {plate / 'track.json'}: has no camera of frame 1004" in told
    assert [path.name for path in out.glob("frame_*")] == ["frame_1003.png"]


def test_frames_of_radiance_stay_radiance_in_their_own_unit(plate, filmed):
    for number, radiance in filmed[1].items():
        (plate / "plate" / f"sh.{number}.png").unlink()
        write_exr(plate / "plate" / f"sh.{number}.exr", 40.0 * radiance)
    out = run(plate, "--frames", "1002")
    lamp = read_exr(out / "frame_1002.exr")[HEIGHT // 2, WIDTH // 2]
    np.testing.assert_allclose(lamp, [360, 0, 360], rtol=0.05, atol=1.0)


def test_without_objects_the_plate_is_what_it_was(plate):
    write_json(plate / "ball.json", {"objects": []})
    out = run(plate)
    for number in NUMBERS:
        before = read_image(plate / "plate" / f"sh.{number}.png")
        np.testing.assert_array_equal(read_image(out / f"frame_{number}.png"), before)


@pytest.mark.parametrize(
    ("job", "told"),
    [
        ({"objects": [BALL], "camera": {"view": 1}}, "leave out 'camera'"),
        ({"objects": [BALL], "length": 9}, "leave out 'length'"),
        ({"views": [{"view": 0}, {"view": 1}]}, "keep one of them for a plate"),
    ],
)
def test_jobs_that_are_not_for_a_plate_are_refused(plate, capsys, job, told):
    write_json(plate / "ball.json", job)
    run(plate, code=3)
    assert told in capsys.readouterr().err


def test_a_camera_file_without_frame_numbers_is_refused(plate, capsys):
    track = json.loads((plate / "track.json").read_text())
    track["frames"][1]["file_path"] = "middle"
    write_json(plate / "track.json", track)
    run(plate, code=3)
    assert "middle has no frame number" in capsys.readouterr().err
