"""The last step of a careful solve: lamps and diffuse radiance together, under the loss of the photos themselves.

Unknown are log radiance per lamp and log diffuse radiance per patch of a sample of glossy patches. Predicted is the
display value that each photo shows,

    z = f( t (lobe D_p + rest + share · e) ),

and minimised a robust distance to the one it does show; where it is clipped, that t L ≥ 1 fails. The light balance
stays: it pulls each lamp towards what shading said, as firmly as shading said it. Response and exposures are held, for
overlap fixed them on many more observations. Patches that were not fitted decide whether any of it is kept.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from ..emission.candidates import tie_fixtures
from ..emission.types import Lights
from ..photometry import Photometry
from ..progress import Progress
from ..reflectance.gloss import Gloss
from ..reflectance.materials import MaterialProblem, continued_paths
from ..response.curve import N_SAMPLES
from ..transport.diffuse import under_lobe
from .highlights import Highlights, trace_highlights

DISPLAY_SCALE = 0.02
"""Display-value residual at which an observation starts to be an outlier."""
EFFECTIVE_OBSERVATIONS = 500
"""Neighbouring observations err together; highlights count as at most this many (see emission.balance)."""
BALANCE_STD = 0.1
"""Least error of log radiance from shading: its loss is sharp, but what biases it (gloss, lost light) is not noise."""
HELD_OUT_EVERY = 8
GAIN_NEEDED = 0.01
"""Relative fall of the loss on held-out patches below which the lamps stay as they were."""
STEPS = 80


@dataclass(frozen=True)
class Refinement:
    """What the refinement found and whether it is kept.

    Attributes:
        radiance: (E, 3) of the lamps, refined if ``taken``.
        before, after: loss on held-out patches, NaN where there is nothing to compare.
    """

    radiance: NDArray[np.float64]
    before: float
    after: float

    @property
    def taken(self) -> bool:
        """Whether held-out patches are explained better."""
        return self.after < (1 - GAIN_NEEDED) * self.before


def refine_lights(
    problem: MaterialProblem, photometry: Photometry, lights: Lights, gloss: Gloss, progress: Progress
) -> tuple[Lights, Refinement]:
    """Lamps refined by what glossy surfaces show of them, if held-out patches agree, and the light they then cast.

    Radiance photos show the lamps themselves; there the lights stay as they are.
    """
    if photometry.hdr or not lights.emitters:
        return lights, Refinement(lights.radiance, np.nan, np.nan)
    highlights = trace_highlights(problem, lights, gloss, np.random.default_rng([problem.seed, 41]))
    tie = tie_fixtures(lights.emitters, problem.light.tracer.areas)
    device = problem.light.transport.device
    found = refine(highlights, photometry, lights.radiance, lights.log_std, tie, device, progress)
    return (_relit(problem, lights, gloss, found.radiance) if found.taken else lights), found


def refine(
    highlights: Highlights,
    photometry: Photometry,
    radiance: NDArray[np.floating],
    log_std: NDArray[np.floating],
    tie: NDArray[np.integer],
    device: str,
    progress: Progress,
) -> Refinement:
    """Refine lamps on most of the patches and try them on the rest.

    Args:
        radiance: (E, 3) to start from and be pulled to; ``log_std`` (E,) how firmly.
        tie: (E,) lamps with the same label change by the same factor.
    """
    held = (highlights.lobe > 0) & (highlights.patch % HELD_OUT_EVERY == 0)
    if not highlights.weight[held].any():
        return Refinement(np.asarray(radiance), np.nan, np.nan)
    start = torch.zeros((int(tie.max()) + 1, 3), dtype=torch.float64, device=device)
    training = PhotoLoss.build(highlights, ~held, photometry, radiance, tie, device)
    testing = PhotoLoss.build(highlights, held, photometry, radiance, tie, device)
    std = np.full((len(start), 1), np.inf)
    np.minimum.at(std[:, 0], tie, np.maximum(log_std, BALANCE_STD))
    change, _ = training.minimise(start, _tensor(std, device), progress)
    before, after = (testing.minimise(step, None, progress)[1] for step in (start, change))
    return Refinement(radiance * np.exp(change.cpu().numpy())[tie], before, after)


@dataclass(frozen=True)
class PhotoLoss:
    """Highlights as tensors. ``change`` (E', 3), the log factors on the radiance of tied lamps, is what is asked for.

    Attributes:
        lamp_light: (m, E', 3) radiance that arrives from each group of tied lamps at a factor of 1.
        t: (m, 3) exposure; ``curve`` (3, 1024) display value over relative exposure.
    """

    patch: torch.Tensor
    lobe: torch.Tensor
    z: torch.Tensor
    clipped: torch.Tensor
    weight: torch.Tensor
    lamp_light: torch.Tensor
    rest: torch.Tensor
    t: torch.Tensor
    log_diffuse: torch.Tensor
    curve: torch.Tensor

    @staticmethod
    def build(
        h: Highlights,
        rows: NDArray[np.bool_],
        photometry: Photometry,
        radiance: NDArray[np.floating],
        tie: NDArray[np.integer],
        device: str,
    ) -> PhotoLoss:
        """The loss over some of the observations."""
        light = np.zeros((int(rows.sum()), int(tie.max()) + 1, 3))
        for k, group in enumerate(tie):
            light[:, group] += h.share[rows, k, None] * radiance[k]
        weight = h.weight[rows] / h.weight[rows].sum()
        shown = (h.patch[rows], h.lobe[rows], h.z[rows], h.clipped[rows], weight, light, h.rest[rows])
        exposure = photometry.exposure_at(h.view[rows], h.pixel[rows])
        given = (exposure, np.log(h.diffuse), photometry.response.samples)
        return PhotoLoss(*(_tensor(column, device) for column in (*shown, *given)))

    def value(self, change: torch.Tensor, log_diffuse: torch.Tensor) -> torch.Tensor:
        """Robust distance of predicted to shown display values; for clipped ones, of t L below 1."""
        diffuse = self.lobe[:, None] * torch.exp(log_diffuse)[self.patch]
        x = self.t * (diffuse + self.rest + (self.lamp_light * torch.exp(change)).sum(1))
        off = develop(self.curve, x.clamp(min=1e-6)) - self.z
        off = torch.where(self.clipped, off.clamp(max=0.0), off)
        return (self.weight[:, None] * torch.log1p((off / DISPLAY_SCALE) ** 2)).sum()

    def minimise(
        self, change: torch.Tensor, std: torch.Tensor | None, progress: Progress
    ) -> tuple[torch.Tensor, float]:
        """Best diffuse radiance and, with ``std`` (E', 1) of the pull to zero, best ``change``; and the loss there."""
        change = change.detach().clone().requires_grad_(std is not None)
        log_diffuse = self.log_diffuse.clone().requires_grad_(True)
        unknowns = [log_diffuse] if std is None else [log_diffuse, change]
        optimiser = torch.optim.LBFGS(unknowns, max_iter=STEPS, history_size=20, line_search_fn="strong_wolfe")

        def closure() -> torch.Tensor:
            progress.check()
            optimiser.zero_grad()
            loss = EFFECTIVE_OBSERVATIONS * self.value(change, log_diffuse)
            if std is not None:
                loss = loss + ((change / std) ** 2).sum()
            loss.backward()
            return loss

        optimiser.step(closure)
        with torch.no_grad():
            return change.detach(), float(self.value(change, log_diffuse))


def develop(curve: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
    """Display values (m, 3) of relative exposures ``x`` (m, 3) > 0; straight on beyond 1, for the sake of its slope."""
    at = x * (N_SAMPLES - 1)
    below = at.detach().floor().long().clamp(0, N_SAMPLES - 2)
    channel = torch.arange(3, device=x.device).expand_as(below)
    low, high = curve[channel, below], curve[channel, below + 1]
    return low + (at - below) * torch.where(below == N_SAMPLES - 2, (high - low).clamp(min=1e-4), high - low)


def _tensor(values: NDArray, device: str) -> torch.Tensor:
    array = np.asarray(values)
    return torch.from_numpy(np.ascontiguousarray(array)).to(device)


def _relit(problem: MaterialProblem, lights: Lights, gloss: Gloss, radiance: NDArray[np.float64]) -> Lights:
    """``lights`` with other lamps: what they cast changes, by way of gloss too, and so what others pass on."""
    transport = problem.light.transport
    bounce = continued_paths(problem, gloss, 0)
    factors = under_lobe(lights.form_factors, transport.kappa) + bounce.form_factors(lights.emitters, len(lights.mask))
    irradiance = lights.irradiance + factors @ (radiance - lights.radiance)
    irradiance = np.maximum(irradiance, 0.1 * lights.irradiance)
    ratio = irradiance / np.maximum(lights.irradiance, 1e-9)
    n = transport.n_seen
    inferred = np.ones((len(ratio), 1), bool)
    inferred[:n] = ~problem.observed.known.all(1, keepdims=True)
    patch_radiance = np.where(inferred, lights.patch_radiance * ratio, lights.patch_radiance)
    return replace(lights, radiance=radiance, irradiance=irradiance, patch_radiance=patch_radiance)


def joint_arrays(lights: Lights, found: Refinement) -> dict[str, NDArray]:
    """Plain arrays for a checkpoint."""
    return {**lights.arrays(), "held_out": np.array([found.before, found.after]), "taken": np.array(found.taken)}


def joint_report(arrays: dict[str, NDArray]) -> dict[str, object]:
    """For report.json: whether it was kept, and the held-out loss that decided."""
    before, after = arrays["held_out"].tolist()
    return {"taken": bool(arrays["taken"]), "held_out_before": before, "held_out_after": after}
