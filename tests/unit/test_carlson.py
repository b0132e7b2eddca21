"""Carlson's integrals against mpmath and SciPy."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from scipy.special import elliprd, elliprf

from vibrissa.numerics.carlson import carlson_rf_rd

carlson = jax.jit(carlson_rf_rd)


def grid(low: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    values = np.geomspace(low, 1.1, count)
    x, y = np.meshgrid(values, values)
    return x.ravel(), y.ravel()


def relative(found: np.ndarray, exact: list[mpmath.mpf]) -> float:
    return max(
        abs(float(mpmath.mpf(float(value)) / reference - 1))
        for value, reference in zip(found, exact, strict=True)
    )


@pytest.mark.parametrize(("low", "tolerance"), [(0.2, 1e-15), (0.02, 1e-12)])
def test_agree_with_mpmath_to_the_stated_error(low: float, tolerance: float) -> None:
    x, y = grid(low, 9)
    rf, rd_z, rd_y = (np.asarray(part) for part in carlson(jnp.asarray(x), jnp.asarray(y)))
    with mpmath.workdps(40):
        pairs = [(mpmath.mpf(float(a)), mpmath.mpf(float(b))) for a, b in zip(x, y, strict=True)]
        assert relative(rf, [mpmath.elliprf(a, b, 1) for a, b in pairs]) < tolerance
        assert relative(rd_z, [mpmath.elliprd(a, b, 1) for a, b in pairs]) < tolerance
        assert relative(rd_y, [mpmath.elliprd(a, 1, b) for a, b in pairs]) < tolerance


def test_agree_with_scipy_on_many_arguments() -> None:
    x, y = np.random.default_rng(1).uniform(0.1, 1.1, (2, 20_000))
    rf, rd_z, rd_y = carlson(jnp.asarray(x), jnp.asarray(y))
    np.testing.assert_allclose(rf, elliprf(x, y, 1), rtol=3e-15)
    np.testing.assert_allclose(rd_z, elliprd(x, y, 1), rtol=3e-15)
    np.testing.assert_allclose(rd_y, elliprd(x, 1, y), rtol=3e-15)


def test_equal_arguments_give_elementary_values() -> None:
    """R_F(1, 1, 1) = R_D(1, 1, 1) = 1 (DLMF 19.20)."""
    one = jnp.ones(())
    assert [float(part) for part in carlson(one, one)] == pytest.approx([1, 1, 1], rel=1e-15)
