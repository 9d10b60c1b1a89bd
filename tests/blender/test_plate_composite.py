"""The artist's own scene onto the sequence behind its tracked camera: the right picture, exposure and frame number."""

import json
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from headless.cli import main
from iris_addon.base.errors import BadInput
from iris_addon.base.images import read_exr, write_exr, write_png
from iris_addon.blender.apply.on_objects import apply_to_objects
from iris_addon.blender.camera import add_camera, look_through
from iris_addon.blender.images import read_image
from iris_addon.blender.insert.photo_composite import write_copy
from iris_addon.blender.insert.plate import plate_picture, read_plate
from iris_addon.blender.render.cycles import empty_scene, render_views
from iris_addon.blender.scene_in.scene_capture import whole_object
from iris_addon.blender.scene_out.build import add_sphere, plain_mesh
from iris_addon.blender.synth.photos import develop
from iris_addon.blender.version import compositor_output, own_compositor_tree
from iris_addon.capture.photos import undistort
from iris_addon.edits.scene_edit import SceneEdit, Sphere
from iris_addon.model.capture import Distortion
from iris_addon.model.recovered import LightState
from iris_addon.model.render_settings import RenderSettings
from iris_addon.model.response import gamma
from iris_addon.results.folder import save_result
from tests.blender_room import camera, room

pytestmark = pytest.mark.bpy

FRAMES, WIDTH, HEIGHT = (11, 12, 13), 32, 24
EXPOSURES = {11: 0.05, 12: 0.11, 13: 0.07}
FIRST_FILE = 1001
"""The file of frame 11 of the scene."""
CAMERAS = {n: camera(WIDTH, HEIGHT, fx=24.0, fy=24.0, position=(0.2 * (n - 12), 0, 0.6)) for n in FRAMES}
GREEN = Sphere(np.array([0.0, 0.0, -0.4]), 0.2, base_color=np.array([0.0, 0.8, 0.0]), roughness=1.0, metallic=0.0)


@pytest.fixture(scope="module")
def filmed():
    """The solved room, and radiance of its plate by scene frame."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    result = replace(
        room(albedo=(0.5, 0.45, 0.4), emission={3: (12, 11, 10)}),
        response=gamma(),
        up=(0.0, 1.0, 0.0),
        exposures={"a": np.ones(3)},
    )
    plates = render_views(result, list(CAMERAS.values()), settings=RenderSettings(samples=128, seed=5))
    return result, dict(zip(FRAMES, plates, strict=True))


@pytest.fixture
def shot(tmp_path, filmed) -> Path:
    """A folder with the result and the plate; the open scene has the room, a green ball and the tracked camera."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    result, plates = filmed
    save_result(result, tmp_path / "result")
    for frame, radiance in plates.items():
        picture = develop(radiance, EXPOSURES[frame], gamma())
        write_png(tmp_path / "plate" / f"sh.{FIRST_FILE - 11 + frame}.png", picture)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = FRAMES[0], FRAMES[-1]
    thing = bpy.data.objects.new("room", plain_mesh(replace(result.mesh, uv=None), "room"))
    scene.collection.objects.link(thing)
    apply_to_objects(result, whole_object(thing), scene, "key")
    add_sphere(GREEN, "ball", scene.collection)
    eye = add_camera(CAMERAS[11], "tracked", scene.collection)
    look_through(scene, CAMERAS[11], eye)
    for frame, view in CAMERAS.items():
        eye.location = view.c2w[:3, 3]
        eye.keyframe_insert("location", frame=frame)
    return tmp_path


def show_clip(shot: Path) -> bpy.types.MovieClip:
    """The plate as a movie clip behind the camera, its first picture at frame 11."""
    clip = bpy.data.movieclips.load(str(shot / "plate" / f"sh.{FIRST_FILE}.png"))
    clip.frame_start = 11
    behind = bpy.context.scene.camera.data.background_images.new()
    behind.source, behind.clip = "MOVIE_CLIP", clip
    return clip


def show_image(shot: Path, suffix: str = ".png") -> bpy.types.ImageUser:
    """The plate as an image sequence behind the camera."""
    image = bpy.data.images.load(str(shot / "plate" / f"sh.{FIRST_FILE}{suffix}"))
    image.source = "SEQUENCE"
    behind = bpy.context.scene.camera.data.background_images.new()
    behind.source, behind.image = "IMAGE", image
    behind.image_user.frame_start, behind.image_user.frame_duration = 11, 3
    behind.image_user.frame_offset = FIRST_FILE - 1
    return behind.image_user


def run(shot: Path, *more: object, code: int = 0) -> Path:
    write_copy(bpy.context.scene, shot / "copy.blend")
    command = ["composite", shot / "copy.blend", "--result", shot / "result", "--out", shot / "out", "--samples", 8]
    assert main([str(word) for word in [*command, *(more or ("--frames", "11-13"))]]) == code
    return shot / "out"


@pytest.mark.parametrize("show", [show_clip, show_image])
def test_each_frame_has_its_picture_its_exposure_and_what_was_added(shot, show):
    show(shot)
    out = run(shot)
    for frame in FRAMES:
        record = json.loads((out / "exposures" / f"frame_{frame:04d}.json").read_text())
        assert record["picture"] == f"sh.{FIRST_FILE - 11 + frame}.png"
        np.testing.assert_allclose(record["exposure"], EXPOSURES[frame], rtol=0.02)
        seen = read_image(out / f"frame_{frame:04d}.png")
        before = read_image(shot / "plate" / record["picture"])
        greener = (seen[..., 1] - seen[..., 0]) - (before[..., 1] - before[..., 0])
        middle = np.flatnonzero(greener[HEIGHT // 2] > 0.1).mean()
        assert middle == pytest.approx(WIDTH / 2 - 24.0 * 0.2 * (frame - 12) - 0.5, abs=1.0)
        assert np.abs(seen - before)[0].max() < 0.1  # far from it the plate stays


def test_a_plate_is_lit_by_the_lamps_of_its_light_state(shot, filmed, capsys):
    """A white ball in a plate that was filmed under the red lamp, which is off in the first state, is as red as in a
    render of the room in that state."""
    plain, _ = filmed
    dark, red, blue = np.zeros(3), np.array([12.0, 3.0, 2.0]), np.array([1.0, 3.0, 12.0])
    states = (
        LightState("evening", ("a",), np.array([blue, dark])),
        LightState("night", ("b",), np.array([dark, red])),
    )
    result = replace(plain, emitters=room(emission={3: blue, 2: dark}).emitters, light_states=states)
    save_result(result, shot / "result")
    white = replace(GREEN, base_color=np.full(3, 0.8))
    night = result.in_state("night")
    quick = RenderSettings(samples=128, seed=5)
    (empty,) = render_views(night, [CAMERAS[11]], settings=quick)
    (truth,) = render_views(night, [CAMERAS[11]], edit=SceneEdit(spheres=(white,)), settings=quick)
    write_png(shot / "plate" / f"sh.{FIRST_FILE}.png", develop(empty, EXPOSURES[11], gamma()))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    thing = bpy.data.objects.new("room", plain_mesh(replace(result.mesh, uv=None), "room"))
    scene.collection.objects.link(thing)
    apply_to_objects(result, whole_object(thing), scene, "key")
    add_sphere(white, "ball", scene.collection)
    look_through(scene, CAMERAS[11], add_camera(CAMERAS[11], "tracked", scene.collection))
    show_clip(shot)
    seen = read_image(run(shot, "--frames", "11", "--light-state", "night") / "frame_0011.png")
    expected = develop(truth, EXPOSURES[11], gamma()) / 255
    assert np.abs(seen - expected).mean() < 0.02
    record = json.loads((shot / "out" / "exposures" / "frame_0011.json").read_text())
    np.testing.assert_allclose(record["exposure"], EXPOSURES[11], rtol=0.03)
    run(shot, "--frames", "11", "--light-state", "noon", code=3)
    assert "not solved in the light state 'noon'" in capsys.readouterr().err


def test_a_scene_without_a_plate_is_rendered_whole_at_one_exposure(shot):
    """What was added moves past the camera, whichever frames are made first and wherever a run was stopped."""
    out = run(shot, "--frames", "11", "--resume")
    exposure = json.loads((out / "frames.json").read_text())["exposure"]
    bpy.ops.wm.open_mainfile(filepath=str(shot / "copy.blend"))
    run(shot, "--frames", "11-13", "--resume")
    assert json.loads((out / "frames.json").read_text())["exposure"] == exposure
    for frame in FRAMES:
        seen = read_image(out / f"frame_{frame:04d}.png")
        assert seen.shape == (HEIGHT, WIDTH, 3)
        green = np.flatnonzero(seen[HEIGHT // 2, :, 1] - seen[HEIGHT // 2, :, 0] > 0.1)
        assert green.mean() == pytest.approx(WIDTH / 2 - 24.0 * 0.2 * (frame - 12) - 0.5, abs=1.0)
    wall = [read_image(out / f"frame_{frame:04d}.png")[0].mean() for frame in FRAMES]
    assert np.ptp(wall) < 0.1 * np.mean(wall)


def test_the_exposure_of_a_whole_scene_is_that_of_the_run_unless_it_is_resumed(shot):
    out = run(shot, "--frames", "12")
    right = json.loads((out / "frames.json").read_text())
    other = {**right, "exposure": 0.25 * right["exposure"]}  # of the scene before it changed
    seen = read_image(out / "frame_0012.png")
    for more, exposure in ((["--resume"], other["exposure"]), ([], right["exposure"])):
        (out / "frames.json").write_text(json.dumps(other))
        (out / "frame_0012.png").unlink()
        bpy.ops.wm.open_mainfile(filepath=str(shot / "copy.blend"))
        run(shot, "--frames", "12", *more)
        assert json.loads((out / "frames.json").read_text())["exposure"] == pytest.approx(exposure)
        same = np.abs(read_image(out / "frame_0012.png") - seen).max() < 1 / 255
        assert same != bool(more)


def test_a_scene_without_a_camera_is_named(shot, capsys):
    bpy.context.scene.camera = None
    run(shot, "--frames", "11", code=3)
    assert "copy.blend: has no active camera" in capsys.readouterr().err


def test_frames_are_kept_on_request_alone(shot):
    """Another ball is not to be found in half of the frames; a run that was stopped goes on."""
    show_clip(shot)
    out = run(shot, "--frames", "11-12")
    times = [(out / f"frame_00{n}.png").stat().st_mtime_ns for n in (11, 12)]
    (out / "frame_0012.png").write_bytes((out / "frame_0012.png").read_bytes()[:60])
    bpy.ops.wm.open_mainfile(filepath=str(shot / "copy.blend"))
    run(shot, "--frames", "11-12", "--resume")
    assert (out / "frame_0011.png").stat().st_mtime_ns == times[0]
    assert read_image(out / "frame_0012.png").shape == (HEIGHT, WIDTH, 3)
    bpy.ops.wm.open_mainfile(filepath=str(shot / "copy.blend"))
    run(shot, "--frames", "11")
    assert (out / "frame_0011.png").stat().st_mtime_ns > times[0]


def test_a_missing_picture_is_named_and_the_others_go_on(shot, capsys):
    show_clip(shot)
    (shot / "plate" / f"sh.{FIRST_FILE + 1}.png").unlink()
    out = run(shot, code=1)
    told = capsys.readouterr().err
    assert "frame 12: " in told and f"sh.{FIRST_FILE + 1}.png: is missing" in told
    assert sorted(path.name for path in out.glob("frame_*")) == ["frame_0011.png", "frame_0013.png"]


def test_plates_of_radiance_stay_radiance(shot, filmed):
    for frame, radiance in filmed[1].items():
        write_exr(shot / "plate" / f"sh.{FIRST_FILE - 11 + frame}.exr", 40.0 * radiance)
    show_image(shot, ".exr")
    out = run(shot, "--frames", "12")
    seen = read_exr(out / "frame_0012.exr")
    np.testing.assert_allclose(seen[0, 0], 40.0 * filmed[1][12][0, 0], rtol=0.1)
    assert seen[HEIGHT // 2, WIDTH // 2, 1] > 10 * seen[HEIGHT // 2, WIDTH // 2, 0]


def test_a_shifted_clip_shows_the_pictures_that_blender_shows(shot):
    clip = show_clip(shot)
    assert plate_picture(bpy.context.scene, 12).name == f"sh.{FIRST_FILE + 1}.png"
    clip.frame_start, clip.frame_offset = 10, 1
    assert plate_picture(bpy.context.scene, 11).name == f"sh.{FIRST_FILE + 2}.png"


@pytest.mark.parametrize(("model", "prefix"), [("POLYNOMIAL", ""), ("BROWN", "brown_")])
def test_the_distortion_that_tracking_found_is_taken_out(shot, model, prefix):
    """As the reader of captures takes it out, whose model is that of OpenCV."""
    clip, rows = show_clip(shot), np.mgrid[:HEIGHT, :WIDTH]
    smooth = np.stack([7 * rows[1], 10 * rows[0], 3 * rows.sum(0)], -1).astype(np.uint8)
    for frame in FRAMES:
        write_png(shot / "plate" / f"sh.{FIRST_FILE - 11 + frame}.png", smooth + np.uint8(frame))
    lens = clip.tracking.camera
    lens.distortion_model = model
    setattr(lens, f"{prefix}k1", -0.12)
    setattr(lens, f"{prefix}k2", 0.03)
    focal, (cx, cy) = lens.focal_length_pixels, lens.principal_point_pixels
    pinhole = replace(CAMERAS[11], fx=focal, fy=focal, cx=cx, cy=HEIGHT - cy)
    for frame in FRAMES:
        values = (smooth + np.uint8(frame)).astype(np.float32) / 255
        ours, valid = undistort(values, np.ones((HEIGHT, WIDTH), bool), pinhole, Distortion(k1=-0.12, k2=0.03))
        seen = read_plate(bpy.context.scene, frame)
        np.testing.assert_array_equal(seen.valid, valid)
        np.testing.assert_allclose(seen.values, ours, atol=1e-5)
        assert np.abs(seen.values - values).max() > 5 / 255


def test_frames_of_a_movie_file_are_those_that_blender_shows(shot):
    """Written without loss; the codec's own color space may cost a few codes."""
    scene = bpy.context.scene
    write_movie(shot / "film.mkv", [shot / "plate" / f"sh.{FIRST_FILE + k}.png" for k in range(3)])
    clip = bpy.data.movieclips.load(str(shot / "film.mkv"))
    clip.frame_start = 11
    behind = scene.camera.data.background_images.new()
    behind.source, behind.clip = "MOVIE_CLIP", clip
    for frame in FRAMES:
        seen, photo = read_plate(scene, frame), read_image(shot / "plate" / f"sh.{FIRST_FILE - 11 + frame}.png")
        assert seen.values.shape == photo.shape and np.abs(seen.values - photo).mean() < 3 / 255
    assert clip.colorspace_settings.name == "sRGB" and len(bpy.data.scenes) == 1
    with pytest.raises(BadInput, match="has 3 frames, from 11 of the scene on"):
        plate_picture(scene, 14)


def test_a_movie_file_as_the_image_behind_the_camera_is_a_plate(shot):
    """The second and third frame of the film at frames 11 and 12 of the scene."""
    scene = bpy.context.scene
    write_movie(shot / "film.mkv", [shot / "plate" / f"sh.{FIRST_FILE + k}.png" for k in range(3)])
    image = bpy.data.images.load(str(shot / "film.mkv"))
    assert image.source == "MOVIE"
    behind = scene.camera.data.background_images.new()
    behind.source, behind.image = "IMAGE", image
    behind.image_user.frame_start, behind.image_user.frame_duration, behind.image_user.frame_offset = 11, 3, 1
    clips = len(bpy.data.movieclips)
    for k, frame in enumerate((11, 12)):
        seen, photo = read_plate(scene, frame), read_image(shot / "plate" / f"sh.{FIRST_FILE + 1 + k}.png")
        assert seen.values.shape == photo.shape and np.abs(seen.values - photo).mean() < 3 / 255
    assert len(bpy.data.movieclips) == clips
    for frame, told in ((13, "film.mkv: has 3 frames, and none with the number 4"), (14, "shows frames 11 to 13")):
        with pytest.raises(BadInput, match=told):
            plate_picture(scene, frame)
    out = run(shot, "--frames", "12")
    record = json.loads((out / "exposures" / "frame_0012.json").read_text())
    assert record["picture"] == "film.mkv"
    np.testing.assert_allclose(record["exposure"], EXPOSURES[13], rtol=0.03)


def write_movie(path: Path, pictures: list[Path]) -> None:
    """The pictures as a movie file, by Blender's compositor, in a scene that is removed again."""
    image = bpy.data.images.load(str(pictures[0]))
    image.colorspace_settings.name, image.source = "Non-Color", "SEQUENCE"
    scene = empty_scene(WIDTH, HEIGHT)
    tree = own_compositor_tree(scene)
    output, node = compositor_output(tree), tree.nodes.new("CompositorNodeImage")
    node.image, node.frame_start, node.frame_duration, node.frame_offset = image, 1, 3, FIRST_FILE - 1
    tree.links.new(node.outputs["Image"], output)
    scene.frame_start, scene.frame_end = 1, len(pictures)
    scene.view_settings.view_transform, scene.display_settings.display_device = "Raw", "sRGB"
    settings = scene.render.image_settings
    if bpy.app.version >= (5, 0, 0):
        settings.media_type = "VIDEO"
    settings.file_format = "FFMPEG"
    scene.render.ffmpeg.format, scene.render.ffmpeg.codec = "MKV", "FFV1"
    scene.render.filepath, scene.render.use_file_extension = str(path), False
    bpy.ops.render.render(animation=True, scene=scene.name)
    bpy.data.scenes.remove(scene)


def test_what_cannot_be_composited_says_what_to_do(shot):
    scene = bpy.context.scene
    with pytest.raises(BadInput, match="shows no plate"):
        plate_picture(scene, 11)
    user = show_image(shot)
    user.frame_duration = 1
    with pytest.raises(BadInput, match="shows frames 11 to 11"):
        plate_picture(scene, 12)
    scene.camera.data.background_images.clear()
    lens = show_clip(shot).tracking.camera
    lens.distortion_model, lens.division_k1 = "DIVISION", 0.1
    with pytest.raises(BadInput, match="choose Polynomial or Brown"):
        read_plate(scene, 11)
    scene.camera = None
    with pytest.raises(BadInput, match="no active camera"):
        plate_picture(scene, 11)


def test_a_scene_of_another_shape_than_its_plate_is_refused(shot, capsys):
    show_clip(shot)
    bpy.context.scene.render.resolution_x = 64
    run(shot, code=1)
    assert "is 32x24 pixels, the scene renders 64x24" in capsys.readouterr().err
