"""A function of one row, applied to many: pytrees in, pytrees out.

Inside a kernel the last axis is the lane (`vibrissa.numerics.trailing`), one trail or one sample
each, so that every operation is plain vector arithmetic; a block of 64 lanes keeps its
intermediates in the core's nearest cache. A kernel takes a fixed number of blocks, so that it is
compiled once for any number of rows. Many rows are distributed over threads; `VIBRISSA_THREADS=1`
uses only one.

A few rows are quicker one after another, and so is any number where each goes its own way through
much code: side by side every lane waits for the others, and code for lanes takes twice as long to
compile. Shared arguments can say so by a property `branching`, and by `lane_width` how many lanes
side by side their code is worth. Large code takes several times as long to compile within the loop
over rows as without: where a function asks for it, and shared arguments have a property `bulky`,
each row is a call.
"""

import math
import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cached_property, partial
from typing import Any, Generic, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from vibrissa.numerics.kernel import Kernel, quietly
from vibrissa.numerics.trailing import trailing

Shared = TypeVar("Shared")
Row = TypeVar("Row")
Part = TypeVar("Part")
Found = TypeVar("Found")

AnyArray: TypeAlias = Any
"""A JAX array in a kernel, a NumPy array outside."""
WIDTH = 64
BLOCKS = 16
"""Blocks per call: 1024 rows, which take far longer than the call itself."""
FEW = 512
"""Up to this many rows, as of one trail, take less time one by one than lanes take to compile."""

_within = threading.local()


def threads() -> int:
    """How many threads share the work: `VIBRISSA_THREADS`, else the cores that the process may use;
    one within such a thread.
    """
    if getattr(_within, "thread", False):
        return 1
    wanted = os.environ.get("VIBRISSA_THREADS", "")
    if wanted:
        return max(1, int(wanted))
    usable = getattr(os, "sched_getaffinity", None)
    return len(usable(0)) if usable else os.cpu_count() or 1


def _enter() -> None:
    _within.thread = True


def in_threads(function: Callable[[Part], Found], parts: Sequence[Part]) -> list[Found]:
    """Apply the function to each part on all cores; results are in order."""
    count = min(threads(), len(parts))
    if count <= 1:
        return [function(part) for part in parts]
    with ThreadPoolExecutor(count, initializer=_enter) as pool:
        return list(pool.map(function, parts))


class Lanes(Generic[Shared, Row]):
    """A function of shared arguments and of one row's arguments, applied to many rows.

    Called with the shared arguments and trees of arrays (rows, …), it returns a tree of NumPy
    arrays (rows, …).
    """

    def __init__(
        self,
        one: Callable[..., Row],
        *,
        width: int = WIDTH,
        blocks: int = BLOCKS,
        alone: int = 0,
        by_call: bool = False,
        walks: bool = False,
    ) -> None:
        self._told_by = "walk_width" if walks else "lane_width"
        self._by_call = by_call
        self._one, self._width, self._blocks = one, width, blocks
        self._alone = alone
        self._begun: set[object] = set()
        self._shapes: dict[object, Any] = {}
        self._of_structure: dict[object, Callable[..., Any]] = {}
        self._found: dict[object, Any] = {}
        """Empty results (0, …), of the shapes and types that a call of one row has."""
        self._of_width: dict[int, Callable[..., Any]] = {}

    def __call__(self, shared: Shared, *rows: Any) -> Row:
        """Apply the function to all rows."""
        count = len(jax.tree.leaves(rows)[0])
        if count == 0:
            return self._nothing(shared, rows)
        if self._by_call and any(_told(shared, "bulky")):
            return self._called(shared, rows, count)
        kernel, width, size = self._kernel(shared, count)

        def call(first: int) -> Row:
            last = min(first + size, count)
            part = jax.tree.map(lambda leaf: _filled(leaf[first:last], size), rows)
            used = np.asarray(-(-(last - first) // width))
            found = kernel(shared, used, part)
            return jax.tree.map(lambda leaf: np.asarray(leaf)[..., : last - first], found)

        found = in_threads(call, range(0, count, size))
        # Lanes stay innermost in memory: the results are views.
        return jax.tree.map(lambda *parts: _lanes_first(np.concatenate(parts, axis=-1)), *found)

    def _called(self, shared: Shared, rows: Any, count: int) -> Row:
        shared, found = jax.tree.map(jnp.asarray, shared), list[Array]()
        for first in range(0, count, FEW):
            last = min(first + FEW, count)
            some = jax.tree.map(lambda leaf, rows=slice(first, last): leaf[rows], rows)
            # A fixed number of rows, so that it is compiled once.
            part = jax.tree.map(lambda leaf: jnp.asarray(_filled(leaf, FEW)), some)
            # A list in and a row of numbers out: handling trees takes as long as many rows do.
            leaves, structure = jax.tree.flatten((shared, part))
            call = self._single(structure)
            found.append(call(leaves, 0))
            found += in_threads(partial(call, leaves), range(1, last - first))
        return _divided(np.stack(found), self._found[_shaped(structure, leaves)])

    def ahead(self, shared: Shared, *rows: Any) -> None:
        """Compile in a separate thread what a call with such rows will need: XLA leaves the other
        cores free for other work.
        """
        kernel, *_ = self._kernel(shared, len(jax.tree.leaves(rows)[0]))
        known = (kernel, jax.tree.structure((shared, rows)))
        if known not in self._begun and threads() > 1:
            self._begun.add(known)
            threading.Thread(target=self._quietly, args=(shared, *rows)).start()

    def _quietly(self, *arguments: Any) -> None:
        """Call; whatever fails will fail again where the result is wanted."""
        with quietly(), suppress(Exception):
            self(*arguments)

    def _kernel(self, shared: Shared, count: int) -> tuple[Callable[..., Any], int, int]:
        """The kernel for so many rows, how many it takes side by side, and how many in one call."""
        if count <= self._alone or self._width == 1 or _branching(shared):
            return self._one_by_one, 1, self._size_alone
        width = min([self._width, *_told(shared, self._told_by)])
        if width == 1:
            return self._one_by_one, 1, self._size_alone
        return self._side_by_side(width), width, width * self._blocks

    def _nothing(self, shared: Shared, rows: Any) -> Row:
        one = jax.tree.map(lambda leaf: np.empty(leaf.shape[1:], leaf.dtype), rows)
        leaves, structure = jax.tree.flatten((one, shared))
        known = structure, *((np.shape(leaf), getattr(leaf, "dtype", float)) for leaf in leaves)
        if known not in self._shapes:
            self._shapes[known] = jax.eval_shape(self._one, shared, *one)
        return jax.tree.map(
            lambda shape: np.zeros((0, *shape.shape), shape.dtype), self._shapes[known]
        )

    @property
    def _size_alone(self) -> int:
        return self._alone or self._width * self._blocks

    @cached_property
    def _one_by_one(self) -> Callable[..., Any]:
        """The kernel for a few rows, or for a branching function."""

        def one(shared: Shared, *row: Any) -> Any:
            only = jax.tree.map(lambda leaf: leaf[..., 0], row)
            return jax.tree.map(lambda leaf: leaf[..., None], self._one(shared, *only))

        return self._compiled(one, 1, self._size_alone)

    def _single(self, structure: Any) -> Callable[..., Any]:
        """The function of one of several rows, which are given with what they share as the leaves
        of a tree.
        """

        def single(leaves: list[Array], index: Array | int) -> Array:
            shared, rows = jax.tree.unflatten(structure, leaves)
            found = self._one(shared, *jax.tree.map(lambda leaf: leaf[index], rows))
            self._found[_shaped(structure, leaves)] = jax.tree.map(
                lambda part: np.empty((0, *part.shape), part.dtype), found
            )
            return jnp.concatenate([jnp.ravel(part) * 1.0 for part in jax.tree.leaves(found)])

        if structure not in self._of_structure:
            single.__name__ = self._one.__name__
            self._of_structure[structure] = Kernel(single, alone=True)
        return self._of_structure[structure]

    def _side_by_side(self, width: int) -> Callable[..., Any]:
        if width not in self._of_width:
            self._of_width[width] = self._blocked(width)
        return self._of_width[width]

    def _blocked(self, width: int) -> Callable[..., Any]:
        return self._compiled(trailing(self._one, width), width, self._blocks)

    def _compiled(
        self, of_block: Callable[..., Any], width: int, blocks: int
    ) -> Callable[..., Any]:
        def kernel(shared: Shared, used: Array, rows: Any) -> Any:
            """Of the first `used` blocks."""
            # Traced once, for its shapes and for its loop.
            traced = jax.jit(of_block)

            def of(index: Array | int) -> Any:
                part = jax.tree.map(
                    lambda leaf: lax.dynamic_slice_in_dim(leaf, index * width, width), rows
                )
                return traced(shared, *jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1), part))

            def put(whole: Array, part: Array, index: Array) -> Array:
                return lax.dynamic_update_slice_in_dim(whole, part, index * width, whole.ndim - 1)

            shapes = jax.eval_shape(of, 0)
            nothing = jax.tree.map(
                lambda leaf: jnp.zeros((*leaf.shape[:-1], blocks * width), leaf.dtype), shapes
            )
            return lax.fori_loop(
                0,
                used,
                lambda index, found: jax.tree.map(partial(put, index=index), found, of(index)),
                nothing,
            )

        # The name that profiles and compilation logs show.
        kernel.__name__ = self._one.__name__
        return Kernel(kernel, alone=width == 1)


def lanes(
    *,
    width: int = WIDTH,
    blocks: int = BLOCKS,
    alone: int = 0,
    by_call: bool = False,
    walks: bool = False,
) -> Callable[[Callable[..., Row]], Lanes[Any, Row]]:
    """Turn a function of (shared, *row) into one of (shared, *rows).

    Parameters
    ----------
    width, blocks
        Lanes per block, and blocks per call; a width of 1 takes rows one after another.
    alone
        Up to this many rows are taken one after another, by a scalar kernel.
    by_call
        Whether rows are called one by one where shared arguments are `bulky`.
    walks
        Whether rows iterate, each in its own way, or need derivatives: shared arguments say by
        `walk_width`, not `lane_width`, how many of them side by side are worth it.
    """
    return lambda one: Lanes(
        one, width=width, blocks=blocks, alone=alone, by_call=by_call, walks=walks
    )


def _shaped(structure: Any, leaves: list[Array]) -> object:
    return structure, *(leaf.shape for leaf in leaves)


def _divided(numbers: AnyArray, none: Any) -> Any:
    """Numbers (rows, …) as a tree of arrays (rows, …) like those without rows."""
    leaves, structure = jax.tree.flatten(none)
    ends = np.cumsum([math.prod(leaf.shape[1:]) for leaf in leaves])
    parts = [
        part.reshape(-1, *leaf.shape[1:]).astype(leaf.dtype)
        for part, leaf in zip(np.split(numbers, ends[:-1], axis=1), leaves, strict=True)
    ]
    return jax.tree.unflatten(structure, parts)


def _branching(shared: Any) -> bool:
    return any(_told(shared, "branching"))


def _told(shared: Any, name: str) -> list[Any]:
    """What shared arguments say about how to run them."""

    def tells(part: object) -> bool:
        return hasattr(part, name)

    parts = jax.tree.leaves(shared, is_leaf=tells)
    return [getattr(part, name) for part in parts if tells(part)]


def _lanes_first(rows: np.ndarray) -> np.ndarray:
    return rows.transpose(rows.ndim - 1, *range(rows.ndim - 1))


def _filled(rows: AnyArray, size: int) -> AnyArray:
    """Rows padded to a number by repeating the last one."""
    count = len(rows)
    if count == size:
        return rows
    whole = np.empty((size, *rows.shape[1:]), rows.dtype)
    whole[:count], whole[count:] = rows, rows[-1]
    return whole
