"""A solved box room made by hand, for the tests of everything that reads a Result."""

import numpy as np

from iris_addon.model.capture import Camera, Mesh
from iris_addon.model.recovered import Emitter, Textures
from iris_addon.model.response import identity
from iris_addon.results.result import Result


def box(size=2.0) -> Mesh:
    """A cube around the origin, two triangles a side, ordered -x +x -y +y -z +z; one UV cell for all."""
    h = size / 2
    corners = np.array([[x, y, z] for x in (-h, h) for y in (-h, h) for z in (-h, h)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    uv = np.tile(np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]], np.float32), (6, 1, 1))
    return Mesh(corners, faces, uv)


def sides_of_box(*sides: int) -> Mesh:
    """The box with these of its sides alone."""
    whole = box()
    faces = [triangle for side in sides for triangle in (2 * side, 2 * side + 1)]
    return Mesh(whole.vertices, whole.faces[faces], whole.uv[faces])


def room(albedo=0.5, emission=None, outside=None, mesh=None, roughness=1.0) -> Result:
    """A box of one colour in which the faces of ``emission`` {face pair: radiance} shine."""
    mesh = mesh or box()
    n = 32
    color = np.broadcast_to(np.asarray(albedo, np.float32), (n, n, 3)).copy()
    flat = np.ones((n, n), np.float32)
    emitters = tuple(
        Emitter(
            id=k, faces=np.array([2 * side, 2 * side + 1]), radiance=np.array(radiance, float), area=4.0, confidence=1.0
        )
        for k, (side, radiance) in enumerate((emission or {}).items())
    )
    return Result(
        mesh=mesh,
        regions=np.zeros(len(mesh.faces), np.int32),
        textures=Textures(color, flat * roughness, flat * 0, flat),
        emitters=emitters,
        outside=outside,
        response=identity(),
        exposures={},
    )


def camera(width=16, height=12, fx=10.0, fy=10.0, cx=None, cy=None, position=(0, 0, 0)) -> Camera:
    """Looks along -z."""
    c2w = np.eye(4)
    c2w[:3, 3] = position
    return Camera(
        width=width,
        height=height,
        fx=fx,
        fy=fy,
        cx=width / 2 if cx is None else cx,
        cy=height / 2 if cy is None else cy,
        c2w=c2w,
    )
