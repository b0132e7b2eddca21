"""Rows of trees of arrays (rows, …) in loops, at places that are known not to be negative: for each
that might be, JAX would add as much code as the row takes itself.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import lax


def row_of(whole: Any, place: Any) -> Any:
    """The row (…) at a place."""
    return jax.tree.map(
        lambda rows: lax.dynamic_index_in_dim(
            rows, place, keepdims=False, allow_negative_indices=False
        ),
        whole,
    )


def rows_from(whole: Any, place: Any, count: int) -> Any:
    """So many rows from a place on."""
    return jax.tree.map(
        lambda rows: lax.dynamic_slice_in_dim(
            jnp.asarray(rows), place, count, allow_negative_indices=False
        ),
        whole,
    )


def with_row(whole: Any, row: Any, place: Any) -> Any:
    """With another row at a place."""
    # An update, not the scatter that `at[place].set` would be.
    return jax.tree.map(
        lambda rows, own: lax.dynamic_update_index_in_dim(
            rows, own, place, 0, allow_negative_indices=False
        ),
        whole,
        row,
    )
