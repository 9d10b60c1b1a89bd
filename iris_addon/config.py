"""The one configuration of a solve, and its three presets."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Literal

from .base.errors import BadInput
from .model.texture_size import AskedSize, atlas_size_of, density_of

MAX_SEED = 2**30 - 1
"""Of seeds and samples: Blender has 32 bits for the double of one."""
TEXTURE_OPTIONS = ("atlas_size", "texels_per_metre")
"""Settings of the size of textures."""
PresetName = Literal["draft", "balanced", "final"]


@dataclass(frozen=True)
class Refinements:
    """Optional parts of the model. None lets held-out data decide; True and False force the choice.

    Attributes:
        device_curves: a response curve per camera model.
        channel_curves: a response curve per colour channel.
        white_balance: an exposure factor per channel, where exposures are unknown or corrected.
        corrected_exposures: exposures fitted to the overlap in place of recorded ones.
        exponent: of response and radiance, fitted to light transport where exposures are unknown.
        hidden_light: light whose source no photo shows: from outside the mesh by direction, and hidden lamps.
        gloss: roughness and metallic of a region; without, every surface is fully rough.
        local_exposure: local tone mapping and vignetting.
        poses: poses of single photos fitted to each other on the mesh, in place of the given ones.
    """

    device_curves: bool | None = None
    channel_curves: bool | None = None
    white_balance: bool | None = None
    corrected_exposures: bool | None = None
    exponent: bool | None = None
    hidden_light: bool | None = None
    gloss: bool | None = None
    local_exposure: bool | None = None
    poses: bool | None = None


AUTO = Refinements()
FULL, MINIMAL = (Refinements(*[forced] * len(fields(Refinements))) for forced in (True, False))


@dataclass(frozen=True)
class SolveConfig:
    """Every setting of a solve.

    Attributes:
        preset: name of the preset the values come from.
        response: "auto" estimates the curve, "gamma" is z = x^(1/2.2), a path names a file with a curve.
        exposures: "auto" takes what the capture knows, "none" withholds it, a path names a file.
        hdr: folder with one EXR of linear radiance per photo, in place of the photos.
        emitters: "search" finds the lamps; a path names an emitters.json with the faces of the only lamps.
        refinements: optional parts of the model that are forced or forbidden, for comparisons.
        device: where torch runs, and with "cuda" also rays, if Warp is installed.
        seed: of all random streams.
        max_patches: upper bound on surface patches; the patch size adapts to it.
        gather_rays: cosine-distributed rays per patch for light that arrives from other patches.
        shadow_rays: rays per patch over all emitters.
        specular_rays: rays per glossy observation; half as many per glossy pixel, whose neighbours serve it too.
        max_atlas_size: side of the texture atlas in texels, at most, where ``atlas_size`` gives none.
        rounds: alternations of lights and materials.
        atlas_size: side of the texture atlas in texels, a power of two; "auto" is as many as the photos resolve or
            ``texels_per_metre`` needs.
        texels_per_metre: density of the textures, everywhere, as far as the atlas holds it; "auto" is that of the
            photos' pixels. Where ``atlas_size`` is a number too, that is the most the atlas may have. The texture
            coordinates of a mesh that has them stay as they are: there this is a mean.

    Raises:
        BadInput: ``atlas_size`` or ``texels_per_metre`` is none of these.
    """

    preset: PresetName = "balanced"
    response: str | Path = "auto"
    exposures: str | Path = "auto"
    hdr: Path | None = None
    emitters: Literal["search"] | Path = "search"
    refinements: Refinements = AUTO
    device: Literal["auto", "cpu", "cuda"] = "auto"
    seed: int = 0
    max_patches: int = 100_000
    gather_rays: int = 96
    shadow_rays: int = 96
    specular_rays: int = 12
    max_atlas_size: int = 2048
    rounds: int = 2
    atlas_size: int | Literal["auto"] = "auto"
    texels_per_metre: float | Literal["auto"] = "auto"

    def __post_init__(self):
        for name, checked in (("atlas_size", atlas_size_of), ("texels_per_metre", density_of)):
            value = getattr(self, name)
            try:
                # Text and floats become what is compared and written down: one fingerprint for one size.
                object.__setattr__(self, name, checked(value))
            except ValueError as error:
                raise BadInput(f"{name} is {value!r}, {error}", "give one of these") from error

    @property
    def texture_size(self) -> AskedSize:
        """How large the texture atlas is to be."""
        side = None if self.atlas_size == "auto" else self.atlas_size
        density = None if self.texels_per_metre == "auto" else self.texels_per_metre
        return AskedSize(side or self.max_atlas_size, side if density is None else None, density)


PRESETS: dict[PresetName, SolveConfig] = {
    "draft": SolveConfig("draft", max_patches=50_000, gather_rays=48, specular_rays=8, max_atlas_size=1024, rounds=1),
    "balanced": SolveConfig(),
    "final": SolveConfig(
        "final",
        max_patches=250_000,
        gather_rays=256,
        shadow_rays=128,
        specular_rays=32,
        max_atlas_size=4096,
    ),
}


def preset(name: PresetName, **changes: object) -> SolveConfig:
    """The preset ``name`` with some fields replaced."""
    return replace(PRESETS[name], **changes)  # type: ignore[arg-type]
