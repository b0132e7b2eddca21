"""Spatial Kirchhoff rod under one contact force: an unshearable, inextensible rod whose stiffness
and rest shape vary along its length.

The contact force F at p leaves the force in the rod constant, and the moment that the part ahead of
s exerts on the part behind is m(s) = (p − r(s)) × F: known from the position alone. With d₃ the
tangent, d₁ and d₂ the axes of the section, B₁, B₂ the bending stiffnesses and B₃ the torsional one,

    r' = d₃,   d_i' = κ × d_i,   κ = Σ (u_i + m·d_i / B_i) d_i,

u the curvatures and twist of the unloaded rod (S. S. Antman, Nonlinear Problems of Elasticity, ch.
8). An initial value problem: the clamp gives r and the axes at s = 0. Beyond its tip the rod is
continued as a straight line, so that contacts near the tip have derivatives on both sides.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float
from scipy.integrate import DOP853

from vibrissa.mechanics.model import Bent, Clamp, Contact, RodModel
from vibrissa.numerics.vectors import dot, joined

Scalar = Float[Any, ""]
Vector = Float[Any, "3"]

STEPS = 24
"""Steps of the method of order 8 by Dormand and Prince (E. Hairer, S. P. Nørsett, G. Wanner,
Solving Ordinary Differential Equations I, sec. II.5; coefficients from SciPy): the uniform rod of
the paper's case agrees with the closed form to 1e-11 L (`tests/verification/test_kirchhoff.py`).
"""
_STAGES, _NODES, _WEIGHTS = DOP853.A, DOP853.C, DOP853.B
_THINNEST, _STRAIGHT = 1 - 1e-6, 1e-12
"""Taper up to which the steps are graded further, and logarithm of the tip's share of the radius
below which they are equal, to rounding.
"""
_CLOSEST_STEPS = 4
"""Newton steps along the rod, from within a step of it: they converge quadratically."""
_FARTHEST = 4.0
"""Arc length [L] up to which the straight continuation is searched: noise puts contacts there."""
_TINY = 1e-300


def graded(taper: Scalar, steps: int = STEPS) -> Float[Any, "nodes"]:
    """Nodes whose distances are as the radius of a rod that is thinner by a fraction `taper` at its
    tip: under the same moment each step bends alike.
    """
    share = np.linspace(0, 1, steps + 1)
    # (1 − (1 − τ)ˣ)/τ, and x for τ → 0.
    thin = jnp.log1p(-jnp.minimum(taper, _THINNEST))
    tiny = abs(thin) < _STRAIGHT
    whole = jnp.where(tiny, 1.0, jnp.expm1(thin))
    return jnp.where(tiny, share, jnp.expm1(share * thin) / whole)


class _State(NamedTuple):
    reach: Vector
    """From the clamp."""
    tangent: Vector
    across: Vector
    """d₁."""
    energy: Scalar


class Line(NamedTuple):
    """A bent rod at nodes from clamp to tip, and how it goes on between them."""

    nodes: Float[Array, "nodes"]
    """Arc lengths [L]."""
    reach: Float[Array, "nodes 3"]
    """From the clamp [L]."""
    tangent: Float[Array, "nodes 3"]
    bend: Float[Array, "nodes 3"]
    """t' [1/L]."""
    curvature: Float[Array, "nodes"]
    energy: Float[Array, "nodes"]
    """Between the clamp and each node [EI/L]."""
    power: Float[Array, "nodes"]
    """Energy per length [EI/L²]."""

    def at(self, s: Scalar) -> tuple[Vector, Vector]:
        """Point and tangent at an arc length: quintic between nodes, straight beyond the tip."""
        place, step, x = self._between(s)
        values = [
            scaled
            for node in (place, place + 1)
            for scaled in (
                self.reach[node],
                step * self.tangent[node],
                step**2 * self.bend[node],
            )
        ]
        weights, slopes = _quintic(x)
        point = sum(w * value for w, value in zip(weights, values, strict=True))
        slope = sum(w * value for w, value in zip(slopes, values, strict=True))
        tangent = slope / jnp.sqrt(dot(slope, slope))
        return point + jnp.maximum(s - 1.0, 0.0) * tangent, tangent

    def energy_up_to(self, s: Scalar) -> Scalar:
        """Energy of bending and twist between clamp and an arc length [EI/L], cubic between
        nodes.
        """
        place, step, x = self._between(s)
        start, rise = self.energy[place], self.energy[place + 1] - self.energy[place]
        first, last = step * self.power[place], step * self.power[place + 1]
        bend, turn = 3 * rise - 2 * first - last, first + last - 2 * rise
        energy: Scalar = start + x * (first + x * (bend + x * turn))
        return energy

    def _between(self, s: Scalar) -> tuple[Array, Scalar, Scalar]:
        """The node before an arc length, the step that begins there, and the place in it."""
        place = jnp.clip(jnp.sum(self.nodes[1:] <= s), 0, len(self.nodes) - 2)
        step = self.nodes[place + 1] - self.nodes[place]
        return place, step, jnp.clip((s - self.nodes[place]) / step, 0.0, 1.0)


def _quintic(x: Scalar) -> tuple[list[Scalar], list[Scalar]]:
    """Weights of value, slope and bend at both ends in a quintic, and of its slope."""
    x2, x3 = x * x, x * x * x
    x4, x5 = x2 * x2, x2 * x3
    return (
        [
            1 - 10 * x3 + 15 * x4 - 6 * x5,
            x - 6 * x3 + 8 * x4 - 3 * x5,
            (x2 - 3 * x3 + 3 * x4 - x5) / 2,
            10 * x3 - 15 * x4 + 6 * x5,
            -4 * x3 + 7 * x4 - 3 * x5,
            (x3 - 2 * x4 + x5) / 2,
        ],
        [
            -30 * x2 + 60 * x3 - 30 * x4,
            1 - 18 * x2 + 32 * x3 - 15 * x4,
            (2 * x - 9 * x2 + 12 * x3 - 5 * x4) / 2,
            30 * x2 - 60 * x3 + 30 * x4,
            -12 * x2 + 28 * x3 - 15 * x4,
            (3 * x2 - 8 * x3 + 5 * x4) / 2,
        ],
    )


class Kirchhoff(RodModel):
    """A rod of varying section and rest shape, in units of its stiffness at the clamp."""

    nodes: Float[Any, "nodes"]
    """Arc lengths [L] at which steps begin and end."""
    compliance: Float[Any, "steps stages 3"]
    """1/B₁, 1/B₂, 1/B₃ [1/EI] at `stages`."""
    rest: Float[Any, "steps stages 3"]
    """u [1/L] there."""

    @classmethod
    def of(
        cls,
        stiffness: Callable[[Any], Any],
        rest: Callable[[Any], Any] | None = None,
        nodes: Float[Any, "nodes"] | None = None,
    ) -> "Kirchhoff":
        """A rod whose B and u (…, 3) are functions of the arc length s [L]."""
        nodes = jnp.linspace(0, 1, STEPS + 1) if nodes is None else jnp.asarray(nodes)
        s = nodes[:-1, None] + jnp.diff(nodes)[:, None] * _NODES
        u = jnp.zeros((*s.shape, 3)) if rest is None else rest(s)
        return cls(nodes, 1 / stiffness(s), u)

    @classmethod
    def tapered(cls, taper: Scalar, poisson_ratio: Scalar, steps: int = STEPS) -> "Kirchhoff":
        """A straight round rod whose radius falls linearly by a fraction: B = (1 − τ s)⁴, and B₃ =
        B/(1 + ν).
        """

        def stiffness(s: Float[Array, "*s"]) -> Float[Array, "*s 3"]:
            bending = (1 - taper * s) ** 4
            return jnp.stack([bending, bending, bending / (1 + poisson_ratio)], axis=-1)

        return cls.of(stiffness, nodes=graded(taper, steps))

    def line(self, tangent: Vector, force: Vector, base_moment: Vector) -> Line:
        """The rod clamped in a direction, under the force F at its contact, where m(0) is the
        moment inside it at the clamp.
        """
        across = _across(tangent)

        def slope(at: _State, compliance: Vector, rest: Vector) -> tuple[_State, Vector]:
            d3, d1 = at.tangent, at.across
            d2 = jnp.cross(d3, d1)
            m = base_moment - jnp.cross(at.reach, force)
            carried = jnp.stack([dot(m, d1), dot(m, d2), dot(m, d3)])
            strain = compliance * carried
            u = rest + strain
            kappa = u[0] * d1 + u[1] * d2 + u[2] * d3
            rates = _State(d3, jnp.cross(kappa, d3), jnp.cross(kappa, d1), dot(strain, carried) / 2)
            return rates, jnp.sqrt(u[0] ** 2 + u[1] ** 2 + _TINY)

        def step(
            at: _State, section: tuple[Any, Any, Any]
        ) -> tuple[_State, tuple[_State, _State, Any]]:
            h, compliance, rest = section
            first, bent = slope(at, compliance[0], rest[0])
            slopes = [first]
            for stage in range(1, len(_WEIGHTS)):
                moved = _moved(at, h, _STAGES[stage, :stage], slopes)
                slopes.append(slope(moved, compliance[stage], rest[stage])[0])
            return _moved(at, h, _WEIGHTS, slopes), (at, first, bent)

        start, h = _State(jnp.zeros(3), tangent, across, jnp.zeros(())), jnp.diff(self.nodes)
        last, (nodes, rates, bent) = lax.scan(step, start, (h, self.compliance, self.rest))
        # The last stage of the last step lies at the tip.
        end, tip = slope(last, self.compliance[-1, -1], self.rest[-1, -1])
        nodes, rates = (
            jax.tree.map(lambda rows, row: jnp.concatenate([rows, row[None]]), rows, row)
            for rows, row in ((nodes, last), (rates, end))
        )
        return Line(
            jnp.asarray(self.nodes),
            nodes.reach,
            nodes.tangent,
            rates.tangent,
            jnp.append(bent, tip),
            nodes.energy,
            rates.energy,
        )

    def bent(
        self,
        clamp: Clamp,
        point: Vector,
        force: Scalar,
        direction: Vector,
        reached: Vector | None = None,  # noqa: ARG002
    ) -> Bent:
        """As in `RodModel`: the contact is where the rod comes closest to the point."""
        r, push = point - clamp.point, force * direction
        line = self.line(clamp.tangent, push, jnp.cross(r, push))

        def along(s: Scalar) -> Scalar:
            at, tangent = line.at(s)
            return dot(at - r, tangent)

        gaps = line.reach - r
        s = _zero(along, line, jnp.sum(gaps * line.tangent, 1), jnp.sum(gaps * gaps, 1))
        at, tangent = line.at(s)
        first = _across(tangent)
        away = r - at
        misses = joined(dot(away, jnp.cross(tangent, first)), dot(away, first))
        incidence = (1 + dot(tangent, direction)) / 2
        return Bent(point, r, force, direction, misses, s, incidence, line)

    def tangent(self, bent: Bent) -> Vector:
        """As in `RodModel`."""
        tangent: Vector = bent.inner.at(bent.arc_length)[1]
        return tangent

    def energy(self, bent: Bent) -> Scalar:
        """As in `RodModel`; with that of twist."""
        energy: Scalar = bent.inner.energy_up_to(bent.arc_length)
        return energy

    def largest_curvature(self, bent: Bent) -> Scalar:
        """As in `RodModel`: the largest at a node."""
        line = bent.inner
        return jnp.max(jnp.where(line.nodes <= bent.arc_length, line.curvature, 0.0))

    def points(self, bent: Bent, share: Float[np.ndarray, "n"]) -> Float[Array, "n 3"]:
        """As in `RodModel`."""
        clamp = bent.point - bent.to_contact
        points: Float[Array, "n 3"] = jax.vmap(
            lambda part: clamp + bent.inner.at((1 - part) * bent.arc_length)[0]
        )(jnp.asarray(share))
        return points

    def contact(self, force: Vector, moment: Vector, tangent: Vector) -> Contact:
        """As in `RodModel`: the first place along the rod where the moment in it is least."""
        push = -force
        f = jnp.sqrt(dot(push, push))
        line = self.line(tangent, push, -moment)

        def falling(s: Scalar) -> Scalar:
            at, along = line.at(s)
            return dot(jnp.cross(along, push), moment + jnp.cross(at, push)) / (f * f)

        inside = moment + jnp.cross(line.reach, push)
        slopes = jnp.sum(jnp.cross(line.tangent, push) * inside, 1) / (f * f)
        s = _zero(falling, line, slopes, None)
        at, along = line.at(s)
        d = push / f
        incidence = (1 + dot(along, d)) / 2
        return Contact(at, d, s, incidence, line.energy_up_to(s))


def _across(tangent: Vector) -> Vector:
    """A unit vector across a tangent that turns with it smoothly but at one direction (T. Duff et
    al., Journal of Computer Graphics Techniques 6 (2017) 1-8).
    """
    x, y, z = tangent
    sign = jnp.where(z < 0, -1.0, 1.0)
    a = -1.0 / (sign + z)
    return jnp.stack([1 + sign * x * x * a, sign * x * y * a, -sign * x])


def _moved(at: _State, h: Scalar, weights: np.ndarray, slopes: list[_State]) -> _State:
    def sum_of(value: Array, *rates: Array) -> Array:
        total = value
        for weight, rate in zip(weights.tolist(), rates, strict=True):
            if weight:
                total = total + h * weight * rate
        return total

    return jax.tree.map(sum_of, at, *slopes)


def _zero(
    function: Callable[[Scalar], Scalar],
    line: Line,
    values: Float[Array, "nodes"],
    distance: Float[Array, "nodes"] | None,
) -> Scalar:
    """Arc length at which a function with given values at the nodes passes from below to above
    zero: next to the nearest node, or for the first time.
    """
    values = lax.stop_gradient(values)
    count = len(values) - 1
    rises = (values[:-1] < 0) & (values[1:] >= 0)
    if distance is None:
        place = jnp.where(rises.any(), jnp.argmax(rises), count)
    else:
        nearest = jnp.argmin(lax.stop_gradient(distance))
        place = nearest - (values[nearest] > 0)
    inner = jnp.clip(place, 0, count - 1)
    low, high = values[inner], values[inner + 1]
    share = jnp.where((low < 0) & (high >= 0), low / (low - high), jnp.where(place < 0, 0.0, 1.0))
    start, end = (lax.stop_gradient(line.nodes[at]) for at in (inner, inner + 1))
    s = start + share * (end - start)

    def newton(_: int, s: Scalar) -> Scalar:
        value, rate = jax.jvp(function, (s,), (jnp.ones(()),))
        return jnp.clip(s - value / rate, 0.0, _FARTHEST)

    s = lax.stop_gradient(lax.fori_loop(0, _CLOSEST_STEPS, newton, s))
    value, rate = jax.jvp(function, (s,), (jnp.ones(()),))
    return s - value / lax.stop_gradient(rate)
