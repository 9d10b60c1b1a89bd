"""A solved box room made by hand, for the tests of everything that reads a Result."""

import numpy as np

from iris_addon.capture.types import Camera, Mesh
from iris_addon.response.curve import identity
from iris_addon.result.types import Emitter, Result, Textures


def box(size=2.0) -> Mesh:
    """A cube around the origin, two triangles a side, ordered -x +x -y +y -z +z; one UV cell for all."""
    h = size / 2
    corners = np.array([[x, y, z] for x in (-h, h) for y in (-h, h) for z in (-h, h)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    uv = np.tile(np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]], np.float32), (6, 1, 1))
    return Mesh(corners, faces, uv)


def room(albedo=0.5, emission=None, outside=None, mesh=None, roughness=1.0) -> Result:
    """A box of one colour in which the faces of ``emission`` {face pair: radiance} shine."""
    mesh = mesh or box()
    n = 32
    color = np.broadcast_to(np.asarray(albedo, np.float32), (n, n, 3)).copy()
    flat = np.ones((n, n), np.float32)
    emitters = tuple(
        Emitter(k, np.array([2 * side, 2 * side + 1]), np.array(radiance, float), 4.0, 1.0)
        for k, (side, radiance) in enumerate((emission or {}).items())
    )
    return Result(
        mesh,
        np.zeros(len(mesh.faces), np.int32),
        Textures(color, flat * roughness, flat * 0, flat),
        emitters,
        outside,
        identity(),
        {},
    )


def camera(width=16, height=12, fx=10.0, fy=10.0, cx=None, cy=None, position=(0, 0, 0)) -> Camera:
    """Looks along -z."""
    c2w = np.eye(4)
    c2w[:3, 3] = position
    return Camera(width, height, fx, fy, width / 2 if cx is None else cx, height / 2 if cy is None else cy, c2w)
