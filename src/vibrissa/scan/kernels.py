"""Blocks of lanes: how many scans share one compiled loop.

Inside a kernel the last axis is the lane, one trail or one position each, so that every operation is plain vector arithmetic. A block of 64 lanes keeps
its intermediates in the core's nearest cache. Array sizes are rounded up, so that a new number of trails or positions seldom compiles anew.
"""

import numpy as np
from jaxtyping import Float, Shaped

WIDE = 64
NARROW = 8


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
    return np.ascontiguousarray(np.moveaxis(filled.reshape(blocks, lanes, *rows.shape[1:]), 1, -1))


def from_blocks(blocks: Shaped[np.ndarray, "blocks ... width"], count: int) -> Shaped[np.ndarray, "lanes ..."]:
    """Undo `to_blocks`, without the filling."""
    rows = np.moveaxis(blocks, -1, 1)
    return rows.reshape(-1, *rows.shape[2:])[:count]


def norm(vector: Float[np.ndarray, "*batch n"]) -> Float[np.ndarray, "*batch"]:
    """Euclidean norm over the last axis."""
    return np.sqrt(np.einsum("...i,...i->...", vector, vector))
