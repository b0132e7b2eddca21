"""The spatial shape of a slightly imperfect rod from its base wrench: Kirchhoff's equations, for
derivatives about the rod as it is described, by default a straight uniform one.

With n and m the force and moment that the rod ahead exerts on the part behind, t the tangent and d
the clamp's x axis carried along without twist,

    r' = t,   t' = κ × t,   d' = κ × d,   m' = −t × n,   n' = −q,   κ = m/(1 − τs)⁴ + t × (c₁ d + c₂
    t × d),

with base values n = −f0, m = −m0. Lengths in L, forces in EI/L² of the base, clamp axes. Twist does
not matter to first order: without imperfection there is none. A described rod adds its own bending
and torsional stiffness, its rest shape with twist, and how its support yields.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float

from vibrissa.mechanics.model import AT_ORIGIN
from vibrissa.mechanics.models import spatial
from vibrissa.numerics.lanes import AnyArray
from vibrissa.rod import Rod

_STEPS = 32
"""Steps of fourth-order Runge-Kutta: error 1e-7 for a rod bent by a right angle (measured)."""
_NEWTON_STEPS = 2
"""Newton steps to the contact of an imperfect rod: what is left is linear, and subtracted by the
caller.
"""
_FARTHEST = 0.2
"""The longest of them [L]: farther away, the moment is no longer linear."""


class Imperfect(NamedTuple):
    """A rod given by its base wrench, or a derivative with respect to each of these."""

    wrench: Float[AnyArray, "*k 6"]
    """Support reactions (f0, m0)."""
    taper: Float[AnyArray, "*k"]
    """τ, fraction by which the radius is smaller at the tip."""
    curvature: Float[AnyArray, "*k 2"]
    """c, of the unloaded rod, in the clamp's axes."""
    load: Float[AnyArray, "*k 3"]
    """q, force per length."""


class End(NamedTuple):
    """The rod at an arc length, or derivatives of it."""

    moment: Float[AnyArray, "*k 3"]
    """Zero at a contact."""
    force: Float[AnyArray, "*k 3"]
    """Of the contact on the rod."""
    tangent: Float[AnyArray, "*k 3"]
    reach: Float[AnyArray, "*k 3"]


class _State(NamedTuple):
    reach: Float[Array, "3"]
    tangent: Float[Array, "3"]
    carried: Float[Array, "3"]
    moment: Float[Array, "3"]


def rod_end(rod: Imperfect, arc_length: Float[Array, ""], described: Rod | None = None) -> End:
    """The rod at `arc_length`, under the load on the part that overhangs beyond; `described` is
    the rod without imperfections, None for the straight uniform one.
    """
    step = arc_length / _STEPS

    def slope(s: Array, at: _State) -> _State:
        t = at.tangent
        rest = rod.curvature[0] * at.carried + rod.curvature[1] * jnp.cross(t, at.carried)
        bend = at.moment / (1 - rod.taper * s) ** 4 + jnp.cross(t, rest)
        if described is not None:
            bend = bend + _described(described, rod.taper, s, at)
        force = -rod.wrench[:3] - rod.load * s
        return _State(t, jnp.cross(bend, t), jnp.cross(bend, at.carried), -jnp.cross(t, force))

    def moved(at: _State, by: Array, slopes: _State) -> _State:
        return jax.tree.map(lambda value, rate: value + by * rate, at, slopes)

    def advance(index: Array | int, at: _State) -> _State:
        s = index * step
        first = slope(s, at)
        second = slope(s + step / 2, moved(at, step / 2, first))
        third = slope(s + step / 2, moved(at, step / 2, second))
        fourth = slope(s + step, moved(at, step, third))
        total = jax.tree.map(lambda a, b, c, d: a + 2 * b + 2 * c + d, first, second, third, fourth)
        return moved(at, step / 6, total)

    x, _, z = jnp.eye(3)
    start = _State(jnp.zeros(3), z, x, -jnp.asarray(rod.wrench)[3:])
    if described is not None and described.support is not None:
        base = spatial(described).base(AT_ORIGIN, -jnp.asarray(rod.wrench))
        across = x if base.across is None else base.across
        moment = start.moment - jnp.cross(base.reach, -jnp.asarray(rod.wrench)[:3])
        start = _State(base.reach, base.tangent, across, moment)
    last = lax.fori_loop(0, _STEPS, advance, start)
    over = jnp.cross(last.tangent, rod.load) * (1 - arc_length) ** 2 / 2
    return End(last.moment - over, -rod.wrench[:3] - rod.load, last.tangent, last.reach)


def _described(rod: Rod, taper: AnyArray, s: Array, at: _State) -> Float[Array, "3"]:
    """What the rod as it is described adds to κ of a straight uniform one."""
    t, m, d = at.tangent, at.moment, at.carried
    thin = (1 - taper * s) ** 4
    # The last stiffness holds beyond the tip.
    bending, torsion = (of(jnp.minimum(s, 1.0)) for of in (rod.bending_at, rod.torsion_at))
    along = jnp.sum(m * t)
    bend = ((1 / bending - 1) * m + (1 / torsion - 1 / bending) * along * t) / thin
    if rod.rest is not None:
        first, second, twist = rod.rest.at(s * rod.length) * rod.length
        bend = bend + first * d + second * jnp.cross(t, d) + twist * t
    return bend


def contact_near(
    rod: Imperfect, arc_length: Float[Array, ""], described: Rod | None = None
) -> Float[Array, ""]:
    """s₁ by Newton's method, starting from that of the ideal rod."""

    def step(_: Array | int, s: Float[Array, ""]) -> Float[Array, ""]:
        end = rod_end(rod, s, described)
        rate = -jnp.cross(end.tangent, end.force)
        change = jnp.sum(end.moment * rate) / jnp.sum(rate**2)
        return s - jnp.clip(change, -_FARTHEST, _FARTHEST)

    return lax.fori_loop(0, _NEWTON_STEPS, step, arc_length)
