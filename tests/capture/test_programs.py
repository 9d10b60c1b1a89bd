"""Cameras of other programs: the box room written as each of them writes it is the room that was photographed."""

from __future__ import annotations

import json
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation

from iris_addon.base.errors import BadInput
from iris_addon.capture.common_frame import Together
from iris_addon.capture.photos import load_photo
from iris_addon.capture.programs import find_program, read_program
from iris_addon.capture.reader import read_capture, read_views, up_direction
from iris_addon.capture.similarity import Similarity
from iris_addon.model.capture import Capture, Distortion, moved_by
from tests.box_room import FOCAL, HEIGHT, WIDTH, RoomCapture
from tests.demo_capture import demo_capture
from tests.program_cameras import (
    FILES,
    WRITERS,
    Writer,
    write_arkit_scenes,
    write_metashape,
    write_openmvg,
    write_polycam,
    write_record3d,
    write_scannet,
    write_scannetpp,
    write_scannetpp_undistorted,
    write_sidecars,
    write_tum,
)


@pytest.mark.parametrize("write", WRITERS, ids=lambda w: w.__name__)
@pytest.mark.parametrize("by_file", [False, True])
def test_cameras_are_those_of_the_room(write: Writer, by_file: bool, nerfstudio_room: RoomCapture) -> None:
    expected = read_capture(nerfstudio_room.root)
    photos = {view.name: load_photo(view).values for view in expected.views}
    nerfstudio_room.transforms.unlink()
    source = write(nerfstudio_room.root, expected)
    capture = read_capture(source if by_file else nerfstudio_room.root)
    np.testing.assert_allclose(capture.mesh.vertices, expected.mesh.vertices, atol=1e-6)
    assert len(capture.views) == len(expected.views)
    for view, wanted in zip(capture.views, expected.views, strict=True):
        np.testing.assert_allclose(view.camera.c2w, wanted.camera.c2w, atol=1e-6)
        for name in ("width", "height", "fx", "fy", "cx", "cy"):
            assert getattr(view.camera, name) == pytest.approx(getattr(wanted.camera, name)), name
        np.testing.assert_array_equal(load_photo(view).values, photos[wanted.name])
        assert view.distortion is None
    assert len(read_views(source)) == len(expected.views)


@pytest.mark.parametrize("write", [write_openmvg, write_scannet], ids=lambda w: w.__name__)
def test_a_unit_is_stated_where_it_is_assumed_and_taken_where_it_is_given(
    write: Writer, nerfstudio_room: RoomCapture
) -> None:
    expected = read_capture(nerfstudio_room.root)
    nerfstudio_room.transforms.unlink()
    root = nerfstudio_room.root
    write(root, expected)
    assumed = any("one unit is taken as one meter" in warning for warning in read_capture(root).warnings)
    assert assumed == (write is write_openmvg)  # ScanNet is in metres
    scaled = read_capture(root, metres_per_unit=1.6)
    assert not any("one unit" in warning for warning in scaled.warnings)
    np.testing.assert_allclose(scaled.mesh.vertices, 1.6 * expected.mesh.vertices, atol=1e-6)
    for view, wanted in zip(scaled.views, expected.views, strict=True):
        np.testing.assert_allclose(view.camera.position, 1.6 * wanted.camera.position, atol=1e-6)
        np.testing.assert_allclose(view.camera.c2w[:3, :3], wanted.camera.c2w[:3, :3], atol=1e-6)
    assert scaled.metres_per_unit == 1.6


def test_photos_without_a_pose_are_left_out_and_named(nerfstudio_room: RoomCapture) -> None:
    expected = read_capture(nerfstudio_room.root)
    nerfstudio_room.transforms.unlink()
    write_metashape(nerfstudio_room.root, expected)
    assert any("lost (no pose)" in warning for warning in read_capture(nerfstudio_room.root).warnings)


def test_distortion_of_metashape_is_that_of_opencv_with_the_tangential_terms_exchanged(
    nerfstudio_room: RoomCapture,
) -> None:
    path = write_metashape(nerfstudio_room.root, read_capture(nerfstudio_room.root))
    text = path.read_text().replace("</f><cx>", "</f><k1>-0.1</k1><k2>0.02</k2><p1>0.003</p1><p2>0.004</p2><cx>")
    path.write_text(text)
    nerfstudio_room.transforms.unlink()
    lens = read_capture(nerfstudio_room.root).views[0].distortion
    assert lens == Distortion(k1=-0.1, k2=0.02, p1=0.004, p2=0.003)


def test_distortion_of_openmvg_is_that_of_its_kind(nerfstudio_room: RoomCapture) -> None:
    path = write_openmvg(nerfstudio_room.root, read_capture(nerfstudio_room.root))
    text = path.read_text()
    nerfstudio_room.transforms.unlink()
    start = text.index('"disto_k3"')
    given = text[start : text.index("]", start) + 1]
    path.write_text(text.replace(given, '"disto_t2": [-0.1, 0.02, 0.001, 0.003, 0.004]'))
    lens = read_capture(path).views[0].distortion
    assert lens == Distortion(k1=-0.1, k2=0.02, k3=0.001, p1=0.003, p2=0.004)
    path.write_text(text.replace(given, '"fisheye": [0.1, 0.02, 0.003, 0.0004]'))
    assert read_capture(path).views[0].distortion == Distortion(k1=0.1, k2=0.02, k3=0.003, k4=0.0004, fisheye=True)
    path.write_text(text.replace(given, '"spherical": [0.1]'))
    with pytest.raises(BadInput, match=r"sfm_data\.json: .*an intrinsic with spherical"):
        read_capture(path)


def test_distortion_of_a_sidecar_is_that_of_its_model(nerfstudio_room: RoomCapture) -> None:
    root = write_sidecars(nerfstudio_room.root, read_capture(nerfstudio_room.root))
    nerfstudio_room.transforms.unlink()
    texts = {path: path.read_text() for path in (root / "images").glob("0*.xmp")}

    def written(model: str) -> Distortion | None:
        for path, text in texts.items():
            lens = text.replace(">0 0 0 0 0 0<", ">-0.1 0.02 0.001 0.5 0.003 0.004<")
            path.write_text(lens.replace("brown3", model))
        return read_capture(root).views[0].distortion

    assert written("brown3") == Distortion(k1=-0.1, k2=0.02, k3=0.001)
    assert written("brown4t2") == Distortion(k1=-0.1, k2=0.02, k3=0.001, k4=0.5, p1=0.003, p2=0.004)
    assert written("perspective") is None
    with pytest.raises(BadInput, match=r"000\.xmp: .*distortion model division"):
        written("division")


def test_a_damaged_sidecar_is_named(nerfstudio_room: RoomCapture) -> None:
    root = write_sidecars(nerfstudio_room.root, read_capture(nerfstudio_room.root))
    nerfstudio_room.transforms.unlink()
    path = root / "images" / "002.xmp"
    path.write_text(path.read_text().replace("<xcr:Position>", "<xcr:Position>x "))
    with pytest.raises(BadInput, match=r"002\.xmp"):
        read_capture(root)


def test_tum_photos_far_from_any_pose_have_none_and_names_tell_the_camera(
    nerfstudio_room: RoomCapture, tmp_path: Path
) -> None:
    root = write_tum(nerfstudio_room.root, read_capture(nerfstudio_room.root))
    nerfstudio_room.transforms.unlink()
    assert any("lost (no pose)" in warning for warning in read_capture(root).warnings)
    (root / "calibration.txt").unlink()
    with pytest.raises(BadInput, match="freiburg1"):
        read_views(root)
    root = root.rename(tmp_path / "rgbd_dataset_freiburg3_room")
    with pytest.raises(BadInput, match="principal point"):  # of 640 x 480 pixels, which these photos have not
        read_views(root)


def test_photos_of_arkit_scenes_far_from_any_pose_have_none(nerfstudio_room: RoomCapture) -> None:
    root = write_arkit_scenes(nerfstudio_room.root, read_capture(nerfstudio_room.root))
    nerfstudio_room.transforms.unlink()
    assert any("41069021_99.000 (no pose)" in warning for warning in read_capture(root).warnings)


@pytest.mark.parametrize("write", [write_polycam, write_arkit_scenes, write_scannet], ids=lambda w: w.__name__)
def test_hidden_files_that_macos_adds_are_no_part_of_a_recording(write: Writer, nerfstudio_room: RoomCapture) -> None:
    root, expected = nerfstudio_room.root, read_capture(nerfstudio_room.root)
    nerfstudio_room.transforms.unlink()
    write(root, expected)
    for path in [path for path in root.rglob("*") if path.is_file()]:
        path.with_name(f"._{path.name}").write_bytes(b"\0\5\x16\7\0\2\0\0Mac OS X        ")
    capture = read_capture(root)
    assert len(capture.views) == len(expected.views)
    for view in capture.views:
        assert view.photo is not None and view.photo.name[0] != "."


def test_an_empty_folder_of_finer_photos_of_arkit_scenes_hides_none(nerfstudio_room: RoomCapture) -> None:
    root, expected = nerfstudio_room.root, read_capture(nerfstudio_room.root)
    nerfstudio_room.transforms.unlink()
    write_arkit_scenes(root, expected)
    (root / "wide").mkdir()
    (root / "vga_wide").mkdir()
    (root / "vga_wide" / "._41069021_10.000.png").write_bytes(b"")
    assert len(read_capture(root).views) == len(expected.views)


def test_polycam_without_optimised_cameras_has_those_of_arkit(nerfstudio_room: RoomCapture) -> None:
    expected = read_capture(nerfstudio_room.root)
    nerfstudio_room.transforms.unlink()
    write_polycam(nerfstudio_room.root, expected)
    keyframes = nerfstudio_room.root / "keyframes"
    shutil.rmtree(keyframes / "images")
    shutil.rmtree(keyframes / "corrected_cameras")
    (keyframes / "corrected_images").rename(keyframes / "images")
    (nerfstudio_room.root / "mesh_info.json").unlink()
    for view, wanted in zip(read_views(nerfstudio_room.root), expected.views, strict=True):
        assert view.photo is not None and view.photo.parent.name == "images" and view.margins == (0, 0, 0, 0)
        given = json.loads((keyframes / "cameras" / f"{wanted.name}.json").read_text())
        np.testing.assert_allclose(view.camera.c2w[:3, 3], [0, given["t_13"], given["t_23"]])


def held_upright(root: Path, capture: Capture, write: Writer, glb: bool = False) -> Path:
    """Half a turn through the room as a phone that is held upright records it, the sensor on its side, in the world of
    the format.

    Args:
        glb: the mesh as GLB, y up as glTF has it.
    """
    rolled, y_up = np.eye(4), np.eye(4)
    rolled[:2, :2] = [[0, -1], [1, 0]]
    y_up[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    to_world = y_up if write in (write_polycam, write_record3d) else np.eye(4)
    views, left_out = [], capture.views[3:]
    for view in left_out:
        assert view.photo is not None
        view.photo.unlink()
    for view in capture.views[:3]:
        views.append(replace(view, camera=replace(view.camera, c2w=to_world @ view.camera.c2w @ rolled)))
    mesh = trimesh.load(root / "mesh.ply", process=False)
    mesh.apply_transform(y_up if glb else to_world)
    (root / "mesh.ply").unlink()
    mesh.export(root / ("mesh.glb" if glb else "mesh.ply"))
    (root / "transforms.json").unlink()
    write(root, replace(capture, views=tuple(views)))
    return root


@pytest.mark.parametrize(
    ("write", "up"),
    [
        (write_polycam, (0, 1, 0)),
        (write_record3d, (0, 1, 0)),
        (write_arkit_scenes, (0, 0, 1)),
        (write_scannetpp, (0, 0, 1)),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_up_is_that_of_the_format_however_the_phone_was_held(
    write: Writer, up: tuple[float, float, float], nerfstudio_room: RoomCapture
) -> None:
    root = held_upright(nerfstudio_room.root, read_capture(nerfstudio_room.root), write)
    assert read_capture(root).up == up
    (root / "meta.json").write_text('{"up_axis": "-x"}')  # who knows better says so
    assert read_capture(root).up == (-1, 0, 0)


def test_up_of_the_format_goes_with_poses_that_are_moved_to_the_mesh(nerfstudio_room: RoomCapture) -> None:
    root = held_upright(nerfstudio_room.root, read_capture(nerfstudio_room.root), write_record3d)
    found = find_program(root)
    assert found is not None
    listing = read_program(root, *found)
    similarity = Similarity(Rotation.from_euler("x", 91, degrees=True).as_matrix(), 2.0, np.zeros(3))
    moved = tuple(replace(view, camera=similarity.camera(view.camera)) for view in listing.views)
    together = Together(moved, (), nerfstudio_room.mesh, similarity=similarity)
    assert up_direction(listing, together) == (0, 0, 1)


def test_a_glb_of_y_up_is_turned_to_the_z_up_of_a_phone_held_upright(nerfstudio_room: RoomCapture) -> None:
    """The room is out of the photos' sight until it is turned: it stands far off beside them."""
    far = np.eye(4)
    far[:3, 3] = [0, 0, 40]
    root, expected = nerfstudio_room.root, read_capture(nerfstudio_room.root)
    mesh = trimesh.load(root / "mesh.ply", process=False)
    mesh.apply_transform(far).export(root / "mesh.ply")
    expected = replace(expected, views=tuple(moved_by(view, far) for view in expected.views))
    capture = read_capture(held_upright(root, expected, write_arkit_scenes, glb=True))
    assert any("turned from y up" in warning for warning in capture.warnings)
    np.testing.assert_allclose(np.sort(capture.mesh.vertices, 0), np.sort(mesh.vertices, 0), atol=1e-5)


def test_the_black_border_of_corrected_photos_is_no_picture(tmp_path: Path) -> None:
    demo = demo_capture(tmp_path / "room")
    write_polycam(demo.root, read_capture(demo.save()))
    (demo.root / "transforms.json").unlink()
    border = round(demo.meta["w"] * 15 / 1024)
    for path in (demo.root / "keyframes" / "corrected_images").iterdir():
        with Image.open(path) as photo:
            inner = photo.crop((border, border, photo.width - border, photo.height - border))
            framed = Image.new("RGB", photo.size)
        framed.paste(inner, (border, border))
        framed.save(path)
    capture = read_capture(demo.root)
    assert not any("bars" in warning for warning in capture.warnings)  # they are those of the format
    for view in capture.views:
        valid = load_photo(view).valid
        assert valid[border:-border, border:-border].all() and valid.sum() == valid[border:-border, border:-border].size


def test_record3d_without_lenses_of_its_photos_has_one_by_columns(nerfstudio_room: RoomCapture) -> None:
    path = write_record3d(nerfstudio_room.root, read_capture(nerfstudio_room.root))
    nerfstudio_room.transforms.unlink()
    meta = json.loads(path.read_text())
    meta["K"][6], meta["K"][7] = 15.0, 13.0
    del meta["perFrameIntrinsicCoeffs"]
    path.write_text(json.dumps(meta))
    camera = read_capture(path).views[0].camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (FOCAL + 3, FOCAL + 3, 15.0, 13.0)


@pytest.mark.parametrize("as_file", [True, False])
def test_a_recording_in_record3ds_own_format_is_named_with_the_way_out(
    as_file: bool, nerfstudio_room: RoomCapture, tmp_path: Path
) -> None:
    """An archive as the app shares it: photos of the room, and depth that nothing here decodes."""
    expected = read_capture(nerfstudio_room.root)
    (tmp_path / "phone").mkdir()
    recording = tmp_path / "phone" / "2026-11-30--10-20-30.r3d"
    with zipfile.ZipFile(recording, "w") as archive:
        archive.writestr("metadata", json.dumps({"w": WIDTH, "h": HEIGHT, "fps": 60, "poses": []}))
        for number, view in enumerate(expected.views):
            assert view.photo is not None
            archive.writestr(f"rgbd/{number}.jpg", view.photo.read_bytes())
            archive.writestr(f"rgbd/{number}.depth", b"bvx2" + bytes(64))
    with pytest.raises(BadInput, match=r'30\.r3d: is a recording .*LZFSE.* — export it from Record3D as "EXR \+ RGB"'):
        read_capture(recording if as_file else recording.parent)


@pytest.mark.parametrize("write", [write_scannetpp, write_scannetpp_undistorted], ids=lambda w: w.__name__)
def test_photos_of_scannetpp_for_tests_are_held_out_and_its_masks_used(
    write: Writer, nerfstudio_room: RoomCapture
) -> None:
    path = write(nerfstudio_room.root, read_capture(nerfstudio_room.root))
    nerfstudio_room.transforms.unlink()
    meta = json.loads(path.read_text())
    meta["test_frames"] = [meta["frames"].pop()]
    path.write_text(json.dumps(meta))
    capture = read_capture(nerfstudio_room.root)
    assert [view.name for view in capture.val_views] == ["005"] and len(capture.views) == 5
    half = np.zeros((HEIGHT, WIDTH), np.uint8)
    half[:, : WIDTH // 2] = 255
    (masks,) = (nerfstudio_room.root / "dslr").glob("*_masks")
    Image.fromarray(half).save(masks / "001.png")
    np.testing.assert_array_equal(load_photo(capture.views[1]).valid, half > 0)
    (masks / "002.png").unlink()
    with pytest.raises(BadInput, match=r"mask '.*002\.png' is missing"):
        read_capture(nerfstudio_room.root)
    shutil.rmtree(masks)
    assert len(read_views(nerfstudio_room.root)) == 6  # cameras to render from need neither photos nor masks


@pytest.mark.parametrize("named", [True, False])
def test_a_file_of_scannetpp_that_is_named_is_read_from_wherever_one_stands(
    named: bool, nerfstudio_room: RoomCapture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a scene with both forms, in which the photos differ."""
    root, expected = nerfstudio_room.root, read_capture(nerfstudio_room.root)
    undistorted = write_scannetpp_undistorted(root, expected)
    nerfstudio_room.transforms.unlink()
    dslr = root / "dslr"
    shutil.copytree(dslr / "resized_undistorted_images", dslr / "resized_images")
    (dslr / "resized_anon_masks").mkdir()
    meta = json.loads(undistorted.read_text())
    meta["frames"] = [{**frame, "mask_path": None} for frame in meta["frames"]]
    (dslr / "nerfstudio" / "transforms.json").write_text(json.dumps(meta))
    monkeypatch.chdir(dslr / "nerfstudio")
    path = Path(undistorted.name) if named else Path()
    for views in (read_capture(path).views, read_views(path)):
        assert len(views) == len(expected.views)
        photos = {view.photo.parent.name for view in views if view.photo is not None}
        assert photos == {"resized_undistorted_images" if named else "resized_images"}


def test_entities_of_an_xml_are_not_expanded(nerfstudio_room: RoomCapture) -> None:
    path = write_metashape(nerfstudio_room.root, read_capture(nerfstudio_room.root))
    path.write_text('<!DOCTYPE d [<!ENTITY a "aaaa">]>' + path.read_text())
    with pytest.raises(BadInput, match=r"cameras\.xml: declares entities"):
        read_capture(path)


@pytest.mark.parametrize("write", FILES, ids=lambda w: w.__name__)
def test_a_damaged_file_is_named(write: Writer, nerfstudio_room: RoomCapture) -> None:
    path = write(nerfstudio_room.root, read_capture(nerfstudio_room.root))
    text = path.read_text()
    path.write_text(text[: int(0.6 * len(text))].rstrip("0123456789.- \n"))
    with pytest.raises(BadInput, match=path.name):
        read_capture(path)
