"""Pose files of a mended capture, read again: their poses mean what those of the solve meant.

A render takes its cameras from a file. Where that is the capture's own, or holds some of its poses, the pose convention
and unit that the solve took them in apply to it too; any other file is in the frame of the result. Poses are recognised
by a digest of each.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from hashlib import sha256
from typing import Any

import numpy as np

from ..base.untrusted import floats
from ..model.capture import View, in_metres
from .common_frame import CONVENTIONS, OURS, Convention


def mend_record(convention: Convention, scale: float, moved: bool, given: Iterable[View]) -> dict[str, Any] | None:
    """What report.json keeps of how poses were taken, None where they are as in the files.

    Args:
        scale: that positions were multiplied by.
        moved: whether a similarity moved them to the mesh, which the report keeps by itself.
        given: views of the capture, with their poses as in the files.
    """
    if convention is OURS and scale == 1 and not moved:
        return None
    return {"convention": convention.name, "scale": scale, "poses": [_digest(view) for view in given]}


def mended_like(report: Mapping[str, Any], views: Sequence[View]) -> tuple[View, ...]:
    """The ``views`` of a file as the solve of ``report`` took the poses of its capture, if some of these are among
    them."""
    record = report.get("mended_poses")
    record = record if isinstance(record, Mapping) else {}
    convention = next((one for one in (OURS, *CONVENTIONS) if one.name == record.get("convention")), None)
    scale = floats(record.get("scale"), ())
    if convention is None or scale is None or not 0 < scale < np.inf:
        return tuple(views)
    if not has_pose_of(report, views):
        return tuple(views)

    def mended(view: View) -> View:
        pose = convention.camera_to_world(view.camera.c2w)
        return in_metres(replace(view, camera=replace(view.camera, c2w=pose)), float(scale))

    return tuple(mended(view) for view in views)


def has_pose_of(report: Mapping[str, Any], views: Sequence[View]) -> bool:
    """Whether one of ``views`` has a pose, as in its file, of the capture of ``report``."""
    record = report.get("mended_poses")
    known = record.get("poses") if isinstance(record, Mapping) else None
    return isinstance(known, list) and any(_digest(view) in known for view in views)


def _digest(view: View) -> str:
    return sha256(np.asarray(view.camera.c2w, np.float64).tobytes()).hexdigest()[:16]
