"""A room whose photos are traced onto its mesh: the geometry that every later stage computes on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..model.capture import Camera, Capture
from ..rays.tracer import Tracer
from .irradiance import IrradianceField
from .mixed_pixels import MixedPixels
from .patches import Surface, build_surface
from .photo_samples import PhotoSamples
from .primary_rays import PixelSamples
from .regions import Regions, split_regions
from .scan_surface import ScanSurface
from .topology import smooth_components


@dataclass(frozen=True)
class TracedRoom:
    """Photos on the mesh, its faces in regions, and its surface in patches.

    Attributes:
        capture: with cameras as they fit the mesh.
        surface: behind the capture's mesh.
        tracer: of the surface behind the capture's mesh.
        photos: the n pixels that show the mesh.
        adjacency: pairs of faces that share an edge, two (k,).
        regions: the F faces in regions.
        mixed: which of the n pixels show more than one surface.
        patches: the P patches that photos see.
        field: neighbourhoods of the patches.
    """

    capture: Capture
    surface: ScanSurface
    tracer: Tracer
    photos: PhotoSamples
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]]
    regions: Regions
    mixed: MixedPixels
    patches: Surface
    field: IrradianceField

    @property
    def samples(self) -> PixelSamples:
        """The n pixels on the mesh."""
        return self.photos.samples

    @property
    def cameras(self) -> list[Camera]:
        """The cameras of the photos."""
        return [view.camera for view in self.capture.views]

    def of_photos(self, photos: NDArray[np.bool_]) -> TracedRoom:
        """The same mesh, regions and patches with the pixels of some ``photos`` (V,) alone; views keep their numbers.

        Patches that none of them shows have no pixel.
        """
        kept = np.flatnonzero(photos[self.samples.view])
        count = np.bincount(self.patches.sample_patch[kept], minlength=len(self.patches.count))
        return replace(
            self,
            photos=self.photos.take(kept, photos),
            mixed=self.mixed.take(kept),
            patches=replace(self.patches, sample_patch=self.patches.sample_patch[kept], count=count),
        )

    @property
    def n_regions(self) -> int:
        """Number of regions."""
        return int(self.regions.of_face.max()) + 1

    @property
    def surveyed(self) -> NDArray[np.bool_]:
        """(F,) faces that a photo shows or a scanner saw: photos miss only scraps along the borders of a scan, and
        what lies beside it in its file are crumbs of the same scan."""
        if self.regions.scanned.any():
            return np.ones(len(self.regions.of_face), bool)
        return self.samples.seen_faces(len(self.regions.of_face))

    @property
    def smooth_components(self) -> NDArray[np.int32]:
        """(F,) connected component of each face once its region is cut along sharp edges."""
        return smooth_components(self.tracer.normals, self.adjacency, self.regions.of_face)

    @cached_property
    def scanned_pixels(self) -> NDArray[np.bool_]:
        """(n,) pixels on a scan, whose regions end where its colour changes."""
        return self.regions.scanned[self.samples.face]


def trace_room(
    capture: Capture,
    surface: ScanSurface,
    tracer: Tracer,
    photos: PhotoSamples,
    max_patches: int,
    rng: np.random.Generator,
) -> TracedRoom:
    """Split the mesh into regions, find the pixels that mix them, and cover what photos see with patches.

    Args:
        surface: behind the capture's mesh, which ``tracer`` traces.
    """
    adjacency = surface.adjacency
    regions = split_regions(capture.mesh, surface, photos.samples, photos.z)
    cameras = [view.camera for view in capture.views]
    patches = build_surface(capture.mesh, photos.samples, regions.of_face, max_patches, rng)
    return TracedRoom(
        capture=capture,
        surface=surface,
        tracer=tracer,
        photos=photos,
        adjacency=adjacency,
        regions=regions,
        mixed=MixedPixels.of(photos, regions.of_face, cameras, surface.outline_error),
        patches=patches,
        field=IrradianceField.build(patches),
    )
