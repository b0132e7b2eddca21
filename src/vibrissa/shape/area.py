"""Points that stand for equal areas, of an object or of a mesh."""

import numpy as np
from jaxtyping import Float, Int

from vibrissa.surfaces import Surface
from vibrissa.surfaces.outline import box_of, outline


def points_over(
    surface: Surface,
    near: Float[np.ndarray, "k 3"],
    reach: float,
    beyond: float,
    count: int,
    rng: np.random.Generator,
    *,
    said: str,
) -> Float[np.ndarray, "n 3"]:
    """Random points, evenly by area, on triangles of all of an object that ends within `reach` of
    some points; of one that does not, of what lies up to `beyond` from them.

    Raises
    ------
    ValueError
        If nothing of the object is found there: `said` names it and the place.
    """
    box = box_of(surface, near, reach, beyond)
    triangles = np.zeros((0, 3, 3)) if box is None else outline(surface, *box)
    if not len(triangles):
        raise ValueError(f"{said}; allowed is an object there, in the same unit of length")
    area = np.linalg.norm(_doubled(triangles), axis=1)
    chosen = rng.choice(len(area), count, p=area / area.sum())
    weights = rng.dirichlet(np.ones(3), len(chosen))
    return np.einsum("nk,nki->ni", weights, triangles[chosen])


def vertex_areas(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]
) -> Float[np.ndarray, "v"]:
    """Area of a mesh that each vertex stands for: a third of its triangles'."""
    area = 0.5 * np.linalg.norm(_doubled(vertices[faces]), axis=1)
    return np.bincount(faces.ravel(), np.repeat(area / 3, 3), minlength=len(vertices))


def _doubled(triangles: Float[np.ndarray, "f 3 3"]) -> Float[np.ndarray, "f 3"]:
    """Normals of triangles, twice as long as their areas."""
    first, second, third = np.moveaxis(triangles, 1, 0)
    return np.cross(second - first, third - first)
