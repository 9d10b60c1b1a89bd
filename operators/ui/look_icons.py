"""Pictures of looks, mixed from the light shares of a photo's view: icons in the panel, and a wipe's "before"."""

from __future__ import annotations

import zlib
from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from ...iris_addon.base.errors import IrisError
from ...iris_addon.base.untrusted import read_arrays
from ...iris_addon.blender.apply.camera_look import LOOK, kept_look
from ...iris_addon.blender.apply.look_gains import Gains, gains_of_look, gains_of_own, gains_of_saved, look_radiance
from ...iris_addon.blender.apply.looks import offered_looks, own_looks
from ...iris_addon.blender.apply.on_objects import APPLIED
from ...iris_addon.blender.apply.saved_looks import read_preset
from ...iris_addon.blender.images import image_from_array
from ...iris_addon.model.response import grey_exposure, srgb
from ...iris_addon.results.files import REPORT, result_file
from ...iris_addon.results.records import exposure_of
from ..folders import folder, look_presets
from ..relight import all_looks
from . import icons
from .wipe import BEFORE_VIEW, PHOTO, view_name

ICON_SIDE = 128
"""Pixels of the longer side of an icon, at most."""
MAX_SHARES_BYTES, MAX_SIDE = 256 << 20, 4096
"""Of a file of shares, and of a picture in it: they are read while the panel is drawn."""
FOLDER = "looks"
"""Of the light shares, in the result's folder."""
BUILT_IN, OWN = "LOOK ", "OWN "
"""What the identifier of a look begins with: one of all rooms, and one of the artist's own or of a light state."""

Shares = dict[str, NDArray[np.floating]]

_small: dict[str, Shares] = {}
"""Shares of the size of an icon, by file and time: those of the one that was read last."""
_choices: list[tuple[str, str, str, str, int]] = []
"""Blender keeps no reference to the texts of a list that changes."""


def shares_path(scene: bpy.types.Scene) -> Path:
    """Where the light shares of the active camera's view are, whether they exist or not; that camera must exist."""
    return folder(scene) / FOLDER / f"{view_name(scene.camera)}.npz"


def has_shares(scene: bpy.types.Scene) -> bool:
    """Whether there are light shares of the active camera's view that belong to the present result."""
    return scene.camera is not None and bool(_key(scene, shares_path(scene)))


def _key(scene: bpy.types.Scene, path: Path) -> str:
    """Identifies the content of ``path``; empty where it is missing, or older than the result."""
    try:
        made = path.stat().st_mtime_ns
        return f"{path}#{made}" if made >= result_file(folder(scene), REPORT).stat().st_mtime_ns else ""
    except (OSError, IrisError):
        return ""


def _nearest_shares(scene: bpy.types.Scene) -> Path | None:
    """The shares of the active camera's view, else of the first one that has any."""
    if has_shares(scene):
        return shares_path(scene)
    others = sorted((folder(scene) / FOLDER).glob("*.npz"))
    return next((path for path in others if _key(scene, path)), None)


def _read(path: Path) -> Shares:
    """The (H, W, 3) shares in a file that may be a stranger's; none where they are not of one size."""
    try:
        arrays = (read_arrays(path) or {}) if path.stat().st_size <= MAX_SHARES_BYTES else {}
    except OSError:
        arrays = {}
    read = {name: share for name, share in arrays.items() if share.dtype.kind == "f"}
    (shape, *others) = {share.shape for share in read.values()} or {()}
    return (
        read if not others and len(shape) == 3 and shape[2] == 3 and min(shape) > 0 and max(shape) <= MAX_SIDE else {}
    )


def _small_shares(key: str, path: Path) -> Shares:
    if key not in _small:
        _small.clear()
        _small[key] = {name: _shrunk(share) for name, share in _read(path).items()}
    return _small[key]


def _shrunk(share: NDArray[np.floating]) -> NDArray[np.floating]:
    step = -(-max(share.shape[:2]) // ICON_SIDE)
    step = min(step, *share.shape[:2])
    height, width = (side // step for side in share.shape[:2])
    blocks = share[: height * step, : width * step].reshape(height, step, width, step, 3)
    return blocks.astype(np.float32).mean((1, 3))


def _gains(scene: bpy.types.Scene, look: str) -> Gains | None:
    if look.startswith(BUILT_IN):
        return gains_of_look(scene, look.removeprefix(BUILT_IN))
    name = look.removeprefix(OWN)
    if name in own_looks(scene):
        return gains_of_own(scene, name)
    try:
        return gains_of_saved(scene, read_preset(look_presets(), name))
    except IrisError:  # damaged: the button says so
        return None


def _display(
    scene: bpy.types.Scene, photo: str, radiance: NDArray[np.floating], shares: Shares
) -> NDArray[np.floating]:
    """(H, W, 3) display values as the camera of ``photo`` would show ``radiance``."""
    response, exposures = kept_look(scene, photo)
    if response.family != "identity":
        return response.apply(radiance * exposure_of(photo, exposures))
    photographed = look_radiance(shares, gains_of_look(scene, "PHOTOGRAPHED"))
    return srgb(radiance * grey_exposure(radiance if photographed is None else photographed))


def look_icon(scene: bpy.types.Scene, look: str) -> int:
    """The icon of the look with that identifier; 0 without light shares of it."""
    path = _nearest_shares(scene) if LOOK in scene else None
    gains = None if path is None else _gains(scene, look)
    if path is None or gains is None:
        return 0
    key = _key(scene, path)
    told = " ".join(f"{name} {gain.round(4).tolist()}" for name, gain in sorted(gains.items()))

    def picture() -> NDArray[np.floating] | None:
        shares = _small_shares(key, path)
        radiance = look_radiance(shares, gains)
        return None if radiance is None else _display(scene, _photo_at(scene, path), radiance, shares)

    return icons.drawn(f"{key} {told}", picture)


def _photo_at(scene: bpy.types.Scene, path: Path) -> str:
    """The photo whose view the shares in ``path`` are of; the name of the file where it is none."""
    views = scene.iris.views
    return next((view.name for view in views if bpy.path.clean_name(view.name) == path.stem), path.stem)


def look_choices(settings: bpy.types.PropertyGroup | None, _context: bpy.types.Context) -> list:
    """What a wipe can go to: the photo, and every look that the panel offers."""
    found = [(PHOTO, "Photo", "The photo of the camera", "IMAGE_DATA", 0)]
    scene = None if settings is None else settings.id_data
    if scene is not None and APPLIED in scene:
        built_in = [(f"{BUILT_IN}{key}", look.label, look.tooltip) for key, look in offered_looks(scene).items()]
        own = [(f"{OWN}{name}", name, "A look of your own, or of a light state") for name in all_looks(scene)]
        # The numbers stay when looks come and go: the file keeps the number.
        found += [
            (key, label, tooltip, "LIGHT", 1 + (zlib.crc32(key.encode()) >> 2))
            for key, label, tooltip in (*built_in, *own)
        ]
    _choices[:] = found
    return _choices


def show_before(scene: bpy.types.Scene) -> None:
    """Make the picture of the look that the wipe goes to, from the active camera, if there are light shares of it."""
    settings = scene.iris
    old, settings.wipe_before = settings.wipe_before, None
    if old is not None:
        bpy.data.images.remove(old)
    if settings.wipe_to in ("", PHOTO) or not has_shares(scene) or LOOK not in scene:
        return
    path = shares_path(scene)
    shares = _read(path)
    radiance = look_radiance(shares, _gains(scene, settings.wipe_to))
    if radiance is None:
        return
    image = image_from_array(
        "IRIS Before", _display(scene, _photo_at(scene, path), radiance, shares), colorspace="sRGB"
    )
    image.pack()  # unpacked images are black after undo
    image[BEFORE_VIEW] = path.stem
    settings.wipe_before = image
