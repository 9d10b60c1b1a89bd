"""Response and exposures of a capture, measured from its photos or given: what turns display values into radiance.

Response files are a response.json of a result, or a table as .npy or text.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput
from ..base.parallel import BLOCK, over_blocks
from ..base.untrusted import read_curves
from ..config import SolveConfig
from ..decide import Decisions
from ..model import response as curve
from ..model.capture import Capture
from ..model.device import devices_of
from ..model.light_states import LightStates
from ..model.local_exposure import LocalExposure
from ..model.response import LUMINANCE, N_SAMPLES, SATURATED, Response
from ..surface.photo_samples import PhotoSamples, ShownPixels
from ..surface.traced_room import TracedRoom
from .family import FITTED
from .observations import Observations
from .overlap import fit_overlap
from .radiance import (
    MODEL_NOISE,
    Linearised,
    darkest,
    exposure_noise,
    linearise,
    linearise_bytes,
    radiance_itself,
    relative_exposure,
)

EXPONENT_MAX_ERROR = 0.015
"""Standard deviation of the log exponent up to which recorded exposures fix it better than light transport does."""
MIN_REGRESSION_SPREAD = 1e-6
"""Stops; keeps the error finite for photos of one exposure."""
DISPLAY_STEPS = 1 << 16
"""Display values that are told apart; all codes of 8 bits are among them."""
MAX_RESPONSE_BYTES = 16 << 20
"""Of a response file."""


@dataclass(frozen=True)
class Photometry:
    """From display values to radiance.

    Attributes:
        exposures: (V, 3) factor per training photo and channel.
        held_out: display-value disagreement between views of held-out patches, NaN where nothing was fitted.
        per_channel: whether each channel has its own curve.
        known_exposures: whether the capture gave the exposures.
        exposure_error: stops RMS by which the given exposures were corrected, 0 where they stand.
        exponent: by which response, exposures and radiance were raised over those that the prior chose.
        local: exposure by place within a photo, None where photos are uniformly exposed.
        others: responses of devices beside that of ``response``, empty where it is that of all photos.
        device: (V,) which of (response, *others) each photo was taken with; None where there is one.
    """

    response: Response
    exposures: NDArray[np.float64]
    held_out: float
    per_channel: bool
    known_exposures: bool
    exposure_error: float = 0.0
    exponent: float = 1.0
    local: LocalExposure | None = None
    others: tuple[Response, ...] = ()
    device: NDArray[np.int64] | None = None

    @property
    def hdr(self) -> bool:
        """Whether the photos are radiance already."""
        return self.response.family == "identity"

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should know."""
        if self.hdr:
            return ()
        found = []
        mapped = 0.0 if self.local is None else max(own.strength for own in (self.local.settings, *self.local.others))
        if mapped:
            lost = f"{mapped:.0%} of the contrast between large areas"
            found.append(f"the photos are locally tone mapped ({lost}); it was undone")
        if not self.known_exposures:
            found.append("exposures are unknown: the overall brightness of lights is relative")
        elif self.exposure_error:
            error = f"{self.exposure_error:.2g} stops"
            found.append(f"the recorded exposures do not fit the photos ({error}) and were corrected")
        return tuple(found)

    @property
    def exponent_unconstrained(self) -> bool:
        """Whether neither photos nor recorded exposures fix the common exponent of response, exposures and radiance."""
        return self.exponent_error > EXPONENT_MAX_ERROR

    @property
    def exponent_error(self) -> float:
        """Standard deviation of the logarithm of that exponent, infinite where no exposures are recorded.

        It is the slope of a linear regression of the true on the recorded exposures, whose error is theirs over their
        spread and the root of their number.
        """
        if self.response.family != FITTED:
            return 0.0
        if not self.known_exposures:
            return np.inf
        spread = float(np.log2(self.exposures).mean(1).std())
        return self.exposure_error / (max(spread, MIN_REGRESSION_SPREAD) * len(self.exposures) ** 0.5)

    def raised(self, exponent: float) -> Photometry:
        """The photometry under which the same photos show radiance to the power ``exponent``."""
        return replace(
            self,
            response=self.response.raised(exponent),
            exposures=self.exposures**exponent,
            exponent=self.exponent * exponent,
            local=None if self.local is None else self.local.raised(exponent),
            others=tuple(other.raised(exponent) for other in self.others),
        )

    def response_of(self, view: int) -> Response:
        """The response that photo ``view`` was taken with."""
        return self.response if self.device is None else (self.response, *self.others)[self.device[view]]

    def _by_response(self, view: NDArray[np.integer]) -> list[tuple[Response, NDArray[np.integer] | slice]]:
        """Each response, and which of the rows of ``view`` (n,) it exposed."""
        if self.device is None:
            return [(self.response, slice(None))]
        of_row = self.device[view]
        return [(own, np.flatnonzero(of_row == k)) for k, own in enumerate((self.response, *self.others))]

    def exposure_at(self, view: NDArray[np.integer], pixel: NDArray[np.integer]) -> NDArray[np.float64]:
        """(n, 3) exposure factor of row-major pixels (n,) of views (n,)."""
        exposure = self.exposures[view]
        return exposure if self.local is None else exposure * self.local.at(view, pixel)[:, None]

    def linearise_pixels(
        self, z: NDArray[np.floating], view: NDArray[np.integer], pixel: NDArray[np.integer]
    ) -> Linearised:
        """Radiance of single pixels, each clipped or not.

        Args:
            z: (n, 3) display values; radiance for HDR input.
            view, pixel: (n,) where each is, row-major.
        """
        if self.hdr:
            return radiance_itself(z / self.exposures[view])
        whole = _empty(z.shape)

        def work(rows: slice) -> None:
            t, some = self.exposure_at(view[rows], pixel[rows]), z[rows]
            clipped, black = (some >= SATURATED).astype(np.float32), (some <= 0).astype(np.float32)
            for response, own in self._by_response(view[rows]):
                linear = linearise_bytes(response, some[own], t[own], clipped[own], black[own])
                _put(linear, whole, rows, own)

        over_blocks(len(z), BLOCK, work)
        return whole

    def linearise_observations(self, o: Observations) -> Linearised:
        """Radiance of every observation, with its bounds."""
        t = self.exposure_at(o.view, o.pixel)
        if self.device is None or self.hdr:
            return linearise(o, self.response, t)
        whole = _empty(o.z.shape)
        for response, own in self._by_response(o.view):
            z = o.z[own].astype(np.float64)
            _put(linearise_bytes(response, z, t[own], o.saturated[own], o.black[own]), whole, slice(None), own)
        return whole

    def exposures_of(self, values: NDArray[np.float32], view: int) -> NDArray[np.float32]:
        """(H, W, 3) relative exposure of the display values of photo ``view``, NaN where clipped; of HDR input
        radiance."""
        if self.hdr:
            return values
        z = np.repeat(np.arange(DISPLAY_STEPS)[:, None] / (DISPLAY_STEPS - 1), 3, 1)
        exposure, _ = relative_exposure(self.response_of(view), z, z == 0)
        table = np.where(z >= SATURATED, np.nan, exposure).astype(np.float32)
        exposures = np.empty(values.shape, np.float32)

        def work(rows: slice) -> None:
            step = np.rint(values[rows] * np.float32(DISPLAY_STEPS - 1)).astype(np.uint16)
            for c in range(3):
                exposures[rows, :, c] = table[:, c][step[..., c]]

        over_blocks(len(values), 64, work)
        return exposures

    def linearise_exposures(
        self, exposure: NDArray[np.floating], view: NDArray[np.integer], pixel: NDArray[np.integer]
    ) -> Linearised:
        """Radiance behind means of :meth:`exposures_of` (n, 3), around row-major pixels (n,) of views (n,)."""
        t = self.exposure_at(view, pixel)
        known = np.isfinite(exposure)
        x = np.where(known, exposure, 1.0)
        if self.hdr:
            return replace(radiance_itself(x / t), unclipped=known)
        whole = _empty(x.shape)
        for response, own in self._by_response(view):
            noise, black = exposure_noise(response, x[own])
            linear = Linearised(
                radiance=x[own] / t[own],
                unclipped=known[own],
                bound=np.where(known[own], 0.0, 1 / t[own]),
                ceiling=np.where(black, darkest(response) / t[own], np.inf),
                precision=1.0 / (MODEL_NOISE**2 + noise**2),
            )
            _put(linear, whole, slice(None), own)
        return whole

    def develop(
        self, radiance: NDArray[np.floating], view: NDArray[np.integer], pixel: NDArray[np.integer]
    ) -> NDArray[np.float64]:
        """Display values (n, 3) of radiance; the radiance itself for HDR input."""
        exposed = radiance * self.exposure_at(view, pixel)
        if self.hdr or self.device is None:
            return exposed if self.hdr else self.response.apply(exposed)
        for response, own in self._by_response(view):
            exposed[own] = response.apply(exposed[own])
        return exposed

    def report(self) -> dict[str, Any]:
        """For report.json: which parts of the model were used, and how well they predict held-out patches."""
        return {
            "family": self.response.family,
            "curves": 3 if self.per_channel else 1,
            "devices": 1 + len(self.others),
            "exposures": ("corrected" if self.exposure_error else "known") if self.known_exposures else "estimated",
            "exposure_error_stops": round(self.exposure_error, 3),
            "exponent": round(self.exponent, 3),
            "local_exposure": None if self.local is None else asdict(self.local.settings),
            "held_out_residual": None if np.isnan(self.held_out) else self.held_out,
        }

    def arrays(self) -> dict[str, NDArray]:
        """Plain arrays for a checkpoint."""
        return {
            "samples": self.response.samples,
            "family": np.array(self.response.family),
            "coefficients": np.array(self.response.coefficients),
            "exposures": self.exposures,
            "held_out": np.array(self.held_out),
            "flags": np.array([self.per_channel, self.known_exposures]),
            "exposure_error": np.array(self.exposure_error),
            **({} if self.local is None else self.local.arrays()),
            **({} if self.device is None else _arrays_of_devices(self.device, self.others)),
        }

    @staticmethod
    def from_arrays(arrays: dict[str, NDArray]) -> Photometry:
        """Inverse of :meth:`arrays`."""
        response = Response(arrays["samples"], str(arrays["family"]), tuple(arrays["coefficients"].tolist()))
        per_channel, known = (bool(flag) for flag in arrays["flags"])
        held_out, error = float(arrays["held_out"]), float(arrays["exposure_error"])
        local = LocalExposure.from_arrays(arrays)
        stored = zip(arrays["other_samples"], arrays["other_coefficients"], strict=True) if "device" in arrays else ()
        others = tuple(Response(table, response.family, tuple(own.tolist())) for table, own in stored)
        return Photometry(
            response=response,
            exposures=arrays["exposures"],
            held_out=held_out,
            per_channel=per_channel,
            known_exposures=known,
            exposure_error=error,
            local=local,
            others=others,
            device=arrays.get("device"),
        )


def _arrays_of_devices(device: NDArray[np.int64], others: Sequence[Response]) -> dict[str, NDArray]:
    return {
        "device": device,
        "other_samples": np.array([own.samples for own in others]),
        "other_coefficients": np.array([own.coefficients for own in others]),
    }


def _empty(shape: tuple[int, ...]) -> Linearised:
    """Room for observations of ``shape``."""
    return Linearised(
        radiance=np.empty(shape),
        unclipped=np.empty(shape, bool),
        bound=np.empty(shape),
        ceiling=np.empty(shape),
        precision=np.empty(shape),
    )


def _put(linear: Linearised, whole: Linearised, rows: slice, own: NDArray[np.integer] | slice) -> None:
    """Write ``linear`` into the rows ``own`` among the ``rows`` of ``whole``."""
    for column in fields(Linearised):
        getattr(whole, column.name)[rows][own] = getattr(linear, column.name)


def measure_photometry(
    capture: Capture,
    config: SolveConfig,
    observations: Observations,
    photos: PhotoSamples,
    rng: np.random.Generator,
    decisions: Decisions,
) -> Photometry:
    """Response and exposures as ``config`` has them: measured, withheld or read from files.

    HDR photos have the identity as response, and the unit of their radiance as exposure.

    Raises:
        BadInput: the response file cannot be used.
    """
    known = capture.exposures_known
    given = np.array([view.exposure for view in capture.views], np.float64) if known else None
    n = len(capture.views)
    if photos.hdr:
        factors = np.ones(n) if given is None or config.hdr is not None else given
        exposures = np.repeat(photos.unit * factors[:, None], 3, 1)
        return Photometry(
            response=curve.identity(), exposures=exposures, held_out=np.nan, per_channel=False, known_exposures=True
        )
    fixed = fixed_response(config)
    devices = devices_of(capture.views)
    comparable = observations.apart(LightStates.of(capture.views))
    fit = fit_overlap(comparable, given, n, rng, fixed, decisions, photos.small, devices)
    device = devices.index if devices is not None and fit.others else None
    error = 0.0 if given is None else _error_of_recorded(fit.exposures, given, device)
    return Photometry(
        response=fit.response,
        exposures=fit.exposures,
        held_out=fit.residual,
        per_channel=fit.per_channel,
        known_exposures=known,
        exposure_error=error,
        local=fit.local,
        others=fit.others,
        device=device,
    )


def _error_of_recorded(
    exposures: NDArray[np.floating], given: NDArray[np.floating], device: NDArray[np.int64] | None
) -> float:
    """Stops RMS between fitted (V, 3) and recorded (V,) exposures, gains of whole devices aside; 0 where none."""
    off = np.log2(exposures / given[:, None])
    for k in () if device is None else range(1, int(device.max()) + 1):
        off[device == k] -= off[device == k].mean(0)
    error = float(np.sqrt(np.mean(off**2)))
    return error if error > 1e-6 else 0.0


def fixed_response(config: SolveConfig) -> Response | None:
    """The response that ``config`` gives, None where it is to be estimated; raises BadInput for an unusable file."""
    if config.response == "auto":
        return None
    if config.response == "gamma":
        return curve.gamma()
    return read_response(Path(config.response))


def read_response(path: Path) -> Response:
    """A monotone curve of 2 or more samples over x = 0 ... 1, for one or three channels.

    Accepts response.json of a result, .npy with (n,) or (3, n), or a text table of one or three columns.

    Raises:
        BadInput: missing, too large, not a table, not finite or falling.
    """
    mend = "give a response.json of a solve, or a table with one or three curves"
    table = read_curves(path, MAX_RESPONSE_BYTES, mend)
    if table.shape[0] not in (1, 3) or table.shape[1] < 2:
        raise BadInput(f"the response table has shape {table.shape}", mend, path)
    if (np.diff(table, axis=1) < -1e-6).any() or (table[:, -1] <= table[:, 0]).any():
        raise BadInput("the response curve falls or is flat", "a response must rise with exposure", path)
    table = (table - table[:, :1]) / (table[:, -1:] - table[:, :1])
    x = np.linspace(0, 1, N_SAMPLES)
    rows = [np.interp(x, np.linspace(0, 1, table.shape[1]), np.maximum.accumulate(row)) for row in table]
    return Response(np.stack(rows if len(rows) == 3 else rows * 3), "file")


def shown_pixels(photometry: Photometry, room: TracedRoom) -> ShownPixels:
    """Luminance of all pixels as photos show it."""
    samples = room.samples
    linear = photometry.linearise_pixels(room.photos.z, samples.view, samples.pixel)
    return ShownPixels(
        luminance=(np.where(linear.unclipped, linear.radiance, linear.bound) @ LUMINANCE).astype(np.float32),
        clipped=~linear.unclipped.all(1),
        usable=np.isinf(linear.ceiling).all(1) & (room.mixed.mask == 0),
    )
