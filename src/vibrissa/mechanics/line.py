"""A bent rod as a line through the states where its steps begin and end."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Bool, Float, Int

from vibrissa.numerics.rows import row_of, rows_from
from vibrissa.numerics.vectors import dot

Scalar = Float[Any, ""]
Vector = Float[Any, "3"]

_CLOSEST_STEPS = 4
"""Newton steps along the rod, from within a step of it: they converge quadratically."""
_FARTHEST = 4.0
"""Arc length [L] up to which the straight continuation is searched: noise puts contacts there."""
_TINY = 1e-300


def _quintic() -> Float[np.ndarray, "3 6 6"]:
    """By which powers of the place in a step give the weights of both ends' values, slopes and
    bends in a quintic, in its slope and in its bend.
    """
    slope = np.diag(np.arange(1.0, 6.0), -1)
    orders = [np.linalg.matrix_power(slope, order) for order in range(3)]
    ends = [order @ powers for order in orders for powers in (np.eye(6)[0], np.ones(6))]
    weights = np.linalg.inv(ends).T
    # Multiples of a half.
    return np.stack([np.round(2 * weights) / 2 @ order for order in orders])


_QUINTIC = _quintic()


class State(NamedTuple):
    """A rod at an arc length, or rates along it; reach and tangent come first."""

    reach: Vector
    """From the clamp point."""
    tangent: Vector
    energy: Scalar
    across: Any = None
    """d₁ (3,), where the rest shape needs it."""
    load: Any = None
    """Q and M (6,), where there are loads."""
    sunk: Any = None
    """Potential of those loads, −∫ q·r ds = −Q·r − ∫ Q·t ds, without the first term."""


class Line(NamedTuple):
    """A bent rod at nodes from clamp to tip, and how it goes on between them."""

    nodes: Float[Array, "nodes"]
    """Arc lengths [L]."""
    states: State
    """At the nodes (nodes, …)."""
    rates: State
    """Their derivatives along the rod."""
    error: Float[Array, "nodes"]
    """Estimated error of reach and tangent, added up from the line's first node."""

    @property
    def reach(self) -> Float[Array, "nodes 3"]:
        """From the clamp point [L]."""
        return self.states.reach

    @property
    def tangent(self) -> Float[Array, "nodes 3"]:
        """Unit tangents."""
        return self.states.tangent

    def curve(self, s: Scalar) -> tuple[Vector, Vector, Vector]:
        """Point, tangent and its slope t' [1/L] at an arc length: quintic between nodes, straight
        beyond the tip.
        """
        *begun, second = self._quintic(s, 3)
        _, step, _ = self.between(s)
        return *_onward(s, *begun), jnp.where(s > 1, 0.0, second / step**2)

    def at(self, s: Scalar) -> tuple[Vector, Vector]:
        """Point and tangent at an arc length."""
        return _onward(s, *self._quintic(s, 2))

    def _quintic(self, s: Scalar, orders: int) -> Float[Array, "orders 3"]:
        """Value, slope and bend in a step, or the first of them."""
        place, step, x = self.between(s)
        known = self.states.reach, self.states.tangent, self.rates.tangent
        reach, tangent, bend = rows_from(known, place, 2)
        ends = jnp.concatenate([reach, step * tangent, step**2 * bend])
        x2, x3 = x * x, x * x * x
        powers = jnp.stack([jnp.ones_like(x), x, x2, x3, x2 * x2, x2 * x3])
        weights = jnp.sum(_QUINTIC[:orders] * powers, axis=2)
        return jnp.sum(weights[:, :, None] * ends, axis=1)

    def along(self, here: State, s: Scalar, step: Scalar) -> State:
        """The state a tiny step further, given at an arc length."""
        place, _, x = self.between(s)
        behind, ahead = (row_of(self.rates, node) for node in (place, place + 1))
        rates = jax.tree.map(lambda one, other: one + x * (other - one), behind, ahead)
        rates = rates._replace(reach=here.tangent, tangent=self.curve(s)[2])
        return jax.tree.map(lambda at, rate: at + step * rate, here, rates)

    def carried(self, there: State, here: State) -> "Line":
        """The line as a rigid body, moved from a state of it to another."""
        axes = zip(axes_of(there), axes_of(here), strict=True)
        turn = sum(before[:, None] * after for before, after in axes)

        def turned(rows: Any) -> Any:
            return None if rows is None else jnp.einsum("ni,ij->nj", rows, turn)

        def moved(rows: State) -> State:
            return rows._replace(
                reach=turned(rows.reach), tangent=turned(rows.tangent), across=turned(rows.across)
            )

        states = moved(self.states._replace(reach=self.states.reach - there.reach))
        states = states._replace(reach=here.reach + states.reach)
        return self._replace(states=states, rates=moved(self.rates))

    def between(self, s: Scalar) -> tuple[Array, Scalar, Scalar]:
        """The node before an arc length, the step that begins there, and the place in it."""
        place = place_in(self.nodes, s)
        begin, end = rows_from(self.nodes, place, 2)
        # Behind a contact at the tip all nodes are one.
        whole = jnp.where(end > begin, end - begin, 1.0)
        return place, end - begin, jnp.clip((s - begin) / whole, 0.0, 1.0)


def _onward(s: Scalar, point: Vector, slope: Vector) -> tuple[Vector, Vector]:
    tangent = slope / jnp.sqrt(jnp.maximum(dot(slope, slope), _TINY))
    return point + jnp.maximum(s - 1.0, 0.0) * tangent, tangent


def place_in(nodes: Float[Array, "nodes"], s: Scalar) -> Int[Array, ""]:
    """The node at which the step begins that holds an arc length, or the last that has a length."""
    last = jnp.maximum(jnp.sum(nodes[:-1] < nodes[-1]) - 1, 0)
    return jnp.minimum(jnp.sum(nodes[1:] <= s), last)


def axes_of(at: State) -> tuple[Vector, Vector, Vector]:
    """Three axes that turn with the rod; for a straight one, any that have its tangent."""
    across = across_of(at.tangent) if at.across is None else at.across
    return across, jnp.cross(at.tangent, across), at.tangent


def rises(values: Float[Array, "nodes"]) -> Bool[Array, "steps"]:
    """Where values at the nodes pass from below to above zero."""
    return (values[:-1] < 0) & (values[1:] >= 0)


def most_zeros(values: Float[Array, "nodes"]) -> Int[Array, ""]:
    """How many such places `zero` can find: one may also lie beyond the tip."""
    return jnp.maximum(jnp.sum(rises(values)) + (values[-1] < 0), 1)


def closest(line: Line, r: Vector, near: Scalar | None = None) -> Scalar:
    """Arc length at which a line comes closest to a point: the first time that it comes about as
    close as ever, since behind a contact the force may curl it up; a step from `near` if that is
    given and a number.
    """

    def along(s: Scalar) -> tuple[Scalar, Scalar]:
        at, tangent, bend = line.curve(s)
        return dot(at - r, tangent), 1 + dot(at - r, bend)

    def anywhere() -> Scalar:
        gaps = line.reach - r
        distance = jnp.sqrt(jnp.sum(gaps * gaps, 1))
        nearer = jnp.minimum(distance[:-1], distance[1:])
        as_near = nearer <= 2 * jnp.min(distance) + jnp.diff(line.nodes)
        return zero(along, line, jnp.sum(gaps * line.tangent, 1), allowed=as_near)

    if near is None:
        return anywhere()
    found: Scalar = lax.cond(jnp.isnan(near), anywhere, lambda: near - along(near)[0])
    return found


def across_of(tangent: Vector) -> Vector:
    """A unit vector across a tangent that turns with it smoothly but at one direction (T. Duff et
    al., Journal of Computer Graphics Techniques 6 (2017) 1-8).
    """
    x, y, z = tangent
    sign = jnp.where(z < 0, -1.0, 1.0)
    a = -1.0 / (sign + z)
    return jnp.stack([1 + sign * x * x * a, sign * x * y * a, -sign * x])


def zero(
    function: Callable[[Scalar], tuple[Scalar, Scalar]] | None,
    line: Line,
    values: Float[Array, "nodes"],
    which: Int[Any, ""] | int = 0,
    *,
    allowed: Any = True,
) -> Scalar:
    """Arc length at which a function, given with its rate, and by values at the nodes, passes from
    below to above zero for the first time, or for a later one, within an allowed step or beyond the
    tip; without a function, interpolated. NaN if it does not any more.
    """
    values, nodes = lax.stop_gradient((values, line.nodes))
    up = rises(values) & allowed
    count = jnp.cumsum(up)
    place, within = jnp.argmax(up & (count == which + 1)), count[-1] > which
    # The first may also lie beyond the tip, and the last where the function still rises there.
    sought = within | (which == 0) | ((count[-1] == which) & (values[-1] < 0))
    (low, high), (start, end) = rows_from((values, nodes), place, 2)
    first = jnp.where(within, start + low / (low - high) * (end - start), 1.0)
    first = jnp.where(sought, first, jnp.nan)
    if function is None:
        return first
    # Beyond the tip; a first one that is nearly there may also turn out to lie before it.
    earliest = jnp.where(which == 0, 0.0, 1.0)
    least, most = jnp.where(within, start, earliest), jnp.where(within, end, _FARTHEST)

    def newton(_: Any, s: Scalar) -> Scalar:
        value, rate = function(s)
        return jnp.clip(s - value / rate, least, most)

    s = lax.stop_gradient(lax.fori_loop(0, _CLOSEST_STEPS, newton, first))
    value, rate = function(s)
    s = s - value / lax.stop_gradient(rate)
    return jnp.where(within | (s >= earliest), s, jnp.nan)
