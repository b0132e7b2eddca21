"""Rotations inside compiled code; outside it, see `vibrissa.geometry.rotation`."""

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from vibrissa.numerics.lanes import AnyArray
from vibrissa.numerics.vectors import joined

_SMALL = 1e-8
"""Square of an angle below which sine and cosine are taken from their series, to rounding."""


def third_axis(quaternion: Float[Array, "4"]) -> Float[Array, "3"]:
    """World direction of the +z axis of a frame turned by a unit quaternion x, y, z, w."""
    x, y, z, w = quaternion
    return joined(2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z)


def first_axis(quaternion: Float[Array, "4"]) -> Float[Array, "3"]:
    """World direction of its +x axis."""
    x, y, z, w = quaternion
    return joined(w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y))


def turned(angle: Float[Array, "3"], vector: Float[Array, "3"]) -> Float[Array, "3"]:
    """A vector turned by a rotation vector [rad], also by a vanishing one."""
    square = jnp.sum(angle * angle)
    small = square < _SMALL
    size = jnp.sqrt(jnp.where(small, 1.0, square))
    sine = jnp.where(small, 1 - square / 6, jnp.sin(size) / size)
    half = jnp.where(small, 0.5 - square / 24, (1 - jnp.cos(size)) / size**2)
    across = jnp.cross(angle, vector)
    return vector + sine * across + half * jnp.cross(angle, across)


def cross_matrix(vector: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """[v]× with [v]× u = v × u."""
    x, y, z = vector
    zero = jnp.zeros_like(x)
    return jnp.stack([jnp.stack([zero, -z, y]), jnp.stack([z, zero, -x]), jnp.stack([-y, x, zero])])


def rotation_matrix(quaternion: Float[AnyArray, "4"]) -> Float[Array, "3 3"]:
    """Of a quaternion x, y, z, w of any norm."""
    x, y, z, w = quaternion / jnp.sqrt(jnp.sum(quaternion**2))
    across = cross_matrix(joined(x, y, z))
    return jnp.eye(3) + 2 * w * across + 2 * across @ across
