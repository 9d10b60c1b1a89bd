"""The bundled room written in every format that is read.

Photos are those of the bundle, pixel by pixel, with their exposures as EXIF; cameras are written by the writers of the
tests, each as its program does. Formats whose world is y up get the room turned.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Literal

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import ExifTags, Image
from PIL.TiffImagePlugin import IFDRational

from iris_addon.capture.phone_exports import CORRECTED_BORDER
from iris_addon.capture.photos import load_photo
from iris_addon.capture.pose_folders import KINECT
from iris_addon.capture.reader import read_capture
from iris_addon.model.capture import Camera, Capture, View, moved_by
from tests import colmap_model, program_cameras
from tests.sparse_points import random_similarity, sparse_points, write_points

from .perturb_photos import copy_capture
from .runs import BUNDLED

FIPT = "FIPT"
POINT_NOISE = 0.002
"""Of the distance, of points of structure from motion: half a pixel of the bundled photos."""
Z_UP_TO_Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
FROM_OUR_AXES = np.diag([-1.0, 1.0, -1.0, 1.0])
"""Turns a pose of ours into one of FIPT's layout, and back."""
Film = Literal["as taken", "with a border", "of a Kinect"]
Mesh = Literal["ply", "obj", "glb"]
Writer = Callable[[Path, Capture], object]


@dataclass(frozen=True)
class Format:
    """How the room is written in one format.

    Attributes:
        write: cameras of a capture whose photos lie in ``images/`` of the folder, and whose mesh beside that.
        y_up: whether the world of the format has y up.
        film: photos as they are; with the black border of Polycam's corrected ones around them; or as the one camera
            sees that the format knows.
        mesh: suffix of the mesh.
        like: the format that the metrics are held against; itself for a reference.
    """

    write: Writer
    y_up: bool = False
    film: Film = "as taken"
    mesh: Mesh = "ply"
    like: str = FIPT


# ---- Writers that the tests have no need of -------------------------------------------------------------------------


def _nerfstudio(root: Path, capture: Capture, **more: object) -> None:
    camera = capture.views[0].camera
    frames = [
        {"file_path": f"./images/{view.photo.name}", "transform_matrix": view.camera.c2w.tolist()}
        for view in capture.views
        if view.photo is not None
    ]
    lens = {"fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy, "w": camera.width}
    meta = {"camera_model": "OPENCV", **lens, "h": camera.height, **more, "frames": frames}
    (root / "transforms.json").write_text(json.dumps(meta))


def _instant_ngp(root: Path, capture: Capture) -> None:
    """As colmap2nerf.py writes it."""
    camera = capture.views[0].camera
    angles = {
        "camera_angle_x": 2 * np.arctan(camera.width / (2 * camera.fx)),
        "camera_angle_y": 2 * np.arctan(camera.height / (2 * camera.fy)),
    }
    lens = {"k1": 0.0, "k2": 0.0, "k3": 0.0, "k4": 0.0, "p1": 0.0, "p2": 0.0, "is_fisheye": False, "aabb_scale": 32}
    _nerfstudio(root, capture, **angles, **lens)


def _colmap(root: Path, capture: Capture, write: Callable[..., None]) -> None:
    model = root / "sparse" / "0"
    model.mkdir(parents=True)
    write(model, colmap_model.camera_of(capture), colmap_model.poses(capture))


def _colmap_text(root: Path, capture: Capture) -> None:
    _colmap(root, capture, colmap_model.write_text)


def _colmap_binary(root: Path, capture: Capture) -> None:
    _colmap(root, capture, colmap_model.write_binary)


def _colmap_in_its_own_frame(root: Path, capture: Capture) -> None:
    """The mesh is from elsewhere: poses and sparse points are in a frame and a unit of their own; the points are off by
    half a pixel or so, a fifth of them are wrong."""
    rng = np.random.default_rng(7)
    own, points = random_similarity(rng), sparse_points(capture, rng, POINT_NOISE)
    _colmap_binary(root, replace(capture, views=tuple(moved_by(view, own) for view in capture.views)))
    write_points(root / "sparse" / "0" / "points3D.txt", points @ own[:3, :3].T + own[:3, 3])


def _polycam_as_recorded(root: Path, capture: Capture) -> None:
    """Without Polycam's own adjustment: cameras of ARKit and photos as the lens saw them."""
    program_cameras.write_polycam(root, capture)
    keyframes = root / "keyframes"
    shutil.rmtree(keyframes / "images")
    shutil.rmtree(keyframes / "cameras")
    (keyframes / "corrected_images").rename(keyframes / "images")
    (keyframes / "corrected_cameras").rename(keyframes / "cameras")


_w = program_cameras
FORMATS: Mapping[str, Format] = {
    FIPT: Format(write=lambda _root, _capture: None),
    "FIPT, y up": Format(write=lambda _root, _capture: None, y_up=True, like="FIPT, y up"),
    "nerfstudio": Format(write=_nerfstudio),
    "nerfstudio, mesh as OBJ": Format(write=_nerfstudio, mesh="obj"),
    "nerfstudio, mesh as GLB": Format(write=_nerfstudio, mesh="glb"),
    "instant-ngp": Format(write=_instant_ngp),
    "COLMAP, text": Format(write=_colmap_text),
    "COLMAP, binary": Format(write=_colmap_binary),
    "COLMAP, poses in a frame of their own": Format(write=_colmap_in_its_own_frame),
    "Metashape": Format(write=_w.write_metashape),
    "Meshroom": Format(write=_w.write_meshroom),
    "RealityScan, CSV": Format(write=_w.write_reality_scan),
    "RealityScan, XMP": Format(write=_w.write_sidecars),
    "OpenMVG": Format(write=_w.write_openmvg),
    "Bundler": Format(write=_w.write_bundler),
    "ScanNet": Format(write=_w.write_scannet),
    "ScanNet++": Format(write=_w.write_scannetpp),
    "ScanNet++, undistorted": Format(write=_w.write_scannetpp_undistorted),
    "ARKitScenes": Format(write=_w.write_arkit_scenes),
    "TUM RGB-D": Format(write=_w.write_tum),
    "Polycam": Format(write=_w.write_polycam, y_up=True, film="with a border", like="FIPT, y up"),
    "Polycam, as recorded": Format(write=_polycam_as_recorded, y_up=True, mesh="glb", like="FIPT, y up"),
    "Record3D": Format(write=_w.write_record3d, y_up=True, like="FIPT, y up"),
    "nerfstudio, photos of a Kinect": Format(
        write=_nerfstudio, film="of a Kinect", like="nerfstudio, photos of a Kinect"
    ),
    "7-Scenes": Format(write=_w.write_seven_scenes, film="of a Kinect", like="nerfstudio, photos of a Kinect"),
}
"""By name, what each is held against first."""


# ---- The room -------------------------------------------------------------------------------------------------------


def write_room(name: str, folder: Path) -> tuple[Path, Path]:
    """The bundled room in the format ``name``, below ``folder``: the folders of the capture and of its ground truth."""
    form = FORMATS[name]
    truth = _turned(copy_capture(BUNDLED, folder / "truth")) if form.y_up else BUNDLED
    if name == form.like and name.startswith(FIPT):
        return truth, truth
    room, root = read_capture(truth), folder / "room"
    (root / "images").mkdir(parents=True)
    views = []
    for view in room.views:
        assert view.photo is not None and view.exposure is not None
        photo = root / "images" / view.photo.name
        camera = _write_photo(view.photo, view.camera, view.exposure, photo, form.film)
        views.append(replace(view, photo=photo, camera=camera))
    if form.mesh == "ply":
        shutil.copyfile(truth / "scene.ply", root / "mesh.ply")
    else:
        trimesh.Trimesh(room.mesh.vertices, room.mesh.faces, process=False).export(root / f"mesh.{form.mesh}")
    form.write(root, replace(room, views=tuple(views)))
    return root, truth


def _turned(root: Path) -> Path:
    """The capture in FIPT's layout at ``root`` with y up."""
    for path in sorted(root.glob("*/transforms.json")):
        meta = json.loads(path.read_text())
        for frame in meta["frames"]:
            frame["transform_matrix"] = (Z_UP_TO_Y_UP @ np.array(frame["transform_matrix"])).tolist()
        path.write_text(json.dumps(meta))
    mesh = trimesh.load(root / "scene.ply", process=False, maintain_order=True)
    mesh.apply_transform(Z_UP_TO_Y_UP).export(root / "scene.ply")
    described = json.loads((root / "meta.json").read_text())
    (root / "meta.json").write_text(json.dumps({**described, "up_axis": "+y"}))
    return root


def _write_photo(source: Path, camera: Camera, exposure: float, path: Path, film: Film) -> Camera:
    """The photo ``source`` on another film, with its exposure as EXIF; the camera of that."""
    with Image.open(source) as image:
        taken = image.convert("RGB")
    if film == "with a border":
        border = round(CORRECTED_BORDER * camera.width)
        while round(CORRECTED_BORDER * (camera.width + 2 * border)) > border:
            border += 1
        taken, camera = _bordered(taken, camera, border)
    elif film == "of a Kinect":
        taken, camera = _by_kinect(taken, camera)
    exif = Image.Exif()
    seconds = Fraction(exposure).limit_denominator(10**6)
    exif[ExifTags.IFD.Exif] = {ExifTags.Base.ExposureTime: IFDRational(seconds)}
    taken.save(path, exif=exif)
    return camera


def _bordered(taken: Image.Image, camera: Camera, border: int) -> tuple[Image.Image, Camera]:
    larger = Image.new("RGB", (camera.width + 2 * border, camera.height + 2 * border))
    larger.paste(taken, (border, border))
    cx, cy = camera.cx + border, camera.cy + border
    return larger, replace(camera, width=larger.width, height=larger.height, cx=cx, cy=cy)


def _by_kinect(taken: Image.Image, camera: Camera) -> tuple[Image.Image, Camera]:
    """The middle of a photo in the pixels of the one camera of 7-Scenes."""
    width, height, focal = int(KINECT["w"]), int(KINECT["h"]), KINECT["fl_x"]
    cx, cy = KINECT["cx"], KINECT["cy"]
    x, y = camera.fx / focal, camera.fy / focal
    to_source = (x, 0.0, camera.cx - cx * x, 0.0, y, camera.cy - cy * y)
    seen = taken.transform((width, height), Image.Transform.AFFINE, to_source, Image.Resampling.BILINEAR)
    return seen, replace(camera, width=width, height=height, fx=focal, fy=focal, cx=cx, cy=cy)


# ---- What the engine gets -------------------------------------------------------------------------------------------


def differences(capture: Capture, reference: Capture) -> dict[str, float]:
    """The largest differences between two captures whose photos are in one order.

    Returns:
        "place" in metres, "turn" in degrees, "intrinsics" in pixels from the border of the picture, "exposure" in
        stops after their mean is taken out, "mesh" in metres, and "pixels" in codes of 8 bits; NaN where photos, or
        corners of the mesh, are not as many.
    """
    corners, wanted = (each.mesh.vertices[each.mesh.faces] for each in (capture, reference))
    if len(capture.views) != len(reference.views) or corners.shape != wanted.shape:
        return dict.fromkeys(("place", "turn", "intrinsics", "exposure", "mesh", "pixels"), float("nan"))
    pairs = list(zip(capture.views, reference.views, strict=True))
    places = [np.linalg.norm(a.camera.position - b.camera.position) for a, b in pairs]
    turns = [a.camera.c2w[:3, :3].T @ b.camera.c2w[:3, :3] - np.eye(3) for a, b in pairs]
    stops = np.array([np.log2(a.exposure or np.nan) - np.log2(b.exposure or np.nan) for a, b in pairs])
    return {
        "place": float(max(places)),
        "turn": float(np.degrees(max(np.linalg.norm(turn) / np.sqrt(2) for turn in turns))),
        "intrinsics": float(max(np.abs(_frustum(a.camera) - _frustum(b.camera)).max() for a, b in pairs)),
        "exposure": float(np.abs(stops - stops.mean()).max()),
        "mesh": float(np.abs(corners - wanted).max()),
        "pixels": float(max(_pixel_difference(a, b) for a, b in pairs)),
    }


def _frustum(camera: Camera) -> NDArray[np.floating]:
    return np.array([camera.fx, camera.fy, camera.cx - camera.width / 2, camera.cy - camera.height / 2])


def _pixel_difference(view: View, wanted: View) -> float:
    """In codes; NaN where another part of the picture is used. A border that is no picture is left out."""
    photo, other = load_photo(view), load_photo(wanted)
    x, y = (view.camera.width - wanted.camera.width) // 2, (view.camera.height - wanted.camera.height) // 2
    inner = slice(y, y + wanted.camera.height), slice(x, x + wanted.camera.width)
    valid = photo.valid[inner]
    if valid.sum() != photo.valid.sum() or not np.array_equal(valid, other.valid):
        return float("nan")
    return float(255 * np.abs(photo.values[inner][valid] - other.values[valid]).max())
