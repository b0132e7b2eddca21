"""The random surface against the same model written down anew: covariances by automatic
differentiation, all data in one matrix, truncation by sampling.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import multivariate_normal

import vibrissa.numerics  # noqa: F401, double precision
from vibrissa.shape.kernel import Coordinates, Kernel, Matern, Sum, covariance, variances
from vibrissa.shape.noise import Noise
from vibrissa.shape.posterior import Basis, Data, _root, information, left_out
from vibrissa.shape.prior import _left_out
from vibrissa.shape.sites import Sites

KERNEL = Kernel(Matern(0.7, 1.3), Matern(0.1, 0.4))


def matern(left, right):
    """Of places alone, as the definition has it."""
    squared = jnp.sum((left - right) ** 2)
    far = jnp.sqrt(jnp.where(squared > 0, squared, 1.0))
    total = 0.0
    for part in KERNEL:
        t = jnp.sqrt(5.0) * far / part.length
        value = part.deviation**2 * (1 + t + t**2 / 3) * jnp.exp(-t)
        # To fourth order about zero, where the root has no derivatives.
        flat = part.deviation**2 * (1 - 5 * squared / (6 * part.length**2))
        total = total + jnp.where(squared > 0, value, flat)
    return total


def lifted(point):
    """Places with a direction that turns with them."""
    return jnp.concatenate([point, 0.6 * jnp.sin(point[::-1] + 0.3)])


def jets(function):
    """Value and gradient by both arguments."""

    def block(left, right):
        def row(other):
            value, slope = jax.value_and_grad(function, argnums=1)(other, right)
            return jnp.concatenate([value[None], slope])

        return jnp.concatenate([row(left)[None], jax.jacfwd(row)(left).T])

    return jax.jit(jax.vmap(jax.vmap(block, (None, 0)), (0, None)))


def whole(function, left, right):
    blocks = np.asarray(jets(function)(left, right))
    return blocks.transpose(0, 2, 1, 3).reshape(4 * len(left), -1)


def coordinates(points):
    return Coordinates(
        np.asarray(jax.vmap(lifted)(points)), np.asarray(jax.vmap(jax.jacfwd(lifted))(points))
    )


def test_covariances_are_those_of_the_derivatives():
    rng = np.random.default_rng(0)
    left, right = rng.normal(size=(2, 5, 3))
    wanted = whole(matern, left, right)
    found = covariance(KERNEL, Coordinates.of(left), Coordinates.of(right))
    np.testing.assert_allclose(found, wanted, atol=1e-12)
    wanted = whole(lambda a, b: matern(lifted(a), lifted(b)), left, right)
    found = covariance(KERNEL, coordinates(left), coordinates(right))
    np.testing.assert_allclose(found, wanted, atol=1e-12)
    own = covariance(KERNEL, coordinates(left), coordinates(left)).reshape(5, 4, 5, 4)
    each = np.arange(5)
    np.testing.assert_allclose(variances(KERNEL, coordinates(left)), own[each, :, each], atol=1e-12)


def test_sums_and_their_derivatives():
    rng = np.random.default_rng(1)
    sites, points, weights = (
        rng.normal(size=(6, 3)),
        rng.normal(size=(4, 3)),
        rng.normal(size=(6, 4)),
    )
    total = Sum(KERNEL, Coordinates.of(sites), weights)

    def level(point):
        values = jax.vmap(lambda site: jets_of(point, site))(jnp.asarray(sites))
        return jnp.sum(values * weights)

    def jets_of(point, site):
        value, slope = jax.value_and_grad(matern, argnums=1)(point, site)
        return jnp.concatenate([value[None], slope])

    values, slopes = total.at(Coordinates.of(points))
    np.testing.assert_allclose(values, jax.vmap(level)(points), atol=1e-12)
    np.testing.assert_allclose(slopes, jax.vmap(jax.grad(level))(points), atol=1e-12)
    np.testing.assert_allclose(
        total.curvature(points), jax.vmap(jax.hessian(level))(points), atol=1e-11
    )


@pytest.fixture(scope="module")
def data():
    rng = np.random.default_rng(2)
    point, normal = rng.normal(size=(2, 14, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    root = 0.1 * rng.normal(size=(14, 6, 6))
    sites = Sites(
        point,
        normal,
        root @ np.swapaxes(root, 1, 2),
        np.repeat([0, 1], 7),
        np.arange(14.0),
        np.ones(14, int),
        np.repeat([0, 1], 7),
        np.ones(14),
        np.zeros(14),
    )
    bent = rng.normal(size=(14, 3, 3))
    return sites, Noise.of(sites, bent + np.swapaxes(bent, 1, 2), np.ones(14), 3.0, 2.0)


def test_posterior_is_that_of_all_data_in_one_matrix(data):
    sites, noise = data
    places = coordinates(sites.point)
    target = np.random.default_rng(3).normal(size=(14, 4))
    basis = Basis.of(KERNEL, places)
    found = information(Data.of(basis, places, target), noise).posterior(basis)
    errors = np.zeros((56, 56))
    for rows in noise.groups:
        columns = (4 * rows[:, None] + np.arange(4)).ravel()
        errors[np.ix_(columns, columns)] = noise.among(rows)
    function = lambda a, b: matern(lifted(a), lifted(b))  # noqa: E731
    points = np.random.default_rng(4).normal(size=(60, 3))
    known = whole(function, sites.point, sites.point) + errors
    across = whole(function, points, sites.point)
    mean = (across @ np.linalg.solve(known, target.ravel())).reshape(-1, 4)
    left = np.diag(across @ np.linalg.solve(known, across.T)).reshape(-1, 4)[:, 0]
    total = Sum(KERNEL, basis.sites, found.weights)
    value, slope = total.at(coordinates(points))
    np.testing.assert_allclose(np.column_stack([value, slope]), mean, atol=1e-5)
    # Drawn towards zero by as much as the mean would grow with the variance of the level.
    step = 1e-4
    more, less = (
        factor * across @ np.linalg.solve(factor * (known - errors) + errors, target.ravel())
        for factor in np.exp([step, -step])
    )
    drawn = ((more - less) / (2 * step)).reshape(-1, 4)[:, 0]
    value, _ = Sum(KERNEL, basis.sites, found.drawn).at(coordinates(points))
    np.testing.assert_allclose(value, drawn, atol=1e-5)
    for few in (9, 60):  # fewer places than unknowns, and more
        variance = found.variance(coordinates(points[:few]))
        np.testing.assert_allclose(variance, KERNEL.variance - left[:few], atol=1e-6)
    # The values of a sweep left out are predicted as if it had never been there.
    missed, predicted, own = left_out(found, Data.of(basis, places, target), noise)[0]
    here, there = np.arange(0, 28, 4), np.arange(28, 56)
    gain = np.linalg.solve(known[np.ix_(there, there)], known[np.ix_(there, here)]).T
    np.testing.assert_allclose(
        missed, target.ravel()[here] - gain @ target.ravel()[there], atol=1e-4
    )
    np.testing.assert_allclose(
        predicted + own, known[np.ix_(here, here)] - gain @ known[np.ix_(there, here)], atol=1e-5
    )


def test_a_factor_exists_where_rounding_leaves_less_than_nothing():
    whole = np.diag([1.0, 0.5, -1e-11])
    root = _root(whole.copy(), np.full(3, 1e-12))
    np.testing.assert_allclose(root @ root.T, whole, atol=2e-10)


def test_space_known_to_be_empty_has_the_moments_of_the_truncated_level(data):
    from vibrissa.shape.level import Level
    from vibrissa.shape.prior import Ball
    from vibrissa.shape.swept import _given_outside

    sites, noise = data
    places, ball = Coordinates.of(sites.point), Ball(np.zeros(3), 1.0)
    target = -ball.at(sites.point) + np.column_stack([np.zeros(14), sites.normal])
    basis = Basis.of(KERNEL, places)
    told = information(Data.of(basis, places, target), noise)
    level = Level.of(ball, None, told.posterior(basis), 0.0)
    empty = np.array([[0.3, 0.2, -0.5], [-0.4, 0.6, 0.1]])
    asked = np.concatenate([empty, [[0.1, 0.3, -0.2]]])
    known = basis.values(Coordinates.of(asked))
    left = np.linalg.solve(level.found.root, known)
    both = left.T @ left - known.T @ known + whole(matern, asked, asked)[::4, ::4]
    rng = np.random.default_rng(5)
    drawn = rng.multivariate_normal(level.values(asked), both, size=400_000)
    kept = drawn[(drawn[:, :2] > 0).all(axis=1)]
    assert 0.02 < len(kept) / len(drawn) < 0.9
    narrowed = _given_outside(level, places, target, noise, empty, 14)
    np.testing.assert_allclose(narrowed.values(asked), kept.mean(axis=0), atol=0.02)
    np.testing.assert_allclose(np.sqrt(narrowed.variance(asked)), kept.std(axis=0), rtol=0.06)


def test_each_sweep_is_as_probable_as_given_all_others():
    """Their conditional densities, one by one; of a single sweep, that of all data."""
    rng, count = np.random.default_rng(4), 24
    root = rng.normal(size=(count, count))
    covariance, told = root @ root.T + np.eye(count), rng.normal(size=count)
    rows = rng.permutation(count)
    for ends in ([5, 6, 15], [12], []):
        sweeps, expected = [np.sort(part) for part in np.split(rows, ends)], 0.0
        for here in sweeps:
            others = np.setdiff1d(rows, here)
            among = covariance[np.ix_(others, others)]
            weights = np.linalg.solve(among, covariance[np.ix_(others, here)]).T
            left = covariance[np.ix_(here, here)] - weights @ covariance[np.ix_(others, here)]
            expected -= multivariate_normal(weights @ told[others], left).logpdf(told[here])
        inverse = np.tril(np.linalg.inv(covariance))
        sizes = {len(here) for here in sweeps}
        alike = [np.stack([here for here in sweeps if len(here) == size]) for size in sizes]
        found = _left_out(inverse, np.linalg.solve(covariance, told), alike)
        assert found + count / 2 * np.log(2 * np.pi) == pytest.approx(expected, rel=1e-9)
