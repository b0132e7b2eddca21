"""Vectors in kernels, as sums and choices along an axis, which compile to plain loops over lanes.

`jnp.dot`, `jnp.stack` and `jnp.concatenate` of many lanes become matrix products of 3×3 and
transpositions: a step of Newton's method then takes twice as long.
"""

from functools import reduce

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from vibrissa.numerics.lanes import AnyArray


def dot(a: Float[AnyArray, "*n k"], b: Float[AnyArray, "*m k"]) -> Float[Array, "..."]:
    """Scalar product along the last axis."""
    return jnp.sum(a * b, axis=-1)


def joined(*parts: Float[AnyArray, "..."]) -> Float[Array, "k"]:
    """The vector of some scalars and vectors, one behind the other."""
    scalars = [scalar for part in parts for scalar in (part if jnp.ndim(part) else [part])]
    places = np.arange(len(scalars))
    return reduce(
        lambda later, at: jnp.where(places == at, scalars[at], later), places[-2::-1], scalars[-1]
    )
