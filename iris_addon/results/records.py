"""JSON records of a result folder.

emitters.json holds the lamps, light from outside the mesh, the sun, and the shell that the backdrop is painted on;
response.json the recovered camera.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput
from ..base.files import from_ranges, to_ranges
from ..base.untrusted import MEND, json_object, numbers, read_json
from ..model.capture import Mesh
from ..model.device import Device, device_of_photo
from ..model.lamp_profile import EVEN_PROFILE, LampProfile
from ..model.light_states import is_state_name
from ..model.local_exposure import UNIFORM, LocalSettings
from ..model.recovered import Backdrop, Emitter, LightState, OutsideLight, Sunlight
from ..model.response import N_SAMPLES, Response
from .files import EMITTERS, REPORT, RESPONSE, result_file

if TYPE_CHECKING:
    from .result import Result

SH_SIZES = (1, 4, 9)
"""Numbers of spherical harmonics of the bands 0 to 2."""
FIGURES = ("holdout_psnr", "rays_traced", "n_patches")
"""Numbers of report.json that are shown."""
_PHOTO_NAME = re.compile(r"[\w.-]{1,255}")
MAX_SHELL = 100_000
"""Vertices or faces that a backdrop's shell may have."""
LOCAL_BOUNDS = {"strength": (0.0, 0.99), "scale": (1e-3, 10.0), "headroom": (1.0, 1e6), "falloff": (0.0, 20.0)}
"""Range of each setting of local exposure."""


class StoredLights(NamedTuple):
    """Lamps, light from outside, the sun, the backdrop's shell, the faces that light passes, and light states."""

    emitters: tuple[Emitter, ...]
    outside: OutsideLight | None
    sun: Sunlight | None
    shell: StoredShell | None
    panes: NDArray[np.int64]
    states: tuple[LightState, ...]


class StoredShell(NamedTuple):
    """Vertices (V, 3) and faces (F, 3) of a backdrop, and whether it has an albedo."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    reflects: bool


def read_report(folder: Path) -> dict[str, Any]:
    """The content of report.json, with the parts that programs calculate with checked; raises BadInput."""
    path = result_file(folder, REPORT)
    report = read_json(path)
    for name in ("seconds", "model", "atlas"):
        json_object(report.get(name, {}), name, path)
    figures = [
        *report.get("seconds", {}).values(),
        *report.get("atlas", {}).values(),
        *(report.get(name) or 0.0 for name in FIGURES),
    ]
    numbers(figures, (None,), f"seconds, atlas or {' or '.join(FIGURES)}", path)
    warnings = report.get("warnings") or []
    if not isinstance(warnings, list) or not all(isinstance(warning, str) for warning in warnings):
        raise BadInput("'warnings' is no list of texts", MEND, path)
    return report


def emitters_json(result: Result) -> dict[str, Any]:
    """The content of emitters.json."""
    backdrop = result.backdrop
    return {
        "emitters": [
            {
                "id": emitter.id,
                "faces": to_ranges(emitter.faces),
                "radiance": emitter.radiance,
                "area": emitter.area,
                "confidence": emitter.confidence,
                **({"patterned": True} if emitter.patterned else {}),
                **({} if emitter.profile is None else {"profile": emitter.profile.values}),
            }
            for emitter in result.emitters
        ],
        **_light_json(result.outside, result.sun),
        "backdrop": None if backdrop is None else _shell_json(backdrop),
        "panes": to_ranges(result.panes),
        **({"light_states": [_state_json(state) for state in result.light_states]} if result.light_states else {}),
    }


def _state_json(state: LightState) -> dict[str, Any]:
    return {
        "name": state.name,
        "photos": list(state.photos),
        "radiance": state.radiance,
        **_light_json(state.outside, state.sun),
    }


def _light_json(outside: OutsideLight | None, sun: Sunlight | None) -> dict[str, Any]:
    """Light from outside as emitters.json has it."""
    return {
        "outside": None if outside is None else {"sh": outside.sh},
        "sun": None if sun is None else {"direction": sun.direction, "irradiance": sun.irradiance},
    }


def _shell_json(backdrop: Backdrop) -> dict[str, Any]:
    reflects = backdrop.albedo is not None
    return {"vertices": backdrop.vertices, "faces": backdrop.faces, "reflects": reflects}


def read_emitters(folder: Path, mesh: Mesh) -> StoredLights:
    """All light of the result in ``folder``, and the backdrop's shell.

    Raises:
        BadInput: the file is missing or damaged.
    """
    path = result_file(folder, EMITTERS)
    content = read_json(path)
    listed = content.get("emitters")
    if not isinstance(listed, list):
        raise BadInput("'emitters' is missing or not a list", MEND, path)
    emitters = tuple(_read_emitter(entry, f"emitters[{number}]", mesh, path) for number, entry in enumerate(listed))
    backdrop = content.get("backdrop")
    return StoredLights(
        emitters,
        *_read_light(content, "", path),
        None if backdrop is None else _read_shell(json_object(backdrop, "backdrop", path), path),
        from_ranges(content.get("panes"), len(mesh.faces), "panes", path),  # results of earlier versions have none
        _read_states(content.get("light_states", []), len(emitters), path),  # only where there are several
    )


def read_light_states(folder: Path) -> dict[str, tuple[str, ...]]:
    """The photos of each light state of the result in ``folder`` by its name, that of most photos first; empty where
    there is one state.

    Raises:
        BadInput: emitters.json is missing or damaged.
    """
    path = result_file(folder, EMITTERS)
    content = read_json(path)
    listed = content.get("emitters")
    if not isinstance(listed, list):
        raise BadInput("'emitters' is missing or not a list", MEND, path)
    return {state.name: state.photos for state in _read_states(content.get("light_states", []), len(listed), path)}


def _read_states(listed: object, n_emitters: int, path: Path) -> tuple[LightState, ...]:
    if not isinstance(listed, list):
        raise BadInput("'light_states' is no list", MEND, path)
    states = []
    for number, entry in enumerate(listed):
        where = f"light_states[{number}]"
        content = json_object(entry, where, path)
        name, photos = content.get("name"), content.get("photos")
        if not isinstance(name, str) or not is_state_name(name) or name in [state.name for state in states]:
            raise BadInput(f"'{where}' has no name of its own", MEND, path)
        if not isinstance(photos, list) or not all(isinstance(photo, str) for photo in photos):
            raise BadInput(f"'{where}.photos' is no list of names", MEND, path)
        radiance = np.zeros((0, 3))
        if n_emitters:
            radiance = numbers(content.get("radiance"), (n_emitters, 3), f"{where}.radiance", path)
        if (radiance < 0).any():
            raise BadInput(f"'{where}.radiance' is negative", MEND, path)
        outside, sun = _read_light(content, f"{where}.", path)
        states.append(LightState(name=name, photos=tuple(photos), radiance=radiance, outside=outside, sun=sun))
    return tuple(states)


def _read_light(content: dict[str, Any], where: str, path: Path) -> tuple[OutsideLight | None, Sunlight | None]:
    """Light from outside and the sun in the part ``where`` of emitters.json."""
    outside, sun = content.get("outside"), content.get("sun")
    return (
        None if outside is None else _read_outside(json_object(outside, f"{where}outside", path), path),
        None if sun is None else read_sunlight(sun, f"{where}sun", path),
    )


def _read_emitter(entry: object, where: str, mesh: Mesh, path: Path) -> Emitter:
    content = json_object(entry, where, path)
    radiance = numbers(content.get("radiance"), (3,), f"{where}.radiance", path)
    if radiance.min() < 0:
        raise BadInput(f"'{where}.radiance' is negative", MEND, path)
    return Emitter(
        id=int(numbers(content.get("id"), (), f"{where}.id", path)),
        faces=from_ranges(content.get("faces"), len(mesh.faces), f"{where}.faces", path),
        radiance=radiance,
        area=float(numbers(content.get("area"), (), f"{where}.area", path)),
        confidence=float(numbers(content.get("confidence"), (), f"{where}.confidence", path)),
        patterned=content.get("patterned") is True,
        profile=_read_profile(content.get("profile"), f"{where}.profile", path),
    )


def _read_profile(value: object, where: str, path: Path) -> LampProfile | None:
    if value is None:
        return None
    profile = numbers(value, EVEN_PROFILE.shape, where, path)
    if profile.min() < 0 or profile.max() <= 0:
        raise BadInput(f"'{where}' is not a profile of radiances, of which one is positive", MEND, path)
    return LampProfile.of(profile)


def _read_outside(content: dict[str, Any], path: Path) -> OutsideLight:
    sh = numbers(content.get("sh"), (None, 3), "outside.sh", path)
    if len(sh) not in SH_SIZES:
        raise BadInput(f"'outside.sh' has {len(sh)} coefficients, not 1, 4 or 9", MEND, path)
    return OutsideLight(sh)


def read_sunlight(value: object, where: str, path: Path) -> Sunlight:
    """The sun that ``path`` describes in its part ``where``: ``{"direction": [...], "irradiance": [...]}``.

    Raises:
        BadInput: no finite numbers, no unit direction, or a negative irradiance.
    """
    content = json_object(value, where, path)
    direction = numbers(content.get("direction"), (3,), f"{where}.direction", path)
    irradiance = numbers(content.get("irradiance"), (3,), f"{where}.irradiance", path)
    if not abs(np.linalg.norm(direction) - 1) < 1e-3 or irradiance.min() < 0:
        raise BadInput(f"'{where}' has no unit direction, or a negative irradiance", MEND, path)
    return Sunlight(direction, irradiance)


def _read_shell(content: dict[str, Any], path: Path) -> StoredShell:
    vertices = numbers(content.get("vertices"), (None, 3), "backdrop.vertices", path)
    faces = numbers(content.get("faces"), (None, 3), "backdrop.faces", path)
    if not 4 <= len(vertices) <= MAX_SHELL or not 4 <= len(faces) <= MAX_SHELL:
        raise BadInput("'backdrop' is no shell, or too large", MEND, path)
    if (faces != np.floor(faces)).any() or faces.min() < 0 or faces.max() >= len(vertices):
        raise BadInput("'backdrop.faces' names vertices that it does not have", MEND, path)
    return StoredShell(vertices, faces.astype(np.int64), content.get("reflects") is True)


# ---- response.json -------------------------------------------------------------------------------------------------


class StoredCamera(NamedTuple):
    """What took the photos: a response and local exposure, (3,) exposure × white balance by photo, and further devices
    with a response of their own."""

    response: Response
    exposures: dict[str, NDArray[np.float64]]
    local: LocalSettings
    devices: tuple[Device, ...]

    def device_of(self, photo: str) -> Device:
        """What took the training photo ``photo``."""
        return device_of_photo(Device("", self.response, self.local), self.devices, photo)


def response_json(result: Result) -> dict[str, Any]:
    """The content of response.json."""
    devices = [
        {
            "name": device.name,
            "photos": list(device.photos),
            "exposure_factor": list(device.exposure_factor),
            **_curve_json(device.response, device.local),
        }
        for device in result.devices
    ]
    return {
        **_curve_json(result.response, result.local),
        "exposures": {
            name: {"factor": value, "exposure": value[1], "white_balance": value / value[1] if value[1] else value}
            for name, value in ((name, np.asarray(value, float)) for name, value in result.exposures.items())
        },
        **({"devices": devices} if devices else {}),
    }


def _curve_json(response: Response, local: LocalSettings) -> dict[str, Any]:
    samples = response.samples
    same = bool((samples == samples[0]).all())
    return {
        "family": response.family,
        "coefficients": list(response.coefficients),
        "samples": samples[0] if same else samples,
        "local_exposure": asdict(local),
    }


def read_response(folder: Path) -> StoredCamera:
    """The recovered camera of the result in ``folder``.

    Raises:
        BadInput: it is missing or damaged.
    """
    path = result_file(folder, RESPONSE)
    content = read_json(path)
    response, local = _read_curve(content, path)
    exposures = {
        _photo_name(name, path): numbers(
            json_object(value, name, path).get("factor"), (3,), f"exposures of {name}", path
        )
        for name, value in json_object(content.get("exposures"), "exposures", path).items()
    }
    listed = content.get("devices", [])  # only where there are several
    if not isinstance(listed, list):
        raise BadInput("'devices' is no list", MEND, path)
    devices = tuple(_read_device(json_object(entry, "devices", path), exposures, path) for entry in listed)
    return StoredCamera(response=response, exposures=exposures, local=local, devices=devices)


def _read_device(content: Mapping[str, Any], exposures: Mapping[str, object], path: Path) -> Device:
    name, photos = content.get("name"), content.get("photos")
    listed = isinstance(photos, list) and all(isinstance(photo, str) and photo in exposures for photo in photos)
    if not isinstance(name, str) or not listed:
        raise BadInput("'devices' has no names, or photos that 'exposures' lacks", MEND, path)
    red, green, blue = numbers(content.get("exposure_factor"), (3,), "devices.exposure_factor", path).tolist()
    if min(red, green, blue) <= 0:
        raise BadInput("'devices.exposure_factor' is not above zero", MEND, path)
    response, local = _read_curve(content, path)
    return Device(
        name=name,
        response=response,
        local=local,
        photos=tuple(photos or ()),
        exposure_factor=(red, green, blue),
    )


def _read_curve(content: Mapping[str, Any], path: Path) -> tuple[Response, LocalSettings]:
    samples = content.get("samples")
    if isinstance(samples, list) and len(samples) == 3:
        table = numbers(samples, (3, N_SAMPLES), "samples", path)
    else:
        table = np.tile(numbers(samples, (N_SAMPLES,), "samples", path), (3, 1))
    coefficients = numbers(content.get("coefficients", []), (None,), "coefficients", path)
    response = Response(table, str(content.get("family", "")), tuple(coefficients.tolist()))
    return response, _read_local(json_object(content.get("local_exposure", {}), "local_exposure", path), path)


def _photo_name(name: str, path: Path) -> str:
    """``name`` if a view can be called so: other programs get it in files, and files are called by it."""
    if not _PHOTO_NAME.fullmatch(name):
        raise BadInput(f"'exposures' has the photo {name!r}", "photos have letters, digits, '_', '-' and '.'", path)
    return name


def exposure_of(photo: str, exposures: Mapping[str, NDArray[np.floating]]) -> NDArray[np.floating]:
    """(3,) exposure × white balance of ``photo``, or the median of the photos where it is none of them."""
    return exposures[photo] if photo in exposures else median_exposure(exposures)


def median_exposure(exposures: Mapping[str, NDArray[np.floating]]) -> NDArray[np.float64]:
    """(3,) median exposure × white balance of the photos; 1 where none is known."""
    return np.median(np.stack(list(exposures.values())), axis=0) if exposures else np.ones(3)


def _read_local(content: Mapping[str, Any], path: Path) -> LocalSettings:
    """Settings of local exposure; missing ones have no effect."""
    settings = {**asdict(UNIFORM), **content}
    for name, (low, high) in LOCAL_BOUNDS.items():
        value = settings[name]
        if not isinstance(value, int | float) or not low <= value <= high:
            raise BadInput(f"'local_exposure.{name}' is {value!r}", f"a number from {low:g} to {high:g}", path)
    return LocalSettings(**{name: float(settings[name]) for name in LOCAL_BOUNDS})
