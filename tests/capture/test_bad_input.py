"""Captures that cannot be used: one clear line that names the file, exit code 3, nothing half done."""

from __future__ import annotations

import json
import os
from collections.abc import Callable

import numpy as np
import pytest
import trimesh
from PIL import Image

from iris_addon.base.errors import BadInput
from iris_addon.capture import listing as files
from iris_addon.capture.reader import read_capture
from tests.box_room import RoomCapture, write_mesh, write_obj


def refused(capture: RoomCapture) -> str:
    """The message of the refusal, checked for its form."""
    with pytest.raises(BadInput) as caught:
        read_capture(capture.save())
    message = str(caught.value)
    assert caught.value.exit_code == 3
    assert " — " in message and "\n" not in message
    return message


# ---- photos --------------------------------------------------------------------------------------------------------


def test_truncated_jpeg(nerfstudio_room: RoomCapture) -> None:
    photo = nerfstudio_room.photos[2].with_suffix(".jpg")
    noise = np.random.default_rng(0).integers(0, 256, (24, 32, 3), np.uint8)
    Image.fromarray(noise).save(photo)
    photo.write_bytes(photo.read_bytes()[:-300])
    nerfstudio_room.meta["frames"][2]["file_path"] = "images/002.jpg"
    assert "002.jpg: is damaged" in refused(nerfstudio_room)


@pytest.mark.parametrize("layout", ["fipt_room", "nerfstudio_room"])
def test_missing_photo(layout: str, request: pytest.FixtureRequest) -> None:
    """One of six is left out and named; three are too many; --strict refuses any."""
    capture = request.getfixturevalue(layout)
    capture.photos[3].unlink()
    read = read_capture(capture.save())
    assert len(read.views) == 5 and f"1 of 6 photos are left out: {capture.photos[3].stem} (no photo)" in read.warnings
    with pytest.raises(BadInput, match="1 of 6 photos are missing"):
        read_capture(capture.root, strict=True)
    for photo in capture.photos[:2]:
        photo.unlink()
    message = refused(capture)
    assert "transforms.json" in message and capture.photos[3].stem in message


def test_frames_that_were_never_posed_are_left_out(nerfstudio_room: RoomCapture) -> None:
    """Recorders write them so where they lost track."""
    nerfstudio_room.meta["frames"][1]["transform_matrix"] = [[-float("inf")] * 4] * 4
    nerfstudio_room.meta["frames"][4].pop("transform_matrix")
    read = read_capture(nerfstudio_room.save())
    assert [view.name for view in read.views] == ["000", "002", "003", "005"]
    assert "2 of 6 photos are left out: 001 (no pose), 004 (no pose)" in read.warnings
    with pytest.raises(BadInput, match="2 of 6 photos are missing or have no pose"):
        read_capture(nerfstudio_room.root, strict=True)


def test_photo_of_another_format(nerfstudio_room: RoomCapture) -> None:
    photo = nerfstudio_room.photos[2]
    Image.open(photo).save(photo.with_suffix(".gif"))
    nerfstudio_room.meta["frames"][2]["file_path"] = f"images/{photo.stem}.gif"
    message = refused(nerfstudio_room)
    assert f"{photo.stem}.gif: is of no format that is read" in message and "save it as PNG, JPEG" in message


def test_photo_size_not_that_of_the_intrinsics(nerfstudio_room: RoomCapture) -> None:
    Image.new("RGB", (64, 48)).save(nerfstudio_room.photos[1])
    message = refused(nerfstudio_room)
    assert "001.png: is 64x48 pixels, the intrinsics are for 32x24" in message


def test_same_photo_listed_twice(nerfstudio_room: RoomCapture) -> None:
    frames = nerfstudio_room.meta["frames"]
    frames[4]["file_path"] = frames[1]["file_path"]
    assert "lists the view images_001 twice" in refused(nerfstudio_room)


def test_no_training_photo(nerfstudio_room: RoomCapture) -> None:
    for frame in nerfstudio_room.meta["frames"]:
        frame["split"] = "val"
    assert "no training photos" in refused(nerfstudio_room)


# ---- paths ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("where", ["..", "absolute", "link"])
@pytest.mark.parametrize("what", ["photo", "mesh"])
def test_paths_may_not_leave_the_capture(nerfstudio_room: RoomCapture, where: str, what: str) -> None:
    root = nerfstudio_room.root
    name = "000.png" if what == "photo" else "mesh.ply"
    inside = nerfstudio_room.photos[0] if what == "photo" else root / "mesh.ply"
    outside = root.parent / name
    outside.write_bytes(inside.read_bytes())
    if where == "link":
        (root / f"link_{name}").symlink_to(outside)
    named = {"..": f"../{name}", "absolute": str(outside), "link": f"link_{name}"}[where]
    if what == "photo":
        nerfstudio_room.meta["frames"][0]["file_path"] = named
    else:
        nerfstudio_room.meta["mesh"] = named
    assert "outside the capture folder" in refused(nerfstudio_room)


def spelled_another_way(capture: RoomCapture, how: str) -> None:
    frame = capture.meta["frames"][0]
    if how == "absolute":
        frame["file_path"] = str(capture.photos[0].resolve())
    elif how == "up and down":
        frame["file_path"] = f"../{capture.root.name}/images/000.png"
    elif how == "case":
        frame["file_path"] = "Images/000.PNG"
    else:
        composed, decomposed = "K\u00fcche.png", "Ku\u0308che.png"
        capture.photos[0].rename(capture.photos[0].with_name(decomposed))
        frame["file_path"] = f"images/{composed}"


@pytest.mark.parametrize("how", ["absolute", "up and down", "case", "normal form"])
def test_paths_that_lead_to_one_file_of_the_capture_are_followed(nerfstudio_room: RoomCapture, how: str) -> None:
    spelled_another_way(nerfstudio_room, how)
    views = read_capture(nerfstudio_room.save(), strict=True).views
    assert len(views) == 6 and views[0].photo is not None and views[0].photo.is_file()


def test_a_name_that_two_files_fit_is_none_of_them(nerfstudio_room: RoomCapture) -> None:
    for name in ("PHOTO.png", "Photo.png"):
        (nerfstudio_room.root / "images" / name).write_bytes(nerfstudio_room.photos[0].read_bytes())
    nerfstudio_room.meta["frames"][0]["file_path"] = "images/photo.png"
    assert len(read_capture(nerfstudio_room.save()).views) == 5


# ---- transforms file -----------------------------------------------------------------------------------------------


def set_pose(change: Callable[[np.ndarray], object]) -> Callable[[dict], None]:
    """A change of the second frame's pose."""

    def apply(meta: dict) -> None:
        pose = np.array(meta["frames"][1]["transform_matrix"])
        change(pose)
        meta["frames"][1]["transform_matrix"] = pose.tolist()

    return apply


def scale_rotation(pose: np.ndarray) -> None:
    pose[:3, :3] *= 1.5


def mirror(pose: np.ndarray) -> None:
    pose[:3, 0] *= -1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (set_pose(scale_rotation), "001: pose is not a rotation"),
        (set_pose(mirror), "001: pose is not a rotation"),
        (set_pose(lambda pose: pose.fill(0)), "001: pose is not a rotation"),
        (lambda meta: meta["frames"][1].update(transform_matrix=[["a"] * 4] * 4), "001: transform_matrix is not 4x4"),
        (lambda meta: meta.update(fl_x=0), "focal length 0 px"),
        (lambda meta: meta.update(fl_x=0.5), "focal length 0.5 px"),
        (lambda meta: meta.update(fl_x="20"), "\"fl_x\" is '20'"),
        (lambda meta: meta.update(cx=900), "principal point 900 px in x"),
        (lambda meta: meta.update(w=0), "image size 0x24"),
        (lambda meta: meta.update(w=10**6, h=10**6), "image size 1000000x1000000"),
        (lambda meta: [meta.pop("fl_x"), meta.pop("fl_y")], "no focal length"),
        (lambda meta: meta.update(frames=[]), 'no list of "frames"'),
        (lambda meta: meta["frames"][0].pop("file_path"), 'frame 0 has no "file_path"'),
        (lambda meta: meta["frames"][0].update(split="holdout"), "split 'holdout'"),
        (lambda meta: meta["frames"][0].update(split=["train"]), "split ['train']"),
        (lambda meta: meta["frames"][0].update(exposure_time=-1), "exposure -1"),
        (lambda meta: meta["frames"][0].update(file_path="a" * 5000), "not a usable path"),
        (lambda meta: meta["frames"][0].update(file_path="a\0b"), "not a usable path"),
        (lambda meta: meta.update(mesh="room.fbx"), "room.fbx"),
        (lambda meta: meta.update(mesh="gone.ply"), "gone.ply: no such mesh"),
    ],
)
def test_impossible_values(nerfstudio_room: RoomCapture, change: Callable[[dict], object], message: str) -> None:
    change(nerfstudio_room.meta)
    assert message in refused(nerfstudio_room)


@pytest.mark.parametrize("text", ["", "{", "[]", "[" * 100_000, '{"frames": 3}', "\x00\xff"])
def test_transforms_file_that_is_not_one(nerfstudio_room: RoomCapture, text: str) -> None:
    nerfstudio_room.transforms.write_text(text)
    with pytest.raises(BadInput, match=r"transforms\.json: "):
        read_capture(nerfstudio_room.root)


def test_huge_transforms_file(nerfstudio_room: RoomCapture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "MAX_JSON_BYTES", 100)
    assert "transforms.json: is larger" in refused(nerfstudio_room)


def test_folder_that_is_no_capture(tmp_path) -> None:
    for path in (tmp_path, tmp_path / "gone"):
        with pytest.raises(BadInput, match=str(path)):
            read_capture(path)


def test_moved_poses_with_an_unnamed_mesh(nerfstudio_room: RoomCapture) -> None:
    nerfstudio_room.meta["applied_transform"] = [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]]
    assert "applied_transform" in refused(nerfstudio_room)
    nerfstudio_room.meta["mesh"] = "mesh.ply"
    assert read_capture(nerfstudio_room.save()).warnings == ()
    nerfstudio_room.meta["applied_scale"] = 0.3
    assert any("applied_scale" in warning for warning in read_capture(nerfstudio_room.save()).warnings)


def test_exposure_array_of_another_length(fipt_room: RoomCapture) -> None:
    np.save(fipt_room.root / "cam" / "exposure.npy", np.ones(4))
    assert "exposure.npy: has 4 values for 6 photos" in refused(fipt_room)


def test_pickled_arrays_are_not_opened(fipt_room: RoomCapture) -> None:
    np.save(fipt_room.root / "cam" / "exposure.npy", np.array([os.getcwd] * 6, object), allow_pickle=True)
    assert "exposure.npy: is not a .npy file of numbers" in refused(fipt_room)


# ---- mesh ----------------------------------------------------------------------------------------------------------


def test_empty_mesh(nerfstudio_room: RoomCapture) -> None:
    (nerfstudio_room.root / "mesh.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 0\nelement face 0\nend_header\n"
    )
    assert "mesh.ply: " in refused(nerfstudio_room)
    (nerfstudio_room.root / "mesh.ply").unlink()
    (nerfstudio_room.root / "mesh.obj").write_text("# nothing\n")
    assert "mesh.obj: has no faces" in refused(nerfstudio_room)


def test_point_cloud_named_as_mesh(nerfstudio_room: RoomCapture) -> None:
    trimesh.PointCloud(nerfstudio_room.mesh.vertices).export(nerfstudio_room.root / "mesh.ply")
    nerfstudio_room.meta["mesh"] = "mesh.ply"
    assert "mesh.ply: has" in refused(nerfstudio_room)


@pytest.mark.parametrize(
    ("vertices", "message"),
    [
        (lambda v: v * [1, 1, np.nan], "8 vertices with NaN"),
        (lambda v: v * 0, "only triangles without area"),
        (lambda v: v * 1000, r"millimeters against meters? — scale the mesh to meters (by 0.001)"),
        (lambda v: v + [500, 0, 0], "no photo sees the mesh"),
    ],
)
def test_unusable_geometry(nerfstudio_room: RoomCapture, vertices, message: str) -> None:
    mesh = nerfstudio_room.mesh
    mesh_file = nerfstudio_room.root / "mesh.ply"
    trimesh.Trimesh(vertices(mesh.vertices), mesh.faces, process=False).export(mesh_file)
    found = refused(nerfstudio_room)
    assert str(mesh_file) in found and message in found


def test_poses_in_millimetres(nerfstudio_room: RoomCapture) -> None:
    for frame in nerfstudio_room.meta["frames"]:
        pose = np.array(frame["transform_matrix"])
        pose[:3, 3] *= 1000
        frame["transform_matrix"] = pose.tolist()
    assert "poses in millimeters?" in refused(nerfstudio_room)


def test_camera_on_a_tripod_and_a_far_backdrop_are_fine(nerfstudio_room: RoomCapture) -> None:
    """Neither a path of length zero nor one quad a kilometre away is a mistake of units."""
    mesh = nerfstudio_room.mesh
    eye = np.array([2.0, 1.5, 1.2])
    for frame in nerfstudio_room.meta["frames"]:
        pose = np.array(frame["transform_matrix"])
        pose[:3, 3] = eye
        frame["transform_matrix"] = pose.tolist()
    backdrop = np.array([[-1e3, 1e3, -1e3], [1e3, 1e3, -1e3], [0, 1e3, 1e3]])
    trimesh.Trimesh(np.vstack([mesh.vertices, backdrop]), np.vstack([mesh.faces, [[8, 9, 10]]]), process=False).export(
        nerfstudio_room.root / "mesh.ply"
    )
    assert len(read_capture(nerfstudio_room.save()).mesh.faces) == 13


def test_photos_that_see_little_are_a_warning(nerfstudio_room: RoomCapture) -> None:
    write_mesh_of_one_wall(nerfstudio_room)
    warnings = read_capture(nerfstudio_room.root).warnings
    assert any("photos see less than 5% of the mesh" in warning for warning in warnings)


def write_mesh_of_one_wall(capture: RoomCapture) -> None:
    trimesh.Trimesh(capture.mesh.vertices, capture.mesh.faces[:2], process=False).export(capture.root / "mesh.ply")


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".glb"])
@pytest.mark.parametrize("share", [0.0, 0.4, 0.9])
def test_truncated_mesh(nerfstudio_room: RoomCapture, suffix: str, share: float) -> None:
    (nerfstudio_room.root / "mesh.ply").unlink()
    path = nerfstudio_room.root / f"mesh{suffix}"
    if suffix == ".obj":
        write_obj(path, nerfstudio_room.mesh)
        text = path.read_text()
        path.write_text(text[: text.index("f ")] + "f 1 2 99\n" if share > 0.5 else text[: int(len(text) * share)])
    else:
        write_mesh(path, nerfstudio_room.mesh)
        path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])
    nerfstudio_room.meta["mesh"] = path.name
    assert path.name in refused(nerfstudio_room)


def test_ply_that_announces_more_than_it_holds(nerfstudio_room: RoomCapture) -> None:
    path = nerfstudio_room.root / "mesh.ply"
    path.write_bytes(path.read_bytes().replace(b"element vertex 8", b"element vertex 99999999999"))
    assert "mesh.ply: announces more elements" in refused(nerfstudio_room)


def test_transforms_can_be_named_directly(nerfstudio_room: RoomCapture) -> None:
    other = nerfstudio_room.root / "subset.json"
    other.write_text(json.dumps({**nerfstudio_room.meta, "frames": nerfstudio_room.meta["frames"][:2]}))
    assert len(read_capture(other).views) == 2
