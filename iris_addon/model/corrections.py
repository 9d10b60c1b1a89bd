"""What is wrong with the cameras of a capture: with all a focal length, a principal point, an offset; with each a pose.

RGB-D recorders often give the poses and the focal length of the depth camera to photos of the colour camera beside it,
and the poses themselves drift.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .capture import Camera, FloatArray, View

SAME_FIELD = 1e-3
SAME_POSE = 1e-4
NEAR = (0.6, 0.6)
"""Radians and metres over which corrections of two photos become less alike, by a factor of e."""
NUGGET = 0.01
"""Variance of what a photo's correction has for itself, relative to what it shares with near ones."""
PREDICTED = 0.7
"""Neighbours speak for each other where what they leave of their corrections is smaller than that, relative."""


@dataclass(frozen=True)
class CameraCorrection:
    """One correction for all photos of one camera.

    Attributes:
        fx_over_width: of the cameras as given, by which the views that it applies to are known.
        focal: factor of the focal lengths.
        principal: shift of the principal point in image widths, right and down.
        offset: shift of the centre of projection, metres along the camera's x (right) and y (up).
    """

    fx_over_width: float
    focal: float = 1.0
    principal: tuple[float, float] = (0.0, 0.0)
    offset: tuple[float, float] = (0.0, 0.0)

    def camera(self, camera: Camera) -> Camera:
        """The camera as it was; one with another field of view is none of this capture's and stays as it is."""
        if abs(camera.fx / camera.width - self.fx_over_width) > SAME_FIELD * self.fx_over_width:
            return camera
        c2w = np.array(camera.c2w, np.float64)
        c2w[:3, 3] += c2w[:3, :2] @ self.offset
        return replace(
            camera,
            fx=camera.fx * self.focal,
            fy=camera.fy * self.focal,
            cx=camera.cx + self.principal[0] * camera.width,
            cy=camera.cy + self.principal[1] * camera.width,
            c2w=c2w,
        )

    def view(self, view: View) -> View:
        """``view`` with its camera corrected; a distorted photo is left alone, its lens was calibrated."""
        return view if view.distortion is not None else replace(view, camera=self.camera(view.camera))

    def content(self) -> dict[str, Any]:
        """Plain values for report.json."""
        return {
            "fx_over_width": self.fx_over_width,
            "focal": round(self.focal, 5),
            "principal": [round(x, 5) for x in self.principal],
            "offset": [round(x, 5) for x in self.offset],
        }

    @staticmethod
    def from_content(content: Mapping[str, Any]) -> CameraCorrection:
        """Inverse of :meth:`content`; raises KeyError, TypeError or ValueError for anything else."""
        numbers = np.array(
            [content["fx_over_width"], content["focal"], *content["principal"], *content["offset"]], float
        )
        if numbers.shape != (6,) or not np.isfinite(numbers).all() or (numbers[:2] <= 0).any():
            raise ValueError("not a camera correction")
        of, focal, cx, cy, x, y = numbers.tolist()
        return CameraCorrection(of, focal, (cx, cy), (x, y))


@dataclass(frozen=True)
class PoseCorrections:
    """A correction for each photo, and for cameras near them what their neighbours have.

    Attributes:
        given: (N, 4, 4) camera to world of the photos before.
        twists: (N, 6) rotation vector and translation in the frame of each camera.
        smooth: whether photos near each other are off alike, as those of a tracker that drifts are.
    """

    given: FloatArray
    twists: FloatArray
    smooth: bool

    @staticmethod
    def between(given: Sequence[Camera], found: Sequence[Camera]) -> PoseCorrections:
        """The corrections that make the cameras ``found`` of those ``given``."""
        before = np.array([camera.c2w for camera in given])
        twists = np.array([twist(np.linalg.inv(a) @ b.c2w) for a, b in zip(before, found, strict=True)])
        corrections = PoseCorrections(before, twists, True)
        # What is left of each if the others predict it (Dubrule 1983, cross validation of kriging in a unique
        # neighbourhood).
        left = corrections._weights / np.diag(corrections._precision)[:, None]
        size, left = (np.linalg.norm(region.reshape(-1, 2, 3), axis=-1) for region in (twists, left))
        return replace(corrections, smooth=bool((np.median(left, 0) < PREDICTED * np.median(size, 0)).all()))

    def sizes(self) -> FloatArray:
        """(N, 2) radians and metres."""
        return np.linalg.norm(self.twists.reshape(-1, 2, 3), axis=-1)

    def camera(self, camera: Camera) -> Camera:
        """The camera of a photo as it was found, another one as its neighbours are off if those are off alike."""
        away = self._away(camera.c2w)
        nearest = int(away.argmin())
        if away[nearest] < SAME_POSE:
            correction = self.twists[nearest]
        elif self.smooth:
            correction = self._predicted(camera.c2w)
        else:
            return camera
        return replace(camera, c2w=camera.c2w @ rigid(correction))

    def _away(self, pose: FloatArray) -> NDArray[np.float64]:
        """(N,) how far the photos were taken from a camera, in the unit of NEAR."""
        cosine = (np.einsum("nij,ij->n", self.given[:, :3, :3], pose[:3, :3]) - 1) / 2
        turn = np.arccos(np.clip(cosine, -1, 1))
        return turn / NEAR[0] + np.linalg.norm(self.given[:, :3, 3] - pose[:3, 3], axis=1) / NEAR[1]

    def _predicted(self, pose: FloatArray) -> FloatArray:
        """(6,) what the photos near a camera say of it, nothing far from all: simple kriging (Matheron 1963)."""
        return np.exp(-self._away(pose)) @ self._weights

    @cached_property
    def _precision(self) -> FloatArray:
        """(N, N) inverse of how alike the corrections of two photos are."""
        alike = np.exp(-np.array([self._away(pose) for pose in self.given]))
        return np.linalg.inv(alike + NUGGET * np.eye(len(alike)))

    @cached_property
    def _weights(self) -> FloatArray:
        """(N, 6) that the corrections are the sum of."""
        return self._precision @ self.twists

    def content(self) -> dict[str, Any]:
        """Plain values for report.json."""
        return {
            "given": np.round(self.given[:, :3].reshape(-1, 12), 6).tolist(),
            "twists": np.round(self.twists, 6).tolist(),
            "smooth": self.smooth,
        }

    @staticmethod
    def from_content(content: Mapping[str, Any]) -> PoseCorrections:
        """Inverse of :meth:`content`; raises KeyError, TypeError or ValueError for anything else."""
        twists = np.array(content["twists"], float).reshape(-1, 6)
        given = np.array(content["given"], float).reshape(-1, 3, 4)
        if len(given) != len(twists) or not len(given) or not (np.isfinite(given).all() and np.isfinite(twists).all()):
            raise ValueError("not corrections of poses")
        poses = np.tile(np.eye(4), (len(given), 1, 1))
        poses[:, :3] = given
        return PoseCorrections(poses, twists, bool(content["smooth"]))


# ---- Rotations and rigid motions as vectors, in numpy alone: Blender's own Python has no scipy ----------------------


def rotation(vector: FloatArray) -> NDArray[np.float64]:
    """(3, 3) rotation about ``vector`` (3,) by its length in radians (Rodrigues' formula)."""
    x, y, z = vector
    angle = float(np.linalg.norm(vector))
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * cross @ cross


def rotation_vector(turn: FloatArray) -> NDArray[np.float64]:
    """(3,) vector of a rotation (3, 3), half a turn at most; inverse of :func:`rotation`."""
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    angle = float(np.arctan2(np.linalg.norm(axis), np.trace(turn) - 1))
    if angle < 1e-9:
        return axis / 2
    if np.pi - angle < 1e-6:  # every axis of the eigenvalue 1 will do
        axis = np.linalg.eigh(turn + turn.T)[1][:, -1]
    return axis * (angle / np.linalg.norm(axis))


def rigid(twist: FloatArray) -> NDArray[np.float64]:
    """(4, 4) rigid motion by a rotation vector (radians) and a translation, together (6,)."""
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = rotation(twist[:3]), twist[3:]
    return motion


def twist(motion: FloatArray) -> NDArray[np.float64]:
    """(6,) rotation vector and translation of a rigid motion (4, 4); inverse of :func:`rigid`."""
    return np.concatenate([rotation_vector(motion[:3, :3]), motion[:3, 3]])
