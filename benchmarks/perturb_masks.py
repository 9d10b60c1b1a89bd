"""Perturbations of the lamp mask that some configurations are given: what a wrong segmentation of lamps costs them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from iris_addon.base.files import to_ranges, write_json
from iris_addon.capture.fipt import read_fipt
from iris_addon.capture.mesh_files import read_mesh

from .configurations import MASK, true_emitters

Lamps = list[NDArray[np.int64]]


def true_lamp_faces(root: Path) -> Lamps:
    """Faces of each true lamp; raises BadInput where they are not recorded."""
    return [np.arange(first, last) for first, last in true_emitters(root)]


def write_mask(path: Path, lamps: Lamps) -> None:
    """A mask file as ``SolveConfig.emitters`` reads it."""
    write_json(path, {"emitters": [{"faces": to_ranges(faces)} for faces in lamps if len(faces)]})


def erode(root: Path, _truth: Path, share: float, _rng: np.random.Generator) -> str:
    """Each lamp without the ``share`` of its faces nearest to its border."""
    centres = _centres(root)
    kept = []
    for faces in true_lamp_faces(root):
        distance = np.linalg.norm(centres[faces] - centres[faces].mean(0), axis=1)
        kept.append(faces[np.argsort(distance, kind="stable")[: max(1, round((1 - share) * len(faces)))]])
    write_mask(root / MASK, kept)
    return f"{sum(map(len, kept))} faces of the lamps left"


def dilate(root: Path, _truth: Path, times: float, _rng: np.random.Generator) -> str:
    """Each lamp with the faces nearest to it, until it has grown by ``times`` its area."""
    centres, areas, lamps = _centres(root), _areas(root), true_lamp_faces(root)
    free = np.ones(len(centres), bool)
    free[np.concatenate(lamps)] = False
    grown = []
    for faces in lamps:
        distance = np.linalg.norm(centres - centres[faces].mean(0), axis=1)
        nearest = np.argsort(np.where(free, distance, np.inf), kind="stable")
        added = nearest[: int(np.searchsorted(np.cumsum(areas[nearest]), times * areas[faces].sum())) + 1]
        added = added[free[added]]
        free[added] = False
        grown.append(np.concatenate([faces, added]))
    write_mask(root / MASK, grown)
    return f"{sum(map(len, grown)) - sum(map(len, lamps))} faces added"


def add_false(root: Path, _truth: Path, number: float, rng: np.random.Generator) -> str:
    """``number`` lamps that are none: patches of surface of the mean size of the true lamps."""
    centres, areas, lamps = _centres(root), _areas(root), true_lamp_faces(root)
    size = float(np.mean([areas[faces].sum() for faces in lamps]))
    taken = np.zeros(len(centres), bool)
    taken[np.concatenate(lamps)] = True
    added: Lamps = []
    for seed in rng.choice(len(centres), int(number), replace=False, p=np.where(taken, 0, areas) / areas[~taken].sum()):
        order = np.argsort(np.linalg.norm(centres - centres[seed], axis=1), kind="stable")
        order = order[~taken[order]]
        faces = np.sort(order[: max(1, int(np.searchsorted(np.cumsum(areas[order]), size)))])
        taken[faces] = True
        added.append(faces)
    write_mask(root / MASK, [*lamps, *added])
    return f"{len(added)} false lamps of about {size:.2f} square metres"


def miss(root: Path, _truth: Path, share: float, rng: np.random.Generator) -> str:
    """A random ``share`` of the lamps not in the mask."""
    lamps = true_lamp_faces(root)
    missed = set(rng.permutation(len(lamps))[: int(np.ceil(share * len(lamps)))].tolist())
    write_mask(root / MASK, [faces for k, faces in enumerate(lamps) if k not in missed])
    return f"{len(missed)} of {len(lamps)} lamps missed"


def _centres(root: Path) -> NDArray[np.float64]:
    mesh, _ = read_mesh(read_fipt(root).mesh_file)
    return mesh.vertices[mesh.faces].mean(1)


def _areas(root: Path) -> NDArray[np.float64]:
    mesh, _ = read_mesh(read_fipt(root).mesh_file)
    corners = mesh.vertices[mesh.faces]
    return 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
