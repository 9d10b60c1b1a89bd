"""Light shares, the part of each light in a rendered picture: on disk, and mixed under changed lights.

Light is linear, so the picture under lamps of other strength and colour is the sum of the pictures under each lamp,
each times its change; nothing is rendered again.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput
from ..base.files import atomic_write
from ..base.image_headers import check_exr_samples, read_exr_parts
from ..base.untrusted import decoding
from ..results.result import Result
from .jobs import changed_sun, lamp_radiance
from .parsing import Json, json_map, known_keys, number
from .scene_edit import OUTSIDE, SUN, lamp_name

COMBINED = "combined"
"""Name of the part of the file with the whole picture."""


@dataclass(frozen=True)
class LightShares:
    """The radiance that each light contributes to one view.

    Attributes:
        combined: (H, W, 3) linear radiance under all of them.
        shares: by name of the light, (H, W, 3) its part of the radiance; the sum is ``combined`` but for denoising.
    """

    combined: NDArray[np.float32]
    shares: dict[str, NDArray[np.float32]]


def mix_shares(
    shares: Mapping[str, NDArray[np.floating]], gains: Mapping[str, Sequence[float] | NDArray[np.floating]]
) -> NDArray[np.float64]:
    """(H, W, 3) radiance with the light of each name multiplied by its (3,) gain; lights not named keep theirs."""
    total = np.zeros(next(iter(shares.values())).shape, np.float64)
    for name, share in shares.items():
        total += np.asarray(gains.get(name, 1.0)) * share
    return total


def light_gains(result: Result, spec: Json) -> dict[str, NDArray[np.float64]]:
    """(3,) factor on each light's share under a relighting job that changes recovered light alone.

    Raises:
        BadInput: the job adds lights, or gives a lamp a colour that it had none of.
    """
    spec = json_map(spec, "the relighting job")
    if spec.get("lights"):
        raise BadInput("adds 'lights', which no share shows", "leave out --shares, so that they are rendered")
    known_keys(spec, {"recovered", "outside", "sun", "lights", "camera", "length"}, "the relighting job")
    gains = {OUTSIDE: np.full(3, number(spec.get("outside", 1.0), "outside"))}
    if "sun" in spec:
        gains[SUN] = _sun_gain(result, spec["sun"])
    changed = lamp_radiance(result, json_map(spec.get("recovered", {}), "recovered"))
    for emitter, radiance in zip(result.emitters, changed, strict=True):
        was = np.asarray(emitter.radiance, float)
        if ((was <= 0) & (radiance > 0)).any():
            what = f"gives lamp {emitter.id} a colour of which it has nothing to scale"
            raise BadInput(what, "leave out --shares, so that it is rendered")
        gains[lamp_name(emitter.id)] = np.divide(radiance, was, out=np.zeros(3), where=was > 0)
    return gains


def _sun_gain(result: Result, change: object) -> NDArray[np.float64]:
    sun = changed_sun(result, change)
    assert result.sun is not None
    if not np.allclose(sun.direction, -result.sun.direction, atol=1e-4):
        raise BadInput("turns the sun, which no share shows", "leave out --shares, so that it is rendered")
    was = result.sun.irradiance
    return np.divide(sun.irradiance, was, out=np.zeros(3), where=was > 0)


def write_shares(path: Path, light: LightShares) -> None:
    """Write ``light`` as one EXR of float32 with a part per light, the whole picture first; raises IrisError."""
    import OpenEXR  # absent from Blender's own Python

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    parts = [
        OpenEXR.Part(dict(header), {"RGB": np.ascontiguousarray(pixels, np.float32)}, name)
        for name, pixels in {COMBINED: light.combined, **light.shares}.items()
    ]
    encoded = io.BytesIO()
    OpenEXR.File(parts).write(encoded)
    atomic_write(path, lambda temporary: temporary.write_bytes(encoded.getbuffer()))


def read_shares(path: Path, size: tuple[int, int] | None = None) -> LightShares:
    """What :func:`write_shares` wrote.

    Args:
        size: (width, height) that it must have; looked at before anything is decoded.

    Raises:
        BadInput: it is no such file, or of another size.
    """
    import OpenEXR

    mend = "render them again with --light-shares"
    announced = read_exr_parts(path)
    check_exr_samples(path, announced)
    if len({(part.width, part.height) for part in announced}) != 1:
        raise BadInput("has parts of different sizes", mend, path)
    if size is not None and (announced[0].width, announced[0].height) != size:
        raise BadInput(f"is not {size[0]}x{size[1]} pixels", mend, path)
    if len(announced) < 2 or any(sorted(part.channels) != ["B", "G", "R"] for part in announced):
        raise BadInput("holds no light shares", mend, path)
    with decoding(path, "holds no light shares", mend):
        parts = {part.name(): part.channels["RGB"].pixels for part in OpenEXR.File(str(path)).parts}
    height, width = announced[0].height, announced[0].width
    whole = all(share.shape == (height, width, 3) for share in parts.values())
    if COMBINED not in parts or len(parts) != len(announced) or not whole:
        raise BadInput("holds no light shares", mend, path)
    return LightShares(parts.pop(COMBINED), parts)
