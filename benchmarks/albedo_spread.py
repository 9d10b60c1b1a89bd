"""How even the albedo of one surface came out: a score for real rooms, of which nobody knows the truth.

    python -m benchmarks.albedo_spread RESULT CAPTURE --at VIEW X Y [--at VIEW X Y ...] [--reach 1]

A surface is named by a place in a photo, X and Y as shares of its width and height. It is what lies in the plane
there, up to ``reach`` metres away, was seen, and has about the colour most of it has: what stands or lies on it is left
out. Printed is the robust spread (1.4826 median absolute deviation over the median) of the luminance of albedo: of its
texels, and of the medians of cells of 5 cm, which leave the grain of wood out and keep baked shading.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from iris_addon.base.errors import BadInput, IrisError
from iris_addon.base.group_by import MAD, group_medians
from iris_addon.capture.reader import read_capture
from iris_addon.model.capture import Camera
from iris_addon.model.response import LUMINANCE
from iris_addon.rays.tracer import Tracer, points_on_faces
from iris_addon.results.folder import load_result
from iris_addon.results.result import Result
from iris_addon.textures.atlas import rasterise_atlas

PATCH = 10
"""Pixels around the one named through which the plane is laid."""
THICKNESS, SAME_NORMAL = 0.02, 0.95
SEEN = 0.2
"""Least confidence of a texel that counts."""
SAME_COLOUR = 0.06
"""Greatest difference of chromaticity from the median of the surface."""
CELL, CELL_TEXELS = 0.05, 20


@dataclass(frozen=True)
class Spread:
    """Robust spreads as shares of the median.

    Attributes:
        texels, cells: spread over texels and over medians of cells of 5 cm.
        n_cells: how many cells have enough texels.
        albedo: (3,) median, scene-linear Rec.709.
    """

    texels: float
    cells: float
    n_cells: int
    albedo: NDArray[np.float64]


class Texels:
    """All texels of a result as points of its mesh."""

    def __init__(self, result: Result) -> None:
        if result.mesh.uv is None:
            raise ValueError("the mesh of a result must have UVs")
        self.tracer = Tracer(result.mesh, without=result.panes)
        side = len(result.textures.base_color)
        face, weights = rasterise_atlas(result.mesh.uv, side)
        covered = np.flatnonzero((face.ravel() >= 0) & (result.textures.confidence.ravel() > SEEN))
        self.face = face.ravel()[covered]
        self.position = points_on_faces(self.tracer.corners, self.face, weights.reshape(-1, 2)[covered])
        self.albedo = result.textures.base_color.reshape(-1, 3)[covered].astype(np.float64)

    def spread_at(self, camera: Camera, x: float, y: float, reach: float) -> Spread:
        """The spread of the surface at a place of a photo; raises BadInput where it shows no flat surface."""
        centre, axes = self._plane(camera, x, y)
        local = (self.position - centre) @ axes.T
        aligned = np.abs(self.tracer.normals[self.face] @ axes[2]) > SAME_NORMAL
        on = (np.abs(local[:, 2]) < THICKNESS) & (np.abs(local[:, :2]).max(1) < reach) & aligned
        albedo, local = self.albedo[on], local[on]
        chromaticity = albedo / np.maximum(albedo.sum(1, keepdims=True), 1e-6)
        own = np.abs(chromaticity - np.median(chromaticity, 0)).max(1) < SAME_COLOUR
        if np.count_nonzero(own) < CELL_TEXELS:
            raise BadInput(f"there is no flat surface at {x:g}, {y:g}", "name a place in the middle of one")
        return spread_of(albedo[own], local[own, :2])

    def _plane(self, camera: Camera, x: float, y: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """A point of the plane through the pixels around a place, and (3, 3) two axes in it and its normal."""
        rows, columns = np.mgrid[-PATCH : PATCH + 1, -PATCH : PATCH + 1]
        row = np.clip(int(y * camera.height) + rows.ravel(), 0, camera.height - 1)
        column = np.clip(int(x * camera.width) + columns.ravel(), 0, camera.width - 1)
        origins, directions = camera.rays()
        pixel = row * camera.width + column
        hits = self.tracer.closest(origins[pixel], directions[pixel])
        on = hits.face >= 0
        if np.count_nonzero(on) < 3:
            raise BadInput(f"nothing of the mesh is seen at {x:g}, {y:g}", "name a place on a surface")
        points = points_on_faces(self.tracer.corners, hits.face[on], hits.barycentric[on])
        centre = points.mean(0)
        return centre, np.linalg.svd(points - centre)[2]


def spread_of(albedo: NDArray[np.floating], place: NDArray[np.floating]) -> Spread:
    """The spread of ``albedo`` (n, 3) at places (n, 2) of a plane, in metres."""
    luminance = albedo @ LUMINANCE
    _, cell = np.unique(np.floor(place / CELL).astype(np.int64), axis=0, return_inverse=True)
    cell = cell.ravel()
    full = np.bincount(cell) >= CELL_TEXELS
    medians = group_medians(luminance[:, None], cell, len(full))[full, 0]
    return Spread(_robust(luminance), _robust(medians), int(full.sum()), np.median(albedo, 0))


def _robust(values: NDArray[np.floating]) -> float:
    middle = np.median(values) if len(values) else np.nan
    return float(MAD * np.median(np.abs(values - middle)) / middle) if len(values) else float("nan")


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("result", type=Path)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--at", nargs=3, action="append", required=True, metavar=("VIEW", "X", "Y"))
    parser.add_argument("--reach", type=float, default=1.0, help="metres")
    args = parser.parse_args(arguments)
    try:
        for line in lines(args.result, args.capture, args.at, args.reach):
            print(line)
    except IrisError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def lines(result_folder: Path, capture: Path, places: Sequence[Sequence[str]], reach: float) -> Iterator[str]:
    """A line per place (view, x, y); raises BadInput for what cannot be read or names no surface."""
    result = load_result(result_folder)
    views = {view.name: view for view in result.as_taken(read_capture(capture).views)}
    texels = Texels(result)
    for name, x, y in places:
        if name not in views:
            raise BadInput(f"has no photo {name!r}", f"name one of {', '.join(sorted(views))}", capture)
        found = texels.spread_at(views[name].camera, float(x), float(y), reach)
        colour = ", ".join(f"{value:.2f}" for value in found.albedo)
        yield f"{name} {x} {y}: texels {found.texels:.1%}, {found.n_cells} cells {found.cells:.1%}, albedo {colour}"


if __name__ == "__main__":
    sys.exit(main())
