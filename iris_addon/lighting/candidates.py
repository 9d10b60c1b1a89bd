"""Candidates for lamps: faces that are, from every side, brighter than a surface could be under the light there.

A threshold on pixel values would not do: a white wall in a long exposure clips too, and a dim lamp does not. The test
is the reflectance that a face would need, its observed radiance (or the bound that clipping gives) over the irradiance
/ pi at it. Above 1 only emission explains it. Because the irradiance depends on the lamps found so far, the caller
(:mod:`.search`) repeats the test with falling thresholds. Lamps may also be read from a file
(:func:`read_given_emitters`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..base.errors import BadInput
from ..base.files import from_ranges
from ..base.group_by import group_means, group_medians
from ..base.untrusted import json_object, read_json
from ..rays.tracer import Tracer
from ..surface.topology import component_labels, smooth_edges

WHOLE_REGION_SHARE = 0.75
"""Share of a region's pixels on emitting faces above which the whole region is a lamp, unseen faces included."""
EMITTING_FACE_SHARE = 0.7
"""Share of a face's pixels on cells that pass the test above which the face emits."""
COPLANAR_COSINE = 0.999
"""Cosine between normals above which two faces lie in one plane."""
SCAN_MIN_DENSITY = 1 / 3
"""Pixels per area of a lamp of a scan over those of the whole scan, at least: what few views show may be a highlight in
all of them."""
SCAN_VOTES = 2
"""Rounds in which a face of a scan takes the side of most pixels on it and its neighbours. A face has three pixels;
where it has less than one, votes take as many rounds more as rings lie between one pixel and the next."""
SCAN_MAX_RINGS = 8
"""Rings of faces between pixels of a scan that are bridged, at most: 64 faces to a pixel."""
PIECE_MAX_GAP = 0.25
"""Distance between two pieces of one lamp of a scan, over the side of a square of the smaller one's area, at most."""
PIECE_MAX_STEP = 0.2
"""Difference in log brightness between two pieces of one lamp, at most."""
PIECE_MIN_COSINE = 0.8
"""Cosine between the mean normals of two pieces of one lamp, at least."""
LAMPS_TOLD_APART = 48
"""Lamps above which neighbours that are equally bright become one lamp: each takes rays and an unknown of its own."""
SPECK_MAX_SHARE = 0.05
"""Area over that of a lamp beside it up to which a piece is a speck: pixels in which the lamp shows through."""
CERTAIN_REFLECTANCE = 3.0
"""Reflectance needed above which only emission explains a face, however wrong the irradiance still is."""
CERTAIN_MIN_SHARE = 0.25
"""Share of the pixels of a bright surface of a scan that must be certain: a few always are by chance."""
COPY_MAX_DIFFERENCE = 0.01
"""Difference of area, and of edges, between two copies of one model, relative."""
LAMP_MIN_PIXELS = 12
"""Pixels over all photos below which there is no evidence for a lamp."""


def emitting_faces(
    passed: NDArray[np.bool_], sample_cell: NDArray[np.int32], sample_face: NDArray[np.int32], n_faces: int
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Faces (F,) nearly all of whose pixels lie on cells that passed the test, and the pixels (F,) of every face.

    A lamp's face shines all over; a large floor triangle that mirrors a window does not.

    Args:
        passed: (C,) bool.
        sample_cell, sample_face: (n,) cell and face of every pixel.
    """
    count = np.bincount(sample_face, minlength=n_faces)
    bright = np.bincount(sample_face[passed[sample_cell]], minlength=n_faces)
    return (bright > EMITTING_FACE_SHARE * count) & (count > 0), count


def continued(
    certain: NDArray[np.bool_],
    emitting: NDArray[np.bool_],
    count: NDArray[np.int64],
    normals: NDArray[np.floating],
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
    scanned: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """(F,) emitting faces that are certain, or continue a certain one in its plane, edge to edge.

    Some triangles of a pane may appear in long exposures only, which show no more than that they are bright. On a scan
    no two faces lie in one plane. There bright faces side by side are one surface, of which a share must be certain.

    Args:
        count: (F,) pixels of each face.
        normals: (F, 3) unit.
        scanned: (F,) faces of scans.
    """
    a, b = adjacency
    flat = smooth_edges(normals, adjacency, COPLANAR_COSINE) | (scanned[a] & scanned[b])
    flat &= emitting[a] & emitting[b]
    label = component_labels(len(emitting), a[flat], b[flat])
    pixels = np.bincount(label, count)
    share = np.bincount(label, count * (certain & emitting)) / np.maximum(pixels, 1)
    least = np.where(scanned, CERTAIN_MIN_SHARE, 0.0)
    return emitting & (share[label] > least)


def voted(
    emitting: NDArray[np.bool_],
    count: NDArray[np.int64],
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
    scanned: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """(F,) emitting faces, where those of scans take the side of most pixels on themselves and their neighbours.

    Args:
        count: (F,) pixels of each face.
        scanned: (F,) faces of scans.
    """
    if not scanned.any():
        return emitting
    a, b = adjacency
    inside = scanned[a] & scanned[b]
    a, b = a[inside], b[inside]
    result, pixels, n = emitting.copy(), count.astype(np.float64), len(emitting)
    for _ in range(SCAN_VOTES + _rings_between_pixels(count, scanned)):
        bright = pixels * result
        votes = bright + np.bincount(a, bright[b], n) + np.bincount(b, bright[a], n)
        of = pixels + np.bincount(a, pixels[b], n) + np.bincount(b, pixels[a], n)
        result = np.where(scanned, (votes > 0.5 * of) & (of > 0), result)
        # What no photo shows votes from now on as its neighbours made it.
        pixels = np.where(scanned & (pixels == 0) & (of > 0), 1.0, pixels)
    return result


def _rings_between_pixels(count: NDArray[np.int64], scanned: NDArray[np.bool_]) -> int:
    """Rings of faces from one pixel on a scan to the next, about; 0 where its faces are no smaller than pixels."""
    faces, pixels = int(scanned.sum()), int(count[scanned].sum())
    return min(math.ceil((faces / max(pixels, 1)) ** 0.5), SCAN_MAX_RINGS) if faces > pixels else 0


def _covered(
    count: NDArray[np.int64], adjacency: tuple[NDArray[np.int64], NDArray[np.int64]], scanned: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """(F,) faces of scans that photos show: those with pixels, and those between them that are smaller than pixels."""
    a, b = adjacency
    covered = count > 0
    for _ in range(_rings_between_pixels(count, scanned)):
        grown = covered.copy()
        grown[a[covered[b]]] = True
        grown[b[covered[a]]] = True
        covered = grown
    return covered & scanned


def with_specks_filled(
    emitting: NDArray[np.bool_],
    areas: NDArray[np.floating],
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
    scanned: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """(F,) emitting faces, and specks of a scan that one lamp encloses: what is beside most lamps is no part of them.

    Args:
        areas: (F,) of each face.
        scanned: (F,) faces of scans.
    """
    a, b = adjacency
    inside = scanned[a] & scanned[b]
    a, b = a[inside], b[inside]
    alike = emitting[a] == emitting[b]
    label = component_labels(len(emitting), a[alike], b[alike])
    area = np.bincount(label, areas)
    dark, bright = (np.where(emitting[a] == side, a, b)[~alike] for side in (False, True))
    island, lamp = label[dark], label[bright]
    least, most = np.full(len(area), len(area)), np.full(len(area), -1)
    np.minimum.at(least, island, lamp)
    np.maximum.at(most, island, lamp)
    enclosed = (least == most) & (area < SPECK_MAX_SHARE * area[np.maximum(most, 0)])
    return emitting | (scanned & enclosed[label])


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
    scanned: NDArray[np.bool_] | None = None,
) -> list[NDArray[np.int64]]:
    """Faces (k,) of each lamp: a whole region where nearly all of it emits, else emitting faces joined by edges.

    Args:
        count: (F,) pixels that saw each face.
        among: (F,) faces that may be lamps, by default all.
        scanned: (F,) faces of scans, whose regions say nothing of lamps; by default none.
    """
    whole = whole_regions(emitting, count, regions)[regions]
    if scanned is not None:
        whole &= ~scanned
    member = emitting | whole
    if among is not None:
        member &= among
    a, b = adjacency
    link = member[a] & member[b]
    label = component_labels(len(regions), a[link], b[link])
    # The faces of a region that emits as a whole belong together even where the mesh is not welded.
    label = np.where(whole, len(regions) + regions, label)
    faces = np.flatnonzero(member & (areas > 0))
    order = np.argsort(label[faces], kind="stable")
    _, first = np.unique(label[faces][order], return_index=True)
    lamps = np.split(faces[order], first[1:]) if len(faces) else []
    least = np.zeros(len(areas))
    if scanned is not None and scanned.any():
        usual = count[scanned].sum() / max(areas[_covered(count, adjacency, scanned)].sum(), 1e-12)
        least[scanned] = SCAN_MIN_DENSITY * usual * areas[scanned]
    return [lamp.astype(np.int64) for lamp in lamps if count[lamp].sum() >= max(LAMP_MIN_PIXELS, least[lamp].sum())]


def joined_pieces(
    lamps: list[NDArray[np.int64]], level: NDArray[np.floating], tracer: Tracer, scanned: NDArray[np.bool_]
) -> list[NDArray[np.int64]]:
    """Lamps of a scan put together from pieces: equally bright ones side by side are one lamp, and specks are left out.

    A scan has holes and noise, and photos see a window through its bars. Pieces of one lamp that have unknowns of their
    own would share its light among them in any way.

    Args:
        level: (F,) brightness of each face, scene-linear.
        scanned: (F,) faces of scans; lamps on other faces are returned as they are.
    """
    modelled = [lamp for lamp in lamps if not scanned[lamp[0]]]
    pieces = [lamp for lamp in lamps if scanned[lamp[0]]]
    if len(pieces) < 2:
        return lamps
    n = len(pieces)
    side = np.sqrt([tracer.areas[piece].sum() for piece in pieces])
    normal = np.array([(tracer.areas[piece, None] * tracer.normals[piece]).sum(0) for piece in pieces])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    faces, of = np.concatenate(pieces), np.repeat(np.arange(n), [len(piece) for piece in pieces])
    log_level = np.log(np.maximum(group_medians(level[faces, None], of, n)[:, 0], 1e-9))
    one, other, gap = _gaps(tracer.corners[faces].mean(1), of, PIECE_MAX_GAP * side)
    less, more = np.minimum(side[one], side[other]), np.maximum(side[one], side[other])
    alike = (np.abs(log_level[one] - log_level[other]) < PIECE_MAX_STEP) & (
        np.abs((normal[one] * normal[other]).sum(1)) > PIECE_MIN_COSINE
    )
    join = alike & (gap < PIECE_MAX_GAP * less)
    label = component_labels(n, one[join], other[join])
    area = np.bincount(label, side**2)
    # Within reach of the larger lamp, but not of the piece: light of the lamp that strayed.
    beside = (gap < PIECE_MAX_GAP * more) & (label[one] != label[other])
    a, b = label[one[beside]], label[other[beside]]
    small, large = np.where(area[a] < area[b], a, b), np.where(area[a] < area[b], b, a)
    speck = np.zeros(len(area), bool)
    speck[small[area[small] < SPECK_MAX_SHARE * area[large]]] = True
    joined = [np.sort(np.concatenate([pieces[k] for k in np.flatnonzero(label == lamp)])) for lamp in range(len(area))]
    return [*modelled, *(joined[k] for k in np.flatnonzero(~speck))]


def fewer_lamps(
    lamps: list[NDArray[np.int64]], level: NDArray[np.floating], tracer: Tracer, most: int = LAMPS_TOLD_APART
) -> list[NDArray[np.int64]]:
    """Lamps of which neighbours that are equally bright are put together, the nearest first, while there are more than
    ``most``. No face is lost, and lamps that differ stay apart however many there are.

    Args:
        level: (F,) brightness of each face, scene-linear.
    """
    if len(lamps) <= most:
        return lamps
    n = len(lamps)
    faces, of = np.concatenate(lamps), np.repeat(np.arange(n), [len(lamp) for lamp in lamps])
    log_level = np.log(np.maximum(group_medians(level[faces, None], of, n)[:, 0], 1e-9))
    centre = group_means(tracer.corners[faces].mean(1), of, n)
    one, other = np.triu_indices(n, 1)
    alike = np.abs(log_level[one] - log_level[other]) < PIECE_MAX_STEP
    one, other = one[alike], other[alike]
    distance = np.linalg.norm(centre[one] - centre[other], axis=1)
    label, left = np.arange(n), n
    for k in np.argsort(distance, kind="stable"):
        if left <= most:
            break
        a, b = label[one[k]], label[other[k]]
        if a != b:
            label[label == b] = a
            left -= 1
    return [np.sort(np.concatenate([lamps[k] for k in np.flatnonzero(label == lamp)])) for lamp in np.unique(label)]


def _gaps(
    position: NDArray[np.floating], of: NDArray[np.integer], reach: NDArray[np.floating]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Pairs (k,), (k,) of pieces that come within reach of each other, and their distance (k,).

    Args:
        position: (n, 3) metres, points on the pieces.
        of: (n,) piece of each, ascending.
        reach: (m,) metres, of each piece; the larger one counts.
    """
    m = len(reach)
    one, other, gap = [], [], []
    start = np.searchsorted(of, np.arange(m + 1))
    trees = [cKDTree(position[start[k] : start[k + 1]]) for k in range(m)]
    low, high = (np.array([f(tree.data, 0) for tree in trees]) for f in (np.min, np.max))
    for k in range(m):
        away = np.maximum(low[k + 1 :] - high[k], low[k] - high[k + 1 :]).max(1)
        for j in k + 1 + np.flatnonzero(away < np.maximum(reach[k], reach[k + 1 :])):
            small, large = (k, j) if start[k + 1] - start[k] < start[j + 1] - start[j] else (j, k)
            most = max(reach[k], reach[j])
            distance = trees[large].query(trees[small].data, distance_upper_bound=most)[0].min()
            if distance < most:
                one.append(k)
                other.append(j)
                gap.append(distance)
    return np.array(one, np.int64), np.array(other, np.int64), np.array(gap)


def tie_fixtures(
    emitters: Sequence[NDArray[np.int64]],
    areas: NDArray[np.floating],
    apart: NDArray[np.bool_] | None = None,
    corners: NDArray[np.floating] | None = None,
) -> NDArray[np.int64]:
    """(E,) label per emitter, the same for lamps of equal face count and total area, which are copies of one model.

    Any two squares of two triangles have as many faces, so these have to have equal edges as well.

    Args:
        corners: (F, 3, 3) of each face, metres; without them lamps of one or two faces are no copies.
        apart: (E,) bool, lamps that are like no other although they are copies; by default none.
    """
    if not emitters:
        return np.zeros(0, np.int64)
    keys = [(len(faces), float(areas[faces].sum())) for faces in emitters]
    alone = np.zeros(len(keys), bool) if apart is None else apart
    label = np.full(len(keys), -1, np.int64)

    def alike(one: int, other: int) -> bool:
        (n, area), (n_other, area_of_other) = keys[one], keys[other]
        if alone[one] or alone[other] or n != n_other or abs(area_of_other / area - 1) >= COPY_MAX_DIFFERENCE:
            return False
        if n > 2 or corners is None:
            return n > 2
        edges = (_edges(corners[emitters[k]]) for k in (one, other))
        return np.allclose(*edges, rtol=COPY_MAX_DIFFERENCE, atol=0)

    for index in range(len(keys)):
        twins = [j for j in range(index) if alike(index, j)]
        label[index] = label[twins[0]] if twins else label.max() + 1
    return label


def _edges(corners: NDArray[np.floating]) -> NDArray[np.floating]:
    """(3 n,) lengths of the edges of faces with ``corners`` (n, 3, 3), ascending."""
    return np.sort(np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2), axis=None)


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
