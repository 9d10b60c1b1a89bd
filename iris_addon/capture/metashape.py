"""Cameras as Agisoft Metashape exports them: XML of one chunk, with its sensors and its transform.

Poses are camera to chunk, x right, y down, z forward. The principal point is counted from the middle of the photo, and
the tangential coefficients stand in the reverse order of OpenCV's (Metashape manual, appendix D).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ..base.errors import BadInput
from ..base.untrusted import decoding, number_in_text, read_bytes

MAX_XML_BYTES = 256 << 20
DOWN_FORWARD = np.diag([1.0, -1.0, -1.0, 1.0])


def read_metashape(path: Path) -> list[dict[str, Any]]:
    """The frames of the first chunk; raises BadInput."""
    root = parse_xml(path)
    chunk = root if root.tag == "chunk" else root.find(".//chunk")
    if chunk is None:
        raise BadInput("has no chunk of cameras", "export the cameras as Agisoft XML", path)
    with decoding(path, mend="export the cameras again"):
        sensors = {sensor.get("id"): _intrinsics(sensor) for sensor in chunk.iter("sensor")}
        to_world = _chunk_transform(chunk)
        frames = []
        for camera in chunk.iter("camera"):
            if camera.get("label") is None or camera.get("enabled") in ("0", "false"):
                continue
            transform = camera.findtext("transform")
            pose = None if transform is None else _pose(numbers_in_text(transform, 16).reshape(4, 4), *to_world)
            frames.append(
                {"file_path": camera.get("label"), "transform_matrix": pose, **sensors[camera.get("sensor_id")]}
            )
    if not frames:
        raise BadInput("has no cameras", "export the cameras of an aligned chunk", path)
    return frames


def parse_xml(path: Path, largest: int = MAX_XML_BYTES) -> ElementTree.Element:
    """The root of an XML file of at most ``largest`` bytes; raises BadInput."""
    data = read_bytes(path, largest, mend="export the cameras alone")
    # Entities may grow without bound, and no export has them. Nor is it UTF-16, in which they would not be seen here.
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data or b"\0" in data:
        raise BadInput("declares entities", "export the cameras again", path)
    with decoding(path, "is not valid XML", "export the cameras again"):
        return ElementTree.fromstring(data)


def numbers_in_text(text: str, count: int) -> np.ndarray:
    """(count,) usable numbers between spaces, for use within ``decoding``; raises ValueError."""
    values = np.array([number_in_text(word) for word in text.split()])
    if len(values) != count:
        raise ValueError(f"{len(values)} numbers for {count}")
    return values


def _chunk_transform(chunk: ElementTree.Element) -> tuple[np.ndarray, np.ndarray, float]:
    """Rotation, translation and scale from the chunk to the world; none of them where it was never scaled."""
    own = chunk.find("transform")
    if own is None:
        return np.eye(3), np.zeros(3), 1.0
    rotation, translation = own.findtext("rotation"), own.findtext("translation")
    return (
        np.eye(3) if rotation is None else numbers_in_text(rotation, 9).reshape(3, 3),
        np.zeros(3) if translation is None else numbers_in_text(translation, 3),
        float(numbers_in_text(own.findtext("scale") or "1", 1)[0]),
    )


def _pose(to_chunk: np.ndarray, rotation: np.ndarray, translation: np.ndarray, scale: float) -> list[list[float]]:
    pose = np.eye(4)
    pose[:3, :3] = rotation @ to_chunk[:3, :3]
    pose[:3, 3] = scale * rotation @ to_chunk[:3, 3] + translation
    return (pose @ DOWN_FORWARD).tolist()


def _intrinsics(sensor: ElementTree.Element) -> dict[str, Any]:
    """Keys of a transforms.json; empty for a sensor without a calibration, whose cameras have no pose either."""
    calibrations = sensor.findall("calibration")
    if not calibrations:
        return {}
    found = next((c for c in calibrations if c.get("class") == "adjusted"), calibrations[-1])
    resolution = found.find("resolution")
    resolution = sensor.find("resolution") if resolution is None else resolution
    if resolution is None:
        raise ValueError("a sensor without a resolution")
    width, height = (int(resolution.get(key, "")) for key in ("width", "height"))
    values = {
        name: number_in_text(found.findtext(name) or "0")
        for name in ("f", "cx", "cy", "b1", "k1", "k2", "k3", "k4", "p1", "p2")
    }
    kind = found.get("type") or sensor.get("type") or "frame"
    if kind not in ("frame", "fisheye"):
        raise ValueError(f"a sensor of type {kind}")
    return {
        "camera_model": "OPENCV" if kind == "frame" else "OPENCV_FISHEYE",
        **{"w": width, "h": height, "fl_x": values["f"] + values["b1"], "fl_y": values["f"]},
        **{"cx": width / 2 + values["cx"], "cy": height / 2 + values["cy"]},
        **{name: values[name] for name in ("k1", "k2", "k3", "k4")},
        **{"p1": values["p2"], "p2": values["p1"]},
    }
