"""Primitives: exact signed distances, outside and in, with derivatives that exist everywhere."""

import re
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from scipy.spatial.transform import Rotation
from solids import AXIS, CENTER, HALF, MAJOR, MINOR, SOLIDS, L, R, around

from vibrissa import surfaces
from vibrissa.numerics.compiled import compiled

ALL = pytest.mark.parametrize("name", SOLIDS)
POINTS = CENTER + np.random.default_rng(8).uniform(-1.0, 1.0, (4000, 3))


@compiled
def derivatives(
    surface: surfaces.Surface, points: jax.Array
) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
    """Gradients and Hessians as the solver takes them, and Hessians the other way round."""
    gradient = lax.map(jax.grad(surface.level), points)
    return gradient, (
        lax.map(jax.jacfwd(jax.grad(surface.level)), points),
        lax.map(jax.jacrev(jax.jacfwd(surface.level)), points),
    )


@ALL
def test_level_is_the_signed_distance_outside_and_inside(name: str) -> None:
    surface, inside, distance, _ = SOLIDS[name]
    level, within = surface.levels(POINTS), inside(POINTS)
    assert within.sum() > 30
    np.testing.assert_array_equal(level < 0, within)
    # Outlines in steps of at most 8e-5: s²/(8 d) < 5e-8 beyond d = 0.016.
    far = np.abs(level) > 0.016
    np.testing.assert_allclose(np.abs(level[far]), distance(POINTS)[far], rtol=0, atol=5e-8)
    np.testing.assert_allclose(np.abs(level), distance(POINTS), rtol=0, atol=5e-5)
    np.testing.assert_allclose(surface.distances(POINTS), level, rtol=0, atol=1e-15)


@ALL
def test_special_places_lie_on_the_surface(name: str) -> None:
    surface, _, _, places = SOLIDS[name]
    np.testing.assert_allclose(surface.levels(places), 0, atol=2e-16)


@ALL
def test_gradients_have_unit_length_and_lead_to_the_closest_point(name: str) -> None:
    surface = SOLIDS[name].surface
    gradient, _ = derivatives(surface, jnp.array(POINTS))
    np.testing.assert_allclose(np.linalg.norm(gradient, axis=1), 1, rtol=0, atol=1e-13)
    np.testing.assert_allclose(surface.levels(surface.nearest(POINTS)), 0, atol=1e-14)


@ALL
def test_derivatives_are_those_of_finite_differences(name: str) -> None:
    surface = SOLIDS[name].surface
    points, step = POINTS[:400], 1e-5
    # Where the differences are good: not next to an axis or a core, where the closest point changes
    # fast.
    points = points[np.linalg.norm(derivatives(surface, jnp.array(points))[1][0], axis=(1, 2)) < 20]
    assert len(points) > 390
    gradient, hessians = derivatives(surface, jnp.array(points))
    ahead, behind = (
        np.stack([surface.levels(points + sign * step * axis) for axis in np.eye(3)], -1)
        for sign in (1, -1)
    )
    np.testing.assert_allclose(gradient, (ahead - behind) / (2 * step), rtol=0, atol=1e-8)
    ahead, behind = (
        np.stack(
            [derivatives(surface, jnp.array(points + sign * step * axis))[0] for axis in np.eye(3)],
            -1,
        )
        for sign in (1, -1)
    )
    for hessian in hessians:
        np.testing.assert_allclose(hessian, (ahead - behind) / (2 * step), rtol=0, atol=1e-6)


@ALL
def test_no_derivative_is_missing_on_faces_edges_corners_and_axes(name: str) -> None:
    surface, _, _, places = SOLIDS[name]
    axis = CENTER + np.linspace(-1, 1, 9)[:, None] * AXIS
    beside = CENTER + np.linspace(-1, 1, 9)[:, None, None] * np.eye(3)
    nudges = np.concatenate(
        [sign * size * np.eye(3) for size in (1e-9, 1e-16, 1e-300) for sign in (1, -1)]
    )
    points = np.concatenate(
        [
            places,
            (places[:, None] + nudges).reshape(-1, 3),
            axis,
            beside.reshape(-1, 3),
            around(MAJOR, 0),
            CENTER[None],
        ]
    )
    gradient, hessians = derivatives(surface, jnp.array(points))
    assert all(np.all(np.isfinite(part)) for part in (surface.levels(points), gradient, *hessians))
    np.testing.assert_allclose(
        np.linalg.norm(gradient[: len(places)], axis=1), 1, rtol=0, atol=1e-12
    )


def test_on_an_axis_in_front_of_a_flat_end_the_second_derivatives_are_zero() -> None:
    for surface in (
        surfaces.Cylinder(CENTER, AXIS, R, L),
        surfaces.Cone(CENTER, -AXIS, R, L),
        surfaces.Box(CENTER, HALF),
    ):
        direction = np.array([0.0, 0, 1]) if isinstance(surface, surfaces.Box) else AXIS
        points = CENTER + np.array([0.45, 0.6, 2.0])[:, None] * direction
        gradient, hessians = derivatives(surface, jnp.array(points))
        np.testing.assert_allclose(gradient, [direction] * 3, atol=1e-15)
        np.testing.assert_array_equal(hessians, 0)


def test_a_face_is_flat_also_a_rounding_error_away() -> None:
    """Stability is read from second derivatives at contact points that lie on a face but for
    rounding.
    """
    up = np.nextafter(CENTER[2] + HALF[2], 2.0)
    for height in (up, CENTER[2] + HALF[2], up + 1e-15, up + 1e-9):
        _, hessians = derivatives(surfaces.Box(CENTER, HALF), jnp.array([[0.2, -0.1, height]]))
        np.testing.assert_array_equal(hessians, 0)


def test_curvature_of_a_torus() -> None:
    """Principal curvatures 1/r and cos θ/(R + r cos θ)."""
    rim = around(MAJOR + MINOR, 0.0, 1)
    _, (hessian, _) = derivatives(surfaces.Torus(CENTER, AXIS, MAJOR, MINOR), jnp.array(rim))
    np.testing.assert_allclose(
        np.linalg.eigvalsh(hessian[0]), [0, 1 / (MAJOR + MINOR), 1 / MINOR], atol=1e-12
    )


@ALL
def test_distance_does_not_change_when_object_and_points_are_moved(name: str) -> None:
    surface = SOLIDS[name].surface
    turn, shift = Rotation.from_rotvec([0.4, -0.7, 1.1]), np.array([0.3, 0.1, -0.2])
    placed, moved = surface.placed(turn, shift), turn.apply(POINTS) + shift
    np.testing.assert_allclose(
        placed.distances(moved), surface.distances(POINTS), rtol=0, atol=1e-14
    )
    np.testing.assert_allclose(
        placed.nearest(moved), turn.apply(surface.nearest(POINTS)) + shift, rtol=0, atol=1e-13
    )


def test_a_capsule_is_all_that_is_near_a_segment_and_a_short_one_nearly_a_ball() -> None:
    ends = CENTER + np.array([[-L / 2], [L / 2]]) * AXIS
    share = np.clip((POINTS - ends[0]) @ AXIS / L, 0, 1)[:, None]
    expected = np.linalg.norm(POINTS - ends[0] * (1 - share) - ends[1] * share, axis=1) - R
    np.testing.assert_allclose(
        surfaces.Capsule(CENTER, AXIS, R, L).levels(POINTS), expected, rtol=0, atol=1e-15
    )
    ball = surfaces.Sphere(CENTER, R).levels(POINTS)
    np.testing.assert_allclose(
        surfaces.Capsule(CENTER, AXIS, R, 1e-12).levels(POINTS), ball, rtol=0, atol=1e-12
    )


BAD: dict[str, tuple[Callable[[], object], str]] = {
    "half extent": (
        lambda: surfaces.Box(CENTER, (1, 0, 1)),
        "half_extents[1] = 0.0; allowed is a finite number greater than 0",
    ),
    "half extents": (
        lambda: surfaces.Box(CENTER, (1, 1)),
        "half_extents has shape (2,); allowed is (3,)",
    ),
    "center": (
        lambda: surfaces.Box((0, 0, np.nan), HALF),
        "center[2] = nan; allowed are finite numbers",
    ),
    "axis": (
        lambda: surfaces.Cylinder(CENTER, (0, 0, 0), R, L),
        "axis = [0.0, 0.0, 0.0]; allowed is any 3-vector of non-zero",
    ),
    "radius": (
        lambda: surfaces.Cylinder(CENTER, AXIS, -0.1, L),
        "radius = -0.1; allowed is a finite number greater than 0",
    ),
    "length": (
        lambda: surfaces.Capsule(CENTER, AXIS, R, np.inf),
        "length = inf; allowed is a finite number greater than 0",
    ),
    "height": (
        lambda: surfaces.Cone(CENTER, AXIS, R, 0),
        "height = 0; allowed is a finite number greater than 0",
    ),
    "ring": (
        lambda: surfaces.Torus(CENTER, AXIS, 0.2, 0.2),
        "minor_radius = 0.2; allowed is less than major_radius = 0.2",
    ),
}


@pytest.mark.parametrize("what", BAD)
def test_what_is_wrong_is_named(what: str) -> None:
    build, message = BAD[what]
    with pytest.raises(ValueError, match=re.escape(message)):
        build()
