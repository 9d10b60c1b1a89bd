"""Cameras of other programs: the box room written as each of them writes it is the room that was photographed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from iris_addon.base.errors import BadInput
from iris_addon.capture.reader import read_capture, read_views
from iris_addon.model.capture import Distortion
from tests.box_room import RoomCapture
from tests.program_cameras import (
    FILES,
    WRITERS,
    Writer,
    write_metashape,
    write_openmvg,
    write_scannet,
    write_sidecars,
    write_tum,
)


@pytest.mark.parametrize("write", WRITERS, ids=lambda w: w.__name__)
@pytest.mark.parametrize("by_file", [False, True])
def test_cameras_are_those_of_the_room(write: Writer, by_file: bool, nerfstudio_room: RoomCapture) -> None:
    expected = read_capture(nerfstudio_room.root)
    nerfstudio_room.transforms.unlink()
    source = write(nerfstudio_room.root, expected)
    capture = read_capture(source if by_file else nerfstudio_room.root)
    assert [view.name for view in capture.views] == [view.name for view in expected.views]
    for view, wanted in zip(capture.views, expected.views, strict=True):
        np.testing.assert_allclose(view.camera.c2w, wanted.camera.c2w, atol=1e-6)
        for name in ("width", "height", "fx", "fy", "cx", "cy"):
            assert getattr(view.camera, name) == pytest.approx(getattr(wanted.camera, name)), name
        assert view.photo is not None and view.photo.name == wanted.photo.name  # type: ignore[union-attr]
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
