"""Sine and cosine as polynomials, against the C library's."""

import jax.numpy as jnp
import numpy as np

from vibrissa.numerics.trigonometry import cosine, sine

ANGLES = np.concatenate([np.linspace(0, np.pi, 10_001), [1e-300, 1e-17, 1e-9, np.pi - 1e-9]])


def test_sine_and_cosine_are_exact_to_rounding_on_half_a_turn() -> None:
    np.testing.assert_allclose(
        np.asarray(sine(jnp.asarray(ANGLES))), np.sin(ANGLES), rtol=0, atol=4e-16
    )
    np.testing.assert_allclose(
        np.asarray(cosine(jnp.asarray(ANGLES))), np.cos(ANGLES), rtol=0, atol=4e-16
    )
