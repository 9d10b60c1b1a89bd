"""The box room as photogrammetry programs and RGB-D data sets write it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation

from iris_addon.model.capture import Capture

DOWN_FORWARD = np.diag([1.0, -1.0, -1.0, 1.0])
Writer = Callable[[Path, Capture], Path]


def numbers(values: np.ndarray) -> str:
    return " ".join(f"{x:.12g}" for x in np.asarray(values).ravel())


def write_metashape(root: Path, capture: Capture) -> Path:
    """A chunk that is turned, moved and scaled against the world, as after setting a reference."""
    turn, shift, scale = Rotation.from_euler("xyz", (0.3, 0.2, 0.1)).as_matrix(), np.array([1.0, 2, 3]), 2.5
    camera = capture.views[0].camera
    rows = []
    for number, view in enumerate(capture.views):
        pose = view.camera.c2w @ DOWN_FORWARD
        own = np.eye(4)
        own[:3, :3], own[:3, 3] = turn.T @ pose[:3, :3], turn.T @ (pose[:3, 3] - shift) / scale
        assert view.photo is not None
        named = f'<camera id="{number}" sensor_id="0" label="{view.photo.stem}">'
        rows.append(f"{named}<transform>{numbers(own)}</transform></camera>")
    size = f'<resolution width="{camera.width}" height="{camera.height}"/>'
    lens = f"<f>{camera.fx}</f><cx>{camera.cx - camera.width / 2}</cx><cy>{camera.cy - camera.height / 2}</cy>"
    path = root / "cameras.xml"
    path.write_text(
        f'<document version="2.0.0"><chunk label="c"><sensors><sensor id="0" type="frame">{size}'
        f'<calibration type="frame" class="initial">{size}<f>1</f></calibration>'
        f'<calibration type="frame" class="adjusted">{size}{lens}</calibration></sensor></sensors>'
        f"<cameras><group>{''.join(rows)}</group><camera id='99' sensor_id='0' label='lost'/></cameras>"
        f"<transform><rotation>{numbers(turn)}</rotation><translation>{numbers(shift)}</translation>"
        f"<scale>{scale}</scale></transform></chunk></document>"
    )
    return path


def write_meshroom(root: Path, capture: Capture) -> Path:
    camera = capture.views[0].camera
    views, poses = [], []
    for number, view in enumerate(capture.views):
        assert view.photo is not None
        pose = view.camera.c2w @ DOWN_FORWARD
        views.append({"poseId": str(number), "intrinsicId": "7", "path": f"/home/else/{view.photo.name}"})
        transform = {"rotation": [str(x) for x in pose[:3, :3].ravel()], "center": [str(x) for x in pose[:3, 3]]}
        poses.append({"poseId": str(number), "pose": {"transform": transform, "locked": "1"}})
    intrinsic = {
        "intrinsicId": "7",
        "width": str(camera.width),
        "height": str(camera.height),
        "sensorWidth": "36",
        "focalLength": str(camera.fx / camera.width * 36),
        "type": "radial3",
        "principalPoint": [str(camera.cx - camera.width / 2), str(camera.cy - camera.height / 2)],
        "distortionParams": ["0.0", "0.0", "0.0"],
    }
    path = root / "sfm.sfm"
    path.write_text(json.dumps({"version": ["1", "2", "3"], "views": views, "intrinsics": [intrinsic], "poses": poses}))
    return path


def write_bundler(root: Path, capture: Capture) -> Path:
    lines, names = ["# Bundle file v0.3", f"{len(capture.views)} 0"], []
    for view in capture.views:
        assert view.photo is not None
        world_to_camera = np.linalg.inv(view.camera.c2w)
        lines.append(f"{view.camera.fx} 0 0")
        lines += [numbers(row) for row in world_to_camera[:3, :3]] + [numbers(world_to_camera[:3, 3])]
        names.append(f"images/{view.photo.name} 0 {view.camera.fx}")
    (root / "list.txt").write_text("\n".join(names) + "\n")
    path = root / "bundle.out"
    path.write_text("\n".join(lines) + "\n")
    return path


def write_reality_scan(root: Path, capture: Capture) -> Path:
    lines = ["#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2"]
    for view in capture.views:
        assert view.photo is not None
        camera = view.camera
        yaw, pitch, roll = Rotation.from_matrix(camera.c2w[:3, :3]).as_euler("ZXY", degrees=True)
        x, y, z = camera.position
        focal = camera.fx / max(camera.width, camera.height) * 36
        lines.append(f"{view.photo.name},{x},{y},{z},{-yaw},{pitch},{roll},{focal},0,0,0,0,0,0,0,0")
    path = root / "cameras.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def write_openmvg(root: Path, capture: Capture) -> Path:
    """As cereal writes it: classes are named at their first object only."""
    camera = capture.views[0].camera
    views, poses = [], []
    for number, view in enumerate(capture.views):
        assert view.photo is not None
        pose = view.camera.c2w @ DOWN_FORWARD
        size = {"width": camera.width, "height": camera.height}
        ids = {"id_view": number, "id_intrinsic": 3, "id_pose": number}
        data = {"local_path": "", "filename": view.photo.name, **size, **ids}
        pointer = {"id": 2147483649 + number, "data": data}
        views.append({"key": number, "value": {"polymorphic_id": 1073741824, "ptr_wrapper": pointer}})
        poses.append({"key": number, "value": {"rotation": pose[:3, :3].T.tolist(), "center": pose[:3, 3].tolist()}})
    views.append({"key": 99, "value": {"polymorphic_id": 1073741824, "ptr_wrapper": {"id": 1, "data": {**data}}}})
    views[-1]["value"]["ptr_wrapper"]["data"] |= {"filename": "lost.png", "id_pose": 99, "id_intrinsic": 4294967295}
    data = {"width": camera.width, "height": camera.height, "focal_length": camera.fx}
    data |= {"principal_point": [camera.cx, camera.cy], "disto_k3": [0.0, 0.0, 0.0]}
    kind = {"polymorphic_id": 2147483649, "polymorphic_name": "pinhole_radial_k3"}
    intrinsic = {"key": 3, "value": {**kind, "ptr_wrapper": {"id": 2147483700, "data": data}}}
    content = {"sfm_data_version": "0.3", "root_path": "/home/else/images", "views": views, "intrinsics": [intrinsic]}
    path = root / "sfm_data.json"
    path.write_text(json.dumps({**content, "extrinsics": poses, "structure": [], "control_points": []}, indent=4))
    return path


def write_sidecars(root: Path, capture: Capture) -> Path:
    """Some values as elements and some as attributes, as RealityScan does; and what another program wrote."""
    for number, view in enumerate(capture.views):
        assert view.photo is not None
        camera = view.camera
        pose, side = camera.c2w @ DOWN_FORWARD, max(camera.width, camera.height)
        turn, place = numbers(pose[:3, :3].T), numbers(pose[:3, 3])
        as_attribute = f'xcr:Rotation="{turn}"' if number % 2 else ""
        as_element = "" if number % 2 else f"<xcr:Rotation>{turn}</xcr:Rotation>"
        u, v = (camera.cx - camera.width / 2) / side, (camera.cy - camera.height / 2) / side
        view.photo.with_suffix(".xmp").write_text(
            '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">\n'
            f'<rdf:Description xcr:Version="3" xcr:PosePrior="initial" xcr:Coordinates="absolute" {as_attribute}\n'
            f'xcr:DistortionModel="brown3" xcr:FocalLength35mm="{camera.fx / side * 36}" xcr:Skew="0"\n'
            f'xcr:AspectRatio="1" xcr:PrincipalPointU="{u}" xcr:PrincipalPointV="{v}" xcr:InTexturing="1"\n'
            f'xmlns:xcr="http://www.capturingreality.com/ns/xcr/1.1#">{as_element}\n'
            f"<xcr:Position>{place}</xcr:Position><xcr:DistortionCoeficients>0 0 0 0 0 0</xcr:DistortionCoeficients>\n"
            "</rdf:Description></rdf:RDF></x:xmpmeta>\n"
        )
    (root / "images" / "aaa.xmp").write_text('<x:xmpmeta xmlns:x="adobe:ns:meta/"/>')
    return root


def write_tum(root: Path, capture: Capture) -> Path:
    """Poses at times before and after each photo's, on a straight path through it at constant speed."""
    (root / "images").rename(root / "rgb")
    photos, poses = ["# color images", "# timestamp filename"], ["# timestamp tx ty tz qx qy qz qw"]
    for number, view in enumerate(capture.views):
        assert view.photo is not None
        pose, time = view.camera.c2w @ DOWN_FORWARD, 1305031102.175304 + number
        photos.append(f"{time:.6f} rgb/{view.photo.name}")
        for away in (-0.01, 0.01):
            turn = Rotation.from_rotvec(away * np.array([3.0, 5, 2])) * Rotation.from_matrix(pose[:3, :3])
            place = pose[:3, 3] + away * np.array([2.0, -7, 1])
            poses.append(f"{time + away:.6f} {numbers(place)} {numbers(turn.as_quat())}")
    photos.append("1305039999.000000 rgb/lost.png")
    (root / "rgb.txt").write_text("\n".join(photos) + "\n")
    (root / "groundtruth.txt").write_text("\n".join(poses) + "\n")
    camera = capture.views[0].camera
    (root / "calibration.txt").write_text(f"{camera.fx} {camera.fy} {camera.cx} {camera.cy}\n")
    return root


def write_scannet(root: Path, capture: Capture) -> Path:
    (root / "images").rename(root / "color")
    (root / "pose").mkdir()
    (root / "intrinsic").mkdir()
    camera = capture.views[0].camera
    matrix = np.eye(4)
    matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2] = camera.fx, camera.fy, camera.cx, camera.cy
    np.savetxt(root / "intrinsic" / "intrinsic_color.txt", matrix)
    for view in capture.views:
        assert view.photo is not None
        np.savetxt(root / "pose" / f"{view.photo.stem}.txt", view.camera.c2w @ DOWN_FORWARD)
    np.savetxt(root / "pose" / "lost.txt", np.full((4, 4), -np.inf))
    return root


def write_seven_scenes(root: Path, capture: Capture) -> Path:
    """Of photos with the one camera of the data set; the mesh lies beside them."""
    for view in capture.views:
        assert view.photo is not None
        np.savetxt(root / f"frame-{view.photo.stem}.pose.txt", view.camera.c2w @ DOWN_FORWARD)
        view.photo.rename(root / f"frame-{view.photo.stem}.color.png")
    return root


def write_scannetpp(root: Path, capture: Capture, undistorted: bool = False) -> Path:
    """The axes exchanged as nerfstudio does, the last photo held out, masks beside the photos."""
    names = (
        ("resized_undistorted_images", "resized_undistorted_masks")
        if undistorted
        else ("resized_images", "resized_anon_masks")
    )
    photos, masks = (root / "dslr" / name for name in names)
    for folder in (root / "scans", root / "dslr" / "nerfstudio", masks):
        folder.mkdir(parents=True)
    (root / "images").rename(photos)
    for path in list(root.glob("mesh.*")):
        trimesh.load(path, process=False, maintain_order=True).export(root / "scans" / "mesh_aligned_0.05.ply")
        path.unlink()
    for other in ("mesh_aligned_0.05_semantic.ply", "pc_aligned.ply"):
        (root / "scans" / other).write_bytes(b"ply\n")
    turn = np.eye(4)
    turn[:3, :3] = [[0, 1, 0], [1, 0, 0], [0, 0, -1]]
    frames = []
    for view in capture.views:
        assert view.photo is not None
        name = view.photo.name
        Image.new("L", (view.camera.width, view.camera.height), 255).save(masks / f"{view.name}.png")
        pose = (turn @ view.camera.c2w).tolist()
        frames.append({"file_path": name, "mask_path": f"{view.name}.png", "transform_matrix": pose, "is_bad": False})
    camera = capture.views[0].camera
    lens = {"w": camera.width, "h": camera.height, "fl_x": camera.fx, "fl_y": camera.fy, "camera_model": "OPENCV"}
    meta = {**lens, "cx": camera.cx, "cy": camera.cy, "frames": frames, "test_frames": []}
    path = root / "dslr" / "nerfstudio" / ("transforms_undistorted.json" if undistorted else "transforms.json")
    path.write_text(json.dumps(meta))
    return path


def write_scannetpp_undistorted(root: Path, capture: Capture) -> Path:
    return write_scannetpp(root, capture, undistorted=True)


def write_polycam(root: Path, capture: Capture) -> Path:
    """Optimised cameras beside those of ARKit; the mesh is turned and moved against both."""
    keyframes = root / "keyframes"
    for folder in ("cameras", "corrected_cameras", "images"):
        (keyframes / folder).mkdir(parents=True)
    (root / "images").rename(keyframes / "corrected_images")
    to_mesh = np.eye(4)
    to_mesh[:3, :3], to_mesh[:3, 3] = Rotation.from_euler("y", 0.4).as_matrix(), (1.0, -2, 0.5)
    for view in capture.views:
        camera, pose = view.camera, np.linalg.inv(to_mesh) @ view.camera.c2w
        lens = {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy, "blur_score": 115.3}
        values = {**lens, "width": camera.width, "height": camera.height, "timestamp": 638443502}
        rows = {f"t_{row}{column}": pose[row, column] for row in range(3) for column in range(4)}
        (keyframes / "corrected_cameras" / f"{view.name}.json").write_text(json.dumps({**values, **rows}))
        (keyframes / "cameras" / f"{view.name}.json").write_text(json.dumps({**values, **rows, "t_03": 0.0}))
        (keyframes / "images" / f"{view.name}.jpg").write_bytes(b"as the lens saw it")
    path = root / "mesh_info.json"
    path.write_text(json.dumps({"faceCount": 12, "alignmentTransform": to_mesh.T.ravel().tolist()}))
    return path


def write_record3d(root: Path, capture: Capture) -> Path:
    """Photos are numbered; the camera stands at the first of them in ``K`` and with each photo."""
    (root / "images").rename(root / "rgb")
    poses, lenses = [], []
    for number, view in enumerate(capture.views):
        assert view.photo is not None
        (root / "rgb" / view.photo.name).rename(root / "rgb" / f"{number}{view.photo.suffix}")
        camera = view.camera
        poses.append([*Rotation.from_matrix(camera.c2w[:3, :3]).as_quat(), *camera.position])
        lenses.append([camera.fx, camera.fy, camera.cx, camera.cy])
    first = capture.views[0].camera
    matrix = [first.fx + 3, 0, 0, 0, first.fy + 3, 0, first.cx, first.cy, 1]
    size = {"w": first.width, "h": first.height, "dw": 192, "dh": 256, "fps": 60}
    path = root / "metadata.json"
    path.write_text(json.dumps({**size, "K": matrix, "poses": poses, "perFrameIntrinsicCoeffs": lenses}))
    return path


def write_arkit_scenes(root: Path, capture: Capture) -> Path:
    """Photos at the times of their poses but the first, which lies between two; the last one has no pose."""
    photos, lenses = root / "lowres_wide", root / "lowres_wide_intrinsics"
    lenses.mkdir()
    (root / "images").rename(photos)
    rows = []
    for number, view in enumerate(capture.views):
        assert view.photo is not None
        camera, time = view.camera, 10.0 + number
        named = f"41069021_{time:.3f}"
        (photos / view.photo.name).rename(photos / f"{named}{view.photo.suffix}")
        given = f"41069021_{time + 0.001 * (number % 2):.3f}.pincam"  # the data set rounds some of them otherwise
        numbers_of_it = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
        (lenses / given).write_text(numbers(np.array(numbers_of_it)))
        pose = camera.c2w @ DOWN_FORWARD
        for away in (-0.05, 0.05) if number == 0 else (0.0,):
            own = pose.copy()
            own[:3, :3] = (Rotation.from_rotvec([0.0, away, 0]) * Rotation.from_matrix(pose[:3, :3])).as_matrix()
            own[:3, 3] += away * np.array([1.0, 2, 0])
            to_camera = np.linalg.inv(own)
            turn = Rotation.from_matrix(to_camera[:3, :3]).as_rotvec()
            rows.append(f"{time + away:.4f} {numbers(turn)} {numbers(to_camera[:3, 3])}")
    (root / "lowres_wide.traj").write_text("\n".join(rows) + "\n")
    (photos / "41069021_99.000.png").write_bytes(b"lost")
    return root


FILES = (write_metashape, write_meshroom, write_bundler, write_reality_scan, write_openmvg)
"""Those that write one file."""
WRITERS = (
    *FILES,
    write_scannet,
    write_sidecars,
    write_tum,
    write_scannetpp,
    write_scannetpp_undistorted,
    write_polycam,
    write_record3d,
    write_arkit_scenes,
)
