"""Rotations inside compiled code; outside it, see `vibrissa.geometry.rotation`."""

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from vibrissa.numerics.lanes import AnyArray
from vibrissa.numerics.vectors import joined


def third_axis(quaternion: Float[Array, "4"]) -> Float[Array, "3"]:
    """World direction of the +z axis of a frame turned by a unit quaternion x, y, z, w."""
    x, y, z, w = quaternion
    return joined(2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z)


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
