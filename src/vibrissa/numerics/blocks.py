"""Blocks of lanes: how many trails or samples share one compiled loop.

Inside a kernel the last axis is the lane, one trail or one position each, so that every operation
is plain vector arithmetic. A block of 64 lanes keeps its intermediates in the core's nearest cache.
Kernels are called with few different numbers of blocks, since each compiles anew.
"""

from collections.abc import Callable, Iterator

import numpy as np
from jax import Array
from jaxtyping import Float, Shaped

AnyArray = Array | np.ndarray

WIDE = 64
SIZES = (1, 16, 1024)
"""Numbers of blocks for which kernels are compiled."""
ONE_BY_ONE = (1,)
"""The same for kernels that take long to compile and longer to run than a call costs."""


def rounded_up(count: int) -> int:
    """Next power of two, at least 256: the capacity of an array whose filled length varies."""
    return max(256, 1 << (count - 1).bit_length())


def runs(count: int, width: int, sizes: tuple[int, ...] = SIZES) -> Iterator[tuple[int, int, int]]:
    """Divide rows into calls of a kernel: first row, last row + 1, and number of blocks."""
    first = 0
    while first < count:
        left = -(-(count - first) // width)
        # The smallest that holds the rest; the next smaller one again and again where that would
        # mostly be filling.
        blocks = next((size for size in sizes if size >= left), sizes[-1])
        smaller = [size for size in sizes if size < blocks]
        if smaller and left < blocks / 4:
            blocks = smaller[-1]
        last = min(count, first + blocks * width)
        yield first, last, blocks
        first = last


def to_blocks(
    rows: Shaped[np.ndarray, "lanes ..."], lanes: int, blocks: int
) -> Shaped[np.ndarray, "blocks ... width"]:
    """Rows (lanes, …) as blocks (blocks, …, width); the last row fills up the last block."""
    missing = lanes * blocks - len(rows)
    filled = np.concatenate([rows, np.repeat(rows[-1:], missing, axis=0)]) if missing else rows
    split = filled.reshape(blocks, lanes, *rows.shape[1:])
    return np.ascontiguousarray(split.transpose(0, *range(2, split.ndim), 1))


def from_blocks(
    blocks: Shaped[np.ndarray, "blocks ... width"], count: int
) -> Shaped[np.ndarray, "lanes ..."]:
    """Undo `to_blocks`, without the filling. In memory the lanes stay innermost: each column of the
    result is contiguous.
    """
    columns = np.moveaxis(blocks, 0, -2)
    return np.moveaxis(columns.reshape(*columns.shape[:-2], -1)[..., :count], -1, 0)


def in_blocks(
    kernel: Callable[..., Array],
    *rows: Shaped[np.ndarray, "count ..."],
    width: int = WIDE,
    sizes: tuple[int, ...] = SIZES,
) -> Float[np.ndarray, "count ..."]:
    """Apply a compiled kernel of blocks (blocks, …, width) to rows (count, …)."""
    count = len(rows[0])
    out: np.ndarray | None = None
    for first, last, blocks in runs(count, width, sizes):
        part = from_blocks(
            np.asarray(kernel(*(to_blocks(part[first:last], width, blocks) for part in rows))),
            last - first,
        )
        if first == 0 and last == count:
            return part
        out = np.moveaxis(np.empty((*part.shape[1:], count)), -1, 0) if out is None else out
        out[first:last] = part
    if out is None:
        raise ValueError("rows = 0; allowed is at least one row")
    return out


def single(
    kernel: Callable[..., Array], *rows: Shaped[np.ndarray, "1 ..."]
) -> Float[np.ndarray, "1 ..."]:
    """The same for one row, in a block of one lane: the quickest answer to one question."""
    return np.asarray(kernel(*(part.reshape(1, *part.shape[1:], 1) for part in rows)))[..., 0]
