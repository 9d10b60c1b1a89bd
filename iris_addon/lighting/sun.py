"""The sun: parallel light from one direction that comes in through the openings of the mesh, equation (35).

Its patches of light on floor and walls have sharp borders, which no light of order 2 and no interpolation between
patches can follow. The direct light is therefore a visibility per pixel, traced towards the sun's disc. In the light
balance the sun is one more emitter whose share at a patch is the mean over the patch's pixels. :mod:`.sun_search` finds
the direction.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from ..base.group_by import group_means
from ..base.parallel import BLOCK, over_random_blocks
from ..base.random_streams import stream
from ..brdf.diffuse import under_lobe
from ..rays.sampling import dot
from ..rays.tracer import Tracer
from ..surface.irradiance import IrradianceField
from ..surface.primary_rays import PixelSamples
from ..transport.form_factors import with_schlick
from ..transport.transport import Transport

SUN_RADIUS = np.radians(0.265)
"""Angular radius of the sun's disc."""
BORDER_RAYS = 12
"""Rays from each pixel that may lie on the border of a patch of sunlight: over its footprint and over the disc."""
PIXEL_BLUR = 0.45
"""Standard deviation, in pixels, of the filter with which a camera averages light."""
MIN_COSINE = 0.02
"""Cosine to the normal below which a surface counts as facing away from the sun."""


@dataclass(frozen=True)
class Sun:
    """The sun as the room sees it.

    Attributes:
        direction: (3,) unit vector towards it.
        irradiance: (3,) on a surface that faces it, as far as the search knows; the light balance solves for it.
        form_factors: (N, 1, 2) irradiance / pi of each patch under unit irradiance, plain and times Schlick's S.
        visible: (n,) share of the disc that each pixel sees, 0 where its surface faces away.
        border: (P,) bool, seen patches that a border of sunlight goes through or past.
    """

    direction: NDArray[np.float64]
    irradiance: NDArray[np.float64]
    form_factors: NDArray[np.float32]
    visible: NDArray[np.float32]
    border: NDArray[np.bool_]

    def arrays(self) -> dict[str, NDArray]:
        """Plain arrays for a checkpoint."""
        return {f"sun.{column.name}": getattr(self, column.name) for column in fields(self)}

    @staticmethod
    def from_arrays(arrays: dict[str, NDArray]) -> Sun | None:
        """Inverse of :meth:`arrays`; None where there are none."""
        own = {name.removeprefix("sun."): value for name, value in arrays.items() if name.startswith("sun.")}
        return Sun(**own) if own else None

    def seen_by(
        self, tracer: Tracer, samples: PixelSamples, patch: NDArray[np.integer], seed: int
    ) -> NDArray[np.float32]:
        """(k,) share of the disc that other pixels or texels see, on ``patch`` (k,), as :attr:`visible` has it."""
        visible = pixel_visibility(tracer, samples, self.direction)
        rows = np.flatnonzero(self.border[patch])
        visible[rows] = _blurred_visibility(tracer, samples, rows, self.direction, seed)
        return visible

    def at_pixels(
        self, samples: PixelSamples, visible: NDArray[np.floating], kappa: NDArray[np.floating]
    ) -> NDArray[np.float32]:
        """(k,) irradiance / pi of pixels under unit irradiance.

        Args:
            visible: (k,) share of the disc that each sees.
            kappa: (k,) of their lobes.
        """
        cosine = samples.normal @ self.direction.astype(np.float32)
        factors = visible[:, None] * np.maximum(cosine, 0)[:, None] / np.float32(np.pi) * with_schlick(cosine)
        return under_lobe(factors[:, None], kappa)[:, 0]


def sun_from(
    direction: NDArray[np.floating],
    irradiance: NDArray[np.floating],
    tracer: Tracer,
    samples: PixelSamples,
    patch: NDArray[np.int32],
    transport: Transport,
    field: IrradianceField,
    seed: int,
) -> Sun:
    """The sun in ``direction`` (3,): who sees it, by pixel and by patch.

    Args:
        tracer: of what casts shadows.
        patch: (n,) patch of each pixel of ``samples``.
        field: neighbourhoods of the seen patches.
    """
    toward = np.asarray(direction, np.float64) / np.linalg.norm(direction)
    visible = pixel_visibility(tracer, samples, toward)
    border = _on_border(visible, patch, field)
    rows = np.flatnonzero(border[patch])
    visible[rows] = _blurred_visibility(tracer, samples, rows, toward, seed)
    cosine = np.maximum(samples.normal @ toward.astype(np.float32), 0)
    factors = visible[:, None] * cosine[:, None] / np.float32(np.pi) * with_schlick(cosine)
    seen = group_means(factors, patch, transport.n_seen)
    o = transport.unseen_origins
    facing = o.normal @ toward.astype(np.float32)
    sees = _clear(tracer, o.position.reshape(-1, 3), o.normal.reshape(-1, 3), toward, facing.ravel())
    unseen = (sees.reshape(facing.shape) * np.maximum(facing, 0) / np.pi)[..., None] * with_schlick(facing)
    both = np.concatenate([seen, unseen.mean(1).reshape(-1, 2)]).astype(np.float32)
    return Sun(
        direction=toward,
        irradiance=np.asarray(irradiance, np.float64),
        form_factors=both[:, None],
        visible=visible,
        border=border,
    )


def pixel_visibility(
    tracer: Tracer, samples: PixelSamples, toward: NDArray[np.floating], rows: NDArray[np.integer] | None = None
) -> NDArray[np.float32]:
    """(n,) 1 where the centre of a pixel sees the direction ``toward`` (3,); of the pixels ``rows``, by default all."""
    position, normal = samples.position, samples.normal
    if rows is not None:
        position, normal = position[rows], normal[rows]
    return _clear(tracer, position, normal, toward, normal @ toward.astype(np.float32)).astype(np.float32)


def _clear(
    tracer: Tracer,
    position: NDArray[np.floating],
    normal: NDArray[np.floating],
    toward: NDArray[np.floating],
    cosine: NDArray[np.floating],
) -> NDArray[np.bool_]:
    """(n,) whether nothing lies between each point and infinity in the direction ``toward``; those facing away do not
    see it."""
    clear = np.zeros(len(position), bool)
    facing = np.flatnonzero(cosine > MIN_COSINE)
    start = position[facing] + tracer.epsilon * normal[facing]
    along = np.broadcast_to(toward.astype(np.float32), start.shape)
    clear[facing] = tracer.unoccluded(start, along, np.full(len(facing), np.inf))
    return clear


def _on_border(visible: NDArray[np.float32], patch: NDArray[np.int32], field: IrradianceField) -> NDArray[np.bool_]:
    """(P,) patches that are lit in part, or that have a neighbour which is lit otherwise."""
    share = group_means(visible[:, None], patch, len(field.position))[:, 0]
    around = share[field.neighbours]
    return (np.ptp(around, axis=1) > 0) | ((share > 0) & (share < 1))


def _blurred_visibility(
    tracer: Tracer, samples: PixelSamples, rows: NDArray[np.int64], toward: NDArray[np.float64], seed: int
) -> NDArray[np.float32]:
    """(m,) share of the disc that the pixels ``rows`` (m,) see, in the mean over their footprints."""
    seen = np.zeros(len(rows), np.float32)
    across = np.linalg.svd(toward[None])[2][1:].astype(np.float32)

    def work(block: slice, rng: np.random.Generator) -> None:
        at = rows[block]
        position, normal, view = samples.position[at], samples.normal[at], samples.direction[at]
        cosine = np.maximum(samples.cosine[at], 0.1)
        for _ in range(BORDER_RAYS):
            # A step in the plane of the photo, then along the line of sight back onto the surface.
            step = rng.standard_normal((len(at), 3), np.float32) * (PIXEL_BLUR * samples.footprint[at])[:, None]
            step -= dot(step, view)[:, None] * view
            step -= (dot(step, normal) / cosine)[:, None] * view
            radius, angle = np.sqrt(rng.random(len(at))) * SUN_RADIUS, 2 * np.pi * rng.random(len(at))
            disc = (radius * np.array([np.cos(angle), np.sin(angle)])).T.astype(np.float32) @ across
            along = toward.astype(np.float32) + disc
            facing = dot(normal, along) > MIN_COSINE
            start = (position + step + tracer.epsilon * normal)[facing]
            clear = tracer.unoccluded(start, along[facing], np.full(len(start), np.inf))
            seen[block][facing] += clear

    over_random_blocks(len(rows), BLOCK, work, stream(seed, "lighting.sun"))
    return seen / np.float32(BORDER_RAYS)
