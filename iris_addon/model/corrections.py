"""Corrections of the cameras of a capture: of all focal length, principal point and offset; of each its pose.

RGB-D recorders often give photos of the colour camera the poses and the focal length of the depth camera beside it, and
the poses themselves drift. Rotations are written in numpy alone, because Blender's own Python has no scipy.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.untrusted import finite
from .capture import Camera, FloatArray, View

FOCAL_TOLERANCE = 1e-3
"""Relative difference of focal lengths up to which a view was taken by the corrected camera."""
POSE_TOLERANCE = 1e-4
"""Distance of poses, in correlation lengths, up to which two are one."""
CORRELATION_LENGTHS = (0.6, 0.6)
"""Radians and metres over which the correlation of the corrections of two photos falls by a factor of e."""
MAX_CORRECTED = 8192
"""Photos with a correction of their own that a report may have: a matrix of all pairs is made of them."""
NUGGET = 0.01
"""Variance of a correction that is not correlated with its neighbours', relative to the one that is (kriging)."""
SMOOTH_RESIDUAL = 0.7
"""Median error of corrections predicted from their neighbours, relative to their size, below which they are smooth."""


@dataclass(frozen=True)
class CameraCorrection:
    """One correction for all photos of one camera.

    Attributes:
        fx_over_width: of the given cameras; identifies the views that the correction applies to.
        focal: factor of the focal lengths.
        principal: shift of the principal point in image widths, right and down.
        offset: shift of the centre of projection, metres along the camera's x (right) and y (up).
    """

    fx_over_width: float
    focal: float = 1.0
    principal: tuple[float, float] = (0.0, 0.0)
    offset: tuple[float, float] = (0.0, 0.0)

    def camera(self, camera: Camera) -> Camera:
        """``camera`` corrected; one with another field of view is not of this capture and is returned unchanged."""
        if abs(camera.fx / camera.width - self.fx_over_width) > FOCAL_TOLERANCE * self.fx_over_width:
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
        """``view`` with its camera corrected; unchanged with lens distortion, because that lens was calibrated."""
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
        numbers = finite([content["fx_over_width"], content["focal"], *content["principal"], *content["offset"]], (6,))
        if numbers is None or (numbers[:2] <= 0).any():
            raise ValueError("not a camera correction")
        of, focal, cx, cy, x, y = numbers.tolist()
        return CameraCorrection(of, focal, (cx, cy), (x, y))


@dataclass(frozen=True)
class PoseCorrections:
    """A pose correction for each photo, and, where they vary smoothly, for cameras between the photos.

    Attributes:
        given: (N, 4, 4) camera to world of the photos before.
        twists: (N, 6) rotation vector and translation in the frame of each camera.
        smooth: whether neighbouring photos have similar corrections, as under a drifting tracker.
    """

    given: FloatArray
    twists: FloatArray
    smooth: bool

    @staticmethod
    def between(given: Sequence[Camera], found: Sequence[Camera]) -> PoseCorrections:
        """The corrections that turn the cameras ``given`` into those ``found``."""
        before = np.array([camera.c2w for camera in given])
        twists = np.array([twist(np.linalg.inv(a) @ b.c2w) for a, b in zip(before, found, strict=True)])
        # Residual of each if the others predict it: Dubrule 1983, cross validation of kriging.
        precision = _kriging_precision(before)
        residual = precision @ twists / np.diag(precision)[:, None]
        size, residual = (np.linalg.norm(x.reshape(-1, 2, 3), axis=-1) for x in (twists, residual))
        smooth = bool((np.median(residual, 0) < SMOOTH_RESIDUAL * np.median(size, 0)).all())
        return PoseCorrections(before, twists, smooth)

    def sizes(self) -> FloatArray:
        """(N, 2) radians and metres of each correction."""
        return np.linalg.norm(self.twists.reshape(-1, 2, 3), axis=-1)

    def camera(self, camera: Camera) -> Camera:
        """The corrected camera of a photo; another camera gets the predicted correction if corrections are smooth."""
        away = _distances(self.given, camera.c2w)
        nearest = int(away.argmin())
        if away[nearest] < POSE_TOLERANCE:
            correction = self.twists[nearest]
        elif self.smooth:
            correction = self._predicted(camera.c2w)
        else:
            return camera
        return replace(camera, c2w=camera.c2w @ rigid(correction))

    def _predicted(self, pose: FloatArray) -> FloatArray:
        """(6,) twist predicted from neighbouring photos, zero far from all: simple kriging (Matheron 1963)."""
        return np.exp(-_distances(self.given, pose)) @ self._weights

    @cached_property
    def _weights(self) -> FloatArray:
        """(N, 6) coefficients of the correlation with each photo."""
        return _kriging_precision(self.given) @ self.twists

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
        twists, given = finite(content["twists"], (None, 6)), finite(content["given"], (None, 12), 1e9)
        if twists is None or given is None or not 0 < len(given) == len(twists) <= MAX_CORRECTED:
            raise ValueError("not corrections of poses")
        poses = np.tile(np.eye(4), (len(given), 1, 1))
        poses[:, :3] = given.reshape(-1, 3, 4)
        return PoseCorrections(poses, twists, bool(content["smooth"]))


def _distances(given: FloatArray, pose: FloatArray) -> NDArray[np.float64]:
    """(N,) distance of the poses ``given`` (N, 4, 4) from ``pose`` (4, 4), in correlation lengths."""
    cosine = (np.einsum("nij,ij->n", given[:, :3, :3], pose[:3, :3]) - 1) / 2
    turn = np.arccos(np.clip(cosine, -1, 1))
    away = np.linalg.norm(given[:, :3, 3] - pose[:3, 3], axis=1)
    return turn / CORRELATION_LENGTHS[0] + away / CORRELATION_LENGTHS[1]


def _kriging_precision(given: FloatArray) -> FloatArray:
    """(N, N) inverse covariance of the corrections of poses (N, 4, 4)."""
    correlation = np.exp(-np.array([_distances(given, pose) for pose in given]))
    return np.linalg.inv(correlation + NUGGET * np.eye(len(correlation)))


# ---- Rotations and rigid motions as vectors -------------------------------------------------------------------------


def rotation(vector: FloatArray) -> NDArray[np.float64]:
    """(3, 3) rotation about ``vector`` (3,) by its length in radians (Rodrigues' formula)."""
    x, y, z = vector
    angle = float(np.linalg.norm(vector))
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * cross @ cross


def rotation_vector(turn: FloatArray) -> NDArray[np.float64]:
    """(3,) rotation vector in radians, of length π at most, of a rotation (3, 3); inverse of :func:`rotation`."""
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    angle = float(np.arctan2(np.linalg.norm(axis), np.trace(turn) - 1))
    if angle < 1e-9:
        return axis / 2
    if np.pi - angle < 1e-6:  # either direction of the axis, the eigenvector of the eigenvalue 1, will do
        axis = np.linalg.eigh(turn + turn.T)[1][:, -1]
    return axis * (angle / np.linalg.norm(axis))


def rigid(twist: FloatArray) -> NDArray[np.float64]:
    """(4, 4) rigid motion by a rotation vector (radians) and a translation (metres), together (6,)."""
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = rotation(twist[:3]), twist[3:]
    return motion


def twist(motion: FloatArray) -> NDArray[np.float64]:
    """(6,) rotation vector and translation of a rigid motion (4, 4); inverse of :func:`rigid`."""
    return np.concatenate([rotation_vector(motion[:3, :3]), motion[:3, 3]])
