"""Ground truth of a capture in FIPT layout, for scoring only: no stage of a solve imports this.

Maps stand in ``gt/train/DiffCol`` ..., or, as in FIPT's own release, beside the photos in ``train/DiffCol``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput
from ..base.images import read_exr, read_image, read_map
from ..base.untrusted import finite, read_json, read_npy
from ..capture.exposures import with_device
from ..capture.fipt import fipt_root, read_fipt_views
from ..model.capture import Split, View
from ..model.recovered import Sunlight
from ..model.response import N_SAMPLES, Response
from ..results.records import read_sunlight

MAX_RESPONSE_BYTES = 16 << 20


@dataclass(frozen=True)
class GroundTruth:
    """Files and cameras of the ground truth of a capture.

    Attributes:
        root: the capture.
        folder: ``root/gt``, or ``root`` where maps and photos stand side by side.
        views, val_views: cameras, with the exposures the capture records.
        response: the true response, or None.
    """

    root: Path
    folder: Path
    views: tuple[View, ...]
    val_views: tuple[View, ...]
    response: Response | None

    def path(self, folder: str, index: int, suffix: str = ".exr") -> Path | None:
        """The file of frame ``index`` in ``folder`` (such as "train/DiffCol"), or None."""
        split = self.val_views if folder.startswith("val/") else self.views if folder.startswith("train/") else ()
        names = [split[index].name] if index < len(split) else []
        for name in [*names, f"{index:03d}_0001", f"{index:03d}"]:
            path = self.folder / folder / (name + suffix)
            if path.is_file():
                return path
        return None

    def map(self, kind: str, split: Split, index: int) -> NDArray[np.float32] | None:
        """(H, W, 3) of a map such as "DiffCol", or None if the capture has no such map.

        Raises:
            BadInput: damaged, or not of the camera's size.
        """
        view = (self.views if split == "train" else self.val_views)[index]
        path = self.path(f"{split}/{kind}", index)
        if path is None:
            return None
        values = read_rgb(path)
        if values.shape[:2] != (view.camera.height, view.camera.width):
            raise BadInput(
                f"is {values.shape[1]}x{values.shape[0]}, its camera {view.camera.width}x{view.camera.height}",
                "restore the capture",
                path,
            )
        return values

    def photo(self, index: int) -> NDArray[np.float64] | None:
        """(H, W, 3) display values of a held-out LDR photo, or None."""
        path = self.path("val/Image", index, ".png") or self.val_views[index].photo
        return None if path is None or path.suffix == ".exr" else read_image(path) / 255.0


def read_rgb(path: Path) -> NDArray[np.float32]:
    """(H, W, 3) of an EXR file, one channel repeated; raises BadInput."""
    values = read_exr(path)
    return np.repeat(values, 3, axis=2) if values.shape[2] == 1 else values[..., :3]


def read_mask(path: Path) -> NDArray[np.bool_]:
    """(H, W) bool of a greyscale PNG; raises BadInput."""
    return read_map(path) > 0


def read_ground_truth(path: Path) -> GroundTruth | None:
    """The ground truth of the capture at ``path``, or None if it has none. Raises BadInput."""
    root = fipt_root(path) if path.exists() else None
    if root is None:
        return None
    folder = root / "gt" if (root / "gt").is_dir() else root
    if not any((folder / "train" / kind).is_dir() for kind in ("DiffCol", "BaseCol", "Emit")):
        return None
    held_out = read_fipt_views(root, "val") if (root / "val" / "transforms.json").is_file() else ()
    val_views = tuple(with_device(view) for view in held_out)
    return GroundTruth(
        root=root, folder=folder, views=read_fipt_views(root, "train"), val_views=val_views, response=_response(folder)
    )


def read_lights(truth: GroundTruth) -> dict | None:
    """The relighting job of the capture, or None."""
    path = truth.root / "relight" / "lights.json"
    return read_json(path) if path.is_file() else None


def read_objects(truth: GroundTruth) -> dict | None:
    """The insertion job of the capture, or None."""
    path = truth.root / "insert" / "objects.json"
    return read_json(path) if path.is_file() else None


def read_sun(truth: GroundTruth) -> Sunlight | None:
    """The strongest sun of the capture, or None.

    Raises:
        BadInput: damaged.
    """
    path = truth.folder / "meta_gt.json"
    listed = read_json(path).get("suns") if path.is_file() else None
    if not isinstance(listed, list):
        return None
    suns = [read_sunlight(entry, f"suns[{k}]", path) for k, entry in enumerate(listed)]
    return max(suns, key=lambda sun: float(sun.irradiance.sum()), default=None)


def _response(folder: Path) -> Response | None:
    path = folder / "cam" / "crf_gt.npy"
    if not path.is_file():
        return None
    samples = finite(read_npy(path, MAX_RESPONSE_BYTES, "restore the capture"), (None, None))
    if samples is None or samples.shape != (3, N_SAMPLES):
        raise BadInput(f"is not (3, {N_SAMPLES}) finite numbers", "restore the capture", path)
    return Response(samples, "file")
