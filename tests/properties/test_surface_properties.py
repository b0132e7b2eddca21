"""What holds for every primitive, of any shape, anywhere: distances do not exceed the way between
two points, and move and scale with the object.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from jax import lax
from scenes import motions, numbers, vectors

from vibrissa.numerics.compiled import compiled
from vibrissa.surfaces import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    Offset,
    Superquadric,
    Surface,
    Torus,
    Union,
)

sizes = numbers(0.05, 1.5)
axes = vectors(-1.0, 1.0).filter(lambda axis: np.linalg.norm(axis) > 0.1)
POINTS = np.random.default_rng(4).uniform(-2.0, 2.0, (100, 3))

FAR = 0.5

# Each takes two sizes, an axis and a scale.
EXACT: dict[str, Callable[[float, float, np.ndarray, float], Surface]] = {
    "box": lambda a, b, axis, k: Box((0, 0, 0), k * np.array([a, b, abs(axis[0]) + 0.1])),
    "cylinder": lambda a, b, axis, k: Cylinder((0, 0, 0), axis, k * a, k * b),
    "capsule": lambda a, b, axis, k: Capsule((0, 0, 0), axis, k * a, k * b),
    "cone": lambda a, b, axis, k: Cone((0, 0, 0), axis, k * a, k * b),
    "torus": lambda a, b, axis, k: Torus((0, 0, 0), axis, k * (a + b), k * a),
    "offset": lambda a, b, axis, k: Offset(Box((0, 0, 0), k * np.array([a, b, 0.3])), k * 0.1),
    "union": lambda a, b, axis, k: Union(
        [Capsule(k * axis, axis, k * a, k * b), Box((0, 0, 0), k * np.array([a, b, 0.2]))]
    ),
}
# By Newton's method: shapes without edges that are nearly sharp.
SMOOTH: dict[str, Callable[[float, float, np.ndarray, float], Surface]] = {
    "ellipsoid": lambda a, b, axis, k: Ellipsoid(
        (0, 0, 0), k * np.array([a, b, abs(axis[0])]) + 0.2 * k
    ),
    "superquadric": lambda a, b, axis, k: Superquadric(
        (0, 0, 0), k * np.array([a, b, abs(axis[0])]) + 0.2 * k, np.abs(axis[1:]) / 2 + 0.4
    ),
}
ALL = pytest.mark.parametrize("name", EXACT | SMOOTH)


@ALL
@given(a=sizes, b=sizes, axis=axes, motion=motions, scale=numbers(0.01, 10.0))
def test_distance_moves_and_scales_with_the_object(
    name: str, a: float, b: float, axis: np.ndarray, motion: tuple, scale: float
) -> None:
    (turn, shift), build = motion, (EXACT | SMOOTH)[name]
    distance = build(a, b, axis, 1.0).placed().distances(POINTS)
    far = np.abs(distance) > 1e-9
    if name in SMOOTH:
        far &= (distance > 0) & (distance < FAR)
    moved = (
        build(a, b, axis, scale).placed(turn, shift).distances(turn.apply(scale * POINTS) + shift)
    )
    np.testing.assert_allclose(
        moved[far], scale * distance[far], rtol=1e-7, atol=1e-12 * (scale + 1)
    )


@ALL
@given(a=sizes, b=sizes, axis=axes)
def test_distance_changes_no_more_than_the_point_moves(
    name: str, a: float, b: float, axis: np.ndarray
) -> None:
    surface = (EXACT | SMOOTH)[name](a, b, axis, 1.0)
    distance = surface.distances(POINTS)
    # Newton's method need not arrive from far away.
    outside = (distance > 0) & ((distance < FAR) | (name in EXACT))
    nearest = surface.nearest(POINTS)
    level = surface.levels(nearest)[outside]
    points, nearest, distance = POINTS[outside], nearest[outside], distance[outside]
    change = np.abs(distance[:, None] - distance[None])
    assert np.all(change <= np.linalg.norm(points[:, None] - points[None], axis=-1) + 1e-9)
    # Nothing lies nearer than the distance, and the closest point does lie on the surface.
    np.testing.assert_allclose(level, 0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(nearest - points, axis=1), distance, rtol=1e-9)


@ALL
@given(a=sizes, b=sizes, axis=axes)
def test_slope_one_and_flat_along_the_normal(
    name: str, a: float, b: float, axis: np.ndarray
) -> None:
    surface = (EXACT | SMOOTH)[name](a, b, axis, 1.0)
    distance = surface.distances(POINTS)
    points = POINTS[(distance > 0.02) & ((distance < FAR) | (name in EXACT))]
    gradient, hessian = jets(surface, jnp.array(np.resize(points, (100, 3))))
    np.testing.assert_allclose(np.linalg.norm(gradient, axis=1), 1, rtol=0, atol=1e-9)
    np.testing.assert_allclose(np.einsum("kij,kj->ki", hessian, gradient), 0, atol=1e-6)
    if name not in ("torus", "union"):
        # Outside a convex solid the distance is convex.
        assert np.linalg.eigvalsh(hessian).min() > -1e-6


@compiled
def jets(surface: Surface, points: jax.Array) -> tuple[jax.Array, jax.Array]:
    gradient = jax.grad(surface.distance)
    return lax.map(gradient, points), lax.map(jax.jacfwd(gradient), points)
