"""What is compared: our presets, and our engine set up to make the assumptions of other methods.

A peer of this family runs on our transport and our solvers, so a difference to ``ours`` is the price of an assumption
and not of an implementation. What a peer has to be given (the lamps' faces, exposures, a curve) is the truth.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from iris_addon.base.errors import BadInput
from iris_addon.base.files import write_json
from iris_addon.capture.fipt import PhotoSet
from iris_addon.capture.reader import read_capture
from iris_addon.config import FULL, MINIMAL, PRESETS, Refinements, SolveConfig, preset
from iris_addon.model.capture import Capture
from iris_addon.response.family import PRIOR_MEAN, to_response

from .perturb_photos import copy_capture, hold_exposure

MASK = "mask.json"
"""A lamp mask in a capture folder that replaces the true one; the perturbations of masks write it."""

SWEEP = preset(
    "draft", max_patches=8_000, gather_rays=48, shadow_rays=32, specular_rays=4, max_atlas_size=512, rounds=1
)
"""`draft` for captures of half the size: a sweep is hundreds of solves, and looks for decibels, not for tenths."""
CLOSED_ROOM = Refinements(
    device_curves=False,
    channel_curves=False,
    white_balance=False,
    corrected_exposures=False,
    exponent=False,
    hidden_light=False,
    local_exposure=False,
    poses=False,
)
"""One curve for all of a photo, exposures and poses as they were recorded, no light but that of surfaces the photos
show."""
Setting = object
Settings = Callable[[Path, Path], dict[str, Setting]]
"""(capture folder, scratch folder) to fields of SolveConfig; raises BadInput where the capture lacks what is needed."""


@dataclass(frozen=True)
class Configuration:
    """One way to solve a capture.

    Attributes:
        name: as in records and charts.
        stands_for: what a reader should take it for.
        settings: fields of SolveConfig that differ from the preset.
        one_exposure: take the photos of one exposure; where the capture has none they are taken anew.
    """

    name: str
    stands_for: str
    settings: Settings
    one_exposure: bool = False

    def solve_config(self, preset_name: str, seed: int, capture: Path, scratch: Path) -> SolveConfig:
        """The configuration of a solve.

        Raises:
            BadInput: the capture lacks what this configuration is given, or the engine lacks a switch.
        """
        settings = self.settings(capture, scratch)
        unknown = settings.keys() - {field.name for field in fields(SolveConfig)}
        if unknown:
            raise BadInput(f"the engine has no switch {', '.join(sorted(unknown))}", f"leave out {self.name}")
        base = SWEEP if preset_name == "sweep" else PRESETS[preset_name]  # type: ignore[index]
        return replace(base, seed=seed, **settings)  # type: ignore[arg-type]

    def read(self, config: SolveConfig, folder: Path, scratch: Path) -> Capture:
        """The capture with the photos and exposures of this configuration. Raises BadInput."""
        photos: PhotoSet = "Image"
        if self.one_exposure and (folder / "train" / "Image_const").is_dir():
            photos = "Image_const"
        elif self.one_exposure:
            folder = copy_capture(folder, scratch / "one_exposure")
            hold_exposure(folder, np.random.default_rng(config.seed))
        return read_capture(folder, exposures=config.exposures, hdr=config.hdr, photos=photos)


def true_emitters(capture: Path) -> list[list[int]]:
    """[first, last + 1] faces of each true lamp; raises BadInput where the capture does not record them."""
    path = capture / "gt" / "emitters.json"
    if not path.is_file():
        raise BadInput("the true lamps are not recorded", "use a capture with gt/emitters.json", capture)
    return [entry["faces"] for entry in json.loads(path.read_text(encoding="utf-8"))]


def _given_mask(capture: Path, scratch: Path) -> Path:
    if (capture / MASK).is_file():
        return capture / MASK
    path = scratch / MASK
    write_json(
        path, {"emitters": [{"faces": [[first, last]]} for first, last in true_emitters(capture) if last > first]}
    )
    return path


def _given_exposures(capture: Path, scratch: Path) -> str | Path:
    """The capture's own exposures; equal ones where it has none, because these methods cannot do without."""
    if (capture / "cam" / "exposure.npy").is_file():
        return "auto"
    count = len(read_capture(capture, exposures="none").views)
    path = scratch / "exposures.npy"
    np.save(path, np.ones(count))
    return path


def _ours(_capture: Path, _scratch: Path) -> dict[str, Setting]:
    return {}


def _iris(capture: Path, scratch: Path) -> dict[str, Setting]:
    return {
        "emitters": _given_mask(capture, scratch),
        "exposures": _given_exposures(capture, scratch),
        "refinements": CLOSED_ROOM,
    }


def _fipt_ldr(capture: Path, scratch: Path) -> dict[str, Setting]:
    return {**_iris(capture, scratch), "response": "gamma"}


def _fipt_hdr(capture: Path, scratch: Path) -> dict[str, Setting]:
    folder = capture / "gt" / "train" / "Image"
    if not folder.is_dir():
        raise BadInput("there is no radiance of the training photos", "make the capture without --compact", folder)
    return {"emitters": _given_mask(capture, scratch), "hdr": folder, "refinements": CLOSED_ROOM}


def _single_bounce(capture: Path, scratch: Path) -> dict[str, Setting]:
    path = scratch / "no_lamps.json"
    write_json(path, {"emitters": []})
    return {"emitters": path, "exposures": _given_exposures(capture, scratch), "refinements": CLOSED_ROOM}


def _forced(refinements: Refinements) -> Settings:
    return lambda _capture, _scratch: {"refinements": refinements}


def _gamma(_capture: Path, _scratch: Path) -> dict[str, Setting]:
    return {"response": "gamma"}


def _mean_response(_capture: Path, scratch: Path) -> dict[str, Setting]:
    path = scratch / "mean_response.npy"
    np.save(path, to_response(PRIOR_MEAN[None]).samples)
    return {"response": path}


CONFIGURATIONS: dict[str, Configuration] = {
    entry.name: entry
    for entry in (
        Configuration("ours", "everything on", _ours),
        Configuration(
            "iris-like", "IRIS: lamp mask fixed (the true one), one curve, exposures given, closed room", _iris
        ),
        Configuration("fipt-ldr-like", "FIPT-LDR*: as iris-like, photos taken for z = x^(1/2.2)", _fipt_ldr),
        Configuration("fipt-hdr-like", "FIPT on HDR input: true radiance in, lamp mask given, closed room", _fipt_hdr),
        Configuration(
            "single-bounce",
            "NeILF++, NeFII: every surface casts the light it was seen with, clipped lamps included",
            _single_bounce,
        ),
        Configuration("forced-full", "every refinement of the model switched on", _forced(FULL)),
        Configuration("forced-minimal", "every refinement of the model switched off", _forced(MINIMAL)),
        Configuration("constant-exposure", "response ablation: all photos with one exposure", _ours, True),
        Configuration("mean-response", "response ablation: the mean of measured responses", _mean_response),
        Configuration("gamma", "response ablation: z = x^(1/2.2)", _gamma),
    )
}
