"""Cameras that fit the mesh: first corrected all together, then one by one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..base.progress import Progress
from ..decide import Decisions
from ..model.capture import Capture
from ..rays.tracer import Tracer
from .calibration import Calibration, calibrate
from .registration import Registration, register


@dataclass(frozen=True)
class CameraFit:
    """The corrections of the cameras, as far as they were accepted."""

    calibration: Calibration
    registration: Registration

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should know."""
        return self.calibration.warnings + self.registration.warnings

    def report(self) -> dict[str, Any]:
        """For report.json."""
        return self.calibration.report() | self.registration.report()


def fit_cameras(
    capture: Capture, tracer: Tracer, rng: np.random.Generator, progress: Progress, decisions: Decisions
) -> tuple[Capture, CameraFit]:
    """The capture with cameras that fit its mesh.

    Args:
        decisions: where the corrections are decided on photos and points that they are not fitted to.
        rng: picks the points on which photos are compared.

    Raises:
        BadInput: a photo cannot be read.
    """
    capture, calibration = calibrate(capture, tracer, rng, progress, decisions)
    if decisions.forbids("poses"):
        return capture, CameraFit(calibration, Registration(None, 0.0))
    capture, registration = register(capture, tracer, rng, progress, decisions)
    return capture, CameraFit(calibration, registration)
