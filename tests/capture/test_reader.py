"""Readers of both capture layouts: rays, splits, exposures, meshes, what is left alone."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation

from iris_addon.base.errors import BadInput
from iris_addon.base.images import read_exr, read_image, write_exr
from iris_addon.capture.nerfstudio import read_nerfstudio
from iris_addon.capture.photos import load_photo
from iris_addon.capture.reader import read_capture, read_views
from tests.box_room import FOCAL, HEIGHT, WALL_COLORS, WIDTH, RoomCapture, box_mesh, render_walls, write_mesh

# ---- photos left out -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("layout", ["fipt_room", "nerfstudio_room"])
def test_photos_that_are_left_out_are_not_even_opened(layout: str, request: pytest.FixtureRequest) -> None:
    root = request.getfixturevalue(layout).root
    whole = read_capture(root)
    *others, last = whole.views
    assert last.photo is not None
    last.photo.write_bytes(b"no picture")
    capture = read_capture(root, exclude=[last.name])
    assert [view.name for view in capture.views] == [view.name for view in others]
    assert capture.excluded == (last.name,) and len(capture.val_views) == len(whole.val_views)


def test_photos_to_leave_out_must_be_there_and_others_remain(nerfstudio_room: RoomCapture) -> None:
    names = [view.name for view in read_capture(nerfstudio_room.root).views]
    with pytest.raises(BadInput, match=f"no photo '{names[0]}x' to leave out.*{names[0]}"):
        read_capture(nerfstudio_room.root, exclude=[f"{names[0]}x"])
    with pytest.raises(BadInput, match="no other photos"):
        read_capture(nerfstudio_room.root, exclude=names)


# ---- FIPT ----------------------------------------------------------------------------------------------------------


def test_fipt_rays_follow_the_published_formula(fipt_room: RoomCapture) -> None:
    """Ray of pixel (i, j): R [-(i + .5 - W/2)/f, -(j + .5 - H/2)/f, 1], columns of R left, up, forward."""
    capture = read_capture(fipt_room.root)
    for view, frame in zip(capture.views, fipt_room.meta["frames"], strict=True):
        matrix = np.array(frame["transform_matrix"])
        j, i = np.mgrid[:HEIGHT, :WIDTH]
        local = np.stack([-(i + 0.5 - WIDTH / 2) / FOCAL, -(j + 0.5 - HEIGHT / 2) / FOCAL, np.ones_like(i, float)], -1)
        expected = local.reshape(-1, 3) @ matrix[:3, :3].T
        expected /= np.linalg.norm(expected, axis=1, keepdims=True)
        origins, directions = view.camera.rays()
        np.testing.assert_allclose(directions, expected, atol=1e-12)
        np.testing.assert_allclose(origins[0], matrix[:3, 3])


@pytest.mark.parametrize("layout", ["fipt_room", "nerfstudio_room"])
def test_rays_see_what_the_photos_show(layout: str, request: pytest.FixtureRequest) -> None:
    capture = read_capture(request.getfixturevalue(layout).root)
    for view in capture.views:
        photo = load_photo(view)
        assert not photo.hdr and photo.valid.all()
        np.testing.assert_array_equal(np.rint(photo.values * 255), render_walls(view.camera, capture.mesh))


def test_points_along_a_ray_lie_in_its_pixel(fipt_room: RoomCapture) -> None:
    camera = replace(read_capture(fipt_room.root).views[0].camera, fx=31.0, fy=29.0, cx=9.0, cy=11.0)
    origin, direction = camera.rays()
    at = camera.project(camera.local(origin + 2.5 * direction))
    row, column = np.divmod(np.arange(len(at)), camera.width)
    np.testing.assert_allclose(at, np.stack([column, row], -1) + 0.5, atol=1e-9)


def test_fipt_exposures_splits_and_up(fipt_room: RoomCapture) -> None:
    capture = read_capture(fipt_room.root)
    assert [view.exposure for view in capture.views] == [0.25, 0.5, 1, 2, 4, 1]
    assert [view.exposure for view in capture.val_views] == [0.5, 2]
    assert all(view.photo is None and view.split == "val" for view in capture.val_views)
    assert capture.views[0].name == "000_0001" and capture.exposures_known
    assert capture.up == (0, 1, 0)
    (fipt_room.root / "meta.json").write_text('{"up_axis": "-z"}')
    assert read_capture(fipt_room.root).up == (0, 0, -1)


def test_fipt_constant_exposure_set(fipt_room: RoomCapture) -> None:
    capture = read_capture(fipt_room.root, photos="Image_const")
    assert {view.exposure for view in capture.views} == {1.5}
    assert all(view.photo is not None and view.photo.parent.name == "Image_const" for view in capture.views)
    assert all(view.exposure is None for view in capture.val_views)


def test_ground_truth_is_never_part_of_the_capture(fipt_room: RoomCapture) -> None:
    photos = fipt_room.root / "gt" / "val" / "Image"
    photos.mkdir(parents=True)
    for name in ("000_0001.png", "001_0001.png"):
        (photos / name).write_bytes(fipt_room.photos[0].read_bytes())
    capture = read_capture(fipt_room.root)
    assert all(view.photo is None for view in capture.val_views)


def test_fipt_release_has_maps_beside_the_photos_and_numbered_frames(fipt_room: RoomCapture) -> None:
    (fipt_room.root / "train" / "DiffCol").mkdir()
    for photo in fipt_room.photos:
        write_exr(fipt_room.root / "train" / "DiffCol" / f"{photo.stem}.exr", np.zeros((HEIGHT, WIDTH, 3)))
    for number, frame in enumerate(fipt_room.meta["frames"]):
        frame["file_path"] = f"./train/r_{number}"
    capture = read_capture(fipt_room.save())
    assert [view.photo for view in capture.views] == fipt_room.photos


def test_the_transforms_file_of_a_fipt_capture_keeps_its_convention(fipt_room: RoomCapture) -> None:
    expected = read_capture(fipt_room.root)
    by_file = read_capture(fipt_room.transforms)
    np.testing.assert_array_equal(by_file.views[0].camera.c2w, expected.views[0].camera.c2w)
    val = read_views(fipt_room.root / "val" / "transforms.json")
    assert [view.exposure for view in val] == [0.5, 2]
    np.testing.assert_array_equal(val[0].camera.c2w, expected.val_views[0].camera.c2w)


# ---- nerfstudio ----------------------------------------------------------------------------------------------------


def test_per_frame_intrinsics_override_those_of_the_file(nerfstudio_room: RoomCapture) -> None:
    nerfstudio_room.meta["frames"][2].update({"fl_x": 30.0, "fl_y": 25.0, "cx": 12.5, "cy": 10.0})
    first, _, third, *_ = (view.camera for view in read_capture(nerfstudio_room.save()).views)
    assert (first.fx, first.fy, first.cx, first.cy) == (FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2)
    assert (third.fx, third.fy, third.cx, third.cy) == (30, 25, 12.5, 10)


def test_camera_angles_and_size_from_the_photo(nerfstudio_room: RoomCapture) -> None:
    for key in ("fl_x", "fl_y", "w", "h"):
        del nerfstudio_room.meta[key]
    nerfstudio_room.meta["camera_angle_x"] = 2 * np.arctan(0.5)
    camera = read_capture(nerfstudio_room.save()).views[0].camera
    assert (camera.width, camera.height) == (WIDTH, HEIGHT)
    assert camera.fx == pytest.approx(WIDTH) and camera.fy == pytest.approx(WIDTH)


def test_splits_per_frame(nerfstudio_room: RoomCapture) -> None:
    splits = ["train", "val", "train", "test", "train", "train"]
    for frame, split in zip(nerfstudio_room.meta["frames"], splits, strict=True):
        frame["split"] = split
    capture = read_capture(nerfstudio_room.save())
    assert [view.name for view in capture.views] == ["000", "002", "004", "005"]
    assert [view.name for view in capture.val_views] == ["001", "003"]


def test_split_lists(nerfstudio_room: RoomCapture) -> None:
    nerfstudio_room.meta["train_filenames"] = [f"images/{n:03d}.png" for n in (0, 1, 2)]
    nerfstudio_room.meta["test_filenames"] = ["images/004.png"]
    capture = read_capture(nerfstudio_room.save())
    assert [view.name for view in capture.views] == ["000", "001", "002"]
    assert [view.name for view in capture.val_views] == ["004"]
    assert any("2 frames are in no split" in warning for warning in capture.warnings)


def test_names_stay_unique_when_folders_repeat_file_names(nerfstudio_room: RoomCapture) -> None:
    for number in (0, 1):
        folder = nerfstudio_room.root / f"day{number}"
        folder.mkdir()
        (folder / "a.png").write_bytes(nerfstudio_room.photos[number].read_bytes())
        nerfstudio_room.meta["frames"][number]["file_path"] = f"day{number}/a"  # without its extension
    names = [view.name for view in read_capture(nerfstudio_room.save()).views]
    assert names[:2] == ["day0_a", "day1_a"] and len(set(names)) == 6


def test_exr_photos_are_radiance(nerfstudio_room: RoomCapture) -> None:
    for photo, frame in zip(nerfstudio_room.photos, nerfstudio_room.meta["frames"], strict=True):
        write_exr(photo.with_suffix(".exr"), read_image(photo) * 0.1)
        frame["file_path"] = f"images/{photo.stem}.exr"
    capture = read_capture(nerfstudio_room.save(), exposures="none")
    photo = load_photo(capture.views[0])
    assert photo.hdr and photo.values.max() > 1
    assert {view.exposure for view in capture.views} == {1.0}


def test_hdr_folder_replaces_the_photos(fipt_room: RoomCapture, tmp_path: Path) -> None:
    folder = tmp_path / "hdr"
    for photo in fipt_room.photos:
        values = read_image(photo) * np.float32(0.1)
        values[0, 0] = np.nan
        write_exr(folder / f"{photo.stem}.exr", values)
    capture = read_capture(fipt_room.root, hdr=folder)
    photo = load_photo(capture.views[3])
    assert photo.hdr and not photo.valid[0, 0] and photo.valid.sum() == photo.valid.size - 1
    np.testing.assert_allclose(photo.values[1:], read_exr(folder / "003_0001.exr")[1:])
    (folder / "003_0001.exr").unlink()
    with pytest.raises(BadInput, match=r"003_0001\.exr"):
        read_capture(fipt_room.root, hdr=folder)


# ---- meshes --------------------------------------------------------------------------------------------------------


def test_obj_groups_become_regions_in_file_order(fipt_room: RoomCapture) -> None:
    mesh = read_capture(fipt_room.root).mesh
    np.testing.assert_array_equal(mesh.faces, fipt_room.mesh.faces)
    assert mesh.regions is not None
    np.testing.assert_array_equal(mesh.regions, np.arange(12) // 2)


def test_obj_keeps_face_order_across_alternating_materials_and_reads_uv(fipt_room: RoomCapture) -> None:
    """Materials A, B, A: readers that group faces by material would reorder them."""
    mesh = fipt_room.mesh
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices]
    for number, face in enumerate(mesh.faces + 1):
        lines.append(f"usemtl {'AB'[number % 2]}")
        column, row = number % 4 / 4, number // 4 / 4
        lines += [f"vt {column + u} {row + v}" for u, v in ((0, 0), (0.2, 0), (0, 0.2))]
        lines.append("f " + " ".join(f"{vertex}/{k - 3}" for k, vertex in enumerate(face)))
    (fipt_room.root / "scene.obj").write_text("\n".join(lines))
    read = read_capture(fipt_room.root).mesh
    np.testing.assert_array_equal(read.faces, mesh.faces)
    np.testing.assert_array_equal(read.regions, np.arange(12) % 2)
    assert read.uv is not None and read.uv.shape == (12, 3, 2)
    np.testing.assert_allclose(read.uv[5], [[0.25, 0.25], [0.45, 0.25], [0.25, 0.45]])


def test_overlapping_or_tiled_uvs_are_not_an_atlas(nerfstudio_room: RoomCapture) -> None:
    mesh = box_mesh()
    corners = mesh.vertices[mesh.faces].reshape(-1, 3)
    for scale, reason in ((1.0, "same place"), (3.0, "leave the unit square")):
        uv = np.tile([[0.0, 0.0], [scale, 0.0], [0.0, scale]], (12, 1))
        visual = trimesh.visual.TextureVisuals(uv=uv)
        trimesh.Trimesh(corners, np.arange(36).reshape(-1, 3), visual=visual, process=False).export(
            nerfstudio_room.root / "mesh.ply"
        )
        capture = read_capture(nerfstudio_room.root)
        assert capture.mesh.uv is None
        assert any(reason in warning for warning in capture.warnings)


def test_glb_nodes_are_placed_and_become_regions(nerfstudio_room: RoomCapture) -> None:
    scene = trimesh.Scene()
    for wall in range(6):
        faces = nerfstudio_room.mesh.faces[2 * wall : 2 * wall + 2]
        node = trimesh.Trimesh(nerfstudio_room.mesh.vertices - [1, 2, 3], faces, process=False)
        scene.add_geometry(node, transform=trimesh.transformations.translation_matrix([1, 2, 3]))
    (nerfstudio_room.root / "mesh.ply").unlink()
    scene.export(nerfstudio_room.root / "mesh.glb")
    mesh = read_capture(nerfstudio_room.root).mesh
    assert mesh.regions is not None and len(np.unique(mesh.regions)) == 6 and len(mesh.faces) == 12
    np.testing.assert_allclose([mesh.vertices.min(0), mesh.vertices.max(0)], [[0, 0, 0], [4, 3, 2.5]], atol=1e-6)


def test_y_up_glb_is_turned_to_z_up_poses_when_only_then_photos_see_it(nerfstudio_room: RoomCapture) -> None:
    """A floor alone: turned on its side it stands far off, so the photos miss it."""
    vertices = np.array([[-50, -50, 0], [50, -50, 0], [50, 50, 0], [-50, 50, 0]]) * [1, 1, 1] + [0, 0, 5.0]
    as_gltf = vertices @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # z up to y up
    for frame in nerfstudio_room.meta["frames"]:
        pose = np.eye(4)
        pose[:3, 3] = np.array(frame["transform_matrix"])[:3, 3] + [0, 0, 6]
        frame["transform_matrix"] = pose.tolist()  # looks straight down
    (nerfstudio_room.root / "mesh.ply").unlink()
    trimesh.Trimesh(as_gltf, [[0, 1, 2], [0, 2, 3]], process=False).export(nerfstudio_room.root / "mesh.glb")
    capture = read_capture(nerfstudio_room.save())
    np.testing.assert_allclose(capture.mesh.vertices, vertices, atol=1e-5)
    assert any("turned from y up" in warning for warning in capture.warnings)


def test_point_cloud_named_by_nerfstudio_is_not_the_mesh(nerfstudio_room: RoomCapture) -> None:
    trimesh.PointCloud(nerfstudio_room.mesh.vertices).export(nerfstudio_room.root / "sparse_pc.ply")
    nerfstudio_room.meta["ply_file_path"] = "sparse_pc.ply"
    assert len(read_capture(nerfstudio_room.save()).mesh.faces) == 12


def test_a_choice_of_meshes_must_be_made(nerfstudio_room: RoomCapture) -> None:
    write_mesh(nerfstudio_room.root / "other.ply", nerfstudio_room.mesh)
    with pytest.raises(BadInput, match=r"several meshes \(mesh.ply, other.ply\)"):
        read_capture(nerfstudio_room.root)
    nerfstudio_room.meta["mesh"] = "other.ply"
    assert len(read_capture(nerfstudio_room.save()).mesh.faces) == 12


def test_a_mesh_that_only_blender_reads_is_named(nerfstudio_room: RoomCapture) -> None:
    (nerfstudio_room.root / "mesh.ply").rename(nerfstudio_room.root / "room.usdz")
    with pytest.raises(BadInput, match=r"import room\.usdz into Blender and export it as GLB"):
        read_capture(nerfstudio_room.root)


def test_non_manifold_mesh_is_a_warning(nerfstudio_room: RoomCapture) -> None:
    mesh = nerfstudio_room.mesh
    extra = np.vstack([mesh.faces, [[0, 1, 7]], [[0, 1, 6]]])
    trimesh.Trimesh(mesh.vertices, extra, process=False).export(nerfstudio_room.root / "mesh.ply")
    assert any("more than two faces" in warning for warning in read_capture(nerfstudio_room.root).warnings)


# ---- exposures -----------------------------------------------------------------------------------------------------


def test_exposures_can_be_withheld(fipt_room: RoomCapture) -> None:
    capture = read_capture(fipt_room.root, exposures="none")
    assert all(view.exposure is None for view in capture.views) and not capture.exposures_known


def test_exposure_time_iso_and_aperture_of_a_frame(nerfstudio_room: RoomCapture) -> None:
    for number, frame in enumerate(nerfstudio_room.meta["frames"]):
        frame.update({"exposure_time": 0.02 * 2**number, "iso": 200, "f_number": 2.0})
    exposures = [view.exposure for view in read_capture(nerfstudio_room.save()).views]
    np.testing.assert_allclose(exposures, 0.02 * 2.0 ** np.arange(6) * 2 / 4)


def with_exif(capture: RoomCapture, skip: int | None = None) -> None:
    """Turn the photos into JPEG with EXIF: 1/50 s, f/4, ISO doubling from photo to photo."""
    for number, (photo, frame) in enumerate(zip(capture.photos, capture.meta["frames"], strict=True)):
        exif = Image.Exif()
        if number != skip:
            exif.get_ifd(0x8769).update({33434: 0.02, 33437: 4.0, 34855: 100 * 2**number})
        Image.open(photo).save(photo.with_suffix(".jpg"), exif=exif)
        frame["file_path"] = f"images/{photo.stem}.jpg"


def test_exposures_from_exif(nerfstudio_room: RoomCapture) -> None:
    with_exif(nerfstudio_room)
    exposures = [view.exposure for view in read_capture(nerfstudio_room.save()).views]
    np.testing.assert_allclose(exposures, 0.02 * 2.0 ** np.arange(6) / 16)


def test_one_photo_without_exif_makes_exposures_unknown_with_a_warning(nerfstudio_room: RoomCapture) -> None:
    with_exif(nerfstudio_room, skip=3)
    capture = read_capture(nerfstudio_room.save())
    assert [view.exposure is None for view in capture.views] == [n == 3 for n in range(6)]
    assert not capture.exposures_known and any("1 of 6 photos" in warning for warning in capture.warnings)


@pytest.mark.parametrize("suffix", [".json", ".csv", ".npy"])
def test_exposures_from_a_file(nerfstudio_room: RoomCapture, tmp_path: Path, suffix: str) -> None:
    values = [0.5, 1, 2, 4, 8, 16]
    path = tmp_path / f"exposures{suffix}"
    if suffix == ".json":
        path.write_text(json.dumps({photo.name: v for photo, v in zip(nerfstudio_room.photos, values, strict=True)}))
    elif suffix == ".csv":
        rows = [f"{photo.stem},{v}" for photo, v in zip(nerfstudio_room.photos, values, strict=True)]
        path.write_text("\n".join(["name,exposure", *rows]))
    else:
        np.save(path, values)
    assert [view.exposure for view in read_capture(nerfstudio_room.root, exposures=path).views] == values


def test_exposure_file_that_forgets_a_photo(nerfstudio_room: RoomCapture, tmp_path: Path) -> None:
    (tmp_path / "e.json").write_text('{"000": 1.0}')
    with pytest.raises(BadInput, match=r"e\.json: has no exposure for 001"):
        read_capture(nerfstudio_room.root, exposures=tmp_path / "e.json")


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_impossible_exposures_are_refused(fipt_room: RoomCapture, value: float) -> None:
    np.save(fipt_room.root / "cam" / "exposure.npy", [1, 1, value, 1, 1, 1])
    with pytest.raises(BadInput, match="002_0001: exposure"):
        read_capture(fipt_room.root)


# ---- public captures -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "train", "val", "known"),
    [("staircase2", 32, 6, True), ("living-room-2", 32, 6, True), ("redkitchen", 80, 12, False)],
)
def test_public_captures(shared: Path, name: str, train: int, val: int, known: bool) -> None:
    capture = read_capture(shared / "captures" / name)
    assert (len(capture.views), len(capture.val_views), capture.exposures_known) == (train, val, known)
    assert load_photo(capture.views[-1]).valid.all()
    for view in (*capture.views, *capture.val_views):
        assert view.photo is None or "gt" not in view.photo.relative_to(capture.root).parts


def test_staircase2_rays_meet_the_mesh_at_the_true_depth(shared: Path) -> None:
    from iris_addon.rays.tracer import Tracer

    capture = read_capture(shared / "captures" / "staircase2")
    tracer = Tracer(capture.mesh)
    for view in capture.views[::8]:
        depth = read_exr(capture.root / "gt" / "train" / "Depth" / f"{view.name}.exr")[..., 0].ravel()
        traced = tracer.closest(*view.camera.rays()).distance
        both = np.isfinite(traced) & (depth > 0)
        assert both.mean() > 0.95
        assert np.median(np.abs(traced - depth)[both] / depth[both]) < 2e-3


def test_exif_of_a_real_bracket(shared: Path) -> None:
    from iris_addon.capture.exposures import from_exif

    photos = sorted((shared / "brackets" / "desk").glob("*.jpg"))
    known = from_exif({photo.stem: photo for photo in photos})
    assert len(known) == len(photos) == 13
    mean = [read_image(photo).mean() for photo in photos]
    order = np.argsort([known[photo.stem] for photo in photos])
    assert (np.diff(np.array(mean)[order]) > 0).all()


def test_wall_colours_are_distinct() -> None:
    """The layout tests above tell walls apart by colour."""
    assert len({tuple(color) for color in WALL_COLORS}) == 6


@pytest.mark.parametrize(
    ("turn", "expected"),
    [
        ([0.0, 0.0, 0.0], (0.0, 0.0, 1.0)),
        ([0.4, 0.0, 0.0], (0.0, 0.0, 1.0)),  # all look down a little
        ([np.pi / 2, 0.0, 0.0], (0.0, -1.0, 0.0)),  # a recorder whose y points down
        ([np.pi / 2 + 0.2, 0.1, 0.0], (0.0, -1.0, 0.0)),
        ([0.0, np.pi, 0.0], (0.0, 0.0, -1.0)),
        ([np.pi / 2 + 0.7, 0.0, 0.0], None),  # no axis is near
    ],
)
def test_up_is_z_unless_the_photos_lie_on_their_side(
    nerfstudio_room: RoomCapture, turn: list[float], expected: tuple[float, float, float] | None
) -> None:
    file = nerfstudio_room.root / "transforms.json"
    content = json.loads(file.read_text())
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    for frame in content["frames"]:
        frame["transform_matrix"] = (matrix @ np.array(frame["transform_matrix"])).tolist()
    file.write_text(json.dumps(content))
    up = read_nerfstudio(file).up
    if expected is None:
        cameras = np.mean([np.array(frame["transform_matrix"])[:3, 1] for frame in content["frames"]], axis=0)
        assert np.dot(up, cameras) / np.linalg.norm(cameras) > 0.999
    else:
        assert up == expected
    (nerfstudio_room.root / "meta.json").write_text('{"up_axis": "+x"}')
    assert read_nerfstudio(file).up == (1.0, 0.0, 0.0)


def with_models(capture: RoomCapture, models: str) -> None:
    """Turn the photos into JPEG with the maker and model of a camera, a letter each; "-" leaves them out."""
    for photo, frame, model in zip(capture.photos, capture.meta["frames"], models, strict=True):
        exif = Image.Exif()
        if model != "-":
            exif.update({271: "Acme", 272: model})
        Image.open(photo).save(photo.with_suffix(".jpg"), exif=exif)
        frame["file_path"] = f"images/{photo.stem}.jpg"


def test_the_camera_of_each_photo_is_that_of_exif(nerfstudio_room: RoomCapture) -> None:
    with_models(nerfstudio_room, "abbaab")
    capture = read_capture(nerfstudio_room.save())
    assert [view.device for view in capture.views] == [f"Acme {letter}" for letter in "abbaab"]
    assert not any("cameras" in warning for warning in capture.warnings)


def test_the_camera_that_a_frame_names_stands_before_that_of_exif(nerfstudio_room: RoomCapture) -> None:
    with_models(nerfstudio_room, "aaaaaa")
    for frame in nerfstudio_room.meta["frames"][::2]:
        frame["device"] = "other"
    capture = read_capture(nerfstudio_room.save())
    assert [view.device for view in capture.views] == ["other", "Acme a"] * 3


def test_a_camera_of_too_few_photos_is_a_warning(nerfstudio_room: RoomCapture) -> None:
    with_models(nerfstudio_room, "aaa-bb")
    (warning,) = [warning for warning in read_capture(nerfstudio_room.save()).warnings if "cameras" in warning]
    assert "3 cameras" in warning and "unknown (1)" in warning and "Acme b (2)" in warning


@pytest.mark.parametrize("layout", ["nerfstudio_room", "fipt_room"])
def test_frames_name_their_light_state(layout: str, request: pytest.FixtureRequest) -> None:
    room: RoomCapture = request.getfixturevalue(layout)
    assert {view.light_state for view in read_capture(room.root).views} == {""}
    states = ["evening", "Bett + Flur", "a-b_c.1", "evening", "evening", "2"]
    for frame, state in zip(room.meta["frames"], states, strict=True):
        frame["light_state"] = state
    assert [view.light_state for view in read_capture(room.save()).views] == states


@pytest.mark.parametrize("state", ["", " ", 3, None, "x" * 41, "a\nb", ["a"]])
def test_a_light_state_that_is_no_name_is_refused_with_the_file(nerfstudio_room: RoomCapture, state: object) -> None:
    for frame in nerfstudio_room.meta["frames"]:
        frame["light_state"] = "evening"
    nerfstudio_room.meta["frames"][2]["light_state"] = state
    with pytest.raises(BadInput, match=r"002.*light_state") as refused:
        read_capture(nerfstudio_room.save())
    assert str(nerfstudio_room.transforms) in str(refused.value)


def test_all_frames_name_a_light_state_or_none_does(nerfstudio_room: RoomCapture) -> None:
    for frame in nerfstudio_room.meta["frames"][1:]:
        frame["light_state"] = "evening"
    with pytest.raises(BadInput, match=r'000 has no "light_state"'):
        read_capture(nerfstudio_room.save())


def test_a_light_state_of_its_own_for_every_photo_is_refused(nerfstudio_room: RoomCapture) -> None:
    frames = nerfstudio_room.meta["frames"]
    nerfstudio_room.meta["frames"] = [{**frames[k % 6], "light_state": f"lamp {k}"} for k in range(17)]
    with pytest.raises(BadInput, match="17 light states"):
        read_capture(nerfstudio_room.save())
