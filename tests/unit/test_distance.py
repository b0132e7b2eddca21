"""Signed distance from smooth level functions, its derivatives, closest points, and objects grown
by it.
"""

import re
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from vibrissa import surfaces
from vibrissa.numerics.compiled import compiled
from vibrissa.surfaces import Surface

quickly = partial(compiled, quick=True)
CENTER = np.array([0.1, -0.2, 0.9])
DIRECTIONS = np.random.default_rng(11).normal(size=(60, 3))
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
TURN, SHIFT = Rotation.from_rotvec([0.4, -0.7, 1.1]), np.array([0.3, 0.1, -0.2])


@quickly
def jets(surface: Surface, points: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Distance, gradient and Hessian, as the solver takes them."""

    def one(point: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        value, gradient = jax.value_and_grad(surface.distance)(point)
        (slope, hessian) = jax.jacfwd(jax.value_and_grad(surface.distance))(point)
        return value, gradient, jnp.concatenate([slope[None], hessian])

    return lax.map(one, points)


@quickly
def bends(surface: Surface, points: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Gradient and Hessian of the level function."""
    return (
        lax.map(jax.grad(surface.level), points),
        lax.map(jax.hessian(surface.level), points),
    )


def wave(x: jax.Array, y: jax.Array) -> jax.Array:
    return 0.5 * x**2 - 0.3 * y**2 + 0.1 * jnp.sin(4 * x) * jnp.cos(3 * y)


def ring(p: jax.Array) -> jax.Array:
    """Of fourth degree, with a gradient far from unit length."""
    return (jnp.sum(p * p) + 0.5**2 - 0.2**2) ** 2 - 4 * 0.5**2 * (p[0] ** 2 + p[1] ** 2)


SMOOTH: dict[str, Surface] = {
    "paraboloid": surfaces.EllipticParaboloid(0.5, 1.0, 0.4),
    "ellipsoid": surfaces.Ellipsoid(CENTER, (0.6, 0.3, 0.45)),
    "disc": surfaces.Ellipsoid(CENTER, (0.6, 0.5, 0.06)),
    "elliptic cylinder": surfaces.EllipticCylinder(CENTER, (0.6, 0.3)),
    "wave": surfaces.HeightField(wave),
    "quartic": surfaces.Implicit(lambda p: jnp.sum(p**4) - 0.2),
    "ring": surfaces.Implicit(ring),
    "superquadric": surfaces.Superquadric(CENTER, (0.6, 0.3, 0.45), (0.5, 0.7)),
    "block": surfaces.Superquadric(CENTER, (0.6, 0.3, 0.45), (0.15, 0.15)),
    "placed": surfaces.Ellipsoid(CENTER, (0.6, 0.3, 0.45)).placed(TURN, SHIFT),
}
ALL = pytest.mark.parametrize("name", SMOOTH)


def on_surface(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of the surface, outward normals, and radii of curvature on the outside that rises
    most.
    """
    surface = SMOOTH[name]
    if name in ("wave", "paraboloid"):
        p = DIRECTIONS.copy()
        p[:, 2] += surface.levels(p)
    else:
        inner = {"quartic": 0 * CENTER, "placed": TURN.apply(CENTER) + SHIFT}.get(
            name, CENTER
        ) + np.zeros_like(DIRECTIONS)
        if name == "ring":
            inner = (
                0.5
                * DIRECTIONS
                * [1, 1, 0]
                / np.linalg.norm(DIRECTIONS[:, :2], axis=1, keepdims=True)
            )
        low, high = np.zeros(len(inner)), np.full(len(inner), 0.45 if name == "ring" else 30.0)
        for _ in range(100):
            middle = (low + high) / 2
            outside = surface.levels(inner + middle[:, None] * DIRECTIONS) > 0
            low, high = np.where(outside, low, middle), np.where(outside, middle, high)
        p = inner + ((low + high) / 2)[:, None] * DIRECTIONS
        p = p[np.abs(surface.levels(p)) < 1e-12]
    n = surface.normal(p)
    gradient, hessian = map(np.asarray, bends(surface, jnp.array(p)))
    across = np.eye(3) - n[:, :, None] * n[:, None, :]
    shape = across @ hessian @ across / np.linalg.norm(gradient, axis=1)[:, None, None]
    return p, n, 1 / np.abs(np.linalg.eigvalsh(shape)).max(axis=1)


@ALL
@pytest.mark.parametrize("share", [1e-9, 1e-3, 0.1, 0.3])
def test_distance_along_a_normal_is_how_far_one_goes(name: str, share: float) -> None:
    """Up to 0.3 of the radius of curvature, and of the object's size where it is flat."""
    p, n, radius = on_surface(name)
    assert len(p) > 40
    far = share * np.minimum(radius, 0.3)
    points = p + far[:, None] * n
    np.testing.assert_allclose(SMOOTH[name].distances(points), far, rtol=0, atol=1e-12)
    np.testing.assert_allclose(SMOOTH[name].nearest(points), p, rtol=0, atol=1e-11)
    _, gradient, _ = jets(SMOOTH[name], jnp.array(points))
    np.testing.assert_allclose(gradient, n, rtol=0, atol=1e-9)


@ALL
def test_a_little_inside_it_is_negative(name: str) -> None:
    p, n, radius = on_surface(name)
    far = 0.1 * np.minimum(radius, 0.1)
    np.testing.assert_allclose(
        SMOOTH[name].distances(p - far[:, None] * n), -far, rtol=0, atol=1e-12
    )


def test_distance_is_the_least_that_minimisation_finds() -> None:
    """The wave, from points that are not on a known normal: least distance over (x, y) from the
    best of a grid.
    """
    grid = np.stack(np.meshgrid(*[np.linspace(-2.5, 2.5, 201)] * 2), axis=-1).reshape(-1, 2)
    height = lambda q: (  # noqa: E731
        0.5 * q[..., 0] ** 2
        - 0.3 * q[..., 1] ** 2
        + 0.1 * np.sin(4 * q[..., 0]) * np.cos(3 * q[..., 1])
    )
    sheet = np.column_stack([grid, height(grid)])
    points = np.column_stack(
        [
            DIRECTIONS[:, :2],
            height(DIRECTIONS[:, :2]) - np.random.default_rng(3).uniform(0.01, 0.12, 60),
        ]
    )
    found = SMOOTH["wave"].distances(points)
    for point, distance in zip(points, found, strict=True):
        start = grid[np.argmin(np.sum((sheet - point) ** 2, axis=1))]
        least = minimize(
            lambda q, point=point: np.sum((np.append(q, height(q)) - point) ** 2),
            start,
            method="BFGS",
            options={"gtol": 1e-12},
        )
        assert distance == pytest.approx(np.sqrt(least.fun), abs=1e-9)


def test_closed_forms_of_balls_and_rings() -> None:
    ball = surfaces.Implicit(lambda p: jnp.sum((p - CENTER) ** 2) ** 2 - 0.5**4)
    points = CENTER + DIRECTIONS * np.linspace(0.5, 0.8, 60)[:, None]
    for found, expected in zip(
        jets(ball, jnp.array(points)),
        jets(surfaces.Sphere(CENTER, 0.5), jnp.array(points)),
        strict=True,
    ):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
    p, n, _ = on_surface("ring")
    points = p + np.linspace(0, 0.06, len(p))[:, None] * n
    torus = surfaces.Torus((0, 0, 0), (0, 0, 1), 0.5, 0.2)
    for found, expected in zip(
        jets(SMOOTH["ring"], jnp.array(points)), jets(torus, jnp.array(points)), strict=True
    ):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)


@ALL
def test_derivatives_are_those_of_finite_differences(name: str) -> None:
    p, n, radius = on_surface(name)
    points, step = p + 0.2 * np.minimum(radius, 0.3)[:, None] * n, 1e-5
    _, gradient, slope_and_hessian = jets(SMOOTH[name], jnp.array(points))
    np.testing.assert_allclose(np.linalg.norm(gradient, axis=1), 1, rtol=0, atol=1e-14)
    np.testing.assert_allclose(slope_and_hessian[:, 0], gradient, rtol=0, atol=1e-14)
    ahead, behind = (
        np.stack([SMOOTH[name].distances(points + sign * step * axis) for axis in np.eye(3)], -1)
        for sign in (1, -1)
    )
    np.testing.assert_allclose(gradient, (ahead - behind) / (2 * step), rtol=0, atol=1e-6)
    ahead, behind = (
        np.stack(
            [jets(SMOOTH[name], jnp.array(points + sign * step * axis))[1] for axis in np.eye(3)],
            -1,
        )
        for sign in (1, -1)
    )
    hessian = np.asarray(slope_and_hessian[:, 1:])
    np.testing.assert_allclose(
        hessian, (ahead - behind) / (2 * step), rtol=0, atol=1e-4 * np.abs(hessian).max()
    )
    np.testing.assert_allclose(
        hessian, hessian.transpose(0, 2, 1), rtol=0, atol=1e-10 * np.abs(hessian).max()
    )
    np.testing.assert_allclose(
        np.einsum("kij,kj->ki", hessian, gradient), 0, atol=1e-10 * np.abs(hessian).max()
    )


def test_forward_and_reverse_differentiation_agree() -> None:
    surface, points = SMOOTH["ellipsoid"], jnp.array(CENTER + 0.7 * DIRECTIONS[:5])
    expected = jets(surface, points)[2][:, 1:]
    for mode in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(
            quickly(partial(lax.map, mode(mode(surface.distance))))(points),
            expected,
            rtol=0,
            atol=1e-13,
        )


def test_derivatives_by_the_objects_own_figures() -> None:
    """∂d/∂θ of an ellipsoid that is a ball: −1 along the radius, −n along the centre, and their
    second derivatives.
    """
    points = jnp.array(CENTER + 0.7 * DIRECTIONS[:20])

    def squares(surface: Surface) -> jax.Array:
        return jnp.sum(lax.map(surface.distance, points) ** 2)

    def of_ellipsoid(figures: jax.Array) -> jax.Array:
        ball = surfaces.Ellipsoid(CENTER, (1, 1, 1))
        tree = jax.tree.structure(ball)
        return squares(jax.tree.unflatten(tree, [figures[:3], figures[3] * jnp.ones(3)]))

    def of_sphere(figures: jax.Array) -> jax.Array:
        return jnp.sum((jnp.linalg.norm(points - figures[:3], axis=1) - figures[3]) ** 2)

    figures = jnp.array([*CENTER, 0.5])
    np.testing.assert_allclose(
        quickly(jax.grad(of_ellipsoid))(figures),
        jax.jit(jax.grad(of_sphere))(figures),
        rtol=1e-12,
    )
    np.testing.assert_allclose(
        quickly(jax.hessian(of_ellipsoid))(figures),
        jax.jit(jax.hessian(of_sphere))(figures),
        rtol=0,
        atol=1e-11,
    )


@ALL
def test_far_away_and_deep_inside_it_is_finite_and_has_the_levels_sign(name: str) -> None:
    surface = SMOOTH[name]
    for scale in (0.01, 0.3, 3.0, 30.0):
        points = CENTER + scale * DIRECTIONS
        distance, gradient, hessian = jets(surface, jnp.array(points))
        assert all(np.all(np.isfinite(part)) for part in (distance, gradient, hessian))
        np.testing.assert_array_equal(np.sign(distance), np.sign(surface.levels(points)))


def test_placing_and_uniting_pass_the_distance_on() -> None:
    parts = [
        surfaces.Ellipsoid(CENTER, (0.6, 0.3, 0.45)),
        surfaces.Box((1.0, 0, 0), (0.3, 0.2, 0.1)),
        surfaces.Sphere((0, -1, 0), 0.4),
    ]
    union, points = surfaces.Union(parts), 1.5 * DIRECTIONS
    each = np.stack([part.distances(points) for part in parts])
    np.testing.assert_allclose(union.distances(points), each.min(axis=0), rtol=0, atol=1e-15)
    np.testing.assert_allclose(
        union.levels(points),
        np.min([part.levels(points) for part in parts], axis=0),
        rtol=0,
        atol=1e-15,
    )
    closest = np.array(
        [
            parts[index].nearest(point)
            for index, point in zip(each.argmin(axis=0), points, strict=True)
        ]
    )
    np.testing.assert_allclose(union.nearest(points), closest, rtol=0, atol=1e-14)
    placed, moved = union.placed(TURN, SHIFT), TURN.apply(points) + SHIFT
    np.testing.assert_allclose(placed.distances(moved), union.distances(points), rtol=0, atol=1e-13)
    np.testing.assert_allclose(
        placed.nearest(moved), TURN.apply(closest) + SHIFT, rtol=0, atol=1e-13
    )


def test_a_grown_box_is_a_box_with_round_edges() -> None:
    box, radius = surfaces.Box(CENTER, (0.5, 0.3, 0.2)), 0.05
    grown = surfaces.Offset(box.placed(TURN, SHIFT), radius)
    corner = CENTER + [0.5, 0.3, 0.2]
    outward = np.abs(DIRECTIONS)
    points = TURN.apply(corner + radius * outward) + SHIFT
    np.testing.assert_allclose(grown.levels(points), 0, atol=1e-15)
    np.testing.assert_allclose(grown.normal(points), TURN.apply(outward), rtol=0, atol=1e-13)
    np.testing.assert_allclose(
        grown.foot(points),
        np.broadcast_to(TURN.apply(corner) + SHIFT, points.shape),
        rtol=0,
        atol=1e-14,
    )
    np.testing.assert_allclose(grown.nearest(points), points, rtol=0, atol=1e-15)


def test_growing_twice_is_growing_by_the_sum() -> None:
    once = surfaces.Offset(SMOOTH["ellipsoid"], 0.05)
    points = CENTER + 0.7 * DIRECTIONS
    np.testing.assert_allclose(
        surfaces.Offset(once, 0.02).levels(points),
        SMOOTH["ellipsoid"].distances(points) - 0.07,
        rtol=0,
        atol=1e-15,
    )


BAD: dict[str, tuple[Callable[[], object], str]] = {
    "no parts": (
        lambda: surfaces.Union([]),
        "parts = []; allowed is a list of at least one surface",
    ),
    "a part alone": (
        lambda: surfaces.Union(surfaces.Sphere(CENTER, 1.0)),
        "allowed is a list of at least one surface",
    ),
    "no surface": (
        lambda: surfaces.Union([surfaces.Sphere(CENTER, 1.0), 3]),
        "parts[1] = 3; allowed is a surface",
    ),
    "radius": (
        lambda: surfaces.Offset(surfaces.Sphere(CENTER, 1.0), 0.0),
        "radius = 0.0; allowed is a finite number greater than 0",
    ),
    "nothing to grow": (lambda: surfaces.Offset(None, 0.1), "surface = None; allowed is a surface"),
    "points": (
        lambda: surfaces.Sphere(CENTER, 1.0).nearest([1.0, 2.0]),
        "points has shape (2,); allowed is (…, 3)",
    ),
}


@pytest.mark.usefixtures("no_shape_checks")
@pytest.mark.parametrize("what", BAD)
def test_what_is_wrong_is_named(what: str) -> None:
    build, message = BAD[what]
    with pytest.raises(ValueError, match=re.escape(message)):
        build()
