"""Superquadrics: the equation itself, the solids it contains, and derivatives on the planes and
axes of symmetry.
"""

import re
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from vibrissa import surfaces
from vibrissa.numerics.compiled import compiled

CENTER = np.array([0.1, -0.2, 0.9])
AXES = np.array([0.5, 0.3, 0.4])
EXPONENTS = [
    (1.0, 1.0),
    (0.5, 0.5),
    (0.2, 0.6),
    (1.0, 0.3),
    (0.3, 1.0),
    (0.05, 0.1),
    (1.4, 1.2),
    (2.0, 2.0),
    (0.1, 2.0),
    (2.0, 0.1),
]
ALL = pytest.mark.parametrize("exponents", EXPONENTS)
SMOOTH = pytest.mark.parametrize("exponents", [pair for pair in EXPONENTS if max(pair) <= 1])
POINTS = CENTER + np.random.default_rng(2).normal(0, 0.4, (300, 3))


@compiled
def derivatives(surface: surfaces.Surface, points: jax.Array) -> tuple[jax.Array, jax.Array]:
    gradient = jax.grad(surface.level)
    return lax.map(gradient, points), lax.map(jax.jacfwd(gradient), points)


def inside_outside(points: np.ndarray, exponents: tuple[float, float]) -> np.ndarray:
    (first, second), (x, y, z) = exponents, np.abs((points - CENTER) / AXES).T
    return (x ** (2 / second) + y ** (2 / second)) ** (second / first) + z ** (2 / first)


@ALL
def test_level_is_that_of_the_inside_outside_function(exponents: tuple[float, float]) -> None:
    level = surfaces.Superquadric(CENTER, AXES, exponents).levels(POINTS)
    expected = inside_outside(POINTS, exponents) ** (exponents[0] / 2)
    np.testing.assert_allclose(level, (expected - 1) * 0.3, rtol=0, atol=1e-14)


def test_solids_that_it_contains() -> None:
    def levels(*exponents: float) -> np.ndarray:
        return surfaces.Superquadric(CENTER, AXES, exponents).levels(POINTS)

    np.testing.assert_allclose(
        levels(1, 1), surfaces.Ellipsoid(CENTER, AXES).levels(POINTS), rtol=0, atol=1e-15
    )
    octahedron = (np.abs((POINTS - CENTER) / AXES).sum(axis=1) - 1) * 0.3
    np.testing.assert_allclose(levels(2, 2), octahedron, rtol=0, atol=1e-14)
    block = (np.abs((POINTS - CENTER) / AXES).max(axis=1) - 1) * 0.3
    np.testing.assert_allclose(levels(1e-3, 1e-3), block, rtol=0, atol=1e-2)


@ALL
def test_derivatives_are_those_of_finite_differences(exponents: tuple[float, float]) -> None:
    surface, step = surfaces.Superquadric(CENTER, AXES, exponents), 1e-6
    points = POINTS[np.min(np.abs(POINTS - CENTER), axis=1) > 0.02]
    gradient, hessian = derivatives(surface, jnp.array(points))
    ahead, behind = (
        np.stack([surface.levels(points + sign * step * axis) for axis in np.eye(3)], -1)
        for sign in (1, -1)
    )
    np.testing.assert_allclose(gradient, (ahead - behind) / (2 * step), rtol=0, atol=2e-8)
    ahead, behind = (
        np.stack(
            [derivatives(surface, jnp.array(points + sign * step * axis))[0] for axis in np.eye(3)],
            -1,
        )
        for sign in (1, -1)
    )
    np.testing.assert_allclose(hessian, (ahead - behind) / (2 * step), rtol=1e-5, atol=1e-5)


@SMOOTH
def test_derivatives_on_the_planes_and_axes_of_symmetry(exponents: tuple[float, float]) -> None:
    """Even in each coordinate: there the gradient lies in the plane, and second derivatives are the
    limits from beside.
    """
    surface = surfaces.Superquadric((0, 0, 0), AXES, exponents)
    planes = np.concatenate(
        [
            np.delete(POINTS[:20] - CENTER, axis, 1)[:, [*range(axis), 0, *range(axis, 2)]]
            * (np.arange(3) != axis)
            for axis in range(3)
        ]
    )
    gradient, hessian = derivatives(surface, jnp.array(planes))
    np.testing.assert_array_equal(
        np.asarray(gradient)[planes == 0],
        np.asarray(gradient)[planes == 0] * 0 + np.asarray(gradient)[planes == 0],
    )
    beside_gradient, beside = derivatives(surface, jnp.array(planes + (planes == 0) * 1e-7))
    np.testing.assert_allclose(gradient, beside_gradient, rtol=0, atol=1e-5)
    gentle = np.linalg.norm(beside, axis=(1, 2)) < 50
    np.testing.assert_allclose(hessian[gentle], np.asarray(beside)[gentle], rtol=0, atol=0.2)


@ALL
def test_no_derivative_is_missing_anywhere(exponents: tuple[float, float]) -> None:
    surface = surfaces.Superquadric(CENTER, AXES, exponents)
    grid = (
        np.stack(np.meshgrid(*[[-1.0, -1e-9, 0.0, 1e-17, 1e-120, 1.0, 1e4]] * 3), axis=-1).reshape(
            -1, 3
        )
        * AXES
    )
    points = np.concatenate([CENTER + grid, grid * [1, 1e-300, 1]])
    for surface_of in (surface, surfaces.Superquadric((0, 0, 0), AXES, exponents)):
        level = surface_of.levels(points)
        gradient, hessian = derivatives(surface_of, jnp.array(points))
        assert all(np.all(np.isfinite(part)) for part in (level, gradient, hessian))


@ALL
def test_slope_is_about_one_on_the_surface(exponents: tuple[float, float]) -> None:
    surface = surfaces.Superquadric(CENTER, AXES, exponents)
    growth = surface.levels(POINTS)[:, None] / 0.3 + 1
    on = CENTER + (POINTS - CENTER) / growth
    np.testing.assert_allclose(surface.levels(on), 0, atol=1e-14)
    steepness = np.linalg.norm(derivatives(surface, jnp.array(on))[0], axis=1)
    assert steepness.min() > 0.4
    assert steepness.max() < 1.5


@ALL
def test_the_solid_is_convex(exponents: tuple[float, float]) -> None:
    surface = surfaces.Superquadric(CENTER, AXES, exponents)
    middle = surface.levels((POINTS[::2] + POINTS[1::2]) / 2)
    assert np.all(
        middle <= (surface.levels(POINTS[::2]) + surface.levels(POINTS[1::2])) / 2 + 1e-14
    )


BAD: dict[str, tuple[Callable[[], object], str]] = {
    "exponent 0": (
        lambda: surfaces.Superquadric(CENTER, AXES, (0, 1)),
        "exponents[0] = 0.0; allowed is a finite number greater than 0",
    ),
    "exponent 3": (
        lambda: surfaces.Superquadric(CENTER, AXES, (1, 3)),
        "exponents = [1.0, 3.0]; allowed are at most 2",
    ),
    "one exponent": (
        lambda: surfaces.Superquadric(CENTER, AXES, 1.0),
        "exponents has shape (); allowed is (2,)",
    ),
    "semi-axis": (
        lambda: surfaces.Superquadric(CENTER, (1, 1, -1), (1, 1)),
        "semi_axes[2] = -1.0; allowed is a finite number greater than 0",
    ),
}


@pytest.mark.parametrize("what", BAD)
def test_what_is_wrong_is_named(what: str) -> None:
    build, message = BAD[what]
    with pytest.raises(ValueError, match=re.escape(message)):
        build()
