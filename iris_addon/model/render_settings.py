"""How a path tracer samples a picture: what every render of a solved room is told beside the room and the camera."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RenderSettings:
    """Sampling of a render. The same settings give the same pixels.

    Attributes:
        samples: paths per pixel.
        seed: of the random numbers.
        max_bounces: reflections of a path after which it ends.
        denoise: pass the picture through a denoiser, where the renderer has one.
        gpu: render on a GPU where there is one.
    """

    samples: int = 64
    seed: int = 0
    max_bounces: int = 24
    denoise: bool = True
    gpu: bool = False
