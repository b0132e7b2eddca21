"""Vector operations in kernels, as sums and selections along an axis, which compile to plain loops
over lanes.

Over many lanes, `jnp.dot`, `jnp.stack` and `jnp.concatenate` become 3×3 matrix products and
transpositions: a Newton step then takes twice as long.
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
    """Scalars and vectors joined into one vector."""
    scalars = [scalar for part in parts for scalar in (part if jnp.ndim(part) else [part])]
    places = np.arange(len(scalars))
    return reduce(
        lambda later, at: jnp.where(places == at, scalars[at], later), places[-2::-1], scalars[-1]
    )
