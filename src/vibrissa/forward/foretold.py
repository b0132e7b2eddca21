"""What is expected at a lane's next position, from those behind it."""

from functools import partial
from itertools import accumulate
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

from vibrissa.forward.solve import Jacobian, Scalar, Solved

Differences = list[Float[Any, "..."]]
"""Backward differences of a value, from order 0, which is the value itself."""

ORDERS = 8
"""Differences kept: trails with steps of 0.01 L then need about one Newton step per position."""
QUADRATIC = 2
"""Order to which a contact is extrapolated without checking how well that did before."""
_BETTER = 2.0
"""Factor by which a higher order has to do better: after a kink all orders do equally badly, and
the highest overshoots most.
"""
_STRIDE, _KNOWN = 3, 3
"""Positions from one at which slopes are looked at to the next, and differences of them kept."""
_FORETOLD = 1e-3
"""Error of foretold slopes, as a part of the largest, up to which they serve for the positions
between too: there, off by half of that at most, they gain three digits, as a rougher rod's own do.
"""
_FALLEN = 0.5
"""What part of its last value the determinant must keep: by proportion, its zero lies beyond the
next of these positions.
"""


def with_value(differences: Differences, value: Array, age: Array) -> Differences:
    """Differences for the next value; those of an order that its age does not reach are zero."""
    foretold = enumerate(accumulate(differences[:-1]))
    return [value, *(jnp.where(age > order, value - at, 0.0) for order, at in foretold)]


def best_of(differences: Differences, age: Array) -> Float[Array, "..."]:
    """The next value, extrapolated to the order that would have foretold the last one best: its
    error there is the difference of the next.
    """
    foretold = list(accumulate(differences))
    expected, least = foretold[QUADRATIC], jnp.asarray(jnp.inf)
    for order in range(QUADRATIC, ORDERS - 1):
        missed = _BETTER * jnp.sqrt(jnp.sum(differences[order + 1] ** 2))
        better = (age > order) & (missed < least)
        expected = jnp.where(better, foretold[order], expected)
        least = jnp.where(better, missed / _BETTER, least)
    return expected


class Slopes(NamedTuple):
    """Slopes that were looked at every third position since a contact began."""

    differences: Differences
    determinant: Scalar
    serve: Bool[Any, ""]
    """Whether they foretold the last of them well."""

    @classmethod
    def none(cls, unknowns: int) -> "Slopes":
        """Before any."""
        blank = np.zeros((unknowns, unknowns))
        return cls([blank] * _KNOWN, np.full((), np.nan), np.zeros((), dtype=bool))

    def _ahead(self, strides: Any) -> Jacobian:
        value, first, second = self.differences
        foretold: Jacobian = value + strides * (first + (strides + 1) / 2 * second)
        return foretold

    def at(self, age: Array) -> Jacobian:
        """At a position of a given age, NaN where they are to be looked at."""
        since = (age - 1) % _STRIDE
        return jnp.where(self.serve & (since > 0), self._ahead(since / _STRIDE), jnp.nan)

    def after(self, age: Array, found: Solved) -> "Slopes":
        """With those found at a position, if it is its turn."""
        new = found.jacobian
        off = jnp.max(jnp.abs(new - self._ahead(1.0))) / jnp.max(jnp.abs(new))
        serve = (off < _FORETOLD) & (found.figure / self.determinant > _FALLEN)
        changed = Slopes(
            with_value(self.differences, new, (age - 1) // _STRIDE), found.figure, serve
        )
        kept = self._replace(serve=self.serve & (age > 0))
        turn = (age - 1) % _STRIDE == 0
        return jax.tree.map(partial(jnp.where, turn), changed, kept)
