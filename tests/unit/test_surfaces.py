"""Objects: positive outside, zero on the surface, normals outward, and placed as a body is moved."""

import re
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vibrissa import surfaces
from vibrissa.surfaces import Surface

CENTER = np.array([0.1, -0.2, 0.9])
TURN, SHIFT = Rotation.from_rotvec([0.4, -0.7, 1.1]), np.array([0.3, 0.1, -0.2])


def paraboloid(points: np.ndarray) -> np.ndarray:
    return 0.5 * points[..., 0] ** 2 + points[..., 1] ** 2 + 0.4 - points[..., 2]


def norm(points: np.ndarray, *semi_axes: float) -> np.ndarray:
    return np.linalg.norm((points - CENTER) / np.array(semi_axes), axis=-1)


OBJECTS: dict[str, tuple[Surface, Callable[[np.ndarray], np.ndarray]]] = {
    "paraboloid": (surfaces.EllipticParaboloid(a=0.5, b=1.0, h=0.4), paraboloid),
    "sphere": (surfaces.Sphere(center=CENTER, radius=0.6), lambda p: norm(p, 1, 1, 1) - 0.6),
    "ellipsoid": (
        surfaces.Ellipsoid(center=CENTER, semi_axes=(0.6, 0.4, 0.5)),
        lambda p: 0.4 * (norm(p, 0.6, 0.4, 0.5) - 1),
    ),
    "cylinder": (
        surfaces.EllipticCylinder(center=CENTER, semi_axes=(0.6, 0.3)),
        lambda p: 0.3 * (norm(p, 0.6, np.inf, 0.3) - 1),
    ),
    "plane": (
        surfaces.Plane(point=CENTER, normal=(3.0, 0.0, -4.0)),
        lambda p: (p - CENTER) @ [0.6, 0.0, -0.8],
    ),
    "height field": (surfaces.HeightField(lambda x, y: 0.5 * x**2 + y**2 + 0.4), paraboloid),
    "implicit": (
        surfaces.Implicit(lambda p: jnp.sum(p**4) - 0.2),
        lambda p: np.sum(p**4, axis=-1) - 0.2,
    ),
}
ALL = pytest.mark.parametrize("name", OBJECTS)
POINTS = np.random.default_rng(5).uniform(-1.5, 1.5, (40, 3))


@ALL
def test_level_is_the_objects_equation(name: str) -> None:
    surface, level = OBJECTS[name]
    np.testing.assert_allclose(surface.levels(POINTS), level(POINTS), rtol=1e-14, atol=1e-14)


@ALL
def test_normals_are_unit_and_point_to_where_the_level_rises(name: str) -> None:
    surface, level = OBJECTS[name]
    step = 1e-6
    slopes = [
        (level(POINTS + step * axis) - level(POINTS - step * axis)) / (2 * step)
        for axis in np.eye(3)
    ]
    gradient = np.stack(slopes, axis=-1)
    expected = gradient / np.linalg.norm(gradient, axis=-1, keepdims=True)
    np.testing.assert_allclose(surface.normal(POINTS), expected, rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    ("name", "inside", "outside"),
    [
        ("paraboloid", (0, 0, 1.0), (0, 0, 0.0)),
        ("sphere", CENTER, (0, 0, 0)),
        ("ellipsoid", CENTER + [0.55, 0, 0], CENTER + [0, 0.55, 0]),
        ("cylinder", CENTER + [0.55, 50, 0], CENTER + [0, 50, 0.55]),
        ("plane", CENTER + [0, 0, 1], CENTER - [0, 0, 1]),
        ("height field", (0, 0, 1.0), (0, 0, 0.0)),
        ("implicit", (0, 0, 0), (1, 1, 1)),
    ],
)
def test_negative_in_the_solid_and_positive_outside(
    name: str, inside: np.ndarray, outside: np.ndarray
) -> None:
    surface, _ = OBJECTS[name]
    assert (
        surface.levels(np.array(inside, dtype=float))
        < 0
        < surface.levels(np.array(outside, dtype=float))
    )


def test_the_papers_normal() -> None:
    """N ∝ (C,x, C,y, −1): the direction in which the object can push a rod (mechanics.md,
    "Two sign errors in the printed paper").
    """
    surface, _ = OBJECTS["paraboloid"]
    x, y = 0.7, -0.3
    expected = np.array([x, 2 * y, -1]) / np.linalg.norm([x, 2 * y, -1])
    np.testing.assert_allclose(
        surface.normal([x, y, 0.5 * x * x + y * y + 0.4]), expected, atol=1e-15
    )


@ALL
def test_placing_an_object_is_moving_the_points_back(name: str) -> None:
    surface, level = OBJECTS[name]
    placed = surface.placed(TURN, SHIFT)
    back = TURN.inv().apply(POINTS - SHIFT)
    np.testing.assert_allclose(placed.levels(POINTS), level(back), rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(
        placed.normal(POINTS), TURN.apply(surface.normal(back)), rtol=0, atol=1e-12
    )


@ALL
def test_placing_twice_composes(name: str) -> None:
    surface, _ = OBJECTS[name]
    other, shift = Rotation.from_rotvec([0, 0.5, 0.2]), np.array([0.0, 0.4, 0.1])
    twice = surface.placed(TURN.as_quat(), SHIFT).placed(other.as_quat(), shift)
    once = surface.placed(other * TURN, other.apply(SHIFT) + shift)
    np.testing.assert_allclose(twice.levels(POINTS), once.levels(POINTS), rtol=0, atol=1e-13)


def test_a_scaled_quaternion_is_the_same_rotation() -> None:
    surface, _ = OBJECTS["ellipsoid"]
    expected = surface.placed(TURN).levels(POINTS)
    np.testing.assert_allclose(
        surface.placed(-3 * TURN.as_quat()).levels(POINTS), expected, rtol=0, atol=1e-14
    )


def test_a_ball_is_an_ellipsoid_with_equal_axes() -> None:
    ball, _ = OBJECTS["sphere"]
    ellipsoid = surfaces.Ellipsoid(center=CENTER, semi_axes=(0.6, 0.6, 0.6))
    np.testing.assert_allclose(ball.levels(POINTS), ellipsoid.levels(POINTS), rtol=0, atol=1e-14)


def test_batches_keep_their_shape() -> None:
    surface, level = OBJECTS["sphere"]
    grid = POINTS.reshape(5, 8, 3)
    assert surface.levels(grid).shape == (5, 8)
    assert surface.normal(grid).shape == (5, 8, 3)
    assert float(surface.levels(POINTS[3])) == pytest.approx(float(level(POINTS[3])), abs=1e-15)


BAD = {
    "a": (
        lambda: surfaces.EllipticParaboloid(a=np.nan, b=1.0, h=0.4),
        "a = nan; allowed is a finite number",
    ),
    "b": (
        lambda: surfaces.EllipticParaboloid(a=0.5, b=np.inf, h=0.4),
        "b = inf; allowed is a finite number",
    ),
    "h": (
        lambda: surfaces.EllipticParaboloid(a=0.5, b=1.0, h=-np.inf),
        "h = -inf; allowed is a finite number",
    ),
    "radius": (
        lambda: surfaces.Sphere(center=CENTER, radius=0.0),
        "radius = 0.0; allowed is a finite number greater",
    ),
    "center": (
        lambda: surfaces.Sphere(center=(0, 0), radius=1.0),
        "center has shape (2,); allowed is (3,)",
    ),
    "center nan": (
        lambda: surfaces.Sphere(center=(0, np.nan, 0), radius=1.0),
        "center[1] = nan; allowed are finite",
    ),
    "semi-axis": (
        lambda: surfaces.Ellipsoid(center=CENTER, semi_axes=(1, -0.5, 1)),
        "semi_axes[1] = -0.5; allowed is a finite number greater than 0",
    ),
    "semi-axes": (
        lambda: surfaces.EllipticCylinder(center=CENTER, semi_axes=(1, 1, 1)),
        "semi_axes has shape (3,); allowed is (2,)",
    ),
    "normal": (
        lambda: surfaces.Plane(point=CENTER, normal=(0, 0, 0)),
        "normal = [0.0, 0.0, 0.0]; allowed is any 3-vector of non-zero length",
    ),
    "point": (
        lambda: surfaces.Plane(point=(0, 0, np.inf), normal=(0, 0, 1)),
        "point[2] = inf; allowed are finite",
    ),
    "vector height": (
        lambda: surfaces.HeightField(lambda x, y: jnp.stack([x, y])),
        "allowed is one real number",
    ),
    "untraceable height": (
        lambda: surfaces.HeightField(lambda x, y: float(x)),
        "allowed is a function of jax.numpy",
    ),
    "whole level": (
        lambda: surfaces.Implicit(lambda p: jnp.asarray(1)),
        "allowed is one real number",
    ),
    "rotation": (
        lambda: surfaces.Sphere(center=CENTER, radius=1.0).placed(rotation=(0, 0, 0, 0)),
        "rotation = [0.0, 0.0, 0.0, 0.0] has zero norm; allowed is any quaternion",
    ),
    "rotations": (
        lambda: surfaces.Sphere(center=CENTER, radius=1.0).placed(rotation=np.ones((2, 4))),
        "rotation has shape (2, 4); allowed is one quaternion (4,)",
    ),
    "translation": (
        lambda: surfaces.Sphere(center=CENTER, radius=1.0).placed(translation=(0, 0, np.nan)),
        "translation[2] = nan; allowed are finite numbers",
    ),
    "points": (
        lambda: surfaces.Sphere(center=CENTER, radius=1.0).normal(np.ones((2, 2))),
        "points has shape (2, 2); allowed is (…, 3)",
    ),
}


@pytest.mark.parametrize("what", BAD)
def test_what_is_wrong_is_named(what: str) -> None:
    build, message = BAD[what]
    with pytest.raises(ValueError, match=re.escape(message)):
        build()
