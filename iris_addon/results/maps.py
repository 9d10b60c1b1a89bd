"""Material and emission maps of a result as a camera sees them: primary hits, barycentric UVs, bilinear texels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..brdf.diffuse import albedo_gain
from ..brdf.ggx import directional_albedo
from ..lighting.backdrop import SeenBackdrop
from ..model.capture import Camera
from ..model.recovered import DiffuseLobe
from ..rays.tracer import Tracer
from ..textures.atlas import interpolate_uv

if TYPE_CHECKING:
    from .result import Result  # which imports this file, for Result.render_maps

FloatArray = NDArray[np.floating]


@dataclass(frozen=True)
class ViewMaps:
    """Maps at the pixel centres of one camera. Colours scene-linear Rec.709.

    A ray that escapes through a hole of the mesh meets the backdrop, whose surfaces are matte. Where one looks outside
    maps are zero.

    Attributes:
        hit: (H, W) bool, pixels on the mesh.
        base_color, kd: (H, W, 3); kd = base colour · (1 − metallic).
        directional_albedo: (H, W, 3) a' towards the camera, of a Lambertian diffuse part.
        lobed_albedo: (H, W, 3) the same of the diffuse lobe that the result names.
        roughness, metallic, confidence: (H, W).
        emission: (H, W, 3) radiance.
    """

    hit: NDArray[np.bool_]
    base_color: FloatArray
    kd: FloatArray
    directional_albedo: FloatArray
    lobed_albedo: FloatArray
    roughness: FloatArray
    metallic: FloatArray
    confidence: FloatArray
    emission: FloatArray


class MapRenderer:
    """Renders the maps of one result; builds its ray tracer once."""

    def __init__(self, result: Result, tracer: Tracer | None = None) -> None:
        if result.mesh.uv is None:
            raise ValueError("the mesh of a result must have UVs")
        self._uv = result.mesh.uv
        self._textures = result.textures
        self._tracer = tracer or Tracer(result.mesh, without=result.panes)
        self._emission = result.face_emission()
        patterned = [emitter.faces for emitter in result.emitters if emitter.patterned]
        self._patterned = np.isin(np.arange(len(self._emission)), np.concatenate([*patterned, np.zeros(0, np.int64)]))
        self._profiled = [(emitter.faces, emitter.profile) for emitter in result.emitters if emitter.profile]
        self._lobe: DiffuseLobe = result.diffuse_lobe
        self._backdrop = SeenBackdrop(result.backdrop)

    def maps(self, camera: Camera) -> ViewMaps:
        """The maps through all pixel centres of ``camera``."""
        origins, directions = camera.rays()
        hits = self._tracer.closest(origins, directions)
        seen, escaping = np.flatnonzero(hits.face >= 0), np.flatnonzero(hits.face < 0)
        face, weights = hits.face[seen], hits.barycentric[seen]
        uv = interpolate_uv(self._uv, face, weights)
        textures = self._textures
        stacked = [textures.base_color] + [
            x[..., None] for x in (textures.roughness, textures.metallic, textures.confidence)
        ]
        base_color, rough, metal, confidence = (bilinear(texture, uv) for texture in stacked)
        cosine = np.abs(np.einsum("nk,nk->n", self._tracer.normals[face], directions[seen]))

        emission, shine = self._emission[face], np.flatnonzero(self._patterned[face])
        if textures.lamp_pattern is not None:
            emission[shine] *= bilinear(textures.lamp_pattern, uv[shine])
        for faces, profile in self._profiled:
            shine = np.flatnonzero(np.isin(face, faces))
            emission[shine] *= profile.at(cosine[shine])[:, None]
        kd = base_color * (1 - metal)
        lambertian = directional_albedo(base_color, rough[:, 0], metal[:, 0], cosine)
        lobed = lambertian + kd * (albedo_gain(self._lobe, rough[:, 0], cosine) - 1)[:, None]

        behind, paint = self._backdrop_at(origins[escaping], directions[escaping])
        behind = escaping[behind]

        def image(values: FloatArray, of_backdrop: FloatArray | float = 0.0) -> FloatArray:
            full = np.zeros((camera.height * camera.width, *values.shape[1:]), np.float32)
            full[seen], full[behind] = values, of_backdrop
            return full.reshape(camera.height, camera.width, *values.shape[1:])

        return ViewMaps(
            hit=image(np.ones(len(seen))) > 0,
            base_color=image(base_color, paint),
            kd=image(kd, paint),
            directional_albedo=image(lambertian, paint),
            lobed_albedo=image(lobed, paint),
            roughness=image(rough[:, 0], 1.0),
            metallic=image(metal[:, 0]),
            confidence=image(confidence[:, 0]),
            emission=image(emission),
        )

    def _backdrop_at(self, origins: FloatArray, directions: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
        """Of escaping rays those (n,) that meet a surface of the backdrop, and its albedo (n, 3) there."""
        recovered = self._backdrop.recovered
        if recovered is None or recovered.albedo is None:
            return np.zeros(0, np.int64), np.zeros((0, 3))
        texel = self._backdrop.texels(origins, directions)
        albedo = recovered.albedo.reshape(-1, 3)[texel]
        met = np.flatnonzero((texel >= 0) & albedo.any(1))
        return met, albedo[met]


def bilinear(texture: FloatArray, uv: FloatArray) -> FloatArray:
    """(n, C) values of ``texture`` (N, M, C), row 0 at v = 1, at ``uv`` (n, 2), by Blender's linear filter; edges
    repeat."""
    height, width = texture.shape[:2]
    x = np.clip(uv[:, 0] * width - 0.5, 0, width - 1)
    y = np.clip((1 - uv[:, 1]) * height - 0.5, 0, height - 1)
    x0, y0 = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    x1, y1 = np.minimum(x0 + 1, width - 1), np.minimum(y0 + 1, height - 1)
    s, t = (x - x0)[:, None], (y - y0)[:, None]
    top = texture[y0, x0] * (1 - s) + texture[y0, x1] * s
    bottom = texture[y1, x0] * (1 - s) + texture[y1, x1] * s
    return top * (1 - t) + bottom * t
