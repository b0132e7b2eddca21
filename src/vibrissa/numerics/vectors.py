"""Vector operations in kernels, as sums along an axis, which compile to plain loops over lanes:
`jnp.dot` becomes a matrix product for each of many lanes.
"""

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from vibrissa.numerics.lanes import AnyArray


def dot(a: Float[AnyArray, "*n k"], b: Float[AnyArray, "*m k"]) -> Float[Array, "..."]:
    """Scalar product along the last axis."""
    return jnp.sum(a * b, axis=-1)


def joined(*parts: Float[AnyArray, "..."]) -> Float[Array, "k"]:
    """Scalars and vectors joined into one vector."""
    return jnp.concatenate([jnp.atleast_1d(part) for part in parts])
