"""A similarity, rotation, scale and shift in seven numbers, that takes the poses of a capture to its mesh."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..model.capture import Camera, FloatArray


@dataclass(frozen=True)
class Similarity:
    """x in the mesh's frame = ``scale * rotation @ x + shift`` of x in the frame of the poses.

    Attributes:
        rotation: (3, 3) from the axes of the poses to those of the mesh.
        scale: unit of the poses in units of the mesh.
        shift: (3,) in units of the mesh.
        share: of the sparse points that then lie on the mesh.
        middle, extent: of the mesh, about which and by parts of which :meth:`nudged` moves.
    """

    rotation: NDArray[np.float64]
    scale: float
    shift: NDArray[np.float64]
    share: float = 0.0
    middle: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    extent: float = 1.0

    def nudged(self, by: NDArray[np.float64]) -> Similarity:
        """Turned, grown and shifted a little: ``by`` (7,) holds radians, a logarithm, and extents of the mesh."""
        turn, grow = Rotation.from_rotvec(by[:3]).as_matrix(), float(np.exp(by[3]))
        shift = self.middle + grow * turn @ (self.shift - self.middle) + self.extent * by[4:]
        return replace(self, rotation=turn @ self.rotation, scale=grow * self.scale, shift=shift)

    def points(self, given: FloatArray) -> NDArray[np.float64]:
        """(n, 3) points of the poses' frame in that of the mesh."""
        return self.scale * given @ self.rotation.T + self.shift

    def camera(self, camera: Camera) -> Camera:
        """The camera in the frame and unit of the mesh."""
        pose = np.eye(4)
        pose[:3, :3] = self.rotation @ camera.c2w[:3, :3]
        pose[:3, 3] = self.scale * self.rotation @ camera.position + self.shift
        return replace(camera, c2w=pose)

    def matrix(self, unit: float = 1.0) -> NDArray[np.float64]:
        """(4, 4) of the same similarity between files in which lengths are ``1 / unit`` of those here."""
        whole = np.eye(4)
        whole[:3, :3] = self.scale * self.rotation
        whole[:3, 3] = self.shift / unit
        return whole

    def describe(self) -> str:
        """What is done, for a message."""
        turn = Rotation.from_matrix(self.rotation).as_rotvec()
        angle = float(np.linalg.norm(turn))
        x, y, z = (turn / max(angle, 1e-12)).tolist()
        shift = ", ".join(f"{value:.3f}" for value in self.shift.tolist())
        return (
            f"the poses are turned by {np.degrees(angle):.1f}° about ({x:.3f}, {y:.3f}, {z:.3f}), "
            f"scaled by {self.scale:.4g} and shifted by ({shift}) onto the mesh, on which {self.share:.0%} of their "
            "sparse points then lie"
        )
