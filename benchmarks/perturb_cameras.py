"""Perturbations of what is known about the photos: exposures, poses, how many there are and whether they show lamps."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from iris_addon.base.errors import BadInput
from iris_addon.base.files import write_json
from iris_addon.capture.fipt import read_fipt_views
from iris_addon.evaluate.ground_truth import read_rgb

from .perturb_photos import save_array

FEWEST = 4
DEGREES_PER_CM = 0.5


def misreport_exposures(root: Path, _truth: Path, stops: float, rng: np.random.Generator) -> str:
    """Recorded exposures off by a normal error; infinitely wrong means not recorded at all."""
    path = root / "cam" / "exposure.npy"
    if not path.is_file():
        raise BadInput("there are no exposures to misreport", "sweep a capture that records them", path)
    exposures = np.load(path, allow_pickle=False).astype(np.float64)
    if np.isinf(stops):
        path.unlink()
        return "exposures unknown"
    save_array(path, exposures * 2.0 ** (stops * rng.standard_normal(len(exposures))))
    return "exposures misreported"


def shake_poses(root: Path, _truth: Path, centimetres: float, rng: np.random.Generator) -> str:
    """Positions off by ``centimetres`` rms and directions by half as many degrees rms, each photo on its own."""
    meta = _read(root)
    for frame in meta["frames"]:
        pose = np.array(frame["transform_matrix"], np.float64)
        turn = Rotation.from_rotvec(_of_rms(rng) * np.radians(DEGREES_PER_CM * centimetres))
        pose[:3, :3] = turn.as_matrix() @ pose[:3, :3]
        pose[:3, 3] += _of_rms(rng) * centimetres / 100
        frame["transform_matrix"] = pose.tolist()
    _write(root, meta)
    return f"{centimetres:g} cm and {DEGREES_PER_CM * centimetres:g} degrees rms"


def _of_rms(rng: np.random.Generator) -> NDArray[np.float64]:
    """(3,) normal vector whose length is 1 rms."""
    return rng.standard_normal(3) / np.sqrt(3)


def keep_photos(root: Path, _truth: Path, count: float, rng: np.random.Generator) -> str:
    """A random ``count`` of the photos; those of a smaller count are among those of a larger one."""
    order = rng.permutation(len(_read(root)["frames"]))
    return _keep(root, order[: int(count)])


def drop_lamp_photos(root: Path, _truth: Path, share: float, _rng: np.random.Generator) -> str:
    """The photos that show most of a lamp left out, until ``share`` of those that show any are gone.

    Four photos always remain, even if they show a lamp; the note counts them.
    """
    views = read_fipt_views(root, "train")
    lit = np.array([_lamp_pixels(root, view.name) for view in views])
    showing = np.flatnonzero(lit)
    worst_first = showing[np.argsort(-lit[showing], kind="stable")]
    drop = worst_first[: min(round(share * len(showing)), len(views) - FEWEST)]
    kept = np.setdiff1d(np.arange(len(views)), drop)
    return f"{_keep(root, kept)}, {np.count_nonzero(lit[kept])} of them show a lamp"


def _lamp_pixels(root: Path, name: str) -> int:
    path = root / "gt" / "train" / "Emit" / f"{name}.exr"
    if not path.is_file():
        raise BadInput("there is no emission map", "sweep a capture with ground truth", path)
    return int(np.count_nonzero(read_rgb(path).max(-1) > 0))


def _keep(root: Path, chosen: NDArray[np.integer]) -> str:
    """Leave only the frames ``chosen``, with names and exposures as they were."""
    meta, chosen = _read(root), np.sort(chosen)
    frames = meta["frames"]
    names = [view.name for view in read_fipt_views(root, "train")]
    meta["frames"] = [{**frames[k], "file_path": f"Image/{names[k]}"} for k in chosen]
    for name in ("exposure", "exposure_const"):
        path = root / "cam" / f"{name}.npy"
        if path.is_file():
            save_array(path, np.load(path, allow_pickle=False)[chosen])
    _write(root, meta)
    return f"{len(chosen)} of {len(frames)} photos"


def _read(root: Path) -> dict[str, Any]:
    return json.loads((root / "train" / "transforms.json").read_text(encoding="utf-8"))


def _write(root: Path, meta: dict[str, Any]) -> None:
    write_json(root / "train" / "transforms.json", meta)
