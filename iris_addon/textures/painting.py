"""Base colour of texels as each photo shows it, at the photo's own resolution, one photo at a time.

Light, response and gloss come from the solve, which may have looked at reduced photos. They change slowly over a photo;
its pixels do not, and are read as they are on file.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, maximum_filter

from ..base.compiled import kernel
from ..base.parallel import BLOCK, over_blocks, over_each
from ..base.progress import Progress
from ..brdf.diffuse import schlick
from ..capture.photos import photos_at_once, read_pixels
from ..materials.gloss import Gloss
from ..materials.shading import Shading
from ..materials.specular import SPECULAR_ROUGH, rough_lobes, subtract_specular
from ..model.capture import View
from ..model.response import SATURATED
from ..response.photometry import Photometry
from ..surface.primary_rays import PixelSamples
from ..surface.traced_room import TracedRoom
from .bake import DIM_ALBEDO, UsualPixel, pixel_albedo, pixel_weight
from .fusion import TEXEL_SAMPLE, fuse_samples
from .paint import light_error
from .photo_texels import SeenTexels, on_edges, own_pixel, read_texels, seen_texels
from .principled import EXPECTED_WEIGHT, PaintedTexels
from .texel_points import TexelPoints

HALF_MAX = 6e4
"""Largest weight and blur that are stored; float16 ends a little above."""


@dataclass(frozen=True)
class PixelLight:
    """Light at n pixels, scene-linear Rec.709.

    Attributes:
        irradiance: (n, 3) irradiance / pi.
        diffuse: (n, 3) radiance that a white diffuse surface sends to the camera.
        ls0, ls1: (n, 3) specular lobes of equation (3).
    """

    irradiance: NDArray[np.floating]
    diffuse: NDArray[np.floating]
    ls0: NDArray[np.floating]
    ls1: NDArray[np.floating]

    def on_lamps(self, level: NDArray[np.floating]) -> PixelLight:
        """The same with pixels on lamps under light of a ``level`` (n,), 0 for other pixels: their base colour is then
        their radiance in that unit."""
        if not level.any():
            return self
        lit, level = level[:, None] > 0, level[:, None]
        irradiance, diffuse = (np.where(lit, level, light) for light in (self.irradiance, self.diffuse))
        return PixelLight(irradiance, diffuse, np.where(lit, 0, self.ls0), np.where(lit, 0, self.ls1))


@dataclass(frozen=True)
class SideLight:
    """Light of the solve at the T texels on one side of the surface; it is that of every photo.

    Attributes:
        patch: (T,) int32, -1 where there is none; there the rest is undefined.
        irradiance: (T, 3) float32 irradiance / pi, without sunlight in :meth:`Painter.light_of_sides`.
        brighter: (T, 3) float32 factor by which a texel is brighter than that explains.
    """

    patch: NDArray[np.int32]
    irradiance: NDArray[np.float32]
    brighter: NDArray[np.float32]


@dataclass(frozen=True)
class Painter:
    """What is known before the photos of one light state are read again.

    Attributes:
        room: with the n pixels of the reduced photos.
        points: the T texels.
        regions: (F,) region of each face.
        photometry, gloss, shading: of the solve.
        sunlight_at: (k, 3) irradiance / pi by the sun of k texels as pixels, on patches (k,).
        light: at the n pixels.
        expected: (P, 3) radiance of each patch.
        brighter: (P, 3) factor by which each patch is brighter than its irradiance explains.
        light_spread: (P,) spread of the irradiance over the neighbours of each patch.
        usual: of the pixels.
        held_out: (n,) bool, pixels that the textures may not see.
        lamp_level: (F,) unit in which the pattern of a lamp is painted, its brightest radiance; 0 for other faces.
        lit: (F,) bool, faces whose base colour the photos of this light state do not show, because they emit in it.
    """

    room: TracedRoom
    points: TexelPoints
    regions: NDArray[np.int32]
    photometry: Photometry
    gloss: Gloss
    shading: Shading
    sunlight_at: Callable[[PixelSamples, NDArray[np.int32]], NDArray[np.float32]]
    light: PixelLight
    expected: NDArray[np.floating]
    brighter: NDArray[np.floating]
    light_spread: NDArray[np.floating]
    usual: UsualPixel
    held_out: NDArray[np.bool_]
    lamp_level: NDArray[np.floating]
    lit: NDArray[np.bool_]

    def light_of_sides(self) -> tuple[SideLight, SideLight]:
        """Light on the side of the faces' normals, and on the other."""
        return self._side_light(1), self._side_light(-1)

    def read(self, view: View, index: int, sides: tuple[SideLight, SideLight]) -> NDArray:
        """What photo ``index`` shows of the texels, rows of :data:`.fusion.TEXEL_SAMPLE`.

        Args:
            view: of the photo at its full size.
            sides: of :meth:`light_of_sides`.
        """
        picture = _ReducedPhoto.of(self.room, index)
        seen = seen_texels(self.room.tracer, self.points, view)
        texels = self._as_pixels(seen, picture, index)
        size, region = self.points.size[seen.row] / seen.footprint, self.regions[texels.face]
        photo = read_pixels(view)
        exposures = self.photometry.exposures_of(photo.values, index)
        exposures[~photo.valid] = np.nan
        clipped = own_pixel(photo.values, seen.file_place) >= (np.inf if self.photometry.hdr else SATURATED)
        clipped &= own_pixel(photo.valid[..., None], seen.file_place)
        near_edge = picture.near_edge[texels.pixel]
        exposure, averaged = read_texels(exposures, seen, size, near_edge)
        nearest = picture.nearest[texels.pixel]
        here = self._light_here(texels, seen.row, self.room.patches.sample_patch[nearest], sides)
        lamp_level = self.lamp_level[texels.face]
        patch, metallic = here.patch, np.where(lamp_level > 0, 0, self.gloss.metallic[region])
        light = self._light(texels, here, seen, picture).on_lamps(lamp_level)
        linear = self.photometry.linearise_exposures(exposure, texels.view, texels.pixel)
        linear = linear.agreeing_with(self.expected[patch])
        at_least = clipped & ~linear.unclipped
        specular = subtract_specular(light.ls0, light.ls1, metallic)
        radiance = np.where(at_least, linear.bound, np.nan_to_num(linear.radiance))
        albedo = pixel_albedo(radiance, specular, light.ls0, light.diffuse, metallic)
        scanned = self.room.regions.scanned[texels.face]
        if picture.reduction == 1:  # all of its pixels have been looked at already
            edge = picture.on_edge[texels.pixel] | (self._pixel_regions[nearest] != region)
        else:
            edge = on_edges(self.room.tracer, self.points, seen, near_edge, self.regions, view.camera)
        # An outline of a scan may lie beside its place, where rays do not find it.
        edge |= scanned & self.room.mixed.mask[nearest]
        usual = self.usual.at(picture.reduction)
        weight = pixel_weight(texels, light.irradiance, specular, edge, scanned, usual)
        precision = linear.precision_at(self.expected[patch] + DIM_ALBEDO * light.diffuse)
        weight = weight * (linear.unclipped | at_least) * precision / usual.weight
        weight[self.held_out[nearest] | self.lit[texels.face]] = 0
        kept = np.flatnonzero((weight > 0).any(1))
        error = light_error(self.light_spread[patch], light.irradiance.mean(1) / self.usual.irradiance)
        blur = averaged / (size * np.sqrt(texels.cosine))
        table = np.empty(len(kept), TEXEL_SAMPLE)
        table["row"] = seen.row[kept]
        table["value"] = np.where(weight > 0, albedo, np.nan)[kept]
        table["at_least"] = at_least[kept]
        table["weight"] = np.minimum(weight[kept], HALF_MAX)
        table["blur"] = np.minimum(blur[kept], HALF_MAX)
        table["light_error"] = error[kept]
        return table

    @cached_property
    def _pixel_regions(self) -> NDArray[np.int32]:
        """(n,) region of each pixel."""
        return self.regions[self.room.samples.face]

    def _as_pixels(self, seen: SeenTexels, picture: _ReducedPhoto, index: int) -> PixelSamples:
        """The texels as if each were a pixel of the reduced photo."""
        column = np.clip(seen.place[:, 0] / picture.reduction, 0, picture.width - 1).astype(np.int32)
        row = np.clip(seen.place[:, 1] / picture.reduction, 0, picture.height - 1).astype(np.int32)
        pixel = row * np.int32(picture.width) + column
        normal = self.points.normal[seen.row]
        normal = normal * np.where((normal * seen.toward).sum(1, keepdims=True) < 0, np.float32(-1), np.float32(1))
        return PixelSamples(
            view=np.full(len(pixel), index, np.int16),
            pixel=pixel,
            face=self.points.face[seen.row],
            barycentric=np.zeros((len(pixel), 2), np.float32),
            position=self.points.position[seen.row],
            normal=normal,
            direction=seen.toward,
            footprint=seen.footprint,
        )

    def _side_light(self, side: int) -> SideLight:
        points, region = self.points, self.regions[self.points.face]
        normal = points.normal * np.float32(side)
        patch = self.room.patches.grid.patches(points.position, normal, region)
        irradiance, brighter = np.zeros((2, len(patch), 3), np.float32)
        known = np.flatnonzero(patch >= 0)
        irradiance[known], brighter[known] = self._surface_light(
            points.position[known], normal[known], region[known], patch[known]
        )
        return SideLight(patch, irradiance, brighter)

    def _light_here(
        self,
        texels: PixelSamples,
        row: NDArray[np.integer],
        otherwise: NDArray[np.int32],
        sides: tuple[SideLight, SideLight],
    ) -> SideLight:
        """Light at the k ``texels`` that a photo shows, texel points ``row`` (k,), on the side that it shows.

        Args:
            otherwise: (k,) patch of those that lie on none.
        """
        front, back = sides
        flipped = np.flatnonzero((texels.normal * self.points.normal[row]).sum(1) < 0)
        patch, irradiance, brighter = front.patch[row], front.irradiance[row], front.brighter[row]
        for values, behind in ((patch, back.patch), (irradiance, back.irradiance), (brighter, back.brighter)):
            values[flipped] = behind[row[flipped]]
        lost = np.flatnonzero(patch < 0)
        patch[lost] = otherwise[lost]
        region = self.regions[texels.face[lost]]
        irradiance[lost], brighter[lost] = self._surface_light(
            texels.position[lost], texels.normal[lost], region, patch[lost]
        )
        # The borders of sunlight are as soft as the pixels of the photo.
        return SideLight(patch, irradiance + self.sunlight_at(texels, patch), brighter)

    def _surface_light(
        self,
        position: NDArray[np.float32],
        normal: NDArray[np.float32],
        region: NDArray[np.integer],
        patch: NDArray[np.int32],
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Irradiance / pi without sunlight (k, 3) of points of regions and on patches (k,), and the factor by which
        they are brighter than it explains."""
        field, metallic = self.room.field, self.gloss.metallic[region]
        brighter = field.at_points(position, normal, patch, self.brighter)
        brighter[metallic > 0.5] = 1  # of metals base colour is no quotient of irradiance
        return field.at_points(position, normal, patch, self.shading.smooth), brighter

    def _light(self, texels: PixelSamples, here: SideLight, seen: SeenTexels, picture: _ReducedPhoto) -> PixelLight:
        region, irradiance = self.regions[texels.face], here.irradiance
        roughness = self.gloss.roughness[region]
        factor = self.shading.view_factor(here.patch, roughness, schlick(texels.cosine), texels.direction)
        ls0, ls1 = rough_lobes(roughness, texels.cosine, irradiance)
        traced = np.flatnonzero(roughness < SPECULAR_ROUGH)
        place = seen.place[traced] / np.float32(picture.reduction)
        for lobe, of_pixels in ((ls0, self.light.ls0), (ls1, self.light.ls1)):
            lobe[traced] = picture.between_pixels(place, region[traced], self._pixel_regions, of_pixels, lobe[traced])
        return PixelLight(irradiance, irradiance * factor[:, None] * here.brighter, ls0, ls1)


@dataclass(frozen=True)
class _ReducedPhoto:
    """A photo as the solve has seen it, of h x w pixels.

    Attributes:
        reduction: rows and columns of the photo on file in one of its pixels.
        pixel: (h, w) int32 which of the n pixels on the mesh each is, -1 for none.
        nearest: (h * w,) int32 the nearest of those on the mesh to each.
        on_edge: (h * w,) bool, a mixed pixel or one off the mesh.
        near_edge: (h * w,) bool, one of those or beside one.
    """

    reduction: int
    pixel: NDArray[np.int32]
    nearest: NDArray[np.int32]
    on_edge: NDArray[np.bool_]
    near_edge: NDArray[np.bool_]

    @staticmethod
    def of(room: TracedRoom, index: int) -> _ReducedPhoto:
        view, samples = room.capture.views[index], room.samples
        own = np.arange(*np.searchsorted(samples.view, [index, index + 1]), dtype=np.int32)
        pixel = np.full(view.camera.height * view.camera.width, -1, np.int32)
        pixel[samples.pixel[own]] = own
        pixel = pixel.reshape(view.camera.height, view.camera.width)
        edge = pixel < 0
        edge.ravel()[samples.pixel[own]] = room.mixed.mask[own]
        near_edge = np.asarray(maximum_filter(edge, 3), bool)
        if len(own):
            at = np.asarray(distance_transform_edt(pixel < 0, return_distances=False, return_indices=True))
            nearest = pixel[at[0], at[1]]
        else:
            nearest = np.zeros_like(pixel)
        return _ReducedPhoto(
            reduction=view.reduction,
            pixel=pixel,
            nearest=nearest.ravel(),
            on_edge=edge.ravel(),
            near_edge=near_edge.ravel(),
        )

    @property
    def height(self) -> int:
        """Rows h."""
        return self.pixel.shape[0]

    @property
    def width(self) -> int:
        """Columns w."""
        return self.pixel.shape[1]

    def between_pixels(
        self,
        place: NDArray[np.float32],
        region: NDArray[np.integer],
        regions: NDArray[np.integer],
        values: NDArray[np.floating],
        otherwise: NDArray[np.float32],
    ) -> NDArray[np.float32]:
        """(k, 3) values of pixels interpolated at places (k, 2), over pixels of the same region alone.

        Args:
            region: (k,) at the places; ``regions`` (n,) at the pixels.
            values: (n, 3) of the pixels.
            otherwise: (k, 3) values where no pixel of the region is beside a place.
        """
        found = otherwise.copy()

        def work(block: slice) -> None:
            _between(self.pixel, place[block], region[block], regions, values, found[block])

        over_blocks(len(place), BLOCK // 4, work)
        return found


@kernel
def _between(
    pixel: NDArray[np.int32],
    place: NDArray[np.float32],
    region: NDArray[np.integer],
    regions: NDArray[np.integer],
    values: NDArray[np.floating],
    found: NDArray[np.float32],
) -> None:
    height, width = pixel.shape
    for n in range(len(place)):
        x, y = place[n, 0] - 0.5, place[n, 1] - 0.5
        column, row = int(np.floor(x)), int(np.floor(y))
        total = a = b = c = 0.0
        for down in range(2):
            for across in range(2):
                near = pixel[min(max(row + down, 0), height - 1), min(max(column + across, 0), width - 1)]
                if near < 0 or regions[near] != region[n]:
                    continue
                # A little weight for all: at a pixel's centre the only one of the region may be another.
                weight = max(1e-3, (1 - abs(x - column - across)) * (1 - abs(y - row - down)))
                total += weight
                a += weight * values[near, 0]
                b += weight * values[near, 1]
                c += weight * values[near, 2]
        if total > 0:
            found[n, 0], found[n, 1], found[n, 2] = a / total, b / total, c / total


def paint_texels(
    painters: Sequence[Painter],
    of_photo: NDArray[np.integer],
    views: Sequence[View],
    size: int,
    keep: Callable[[str, Callable[[], NDArray]], NDArray],
    progress: Progress,
) -> PaintedTexels:
    """Base colour of the texels of an atlas of side ``size``, from the photos of ``views`` at full size.

    Args:
        painters: of each light state, with the same texel points.
        of_photo: (V,) painter of each photo.
        keep: stores the table that its second argument makes under a name, or finds it there, and returns it mapped.
    """
    sides = [painter.light_of_sides() for painter in painters]

    def read(index: int) -> NDArray:
        own = int(of_photo[index])
        return keep(f"photo-{index:05d}", lambda: painters[own].read(views[index], index, sides[own]))

    photos = over_each(range(len(views)), read, progress.update, photos_at_once(views))
    points = painters[0].points
    n = len(points.texel)
    error, bounded, measured = np.zeros(n, np.float32), np.zeros((n, 3), bool), np.zeros((n, 3), bool)
    for photo in photos:
        row, at_least, told = photo["row"], photo["at_least"], (photo["weight"] > 0) & ~photo["at_least"]
        error[row[told.any(1)]] = photo["light_error"][told.any(1)]
        measured[row] |= told
        bounded[row] |= at_least & (photo["weight"] > EXPECTED_WEIGHT)
    return PaintedTexels(
        points=points,
        fused=fuse_samples(photos, points, size),
        light_error=error,
        bounded=bounded,
        measured=measured,
    )
