"""Cameras that RealityScan (RealityCapture) writes beside each photo: NAME.xmp, with pose and lens.

The rotation is world to camera by rows, x right, y down, z forward, beside the position of the camera. The focal length
is that of a film 36 millimetres wide, the principal point, from the middle, a share of the photo's longer side.
Programs for photos write .xmp too; theirs lack the name space and are not looked at.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ..base.errors import BadInput
from ..base.untrusted import decoding, open_file
from .camera_tables import FULL_FRAME_MM, MAX_CAMERAS
from .metashape import DOWN_FORWARD, numbers_in_text, parse_xml
from .photo_files import PHOTO_SUFFIXES

NAME_SPACE = "http://www.capturingreality.com/ns/xcr/1.1#"
MAX_SIDECAR_BYTES = 16 << 20
AGAIN = "export the registration as XMP again"
LENSES = {
    "perspective": 0,
    "brown3": 3,
    "brown4": 4,
    "brown3t2": 6,
    "brown4t2": 6,
}
"""How many coefficients of k1, k2, k3, k4, t1, t2 a distortion model has."""
SQUARE_TOLERANCE = 1e-4
"""Of the aspect ratio, and of the skew, of a pixel that counts as square."""


def is_sidecar(path: Path) -> bool:
    """Whether RealityScan wrote the file ``path``; raises BadInput for one that cannot be read."""
    if path.suffix.lower() != ".xmp" or not path.is_file():
        return False
    with open_file(path, MAX_SIDECAR_BYTES, mend=AGAIN) as file:
        return b"capturingreality.com/ns/xcr" in file.read(4096)


def read_sidecars(first: Path) -> list[dict[str, Any]]:
    """A frame for each sidecar in the folder of ``first``; raises BadInput. Those without a pose were not aligned."""
    paths = [path for path in sorted(first.parent.iterdir()) if is_sidecar(path)]
    if len(paths) > MAX_CAMERAS:
        raise BadInput(f"lies beside {len(paths)} others", f"give at most {MAX_CAMERAS} photos", first)
    photos = {path.stem: path.name for path in first.parent.iterdir() if path.suffix.lower() in PHOTO_SUFFIXES}
    return [{"file_path": photos.get(path.stem, path.stem), **_camera(path)} for path in paths]


def _camera(path: Path) -> dict[str, Any]:
    root = parse_xml(path, MAX_SIDECAR_BYTES)
    with decoding(path, mend=AGAIN):
        values = _values(root)
        if "Rotation" not in values or "Position" not in values:
            return {"transform_matrix": None}
        pose = np.eye(4)
        pose[:3, :3] = numbers_in_text(values["Rotation"], 9).reshape(3, 3).T
        pose[:3, 3] = numbers_in_text(values["Position"], 3)
        focal, x, y, skew, aspect = (
            float(numbers_in_text(values.get(key, usual), 1)[0])
            for key, usual in (
                ("FocalLength35mm", ""),
                ("PrincipalPointU", "0"),
                ("PrincipalPointV", "0"),
                ("Skew", "0"),
                ("AspectRatio", "1"),
            )
        )
        if abs(skew) > SQUARE_TOLERANCE or abs(aspect - 1) > SQUARE_TOLERANCE:
            raise ValueError("pixels that are not square")
        return {
            "transform_matrix": (pose @ DOWN_FORWARD).tolist(),
            "relative": (focal / FULL_FRAME_MM, x, y),
            **_lens(values),
        }


def _values(root: ElementTree.Element) -> dict[str, str]:
    """Values by their name: the program writes some as attributes, some as elements, and has exchanged them."""
    found = {}
    for element in root.iter():
        for name, text in [*element.attrib.items(), (element.tag, element.text or "")]:
            space, _, key = name.removeprefix("{").rpartition("}")
            if space == NAME_SPACE and text.strip():
                found[key] = text
    return found


def _lens(values: dict[str, str]) -> dict[str, float]:
    given = values.get("DistortionCoeficients", values.get("DistortionCoefficients", "0 0 0 0 0 0"))
    k1, k2, k3, k4, p1, p2 = numbers_in_text(given, 6).tolist()
    model = values.get("DistortionModel", "perspective")
    if model not in LENSES and any((k1, k2, k3, k4, p1, p2)):
        raise ValueError(f"distortion model {model[:40]}, export with {', '.join(LENSES)}")
    count = LENSES.get(model, 0)
    coefficients = dict(zip(("k1", "k2", "k3", "k4")[:count], (k1, k2, k3, k4), strict=False))
    if model == "brown3t2":
        del coefficients["k4"]
    return coefficients | ({"p1": p1, "p2": p2} if count == 6 else {})
