"""Loops over the first rows of a pytree, compiled for few different lengths."""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

Tree = TypeVar("Tree")
Carry = TypeVar("Carry")
Given = TypeVar("Given")
Told = TypeVar("Told")

BUCKET = 512
"""Rows are filled up to multiples of it: a recording has some, and each length is compiled anew."""


def filled(rows: Tree, size: int = BUCKET) -> Tree:
    """With rows of zeros, which loops leave out, up to a multiple of a size."""
    missing = -len(jax.tree.leaves(rows)[0]) % size
    return jax.tree.map(
        lambda part: np.concatenate([part, np.zeros((missing, *part.shape[1:]))]), rows
    )


def scanned(
    one: Callable[[Carry, Given], tuple[Carry, Told]],
    carry: Carry,
    rows: Given,
    count: Any,
    *,
    back: bool = False,
) -> tuple[Carry, Told]:
    """`lax.scan` over the first `count` rows, from the last to the first if `back`."""

    def row(index: Array | int) -> Given:
        return jax.tree.map(
            lambda part: lax.dynamic_index_in_dim(part, index, keepdims=False), rows
        )

    def step(number: Array, state: tuple[Carry, Told]) -> tuple[Carry, Told]:
        index = count - 1 - number if back else number
        after, told = one(state[0], row(index))
        return after, jax.tree.map(
            lambda whole, part: lax.dynamic_update_index_in_dim(whole, part, index, 0),
            state[1],
            told,
        )

    length = len(jax.tree.leaves(rows)[0])
    nothing: Any = jax.tree.map(
        lambda part: jnp.zeros((length, *part.shape), part.dtype),
        jax.eval_shape(one, carry, row(0))[1],
    )
    through: tuple[Carry, Told] = lax.fori_loop(0, count, step, (carry, nothing))
    return through
