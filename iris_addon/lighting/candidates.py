"""Candidates for lamps: faces that are, from every side, brighter than a surface could be under the light there.

A threshold on pixel values would not do: a white wall in a long exposure clips too, and a dim lamp does not. The test
is the reflectance that a face would need, its observed radiance (or the bound that clipping gives) over the irradiance
/ pi at it. Above 1 only emission explains it. Because the irradiance depends on the lamps found so far, the caller
(:mod:`.search`) repeats the test with falling thresholds. Lamps may also be read from a file
(:func:`read_given_emitters`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput
from ..base.files import from_ranges, json_object, read_json
from ..base.group_by import order_in_groups
from ..response.observations import Observations
from ..response.radiance import Linearised, group_radiance
from ..surface.topology import component_labels, smooth_edges

WHOLE_REGION_SHARE = 0.75
"""Share of a region's pixels on emitting faces above which the whole region is a lamp, unseen faces included."""
EMITTING_FACE_SHARE = 0.7
"""Share of a face's pixels on patches that pass the test above which the face emits."""
COPLANAR_COSINE = 0.999
"""Cosine between normals above which two faces lie in one plane."""
MAX_LAMPS = 48
"""Lamps at most; those with most pixels are kept."""
CERTAIN_REFLECTANCE = 3.0
"""Reflectance needed above which only emission explains a face, however wrong the irradiance still is."""
LAMP_MIN_PIXELS = 12
"""Pixels over all photos below which there is no evidence for a lamp."""
VIEW_QUANTILE = 0.25
"""Quantile over views at which a patch's radiance is tested: emission is seen in all views, a highlight in few."""


@dataclass(frozen=True)
class Brightness:
    """Radiance of each patch as photos show it, clipped views included; scene-linear Rec.709.

    Attributes:
        floor: (P, 3) radiance that nearly all views reach: a low quantile over unclipped views, raised to the highest
            bound where clipped views prevail.
        measured: (P, 3) radiance from unclipped views, NaN without one.
        bound: (P, 3) lower bound from clipped views.
    """

    floor: NDArray[np.float64]
    measured: NDArray[np.float64]
    bound: NDArray[np.float64]


def brightness(
    observations: Observations, linear: Linearised, n_patches: int, specular: NDArray[np.floating] | None = None
) -> Brightness:
    """Brightness of every seen patch, without the ``specular`` radiance (M, 3) of the observations if known."""
    o = observations
    group = group_radiance(linear, o.patch, o.count, n_patches)
    value = least_radiance(linear, specular)
    floor = [_low_quantile(value[:, c], linear.unclipped[:, c], o.count, o.patch, n_patches) for c in range(3)]
    return Brightness(np.stack(floor, -1), np.where(group.known, group.radiance, np.nan), group.bound)


def least_radiance(linear: Linearised, specular: NDArray[np.floating] | None) -> NDArray[np.float64]:
    """(M, 3) least radiance of each observation, measured or a bound, without its ``specular`` part (M, 3)."""
    value = np.where(linear.unclipped, linear.radiance, linear.bound)
    return value if specular is None else np.maximum(value - specular, 0.0)


def _low_quantile(
    value: NDArray[np.float64],
    unclipped: NDArray[np.bool_],
    count: NDArray[np.floating],
    patch: NDArray[np.integer],
    n: int,
) -> NDArray[np.float64]:
    """(n,) low quantile over views of the least radiance of each patch in one channel.

    Args:
        value: (M,) least radiance of each observation.
        unclipped: (M,) bool; clipped observations can only raise the result.
        count: (M,) pixels.
        patch: (M,) patch of each observation, below ``n``.
    """
    result = np.zeros(n)
    bound = np.zeros(n)
    np.maximum.at(bound, patch, np.where(unclipped, 0.0, value))
    use = np.flatnonzero(unclipped)
    order = use[order_in_groups(value[use], patch[use])]
    in_order = patch[order]
    weight = count[order].astype(np.float64)
    total = np.bincount(in_order, weight, n)
    running = np.cumsum(weight) - np.concatenate([[0], np.cumsum(total)])[in_order]
    reached = running >= VIEW_QUANTILE * total[in_order]
    chosen = np.flatnonzero(reached & np.concatenate([[True], (in_order[1:] != in_order[:-1]) | ~reached[:-1]]))
    result[in_order[chosen]] = value[order][chosen]
    unclipped_share = total / np.maximum(np.bincount(patch, count, n), 1e-9)
    return np.where(unclipped_share > VIEW_QUANTILE, result, np.maximum(result, bound))


def reflectance_needed(seen: Brightness, irradiance: NDArray[np.floating]) -> NDArray[np.float64]:
    """(P,) reflectance that would explain the brightness of each patch; ``irradiance`` (P, 3) is irradiance / pi."""
    return (seen.floor / np.maximum(irradiance, 1e-6)).max(1)


def emitting_faces(
    passed: NDArray[np.bool_], sample_patch: NDArray[np.int32], sample_face: NDArray[np.int32], n_faces: int
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Faces (F,) nearly all of whose pixels lie on patches that passed the test, and the pixels (F,) of every face.

    A lamp's face shines all over; a large floor triangle that mirrors a window does not.

    Args:
        passed: (P,) bool.
        sample_patch, sample_face: (n,) patch and face of every pixel.
    """
    count = np.bincount(sample_face, minlength=n_faces)
    bright = np.bincount(sample_face[passed[sample_patch]], minlength=n_faces)
    return (bright > EMITTING_FACE_SHARE * count) & (count > 0), count


def coplanar_with(
    certain: NDArray[np.bool_],
    emitting: NDArray[np.bool_],
    normals: NDArray[np.floating],
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> NDArray[np.bool_]:
    """(F,) emitting faces that are certain, or continue a certain one in its plane, edge to edge.

    Some triangles of a pane may appear in long exposures only, which show no more than that they are bright.
    """
    a, b = adjacency
    flat = emitting[a] & emitting[b] & smooth_edges(normals, adjacency, COPLANAR_COSINE)
    label = component_labels(len(emitting), a[flat], b[flat])
    holds_certain = np.zeros(len(emitting), bool)
    holds_certain[label[certain & emitting]] = True
    return emitting & holds_certain[label]


def with_gaps_closed(
    emitting: NDArray[np.bool_],
    seen: NDArray[np.bool_],
    normals: NDArray[np.floating],
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> NDArray[np.bool_]:
    """(F,) emitting faces, and those between them that no pixel hit because triangles are smaller than pixels.

    Unseen faces joined by smooth edges are one gap. A gap emits if nearly all seen faces at its border do.
    """
    a, b = adjacency
    smooth = smooth_edges(normals, adjacency)
    inside, border = smooth & ~seen[a] & ~seen[b], smooth & (seen[a] != seen[b])
    gap = component_labels(len(emitting), a[inside], b[inside])
    unseen_end, seen_end = np.where(seen[a], b, a)[border], np.where(seen[a], a, b)[border]
    n_gaps = int(gap.max()) + 1
    at_border = np.bincount(gap[unseen_end], minlength=n_gaps)
    bright = np.bincount(gap[unseen_end], emitting[seen_end], n_gaps)
    return emitting | (~seen & ((bright > EMITTING_FACE_SHARE * at_border) & (at_border > 0))[gap])


def whole_regions(
    emitting: NDArray[np.bool_], count: NDArray[np.int64], regions: NDArray[np.int32]
) -> NDArray[np.bool_]:
    """(n_regions,) regions nearly all of whose pixels lie on emitting faces; ``count`` (F,) pixels of each face."""
    n_regions = int(regions.max()) + 1
    return np.bincount(regions, count * emitting, n_regions) > WHOLE_REGION_SHARE * np.bincount(
        regions, count, n_regions
    )


def group_emitters(
    emitting: NDArray[np.bool_],
    count: NDArray[np.int64],
    areas: NDArray[np.floating],
    regions: NDArray[np.int32],
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
    among: NDArray[np.bool_] | None = None,
) -> list[NDArray[np.int64]]:
    """Faces (k,) of each lamp: a whole region where nearly all of it emits, else emitting faces joined by edges.

    Args:
        count: (F,) pixels that saw each face.
        among: (F,) faces that may be lamps, by default all.
    """
    whole = whole_regions(emitting, count, regions)
    member = emitting | whole[regions]
    if among is not None:
        member &= among
    a, b = adjacency
    link = member[a] & member[b]
    label = component_labels(len(regions), a[link], b[link])
    # The faces of a region that emits as a whole belong together even where the mesh is not welded.
    label = np.where(whole[regions], len(regions) + regions, label)
    faces = np.flatnonzero(member & (areas > 0))
    order = np.argsort(label[faces], kind="stable")
    _, first = np.unique(label[faces][order], return_index=True)
    lamps = np.split(faces[order], first[1:]) if len(faces) else []
    pixels = np.array([count[lamp].sum() for lamp in lamps])
    kept = np.sort(np.argsort(-pixels, kind="stable")[:MAX_LAMPS])
    return [lamps[k].astype(np.int64) for k in kept if pixels[k] >= LAMP_MIN_PIXELS]


def tie_fixtures(emitters: Sequence[NDArray[np.int64]], areas: NDArray[np.floating]) -> NDArray[np.int64]:
    """(E,) label per emitter, the same for lamps of equal face count and total area, which are copies of one model."""
    if not emitters:
        return np.zeros(0, np.int64)
    keys = [(len(faces), float(areas[faces].sum())) for faces in emitters]
    label = np.full(len(keys), -1, np.int64)
    for index, (n, area) in enumerate(keys):
        twins = [j for j in range(index) if keys[j][0] == n and n > 2 and abs(keys[j][1] / area - 1) < 0.01]
        label[index] = label[twins[0]] if twins else label.max() + 1
    return label


# ---- Lamps given in a file, in the form of a result's emitters.json -------------------------------------------------


def read_given_emitters(path: Path, areas: NDArray[np.floating]) -> list[NDArray[np.int64]]:
    """Faces of each lamp: ``{"emitters": [{"faces": [[first, last + 1], ...]}, ...]}``; no lamp is a valid answer.

    Args:
        areas: (F,) of the mesh's faces. Faces without area are left out; a face that two lamps name goes to the first.

    Raises:
        BadInput: unreadable, a face is not of this mesh, or a lamp has none with an area.
    """
    listed = read_json(path).get("emitters")
    if not isinstance(listed, list):
        raise BadInput("'emitters' is missing or not a list", "give an emitters.json with the faces of each lamp", path)
    emitters, taken = [], np.zeros(len(areas), bool)
    for k, entry in enumerate(listed):
        label = f"emitters[{k}].faces"
        faces = from_ranges(json_object(entry, f"emitters[{k}]", path).get("faces"), len(areas), label, path)
        faces = faces[areas[faces] > 0]
        if not len(faces):
            raise BadInput(f"{label} names no face that has an area", "leave that lamp out", path)
        own = faces[~taken[faces]]
        taken[own] = True
        if len(own):
            emitters.append(own)
    return emitters
