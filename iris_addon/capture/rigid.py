"""Rotations and rigid motions as vectors, in numpy alone: Blender's own Python has no scipy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .types import FloatArray


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
