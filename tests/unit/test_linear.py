"""The unrolled 4×4 solver against LAPACK."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from vibrissa.numerics.linear import solve_4x4

solve = jax.jit(jax.vmap(solve_4x4))


def test_random_systems_agree_with_numpy() -> None:
    rng = np.random.default_rng(4)
    matrix, right = rng.normal(size=(500, 4, 4)), rng.normal(size=(500, 4))
    x, determinant = solve(jnp.asarray(matrix), jnp.asarray(right))
    condition = np.linalg.cond(matrix)
    exact = np.linalg.solve(matrix, right[..., None])[..., 0]
    error = np.linalg.norm(x - exact, axis=1) / np.linalg.norm(exact, axis=1)
    assert np.all(error < 1e-14 + 1e-15 * condition**2)
    np.testing.assert_allclose(determinant, np.linalg.det(matrix), rtol=0, atol=1e-13)


@pytest.mark.parametrize("order", [(1, 0, 2, 3), (3, 2, 1, 0), (0, 2, 3, 1)])
def test_permutations_are_undone_and_signed(order: tuple[int, ...]) -> None:
    matrix = np.eye(4)[list(order)]
    x, determinant = solve_4x4(jnp.asarray(matrix), jnp.arange(4.0))
    np.testing.assert_allclose(x, matrix.T @ np.arange(4.0), atol=1e-15)
    assert float(determinant) == np.linalg.det(matrix)


def test_a_singular_matrix_has_no_finite_solution() -> None:
    matrix = np.ones((4, 4))
    x, determinant = solve_4x4(jnp.asarray(matrix), jnp.arange(4.0))
    assert float(determinant) == 0
    assert not np.any(np.isfinite(x))


def test_newton_converges_with_it_on_an_ill_conditioned_system() -> None:
    """One step with the residual computed anew makes good what the cofactors lose."""
    rng = np.random.default_rng(7)
    left, right = (np.linalg.qr(rng.normal(size=(4, 4)))[0] for _ in range(2))
    matrix, exact = left @ np.diag([1, 1e-2, 1e-3, 1e-5]) @ right, rng.normal(size=4)
    x = np.zeros(4)
    for _ in range(3):
        x = x - np.asarray(solve_4x4(jnp.asarray(matrix), jnp.asarray(matrix @ (x - exact)))[0])
    np.testing.assert_allclose(x, exact, rtol=0, atol=1e-11)
