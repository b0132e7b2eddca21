"""Blocks of lanes: how many trails or samples share one compiled loop.

Inside a kernel the last axis is the lane, one trail or one position each, so that every operation is plain vector arithmetic. A block of 64 lanes keeps
its intermediates in the core's nearest cache. Array sizes are rounded up, so that a new number of trails or positions seldom compiles anew.
"""

from collections.abc import Callable

import numpy as np
from jax import Array
from jaxtyping import Float, Shaped

WIDE = 64
NARROW = 8
# Rows handled by one call of a kernel: what passes through it stays in the cache, and only the last call is filled up.
_LONGEST_RUN = 1 << 16


def lanes_per_block(count: int) -> int:
    """1, 8 or 64 lanes."""
    if count == 1:
        return 1
    return NARROW if count <= NARROW else WIDE


def rounded_up(count: int) -> int:
    """Next power of two, at least 16: the capacity of an array whose filled length varies."""
    return max(16, 1 << (count - 1).bit_length())


def to_blocks(rows: Shaped[np.ndarray, "lanes ..."], lanes: int, blocks: int) -> Shaped[np.ndarray, "blocks ... width"]:
    """Rows (lanes, …) as blocks (blocks, …, width); the last row fills up the last block."""
    missing = lanes * blocks - len(rows)
    filled = np.concatenate([rows, np.repeat(rows[-1:], missing, axis=0)]) if missing else rows
    split = filled.reshape(blocks, lanes, *rows.shape[1:])
    return np.ascontiguousarray(split.transpose(0, *range(2, split.ndim), 1))


def from_blocks(blocks: Shaped[np.ndarray, "blocks ... width"], count: int) -> Shaped[np.ndarray, "lanes ..."]:
    """Undo `to_blocks`, without the filling."""
    rows = blocks.transpose(0, blocks.ndim - 1, *range(1, blocks.ndim - 1))
    return rows.reshape(-1, *rows.shape[2:])[:count]


def in_blocks(kernel: Callable[..., Array], *rows: Shaped[np.ndarray, "count ..."], width: int = WIDE) -> Float[np.ndarray, "count ..."]:
    """Apply a compiled kernel of blocks (blocks, …, width) to rows (count, …)."""
    count = len(rows[0])
    if count == 1:
        return np.asarray(kernel(*(part.reshape(1, *part.shape[1:], 1) for part in rows)))[..., 0]
    if count <= _LONGEST_RUN:
        lanes = width if count > width else lanes_per_block(count)
        blocks = rounded_up(-(-count // lanes)) if count > lanes else 1
        return from_blocks(np.asarray(kernel(*(to_blocks(part, lanes, blocks) for part in rows))), count)
    parts = (in_blocks(kernel, *(part[first : first + _LONGEST_RUN] for part in rows), width=width) for first in range(0, count, _LONGEST_RUN))
    filled, out = 0, None
    for part in parts:
        out = np.empty((count, *part.shape[1:])) if out is None else out
        out[filled : filled + len(part)] = part
        filled += len(part)
    assert out is not None  # noqa: S101
    return out
