"""Spatial Kirchhoff rod: unshearable and inextensible, with a stiffness and a rest shape that vary
along its length, under one contact force, distributed loads, and on a compliant support.

The part ahead of s exerts on the part behind the force F + Q(s) and the moment

    m(s) = (p − r(s)) × F + M(s),      Q' = −q,      M' = −t × Q,

with F the contact force at p and q the load per length: without loads both are known from the
position alone. With t the tangent, d₁ and d₂ the axes of the section, B the bending and B₃ the
torsional stiffness, and u the curvatures and twist of the unloaded rod,

    r' = t,   t' = κ × t,   d₁' = κ × d₁,   κ = m/B + (1/B₃ − 1/B)(m·t) t + Σ u_i d_i

(S. S. Antman, Nonlinear Problems of Elasticity, ch. 8). An initial value problem: the clamp gives r
and the axes at s = 0. With loads, Q and M there are what leaves no force and no moment at the tip.
Beyond its tip the rod is continued as a straight line, so that contacts near the tip have
derivatives on both sides.
"""

import math
import sys
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.flatten_util import ravel_pytree
from jaxtyping import Bool, Float, Int
from scipy.integrate import DOP853

from vibrissa.geometry.checks import positive
from vibrissa.mechanics.model import Bent, Clamp, Contact, Flag, Free, Own, RodModel
from vibrissa.numerics.lanes import FEW
from vibrissa.numerics.linear import solve_pivoted
from vibrissa.numerics.rotation import turned
from vibrissa.numerics.vectors import dot, joined

Scalar = Float[Any, ""]
Vector = Float[Any, "3"]
Wrench = Float[Any, "6"]

ACCURACY, _ORDER = 1e-10, 8
STEPS = 12
"""Steps of the method of order 8 by Dormand and Prince (E. Hairer, S. P. Nørsett, G. Wanner,
Solving Ordinary Differential Equations I, sec. II.5; coefficients from SciPy) for an error of
`ACCURACY` [L]: with them the uniform rod of the paper's case agrees with the closed form to 1e-10
(`tests/verification/test_uniform_limit.py`).
"""
_STAGES, _NODES, _WEIGHTS = DOP853.A, DOP853.C, DOP853.B
_THIRD, _FIFTH, _SHARE = DOP853.E3[:-1], DOP853.E5[:-1], 0.1
"""Differences to the two formulas of lower order that the method holds, of which its estimate of
the error is made (ibid., sec. II.10).
"""
_ROUGHLY = 3
"""Steps that are one where only derivatives for Newton's method are wanted: to about 1e-6, so that
a step of it still gains as many digits.
"""
DEGREE = 4
"""Of the polynomials in which a section is given within each step: the stiffness of a round rod
whose radius changes linearly is one.
"""
_POINTS, _QUADRATURE = (np.array(np.polynomial.legendre.leggauss(DEGREE + 1)) + [[1], [0]]) / 2
_FIT = np.linalg.inv(np.vander(_POINTS, increasing=True))
_THINNEST, _STRAIGHT = 1 - 1e-6, 1e-12
"""Taper up to which the steps are graded further, and logarithm of the tip's share of the radius
below which they are equal, to rounding.
"""
_CLOSEST_STEPS = 4
"""Newton steps along the rod, from within a step of it: they converge quadratically."""
_LARGEST_TURN = 1.5
"""Angle [rad] by which a rod may turn in one step; a row whose rod turned further says so by its
residual.
"""
_CANDIDATES = 6
"""Most contacts that are looked for: each crosses the force's line of action once more. A whisker
that the force rolls up has up to five.
"""
_FULL_TURN = 2 * math.pi
"""By which bending turns a rod that meets itself."""
_FARTHEST = 4.0
"""Arc length [L] up to which the straight continuation is searched: noise puts contacts there."""
_LOAD_STEPS, _LOAD_SETTLED, _LOAD_FOUND = 25, 1e-13, 1e-8
"""Most Newton steps to the loads' resultants, the size [EI/L²] of one that ends them, and up to
which they count as found.
"""
_HARDLY_BENT = 0.5
"""Largest elastic curvature [1/L] of a rod on which the moments at tip and clamp are alike."""
_LARGEST_CHANGE = 2.0
"""Of the resultants in one such step [EI/L²]: a rod as soft as a rope still finds its shape."""
_ROUNDING = 1e-9
"""By which a contact at the tip may seem to lie before it [L]."""
_TOO_LARGE = 50.0
"""By which the method's estimate exceeds errors up to 1e-5 (measured: 90 or more)."""
_TINY = 1e-300


def steps_for(accuracy: float) -> int:
    """Steps that leave errors of about this size [L]: they fall with the eighth power.

    Raises
    ------
    ValueError
        If the accuracy is not a positive number.
    """
    return math.ceil(STEPS * (ACCURACY / positive(accuracy, "accuracy")) ** (1 / _ORDER))


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


class Load(eqx.Module):
    """Force per length on the rod [EI/L³], world axes."""

    @abstractmethod
    def per_length(self, s: Scalar, position: Vector, tangent: Vector, section: Any) -> Vector:
        """At an arc length and a position [L]; `section` holds whatever varies along the rod."""


class Local(NamedTuple):
    """A rod at an arc length, or polynomials of it, one row per step."""

    bending: Float[Any, "*s"]
    """B [EI]."""
    torsion: Float[Any, "*s"]
    """B₃ [EI]."""
    rest: Any = None
    """u (…, 3) [1/L]: curvatures about d₁ and d₂, and twist; None for a straight rod."""
    girth: Any = None
    """Radius (…) over that at the clamp; None if it is the same everywhere, or unknown."""
    loaded: Any = None
    """What the load depends on, (…)."""


def fitted(values: Callable[[Any], Any], nodes: Float[Any, "nodes"]) -> Any:
    """Polynomials (steps, 5, …) of functions of the arc length in each step between nodes."""
    s = nodes[:-1, None] + jnp.diff(nodes)[:, None] * _POINTS

    def fit(at: Array) -> Array:
        flat = jnp.reshape(at, (*s.shape, -1))
        return jnp.einsum("ij,sjk->sik", _FIT, flat).reshape(at.shape)

    return jax.tree.map(fit, values(s))


def _at_stages(polynomials: Local, start: Any, width: Any) -> Local:
    """Polynomials (5, …) of one step at the stages (12, …) of a part of it."""
    x = start + width * _NODES[: len(_WEIGHTS)]

    def at(coefficients: Array) -> Array:
        along = x.reshape(-1, *(1,) * (coefficients.ndim - 1))
        *lower, total = coefficients
        for coefficient in reversed(lower):
            total = total * along + coefficient
        return total

    return jax.tree.map(at, polynomials)


class _State(NamedTuple):
    reach: Vector
    """From the clamp point."""
    tangent: Vector
    energy: Scalar
    across: Any = None
    """d₁ (3,), where the rest shape needs it."""
    load: Any = None
    """Q and M (6,), where there are loads."""


class Push(NamedTuple):
    """What a contact exerts on the rod: F, and p × F with p from the clamp point."""

    force: Vector
    moment: Vector


_NO_PUSH = Push(np.zeros(3), np.zeros(3))


class Line(NamedTuple):
    """A bent rod at nodes from clamp to tip, and how it goes on between them."""

    nodes: Float[Array, "nodes"]
    """Arc lengths [L]."""
    states: _State
    """At the nodes (nodes, …)."""
    rates: _State
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

    def at(self, s: Scalar) -> tuple[Vector, Vector]:
        """Point and tangent at an arc length: quintic between nodes, straight beyond the tip."""
        place, step, x = self.between(s)
        values = self._ends(place, step)
        weights, slopes, _ = _quintic(x)
        point = sum(w * value for w, value in zip(weights, values, strict=True))
        slope = sum(w * value for w, value in zip(slopes, values, strict=True))
        tangent = slope / jnp.sqrt(jnp.maximum(dot(slope, slope), _TINY))
        return point + jnp.maximum(s - 1.0, 0.0) * tangent, tangent

    def bend(self, s: Scalar) -> Vector:
        """Slope t' of the tangent [1/L] at an arc length."""
        place, step, x = self.between(s)
        values, (_, _, seconds) = self._ends(place, step), _quintic(x)
        return sum(w * value for w, value in zip(seconds, values, strict=True)) / step**2

    def _ends(self, place: Array, step: Scalar) -> list[Vector]:
        return [
            scaled
            for node in (place, place + 1)
            for scaled in (
                self.states.reach[node],
                step * self.states.tangent[node],
                step**2 * self.rates.tangent[node],
            )
        ]

    def between(self, s: Scalar) -> tuple[Array, Scalar, Scalar]:
        """The node before an arc length, the step that begins there, and the place in it."""
        place = jnp.clip(jnp.sum(self.nodes[1:] <= s), 0, len(self.nodes) - 2)
        step = self.nodes[place + 1] - self.nodes[place]
        # Behind a contact at the tip all nodes are one.
        whole = jnp.where(step > 0, step, 1.0)
        return place, step, jnp.clip((s - self.nodes[place]) / whole, 0.0, 1.0)


def _quintic(x: Scalar) -> tuple[list[Scalar], list[Scalar], list[Scalar]]:
    """Weights of value, slope and bend at both ends in a quintic, in its slope and in its bend."""
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
        [
            -60 * x + 180 * x2 - 120 * x3,
            -36 * x + 96 * x2 - 60 * x3,
            (2 - 18 * x + 36 * x2 - 20 * x3) / 2,
            60 * x - 180 * x2 + 120 * x3,
            -24 * x + 84 * x2 - 60 * x3,
            (6 * x - 24 * x2 + 20 * x3) / 2,
        ],
    )


class Inner(NamedTuple):
    """What this model knows about a bent rod besides what every model provides."""

    line: Line
    """As if the contact force acted at the tip: the rod up to the contact."""
    clamp: Clamp
    push: Push
    tangent: Vector | None = None
    """Of the rod at the contact, where that is known."""


class Hanging(Free):
    """The rod without contact."""

    clamp: Clamp
    line: Line
    load: Wrench | None = None
    settled: Any = True

    @property
    def sound(self) -> Flag:
        """As in `Free`."""
        return self.settled

    def at(self, s: Scalar) -> tuple[Vector, Vector, Vector]:
        """As in `Free`."""
        point, tangent = self.line.at(s)
        return self.clamp.point + point, tangent, self.line.bend(s)

    @property
    def reactions(self) -> Wrench:
        """As in `Free`."""
        return jnp.zeros(6) if self.load is None else -self.load

    @property
    def energy(self) -> Scalar:
        """As in `Free`."""
        return self.line.states.energy[-1]


class Kirchhoff(RodModel):
    """A rod of varying section and rest shape, in units of its stiffness at the clamp."""

    nodes: Float[Any, "nodes"]
    """Arc lengths [L] at which steps begin and end."""
    local: Local
    """Polynomials (steps, 5, …) in each step."""
    load: Load | None = None
    compliance: Float[Any, "6 6"] | None = None
    """Of the support, clamp axes: displacement [L] and rotation vector under force [EI/L²] and
    moment [EI/L].
    """

    derived: "Kirchhoff | None" = None
    """The rod in fewer steps, as in `rough`."""

    accuracy: ClassVar[float] = 1e-8
    last_step: ClassVar[float] = 1e-7  # the step leaves less than the error of the discretisation
    lane_width: ClassVar[int] = 8
    """Rods side by side: the stages of more would leave the core's nearest cache."""

    @classmethod
    def of(
        cls,
        bending: Callable[[Any], Any],
        torsion: Callable[[Any], Any],
        rest: Callable[[Any], Any] | None = None,
        nodes: Float[Any, "nodes"] | None = None,
        *,
        loaded: Callable[[Any], Any] | None = None,
        girth: Callable[[Any], Any] | None = None,
        load: Load | None = None,
        compliance: Float[Any, "6 6"] | None = None,
    ) -> "Kirchhoff":
        """A rod whose B, B₃ (…), u (…, 3) and whatever its load depends on are functions of the arc
        length s [L].
        """
        nodes = jnp.linspace(0, 1, STEPS + 1) if nodes is None else jnp.asarray(nodes)
        given = (bending, torsion, rest, girth, loaded)

        def divided(nodes: Array, derived: Kirchhoff | None = None) -> Kirchhoff:
            local = Local(*(None if of is None else fitted(of, nodes) for of in given))
            return cls(nodes, local, load, compliance, derived)

        steps = len(nodes) - 1
        few = np.linspace(0, steps, math.ceil(steps / _ROUGHLY) + 1).round().astype(int)
        return divided(nodes, divided(nodes[few]))

    @classmethod
    def tapered(cls, taper: Scalar, poisson_ratio: Scalar, steps: int = STEPS) -> "Kirchhoff":
        """A straight round rod whose radius falls linearly by a fraction: B = (1 − τ s)⁴, and B₃ =
        B/(1 + ν).
        """
        return cls.of(
            lambda s: (1 - taper * s) ** 4,
            lambda s: (1 - taper * s) ** 4 / (1 + poisson_ratio),
            nodes=graded(taper, steps),
        )

    @property
    def bulky(self) -> int:
        """Up to how many rows, as in `vibrissa.numerics.lanes`: lanes do not help loaded rods."""
        return sys.maxsize if self.loaded else FEW

    @property
    def loaded(self) -> bool:
        """As in `RodModel`."""
        return self.load is not None

    @property
    def uniform(self) -> bool:
        """As in `RodModel`."""
        return self.local.girth is None

    def slimmer(self, s: Scalar) -> Scalar:
        """As in `RodModel`."""
        place = jnp.clip(jnp.sum(self.nodes[1:] <= s), 0, len(self.nodes) - 2)
        start, end = self.nodes[place], self.nodes[place + 1]
        # Beyond the tip it would go on as before.
        return 1 - jnp.polyval(self.local.girth[place][::-1], (s - start) / (end - start))

    def lateral_stiffness(self, s: Float[Any, "n"]) -> Float[Any, "n"]:
        """As in `RodModel`: (s³/3) / ∫ (s − σ)²/B dσ."""
        h = jnp.diff(self.nodes)
        place = (self.nodes[:-1, None] + h[:, None] * _POINTS).ravel()
        bending = jnp.einsum("sj,ij->si", self.local.bending, np.vander(_POINTS, increasing=True))
        weight = (h[:, None] * _QUADRATURE).ravel() / bending.ravel()
        lever = jnp.clip(s[:, None], 1e-3, 1.0) - place
        own = jnp.sum(weight * jnp.maximum(lever, 0.0) ** 2, axis=1)
        uniform = jnp.sum(weight * bending.ravel() * jnp.maximum(lever, 0.0) ** 2, axis=1)
        return uniform / own

    @property
    def rough(self) -> "Kirchhoff | None":
        """As in `RodModel`."""
        return self.derived

    @property
    def finer(self) -> "Kirchhoff":
        """As in `RodModel`."""
        half = self.nodes[:-1] + jnp.diff(self.nodes) / 2
        nodes = jnp.append(jnp.stack([self.nodes[:-1], half], 1).ravel(), self.nodes[-1])
        # p(x) at x = (i + y)/2 as a polynomial in y.
        halved = [_FIT @ np.vander((i + _POINTS) / 2, increasing=True) for i in (0, 1)]
        local = jax.tree.map(
            lambda part: jnp.einsum("hij,sj...->shi...", np.array(halved), part).reshape(
                2 * len(part), *part.shape[1:]
            ),
            self.local,
        )
        return Kirchhoff(nodes, local, self.load, self.compliance)

    def base(self, clamp: Clamp, wrench: Wrench) -> _State:
        """The rod where its support has yielded to force and moment about the clamp point, without
        what the loads do.
        """
        reach, tangent, across = jnp.zeros(3), clamp.tangent, clamp.across
        if self.compliance is not None:
            axes = across, jnp.cross(tangent, across), tangent
            own = joined(*(dot(part, axis) for part in (wrench[:3], wrench[3:]) for axis in axes))
            yields = jnp.sum(self.compliance * own, axis=1)
            reach, angle = (
                sum(yields[first + i] * axis for i, axis in enumerate(axes)) for first in (0, 3)
            )
            tangent, across = turned(angle, tangent), turned(angle, across)
        curved = self.local.rest is not None
        return _State(reach, tangent, jnp.zeros(()), across if curved else None)

    def _slope(
        self, origin: Vector, push: Push, s: Scalar, at: _State, local: Local, h: Scalar = 0.0
    ) -> _State:
        """Derivatives along the rod."""
        t, load = at.tangent, at.load
        m = _moment(push, at)
        square, about = dot(m, m), dot(m, t)
        # Behind a contact the force may curl up a thin tip: no further than a step resolves.
        soft = 1 / jnp.maximum(local.bending, h * jnp.sqrt(square + _TINY) / _LARGEST_TURN)
        twisting = (1 / local.torsion - 1 / local.bending) * about
        energy = (soft * square + twisting * about) / 2
        bend, across, rates = soft * jnp.cross(m, t), None, None
        if at.across is not None:
            d1, d2 = at.across, jnp.cross(t, at.across)
            u1, u2, u3 = local.rest
            bend = bend + u2 * d1 - u1 * d2
            across = soft * jnp.cross(m, d1) + (twisting + u3) * d2 - u2 * t
        if load is not None:
            assert self.load is not None
            q = self.load.per_length(s, origin + at.reach, t, local.loaded)
            rates = joined(-q, -jnp.cross(t, load[:3]))
        return _State(t, bend, energy, across, rates)

    def _step(
        self,
        origin: Vector,
        push: Push,
        at: _State,
        start: Scalar,
        h: Scalar,
        stages: Local,
    ) -> tuple[_State, _State, Scalar]:
        """One step from an arc length; the slope where it begins, and its estimated error. The
        section is given at the stages.
        """
        # One array: XLA spends far longer on a loop over many small ones.
        begin, state_of = ravel_pytree(at)
        count = len(_WEIGHTS)

        def weighted(weights: Any, slopes: Array) -> Array:
            return h * jnp.sum(weights[:, None] * slopes, axis=0)

        def stage(index: Array, slopes: Array) -> Array:
            local = jax.tree.map(lambda part: part[index], stages)
            s = start + h * jnp.asarray(_NODES)[index]
            here = state_of(begin + weighted(jnp.asarray(_STAGES)[index, :count], slopes))
            slope, _ = ravel_pytree(self._slope(origin, push, s, here, local, h))
            return lax.dynamic_update_index_in_dim(slopes, slope, index, 0)

        # A loop, not a sequence: a fifth of the time to compile, and no slower.
        slopes = lax.fori_loop(0, count, stage, jnp.zeros((count, begin.size)))
        # Reach and tangent come first.
        known = lax.stop_gradient(slopes[:, :6])
        third, fifth = (jnp.sum(weighted(of, known) ** 2) for of in (_THIRD, _FIFTH))
        error = fifth / (_TOO_LARGE * jnp.sqrt(fifth + _SHARE**2 * third + _TINY))
        return state_of(begin + weighted(_WEIGHTS, slopes)), state_of(slopes[0]), error

    def line(self, clamp: Clamp, push: Push, load: Wrench | None = None) -> Line:
        """The rod under a contact force that acts at or beyond its tip; with loads, Q and their
        moment about the clamp point at s = 0.
        """
        wrench = joined(push.force, push.moment)
        first = self.base(clamp, wrench if load is None else wrench + load)
        if load is not None:
            moment = load[3:] - jnp.cross(first.reach, load[:3])
            first = first._replace(load=joined(load[:3], moment))
        stages = jax.vmap(lambda local: _at_stages(local, 0.0, 1.0))(self.local)

        def step(at: _State, section: Any) -> tuple[_State, Any]:
            after, *begin = self._step(clamp.point, push, at, *section)
            return after, (at, *begin)

        last, rows = lax.scan(step, first, (self.nodes[:-1], jnp.diff(self.nodes), stages))
        return self._line(clamp.point, push, jnp.asarray(self.nodes), last, rows)

    def _line(self, origin: Vector, push: Push, nodes: Any, last: _State, rows: Any) -> Line:
        """A line from states and rates where its steps begin, their errors, and its last state."""
        tip = jax.tree.map(lambda part: jnp.sum(part[-1], axis=0), self.local)
        end = last, self._slope(origin, push, nodes[-1], last, tip)
        *begin, errors = rows
        states, rates = jax.tree.map(
            lambda row, at: jnp.concatenate([row, at[None]]), tuple(begin), end
        )
        return Line(nodes, states, rates, jnp.append(0.0, jnp.cumsum(errors)))

    def _strain(self, line: Line, push: Push) -> Float[Array, "nodes"]:
        """Elastic curvature [1/L] at the nodes."""
        m = jax.vmap(lambda at: _moment(push, at))(line.states)
        across = jnp.cross(m, line.tangent)
        bending = jnp.append(self.local.bending[:, 0], jnp.sum(self.local.bending[-1]))
        return jnp.sqrt(jnp.sum(across**2, axis=1) + _TINY) / bending

    def _error_at(self, inner: "Inner", s: Scalar) -> Scalar:
        """Estimated error at an arc length: that of the node behind it; infinite where the rod is
        rolled up before.
        """
        line, strain = inner.line, self._strain(inner.line, inner.push)
        place, _, _ = line.between(s)
        turns = (strain[1:] + strain[:-1]) / 2 * jnp.diff(line.nodes)
        turned = jnp.sum(jnp.where(jnp.arange(len(turns)) < place, turns, 0.0))
        error: Scalar = jnp.where(turned < _FULL_TURN, line.error[place + 1], jnp.inf)
        return error

    def _at(self, inner: Inner, s: Scalar) -> _State:
        """The rod at an arc length, by a step from the node before it; straight beyond the tip."""
        line, clamp, push, _ = inner
        place, step, x = line.between(s)
        before = jax.tree.map(lambda rows: rows[place], line.states)
        own = jax.tree.map(lambda part: part[place], self.local)
        start, stages = line.nodes[place], _at_stages(own, 0.0, x)
        here, *_ = self._step(clamp.point, push, before, start, x * step, stages)
        return here._replace(reach=here.reach + jnp.maximum(s - 1.0, 0.0) * here.tangent)

    def _rest(self, inner: Inner, s: Scalar, here: _State) -> Line:
        """The rod behind a contact, given there: nodes before the contact all lie at it."""
        nodes, stop = inner.line.nodes, jnp.clip(jnp.maximum(inner.line.nodes, s), 0.0, 1.0)

        def advance(at: _State, section: Any) -> tuple[_State, Any]:
            (node, start), (following, end), local = section
            width = following - node
            stages = _at_stages(local, (start - node) / width, (end - start) / width)
            after, *begin = self._step(inner.clamp.point, _NO_PUSH, at, start, end - start, stages)
            return after, (at, *begin)

        both = jnp.stack([nodes, stop], 1)
        last, rows = lax.scan(advance, here, (both[:-1], both[1:], self.local))
        return self._line(inner.clamp.point, _NO_PUSH, stop, last, rows)

    def beyond(self, inner: Inner, s: Scalar) -> Line:
        """The rest of the rod, from the contact at s on."""
        return self._rest(inner, s, self._at(inner, s))

    @staticmethod
    def _resultants(left: Callable[[Any, Any], Any], begin: Any, given: Any) -> Any:
        """Resultants of loads that leave nothing at the tip, by Newton's method: the first entries
        of `left(resultants, given)`, as many as there are resultants; with derivatives with respect
        to what is given. Also whether they were found, and the derivatives of all that is left with
        respect to them.
        """
        fixed = lax.stop_gradient(given)
        slopes = jax.jacfwd(lambda load: (left(load, fixed),) * 2, has_aux=True)

        def unfinished(state: tuple[Any, Any, Scalar, Array]) -> Array:
            return (state[2] > _LOAD_SETTLED) & (state[3] < _LOAD_STEPS)

        def refine(state: tuple[Any, Any, Scalar, Array]) -> tuple[Any, Any, Scalar, Array]:
            jacobian, value = slopes(state[0])
            change, _ = solve_pivoted(jacobian[:count], value[:count])
            size = jnp.max(jnp.abs(change))
            share = jnp.minimum(1.0, _LARGEST_CHANGE / jnp.maximum(size, _TINY))
            return state[0] - share * change, jacobian, size, state[3] + 1

        count = len(begin)
        size = jax.eval_shape(left, begin, fixed).size
        blank = jnp.zeros((size, count)), jnp.asarray(jnp.inf), jnp.zeros((), dtype=int)
        start = lax.stop_gradient(begin), *blank
        load, jacobian, size, _ = lax.stop_gradient(lax.while_loop(unfinished, refine, start))
        # One more step, which carries the derivatives (implicit function theorem).
        load = load - solve_pivoted(jacobian[:count], left(load, given)[:count])[0]
        return load, size < _LOAD_FOUND, jacobian

    def free(self, clamp: Clamp) -> Hanging:
        """As in `RodModel`."""
        if self.load is None:
            return Hanging(clamp, self.line(clamp, _NO_PUSH))

        def left(load: Wrench, given: tuple[Kirchhoff, Clamp]) -> Float[Array, "9"]:
            model, clamp = given
            states = model.line(clamp, _NO_PUSH, load).states
            return joined(states.load[-1], states.tangent[-1])

        load, found, slopes = self._resultants(left, jnp.zeros(6), (self, clamp))
        line = self.line(clamp, _NO_PUSH, load)
        strain = jnp.max(self._strain(line, _NO_PUSH))
        return Hanging(clamp, line, load, found & _stands(slopes, line.tangent[-1], strain))

    def bent(
        self,
        clamp: Clamp,
        point: Vector,
        force: Scalar,
        direction: Vector,
        own: Own = (),
        reached: Vector | None = None,  # noqa: ARG002
    ) -> Bent:
        """As in `RodModel`: the contact is where the rod comes closest to the point. Loads leave no
        force and no moment at the tip: their resultants at the clamp are the model's own unknowns.
        """
        r, along = point - clamp.point, force * direction
        push = Push(along, jnp.cross(r, along))
        load = own if self.loaded else None
        line = self.line(clamp, push, load)
        inner, s = Inner(line, clamp, push), _closest(line, r)
        here = self._at(inner, s)
        first, away, tangent = _across(here.tangent), r - here.reach, here.tangent
        misses = joined(dot(away, jnp.cross(tangent, first)), dot(away, first))
        # From the closest point of what is interpolated to that of what is as exact as the nodes.
        along = dot(away, tangent)
        s, tangent = s + along, tangent + along * line.bend(s)
        incidence = (1 + dot(tangent, direction)) / 2
        if load is not None:
            misses = joined(misses, self.beyond(inner, s).states.load[-1])
        inner = inner._replace(tangent=tangent)
        return Bent(point, r, force, direction, misses, s, incidence, inner, load)

    def tangent(self, bent: Bent) -> Vector:
        """As in `RodModel`."""
        tangent: Vector = bent.inner.tangent
        return tangent

    def energy(self, bent: Bent) -> Scalar:
        """As in `RodModel`; with that of twist."""
        if self.load is None:
            return self._at(bent.inner, bent.arc_length).energy
        energy: Scalar = self.beyond(bent.inner, bent.arc_length).states.energy[-1]
        return energy

    def largest_curvature(self, bent: Bent) -> Scalar:
        """As in `RodModel`: the largest at a node."""
        line = bent.inner.line
        bend = jnp.sqrt(jnp.sum(line.rates.tangent**2, axis=1))
        return jnp.max(jnp.where(line.nodes <= bent.arc_length + _ROUNDING, bend, 0.0))

    def largest_bend(self, bent: Bent) -> Scalar:
        """As in `RodModel`: the largest at a node."""
        line = bent.inner.line
        at = self._strain(line, bent.inner.push)
        if self.local.girth is not None:
            girth = self.local.girth
            at = at * jnp.append(girth[:, 0], jnp.sum(girth[-1]))
        return jnp.max(jnp.where(line.nodes <= bent.arc_length + _ROUNDING, at, 0.0))

    def points(self, bent: Bent, share: Float[np.ndarray, "n"]) -> Float[Array, "n 3"]:
        """As in `RodModel`."""
        clamp = bent.point - bent.to_contact
        points: Float[Array, "n 3"] = jax.vmap(
            lambda part: clamp + bent.inner.line.at((1 - part) * bent.arc_length)[0]
        )(jnp.asarray(share))
        return points

    def drawn(self, bent: Bent, s: Float[Any, "n"]) -> Float[Array, "n 3"]:
        """Points at arc lengths from clamp to tip."""
        inner, s1 = bent.inner, bent.arc_length
        rest, clamp = self.beyond(inner, s1), bent.point - bent.to_contact

        def at(s: Scalar) -> Vector:
            return clamp + jnp.where(s <= s1, inner.line.at(s)[0], rest.at(s)[0])

        points: Float[Array, "n 3"] = jax.vmap(at)(jnp.asarray(s))
        return points

    def along(self, bent: Bent, s: Float[Any, "n"]) -> tuple[Array, ...]:
        """Tangent, moment and force in the rod (n, 3), B and B₃ (n,), up to the contact."""
        inner = bent.inner

        def at(s: Scalar) -> tuple[Array, ...]:
            place, _, x = inner.line.between(s)
            own = jax.tree.map(lambda part: part[place], (self.local.bending, self.local.torsion))
            stiff = [jnp.polyval(part[::-1], x) for part in own]
            here, push = self._at(inner, s), inner.push
            m, n = push.moment - jnp.cross(here.reach, push.force), push.force
            if here.load is not None:
                m, n = m + here.load[3:], n + here.load[:3]
            return (here.tangent, m, n, *stiff)

        found: tuple[Array, ...] = jax.vmap(at)(jnp.asarray(s))
        return found

    def tail(self, bent: Bent, share: Float[np.ndarray, "n"]) -> Float[Array, "n 3"]:
        """As in `RodModel`."""
        rest, s = self.beyond(bent.inner, bent.arc_length), bent.arc_length
        place = jnp.maximum(1.0 - s, 0.0)
        clamp = bent.point - bent.to_contact
        shift = bent.to_contact - bent.inner.line.at(s)[0]
        points: Float[Array, "n 3"] = jax.vmap(
            lambda part: clamp + shift + rest.at(s + part * place)[0]
        )(jnp.asarray(share))
        return points

    @property
    def candidates(self) -> int:
        """As in `RodModel`: a straight rod would have to be bent to and fro to have several."""
        return 1 if self.local.rest is None else _CANDIDATES

    def contact(
        self, force: Vector, moment: Vector, clamp: Clamp, which: Int[Any, ""] | int = 0
    ) -> Contact:
        """As in `RodModel`: a place along the rod where the moment in it is least, once that of the
        loads behind it is taken off.
        """
        return self._crossings(clamp, Push(-force, -moment))(which)

    def contacts(self, force: Vector, moment: Vector, clamp: Clamp) -> Contact:
        """As in `RodModel`."""
        crossing = self._crossings(clamp, Push(-force, -moment))
        found: Contact = lax.map(crossing, jnp.arange(self.candidates))
        return found

    def _crossings(self, clamp: Clamp, push: Push) -> Callable[[Any], Contact]:
        """The contact at a crossing of the rod and the force's line of action, in order."""
        if self.load is not None:
            return self._loaded_crossings(clamp, push)
        line, f = self.line(clamp, push), jnp.sqrt(dot(push.force, push.force))

        def falling(s: Scalar) -> Scalar:
            at, along = line.at(s)
            inside = push.moment - jnp.cross(at, push.force)
            return -dot(jnp.cross(along, push.force), inside) / (f * f)

        inside = push.moment - jnp.cross(line.reach, push.force)
        slopes = -jnp.sum(jnp.cross(line.tangent, push.force) * inside, 1) / (f * f)
        return lambda which: self._crossing(
            Inner(line, clamp, push), _zero(falling, line, slopes, which)
        )

    def _crossing(self, inner: Inner, s: Scalar) -> Contact:
        """The contact near an arc length, without loads."""
        line, _, push, _ = inner
        f, here = jnp.sqrt(dot(push.force, push.force)), self._at(inner, s)
        at, along = here.reach, here.tangent
        lever, inside = jnp.cross(along, push.force) / f, push.moment - jnp.cross(at, push.force)
        # Before the next step: where rod and force are parallel, that step goes anywhere.
        gap = jnp.sqrt(dot(inside, inside)) / f
        # From what is interpolated to what is as exact as the nodes.
        step = dot(lever, inside) / (f * dot(lever, lever))
        s, at, along = s + step, at + step * along, along + step * line.bend(s)
        d = push.force / f
        incidence = (1 + dot(along, d)) / 2
        # Where rod and force cross at a small angle, the crossing moves further than the rod.
        error = self._error_at(inner, s) / jnp.sqrt(dot(lever, lever))
        return Contact(at, d, s, incidence, here.energy, gap, error=error)

    def _loaded_crossings(self, clamp: Clamp, push: Push) -> Callable[[Any], Contact]:
        """Where the moment is that of the loads behind the contact; place and those loads'
        resultants by Newton's method, beginning with the resultants of the free rod.
        """
        line = self.line(clamp, push, jnp.zeros(6))
        inner, free = Inner(line, clamp, push), self.free(clamp).line.states.load
        force = push.force + line.states.load[:, :3] - free[:, :3]
        inside = push.moment - jnp.cross(line.reach, push.force)
        inside = inside + line.states.load[:, 3:] - free[:, 3:]
        slopes = -jnp.sum(jnp.cross(line.tangent, force) * inside, 1)

        def parts(unknowns: Float[Array, "7"], inner: Inner) -> tuple[_State, Vector, Vector, Line]:
            push, s, tail = inner.push, unknowns[0], unknowns[1:]
            here = self._at(inner, s)
            force = push.force + here.load[:3] - tail[:3]
            moment = push.moment - jnp.cross(here.reach, push.force) + here.load[3:] - tail[3:]
            return here, force, moment, self._rest(inner, s, here._replace(load=tail))

        def left(unknowns: Float[Array, "7"], inner: Inner) -> Float[Array, "7"]:
            here, force, moment, rest = parts(unknowns, inner)
            lever = -dot(jnp.cross(here.tangent, force), moment) / dot(force, force)
            return joined(lever, rest.states.load[-1])

        def crossing(which: Any) -> Contact:
            begin = _zero(None, line, slopes, which)
            place, _, x = line.between(begin)
            tail = free[place] + x * (free[place + 1] - free[place])
            unknowns, *_ = self._resultants(left, joined(begin, tail), inner)
            here, force, moment, rest = parts(unknowns, inner)
            f, reach = jnp.sqrt(dot(force, force)), here.reach
            total = joined(-push.force, -push.moment)
            load = total + joined(force, jnp.cross(reach, force) + moment)
            incidence = (1 + dot(here.tangent, force) / f) / 2
            energy = rest.states.energy[-1]
            gap = jnp.sqrt(dot(moment, moment)) / f
            lever = jnp.cross(here.tangent, force) / f
            error = (self._error_at(inner, unknowns[0]) + rest.error[-1]) / jnp.sqrt(
                dot(lever, lever)
            )
            return Contact(reach, force / f, unknowns[0], incidence, energy, gap, load, error)

        return crossing


def _moment(push: Push, at: _State) -> Vector:
    """Moment in the rod."""
    m: Vector = push.moment - jnp.cross(at.reach, push.force)
    return m if at.load is None else m + at.load[3:]


def _stands(slopes: Float[Array, "9 6"], tangent: Vector, strain: Scalar) -> Bool[Array, ""]:
    """Whether a rod without contact is stable: whether small moments across its tip turn it their
    own way. Given are the derivatives of force and moment at the tip, and of its tangent, with
    respect to force and moment at the clamp.

    Under more than its second critical load an upright column answers in that way again; but while
    the rod is hardly bent, its clamp then has to hold against the moment's sense.
    """
    none = jnp.zeros(3)
    across = _across(tangent)
    moments = across, jnp.cross(tangent, across)
    at_clamp = [solve_pivoted(slopes[:6], joined(none, moment))[0] for moment in moments]

    def positive(answers: list[Vector]) -> Bool[Array, ""]:
        (a, b), (c, d) = ([dot(moment, answer) for answer in answers] for moment in moments)
        return (a > 0) & (a * d > ((b + c) / 2) ** 2)

    turns = [jnp.cross(tangent, slopes[6:] @ answer) for answer in at_clamp]
    hardly = strain < _HARDLY_BENT
    return positive(turns) & (positive([answer[3:] for answer in at_clamp]) | ~hardly)


def _closest(line: Line, r: Vector) -> Scalar:
    """Arc length at which a line comes closest to a point: the first time that it comes about as
    close as ever, since behind a contact the force may curl it up.
    """

    def along(s: Scalar) -> Scalar:
        at, tangent = line.at(s)
        return dot(at - r, tangent)

    gaps = line.reach - r
    distance = jnp.sqrt(jnp.sum(gaps * gaps, 1))
    near = jnp.minimum(distance[:-1], distance[1:])
    as_near = near <= 2 * jnp.min(distance) + jnp.diff(line.nodes)
    return _zero(along, line, jnp.sum(gaps * line.tangent, 1), allowed=as_near)


def _across(tangent: Vector) -> Vector:
    """A unit vector across a tangent that turns with it smoothly but at one direction (T. Duff et
    al., Journal of Computer Graphics Techniques 6 (2017) 1-8).
    """
    x, y, z = tangent
    sign = jnp.where(z < 0, -1.0, 1.0)
    a = -1.0 / (sign + z)
    return jnp.stack([1 + sign * x * x * a, sign * x * y * a, -sign * x])


def _zero(
    function: Callable[[Scalar], Scalar] | None,
    line: Line,
    values: Float[Array, "nodes"],
    which: Int[Any, ""] | int = 0,
    *,
    allowed: Any = True,
) -> Scalar:
    """Arc length at which a function with given values at the nodes passes from below to above zero
    for the first time, or for a later one, within an allowed step or beyond the tip; without a
    function, interpolated. NaN if it does not any more.
    """
    values, nodes = lax.stop_gradient((values, line.nodes))
    rises = (values[:-1] < 0) & (values[1:] >= 0) & allowed
    count = jnp.cumsum(rises)
    place, within = jnp.argmax(rises & (count == which + 1)), count[-1] > which
    # The first may also lie beyond the tip, and the last where the function still rises there.
    sought = within | (which == 0) | ((count[-1] == which) & (values[-1] < 0))
    low, high = values[place], values[place + 1]
    start, end = nodes[place], nodes[place + 1]
    first = jnp.where(within, start + low / (low - high) * (end - start), 1.0)
    first = jnp.where(sought, first, jnp.nan)
    if function is None:
        return first
    # Beyond the tip; a first one that is nearly there may also turn out to lie before it.
    earliest = jnp.where(which == 0, 0.0, 1.0)
    least, most = jnp.where(within, start, earliest), jnp.where(within, end, _FARTHEST)

    def newton(_: Any, s: Scalar) -> Scalar:
        value, rate = jax.jvp(function, (s,), (jnp.ones(()),))
        return jnp.clip(s - value / rate, least, most)

    s = lax.stop_gradient(lax.fori_loop(0, _CLOSEST_STEPS, newton, first))
    value, rate = jax.jvp(function, (s,), (jnp.ones(()),))
    s = s - value / lax.stop_gradient(rate)
    return jnp.where(within | (s >= earliest), s, jnp.nan)
