"""Perturbations of the photos: exposure, white balance, local tone mapping, vignetting, other responses.

All start from radiance. A capture that keeps its training radiance (``gt/train/Image/*.exr``) is developed anew, which
is exact. Of others the 8-bit photo is inverted: a value uniform within its quantisation step; where it is clipped, the
true emission of lamps, what darker photos show of other surfaces, and the clipping level of what none shows. The note
in the record names which of the two it was.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from iris_addon.base.errors import BadInput
from iris_addon.base.files import atomic_write
from iris_addon.base.images import read_image, write_png
from iris_addon.capture.fipt import read_fipt_views
from iris_addon.evaluate.ground_truth import read_rgb
from iris_addon.evaluate.metrics import to_ldr
from iris_addon.model.capture import View
from iris_addon.model.response import LUMINANCE, N_SAMPLES, Response
from iris_addon.response import family

from .clipped_pixels import radiance_behind_clipping
from .machine import ROOT

DORF = ROOT.parent / "shared" / "crf" / "dorf_dev.npz"
FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Film:
    """What is needed to take the photos of a capture again.

    Attributes:
        response: the true one.
        exact: whether radiance comes from EXR files.
        behind_clipping: where it does not, radiance of the clipped pixels of each view, NaN where it is unknown.
    """

    root: Path
    views: tuple[View, ...]
    response: Response
    exact: bool
    behind_clipping: Mapping[str, FloatArray]

    @staticmethod
    def of(root: Path) -> Film:
        """The film of the capture in ``root``; raises BadInput where response or exposures are not recorded."""
        views = read_fipt_views(root, "train")
        path = root / "gt" / "cam" / "crf_gt.npy"
        if not path.is_file() or any(view.exposure is None for view in views):
            raise BadInput(
                "records no response or no exposures", "photos can be taken anew only where both are known", root
            )
        exact = all((root / "gt" / "train" / "Image" / f"{view.name}.exr").is_file() for view in views)
        response = Response(np.load(path, allow_pickle=False).astype(np.float64), "file")
        return Film(
            root=root,
            views=views,
            response=response,
            exact=exact,
            behind_clipping={} if exact else radiance_behind_clipping(root, views, response),
        )

    @property
    def note(self) -> str:
        """Where radiance came from."""
        return "photos developed from radiance" if self.exact else "photos developed from inverted 8-bit photos"

    def radiance(self, view: View, rng: np.random.Generator) -> FloatArray:
        """(H, W, 3) radiance before ``view``."""
        if self.exact:
            return read_rgb(self.root / "gt" / "train" / "Image" / f"{view.name}.exr").astype(np.float64)
        assert view.photo is not None and view.exposure is not None
        byte = read_image(view.photo)
        x = self.response.invert((byte + rng.random(byte.shape)) / 255.0)
        clipped = byte == 255
        radiance = np.where(clipped, 1.0, x) / view.exposure
        radiance = np.fmax(radiance, self.behind_clipping[view.name])
        emit = self.root / "gt" / "train" / "Emit" / f"{view.name}.exr"
        if emit.is_file():
            radiance = np.where(clipped, np.maximum(radiance, read_rgb(emit)), radiance)
        return radiance

    def take(self, develop: Callable[[FloatArray, View], FloatArray], rng: np.random.Generator) -> None:
        """Replace every training photo; ``develop`` gives display values in [0, 1] of radiance."""
        for view in self.views:
            assert view.photo is not None
            write_png(view.photo, np.round(255 * develop(self.radiance(view, rng), view)).astype(np.uint8))

    def shoot(self, radiance: FloatArray, exposure: float | FloatArray) -> FloatArray:
        """The photo with the true response."""
        return to_ldr(radiance, self.response, exposure)


def save_array(path: Path, values: NDArray) -> None:
    """Replace an array file in one step."""
    atomic_write(path, lambda temporary: np.save(temporary, values, allow_pickle=False))


def copy_capture(source: Path, folder: Path) -> Path:
    """A copy of the capture ``source`` in ``folder`` that may be written to."""
    capture = folder / source.name
    shutil.copytree(source, capture)
    for path in (capture, *capture.rglob("*")):  # the source may be read-only
        path.chmod(path.stat().st_mode | 0o200)
    return capture


def raise_exposure(root: Path, _truth: Path, stops: float, rng: np.random.Generator) -> str:
    """All photos exposed ``stops`` longer, and recorded so: more pixels clip."""
    film = Film.of(root)
    exposures = np.array([view.exposure for view in film.views], np.float64) * 2.0**stops
    by_name = {view.name: t for view, t in zip(film.views, exposures, strict=True)}
    film.take(lambda radiance, view: film.shoot(radiance, by_name[view.name]), rng)
    save_array(root / "cam" / "exposure.npy", exposures)
    clipped = np.mean([(read_image(v.photo) == 255).any(-1).mean() for v in film.views if v.photo is not None])
    return f"{film.note}; {clipped:.1%} of the pixels clip"


def drift_white_balance(root: Path, _truth: Path, stops: float, rng: np.random.Generator) -> str:
    """Red and blue gain of each photo off by a normal error; green keeps the exposure."""
    film = Film.of(root)
    error = rng.standard_normal((len(film.views), 2)) * stops
    gains = {view.name: 2.0 ** np.array([r, 0.0, b]) for view, (r, b) in zip(film.views, error, strict=True)}
    film.take(lambda radiance, view: film.shoot(radiance, (view.exposure or 1.0) * gains[view.name]), rng)
    return film.note


def map_tones(root: Path, _truth: Path, strength: float, rng: np.random.Generator) -> str:
    """Local tone mapping: large-scale contrast of the exposed image compressed by ``strength``, as phones do.

    The base layer is the Gaussian mean of log luminance over a twelfth of the width; a photo's middle stays as it is.
    """
    film = Film.of(root)

    def develop(radiance: FloatArray, view: View) -> FloatArray:
        exposed = np.minimum(radiance * (view.exposure or 1.0), 4.0)
        log_luminance = np.log(np.maximum(exposed @ LUMINANCE, 1e-4))
        base = gaussian_filter(log_luminance, radiance.shape[1] / 12, mode="nearest")
        gain = np.exp(-strength * (base - np.median(base)))
        return film.shoot(radiance * gain[..., None], view.exposure or 1.0)

    film.take(develop, rng)
    return film.note


def darken_corners(root: Path, _truth: Path, stops: float, rng: np.random.Generator) -> str:
    """Vignetting: exposure falls with the square of the distance from the middle, by ``stops`` in the corners."""
    film = Film.of(root)

    def develop(radiance: FloatArray, view: View) -> FloatArray:
        height, width = radiance.shape[:2]
        x, y = (np.arange(n) + 0.5 - n / 2 for n in (width, height))
        r2 = (x**2 + y[:, None] ** 2) / ((width / 2) ** 2 + (height / 2) ** 2)
        return film.shoot(radiance * 2.0 ** (-stops * r2)[..., None], view.exposure or 1.0)

    film.take(develop, rng)
    return film.note


def hold_exposure(root: Path, rng: np.random.Generator) -> str:
    """All photos taken with one exposure, the geometric mean of what they had."""
    film = Film.of(root)
    constant = float(np.exp(np.mean([np.log(view.exposure) for view in film.views if view.exposure is not None])))
    film.take(lambda radiance, _view: film.shoot(radiance, constant), rng)
    save_array(root / "cam" / "exposure.npy", np.full(len(film.views), constant))
    return film.note


# ---- other responses -----------------------------------------------------------------------------------------------


def odd_response(root: Path, _truth: Path, deviations: float, rng: np.random.Generator) -> str:
    """A smooth response ``deviations`` standard deviations from the median measured one, in a random direction.

    The direction is drawn until the curve rises everywhere: a camera that does not would be no camera.
    """
    for _ in range(1000):
        direction = rng.standard_normal(family.N_KNOTS)
        # Neighbouring knots of real curves move together; white directions give curves nobody would build.
        direction = gaussian_filter(direction, 1.0, mode="nearest")
        away = deviations * family.PRIOR_STD * direction / np.sqrt(np.mean(direction**2))
        knots = (family.PRIOR_MEAN + torch.from_numpy(away))[None]
        if family.downhill(knots).max() < 1e-6:
            return _take_with(root, family.to_response(knots), rng)
    raise BadInput(f"no rising response found {deviations:g} deviations away", "ask for fewer", root)


def measured_response(root: Path, _truth: Path, percentile: float, rng: np.random.Generator) -> str:
    """A measured response, chosen near ``percentile`` of the distances from the mean of all."""
    curves = curves_by_distance()
    near = round(percentile / 100 * (len(curves) - 1)) - int(rng.integers(0, 3))
    return take_with_curve(root, curves[np.clip(near, 0, len(curves) - 1)], rng)


def take_with_curve(root: Path, samples: FloatArray, rng: np.random.Generator) -> str:
    """All photos taken with the response ``samples`` (1024,) in every channel, which becomes the true one."""
    return _take_with(root, Response(np.tile(samples, (3, 1)), "file"), rng)


def curves_by_distance() -> FloatArray:
    """(n, 1024) measured responses, the nearest to their mean first; raises BadInput where the file is missing."""
    curves = measured_curves()
    return curves[np.argsort(np.linalg.norm(curves - curves.mean(0), axis=1))]


def measured_curves() -> FloatArray:
    """(n, 1024) rising responses of the DoRF database; raises BadInput where the file is missing."""
    if not DORF.is_file():
        raise BadInput("the measured responses are not here", "put dorf_dev.npz there", DORF)
    with np.load(DORF, allow_pickle=False) as file:
        x, curves = file["x"], file["curves"]
    table = np.stack([np.interp(np.linspace(0, 1, N_SAMPLES), x, row) for row in curves])
    table = np.maximum.accumulate(table, axis=1)
    return (table - table[:, :1]) / (table[:, -1:] - table[:, :1])


def _take_with(root: Path, response: Response, rng: np.random.Generator) -> str:
    """All photos, held-out ones included, taken with ``response``, which becomes the true one."""
    film = Film.of(root)
    film.take(lambda radiance, view: to_ldr(radiance, response, view.exposure or 1.0), rng)
    for view in read_fipt_views(root, "val") if (root / "val" / "transforms.json").is_file() else ():
        exr, png = (root / "gt" / "val" / "Image" / f"{view.name}{suffix}" for suffix in (".exr", ".png"))
        if exr.is_file() and png.is_file() and view.exposure is not None:
            write_png(png, np.round(255 * to_ldr(read_rgb(exr), response, view.exposure)).astype(np.uint8))
    distance = film.response.samples - response.samples
    save_array(root / "gt" / "cam" / "crf_gt.npy", response.samples)
    return f"{film.note}; {np.sqrt(np.mean(distance**2)):.3f} rms from the capture's own response"
