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
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float, Int

from vibrissa.geometry.checks import positive
from vibrissa.mechanics.hanging import Load, Share, Tip, balanced, grown
from vibrissa.mechanics.line import Line, State, across_of, closest, most_zeros, place_in, zero
from vibrissa.mechanics.model import (
    AT_ORIGIN,
    Bent,
    Clamp,
    Contact,
    Flag,
    Free,
    Own,
    Resting,
    RodModel,
)
from vibrissa.mechanics.section import (
    POINTS,
    QUADRATURE,
    Local,
    Stage,
    Steps,
    at_stages,
    fitted,
    graded,
    padded,
    powered,
    stage_of,
)
from vibrissa.numerics.derivatives import by_differences
from vibrissa.numerics.rotation import cross_matrix, turned
from vibrissa.numerics.rows import row_of, rows_from, with_row
from vibrissa.numerics.runge_kutta import ORDER_5, ORDER_8, Scheme, error_of_order_8, stepped
from vibrissa.numerics.vectors import dot, joined

Scalar = Float[Any, ""]
Vector = Float[Any, "3"]
Wrench = Float[Any, "6"]

ACCURACY, _ORDER = 1e-10, 8
STEPS = 12
"""Steps of the method of order 8 (`vibrissa.numerics.runge_kutta`) for an error of `ACCURACY` [L]:
with them the uniform rod of the paper's case agrees with the closed form to 3e-12, which leaves
room for rods that bend further (`tests/verification/test_uniform_limit.py`).
"""
_ROUGHLY = 3
"""Steps that are one, of a method of order 5, where only derivatives for Newton's method are
wanted, and the fewest of these: to three digits or more, so that a step of it gains as many.
"""
_ROUGH = 30.0
"""How much a step with slopes of the rougher rod is to gain at least."""
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
_LARGEST_ERROR = 1e-6
"""Estimated error of a hanging rod's tip [L] up to which it counts as found: as for contacts."""
_ROUNDING = 1e-9
"""By which a contact at the tip may seem to lie before it [L]."""
_TINY = 1e-300

_traced_once = partial(jax.jit, inline=True)
"""Of functions that kernels call several times: tracing them takes as long as all else."""


def steps_for(accuracy: float) -> int:
    """Steps that leave errors of this size [L] or less, which fall with the eighth power; at least
    as many as a rougher rod has.

    Raises
    ------
    ValueError
        If the accuracy is not a positive number.
    """
    steps = STEPS * (ACCURACY / positive(accuracy, "accuracy")) ** (1 / _ORDER)
    return max(_ROUGHLY, math.floor(steps))


class Push(NamedTuple):
    """What a contact exerts on the rod: F, and p × F with p from the clamp point."""

    force: Vector
    moment: Vector


_NO_PUSH = Push(np.zeros(3), np.zeros(3))


class Inner(NamedTuple):
    """What this model knows about a bent rod besides what every model provides."""

    line: Line
    """As if the contact force acted at the tip: the rod up to the contact."""
    clamp: Clamp
    push: Push
    here: State | None = None
    """The rod at the contact, where that is known."""
    rest: Line | None = None
    """And the rod behind it, under loads."""


class Unloaded(Free):
    """The rod without contact, where nothing loads it: its own shape, seen from its clamp."""

    clamp: Clamp
    line: Line

    def at(self, s: Scalar) -> tuple[Vector, Vector, Vector]:
        """As in `Free`."""
        place, along, bend = map(self._turned, self.line.curve(s))
        return self.clamp.point + place, along, bend

    def _turned(self, vector: Vector) -> Vector:
        tangent, across = self.clamp.tangent, self.clamp.across
        x, y, z = vector
        return x * across + y * jnp.cross(tangent, across) + z * tangent


class Hanging(Free):
    """The rod without contact, under its loads."""

    clamp: Clamp
    line: Line
    load: Wrench
    settled: Any

    @property
    def sound(self) -> Flag:
        """As in `Free`."""
        return self.settled

    def at(self, s: Scalar) -> tuple[Vector, Vector, Vector]:
        """As in `Free`."""
        point, tangent, bend = self.line.curve(s)
        return self.clamp.point + point, tangent, bend

    @property
    def reactions(self) -> Wrench:
        """As in `Free`."""
        return -self.load

    @property
    def energy(self) -> Scalar:
        """As in `Free`."""
        return self.line.states.energy[-1]


class Kirchhoff(RodModel):
    """A rod of varying section and rest shape, in units of its stiffness at the clamp."""

    steps: Steps
    load: Load | None = None
    pull: Vector | None = None
    """Resultant of a load that depends on the arc length alone."""
    compliance: Float[Any, "6 6"] | None = None
    """Of the support, clamp axes: displacement [L] and rotation vector under force [EI/L²] and
    moment [EI/L].
    """

    roughly: Steps | None = None
    """Fewer and cheaper steps."""
    unloaded: Line | None = None
    """The rod's own shape, seen from an unmoved clamp, where nothing but a contact loads it."""
    divided: "Kirchhoff | None" = None
    """The rod whose steps were halved to get this one."""

    accuracy: ClassVar[float] = 1e-8
    last_step: ClassVar[float] = 1e-8
    """As in `RodModel`: even on a thin whisker, whose rougher rod gives two digits of a derivative,
    one more step leaves less than the error of the discretisation.
    """
    linear: ClassVar[float] = 0.005
    """As in `RodModel`: at 0.01 the 95 % ellipsoids of contacts near a tip with a tenth of the
    clamp's radius hold 91 %, at 0.02 only 78 % (`tests/roundtrip/test_thin_tips.py`).
    """
    lane_width: ClassVar[int] = 32
    """Rods side by side: the stages of more would leave the core's nearest cache."""
    walk_width: ClassVar[int] = 1
    """The same for Newton's method, where each would wait for the slowest, and for derivatives:
    the six of a contact with respect to its wrench take 100 µs, and 290 in lanes.
    """

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

        def divided(nodes: Array, scheme: Scheme, count: int) -> Steps:
            local = Local(*(None if of is None else fitted(of, nodes) for of in given))
            return Steps.of(*padded(nodes, local, count), scheme)

        count = len(nodes) - 1
        fewer_steps = max(math.ceil(count / _ROUGHLY), _ROUGHLY)
        few: Any = np.linspace(0, count, fewer_steps + 1).round().astype(int)
        steps, pull = divided(nodes, ORDER_8, count), None
        if load is not None and load.given:
            by_step = _pulls(load, steps)
            pull = jnp.sum(by_step, axis=0)
            enough = jnp.clip(_rough_steps(by_step, steps), fewer_steps, count)
            few = jnp.minimum(np.arange(count + 1), enough) * (count / enough)
            few = jnp.round(few).astype(int)
        fewer = divided(nodes[few], ORDER_5, count)
        rod = cls(steps, load, pull, compliance, roughly=fewer)
        return rod if load is not None else replace(rod, unloaded=rod.own_shape)

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
    def bulky(self) -> bool:
        """As in `vibrissa.numerics.lanes`: loads make twice as much code."""
        return self.loaded

    @property
    def loaded(self) -> bool:
        """As in `RodModel`."""
        return self.load is not None

    @property
    def unknowns(self) -> int:
        """As in `RodModel`."""
        if not self.loaded:
            return 0
        return 6 if self.pull is None else 3

    @property
    def alike_everywhere(self) -> bool:
        """As in `RodModel`."""
        return self.load is None or self.load.alike_everywhere

    @property
    def uniform(self) -> bool:
        """As in `RodModel`."""
        return self.steps.local.girth is None

    def slimmer(self, s: Scalar) -> Scalar:
        """As in `RodModel`."""
        nodes, local, *_ = self.steps
        place = place_in(jnp.asarray(nodes), s)
        start, end = rows_from(nodes, place, 2)
        # Beyond the tip it would go on as before.
        return 1 - jnp.polyval(row_of(local.girth, place)[::-1], (s - start) / (end - start))

    def lateral_stiffness(self, s: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """As in `RodModel`: (s³/3) / ∫ (s − σ)²/B dσ."""
        nodes, coefficients = np.asarray(self.steps.nodes), np.asarray(self.steps.local.bending)
        h = np.diff(nodes)
        place = (nodes[:-1, None] + h[:, None] * POINTS).ravel()
        bending = (coefficients @ np.vander(POINTS, increasing=True).T).ravel()
        weight = (h[:, None] * QUADRATURE).ravel() / bending
        lever = np.maximum(np.clip(s[:, None], 2 * place[0], 1.0) - place, 0.0) ** 2
        own = np.sum(weight * lever, axis=1)
        uniform = np.sum(weight * bending * lever, axis=1)
        return uniform / own

    @property
    def rough(self) -> "Kirchhoff | None":
        """As in `RodModel`."""
        return None if self.roughly is None else replace(self, steps=self.roughly)

    @property
    def derivatives(self) -> Callable[..., Any]:
        """As in `RodModel`."""
        return by_differences

    @property
    def finer(self) -> "Kirchhoff":
        """As in `RodModel`."""
        steps = self.steps.halved
        return Kirchhoff(steps, self.load, self.pull, self.compliance, divided=self)

    def partly(self, share: Scalar) -> "Kirchhoff":
        """A rod on the way from a straight, uniform one that is rigidly held and without loads to
        this one: its stiffness and radius to a power, all else by a share. It has no rougher one.
        """
        nodes, local, scheme, _ = self.steps
        bending, torsion, girth = (
            None if part is None else powered(part, share)
            for part in (local.bending, local.torsion, local.girth)
        )
        rest = None if local.rest is None else share * local.rest
        steps = Steps.of(nodes, Local(bending, torsion, rest, girth, local.loaded), scheme)
        load = None if self.load is None else Share(self.load, share)
        pull = None if self.pull is None else share * self.pull
        compliance = None if self.compliance is None else share * self.compliance
        rod = Kirchhoff(steps, load, pull, compliance)
        return rod if load is not None else replace(rod, unloaded=rod.own_shape)

    def base(self, clamp: Clamp, wrench: Wrench) -> State:
        """The rod where its support has yielded to force and moment about the clamp point, without
        what the loads do.
        """
        reach, tangent, across = jnp.zeros(3), clamp.tangent, clamp.across
        if self.compliance is not None:
            axes = clamp.axes
            own = _along(axes, wrench)
            yields = jnp.sum(self.compliance * own, axis=1)
            reach, angle = (
                sum(yields[first + i] * axis for i, axis in enumerate(axes)) for first in (0, 3)
            )
            tangent, across = turned(angle, tangent), turned(angle, across)
        curved = self.steps.local.rest is not None
        return State(reach, tangent, jnp.zeros(()), across if curved else None)

    def _slope(
        self, origin: Vector, push: Push, s: Scalar, at: State, local: Stage, h: Scalar = 0.0
    ) -> State:
        """Derivatives along the rod."""
        t, load = at.tangent, at.load
        m = _moment(push, at)
        square, about = dot(m, m), dot(m, t)
        # Behind a contact the force may curl up a thin tip: no further than a step resolves.
        soft = local.softness
        soft = soft / jnp.maximum(1.0, h * soft * jnp.sqrt(square + _TINY) / _LARGEST_TURN)
        twisting = local.twisting * about
        energy = (soft * square + twisting * about) / 2
        bend, across, rates, sunk = soft * jnp.cross(m, t), None, None, None
        if at.across is not None:
            d1, d2 = at.across, jnp.cross(t, at.across)
            u1, u2, u3 = local.rest
            bend = bend + u2 * d1 - u1 * d2
            across = soft * jnp.cross(m, d1) + (twisting + u3) * d2 - u2 * t
        if load is not None:
            assert self.load is not None
            q = self.load.per_length(s, origin + at.reach, t, local.loaded)
            rates, sunk = joined(-q, -jnp.cross(t, load[:3])), -dot(load[:3], t)
        return State(t, bend, energy, across, rates, sunk)

    def _step(
        self,
        origin: Vector,
        push: Push,
        at: State,
        start: Scalar,
        h: Scalar,
        stages: Stage,
    ) -> tuple[State, State, Scalar]:
        """One step from an arc length; the slope where it begins, and its estimated error. The
        section is given at the stages.
        """
        after, first, slopes = stepped(
            lambda s, here, local: self._slope(origin, push, s, here, local, h),
            at,
            start,
            h,
            stages,
            self.steps.scheme,
        )
        # Reach and tangent come first.
        return after, first, error_of_order_8(h, slopes[:, :6])

    @_traced_once
    def line(self, clamp: Clamp, push: Push, load: Wrench | None = None) -> Line:
        """The rod under a contact force that acts at or beyond its tip; with loads, Q and their
        moment about the clamp point at s = 0.
        """
        wrench = joined(push.force, push.moment)
        first = self.base(clamp, wrench if load is None else wrench + load)
        if load is not None:
            moment = load[3:] - jnp.cross(first.reach, load[:3])
            sunk = -dot(load[:3], first.reach)
            first = first._replace(load=joined(load[:3], moment), sunk=sunk)
        return self._run(clamp.point, push, first, jnp.asarray(self.steps.nodes))

    def _run(
        self,
        origin: Vector,
        push: Push,
        first: State,
        stops: Array,
        begin: Any = 0,
        part: Stage | None = None,
    ) -> Line:
        """From a state on, given at the stop `begin`: stops lie at the nodes or, where the rod
        begins behind them, at its beginning, where rates are not known. Of the first step there may
        be only a part, whose stages are given.
        """
        steps = len(self.steps.nodes) - 1
        count = jnp.sum(self.steps.nodes[:-1] < self.steps.nodes[-1])

        def advance(index: Array, state: tuple[State, Any]) -> tuple[State, Any]:
            at, rows = state
            (start, end), stages = rows_from(stops, index, 2), row_of(self.steps.stages, index)
            if part is not None:
                stages = jax.tree.map(partial(jnp.where, index == begin), part, stages)
            after, *told = self._step(origin, push, at, start, end - start, stages)
            return after, with_row(rows, (at, *told), index)

        blank = first, jax.tree.map(jnp.zeros_like, first), jnp.zeros(())
        rows = jax.tree.map(lambda part: jnp.broadcast_to(part, (steps, *part.shape)), blank)
        last, (states, rates, errors) = lax.fori_loop(begin, count, advance, (first, rows))
        tip = jax.tree.map(lambda part: jnp.sum(part[-1], axis=0), self.steps.local)
        end = last, self._slope(origin, push, stops[-1], last, stage_of(tip))
        done = jnp.arange(steps) < count

        def ended(rows: Array, end: Array) -> Array:
            run = done.reshape(-1, *(1,) * end.ndim)
            return jnp.concatenate([jnp.where(run, rows, end), end[None]])

        states, rates = jax.tree.map(ended, (states, rates), end)
        return Line(stops, states, rates, jnp.append(0.0, jnp.cumsum(errors)))

    def _strain(self, line: Line, push: Push) -> Float[Array, "nodes"]:
        """Elastic curvature [1/L] at the nodes."""
        m = jax.vmap(lambda at: _moment(push, at))(line.states)
        across = jnp.cross(m, line.tangent)
        bending = jnp.append(self.steps.local.bending[:, 0], jnp.sum(self.steps.local.bending[-1]))
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

    @_traced_once
    def _at(self, inner: Inner, s: Scalar) -> State:
        """The rod at an arc length, by a step from the node before it; straight beyond the tip."""
        line, clamp, push, *_ = inner
        place, step, x = line.between(s)
        before, start, own = row_of((line.states, line.nodes, self.steps.local), place)
        stages = at_stages(own, 0.0, x, self.steps.scheme.nodes)
        here, *_ = self._step(clamp.point, push, before, start, x * step, stages)
        return here._replace(reach=here.reach + jnp.maximum(s - 1.0, 0.0) * here.tangent)

    def _contact(self, inner: Inner, s: Scalar) -> State:
        """The rod at the contact, given its arc length."""
        return self._at(inner, s) if inner.here is None else inner.here

    def _rest(self, inner: Inner, s: Scalar, here: State) -> Line:
        """The rod behind a contact, given there, under loads: nodes before the contact all lie at
        it, without rates.
        """
        stops = jnp.clip(jnp.maximum(inner.line.nodes, s), 0.0, 1.0)
        # Steps before the contact have no length.
        place, _, x = inner.line.between(s)
        part = at_stages(row_of(self.steps.local, place), x, 1 - x, self.steps.scheme.nodes)
        return self._run(inner.clamp.point, _NO_PUSH, here, stops, place, part)

    def beyond(self, inner: Inner, s: Scalar) -> Line:
        """The rest of the rod, from the contact at s on: without loads it has its own shape."""
        if inner.rest is not None:
            return inner.rest
        here, whole = self._contact(inner, s), self.divided or self
        if self.loaded:
            return self._rest(inner, s, here)
        shape = whole.own_shape
        return shape.carried(whole._at(Inner(shape, AT_ORIGIN, _NO_PUSH), s), here)

    @property
    def own_shape(self) -> Line:
        """The rod that nothing loads, seen from its clamp."""
        return self.unloaded or replace(self, compliance=None).line(AT_ORIGIN, _NO_PUSH)

    def free(self, clamp: Clamp, resting: Resting | None = None) -> Free:
        """As in `RodModel`."""
        if not self.loaded:
            return Unloaded(clamp, (self.divided or self).own_shape)
        if resting is None:
            return self._hanging(clamp)
        load = jnp.asarray(resting.load)
        return Hanging(clamp, self.line(clamp, _NO_PUSH, load), load, resting.sound)

    def _under(self, clamp: Clamp, load: Wrench, share: Any) -> Line:
        """The rod without contact under a share of its load, of given resultants."""
        assert self.load is not None
        rod = replace(self, load=Share(self.load, jnp.asarray(share)))
        return rod.line(clamp, _NO_PUSH, load)

    def _hanging(self, clamp: Clamp) -> Hanging:
        load, found = grown(_at_tip, self, clamp)
        line = self._under(clamp, load, 1.0)
        return Hanging(clamp, line, load, found & (line.error[-1] < _LARGEST_ERROR))

    def bent(
        self,
        clamp: Clamp,
        point: Vector,
        force: Scalar,
        direction: Vector,
        own: Own = (),
        reached: Vector | None = None,  # noqa: ARG002
        near: Scalar | None = None,
    ) -> Bent:
        """As in `RodModel`: the contact is where the rod comes closest to the point. Loads leave no
        force and no moment at the tip: their resultants at the clamp, as far as these are not
        known, are the model's own unknowns.
        """
        r, along = point - clamp.point, force * direction
        push = Push(along, jnp.cross(r, along))
        load = (own if self.pull is None else joined(self.pull, own)) if self.loaded else None
        line = self.line(clamp, push, load)
        inner, s = Inner(line, clamp, push), closest(line, r, near)
        here = self._at(inner, s)
        first, away, tangent = across_of(here.tangent), r - here.reach, here.tangent
        misses = joined(dot(away, jnp.cross(tangent, first)), dot(away, first))
        # From the closest point of what is interpolated to that of what is as exact as the nodes.
        along = dot(away, tangent)
        here = line.along(here, s, along)
        s, incidence = s + along, (1 + dot(here.tangent, direction)) / 2
        inner = inner._replace(here=here)
        if load is not None:
            rest = self._rest(inner, s, here)
            left = rest.states.load[-1, 6 - self.unknowns :]
            inner, misses = inner._replace(rest=rest), joined(misses, left)
        return Bent(point, r, force, direction, misses, s, incidence, inner, load)

    def tangent(self, bent: Bent) -> Vector:
        """As in `RodModel`."""
        tangent: Vector = bent.inner.here.tangent
        return tangent

    def energy(self, bent: Bent) -> Scalar:
        """As in `RodModel`; with that of twist."""
        if self.load is None:
            energy: Scalar = self._contact(bent.inner, bent.arc_length).energy
        else:
            energy = self.beyond(bent.inner, bent.arc_length).states.energy[-1]
        return energy

    def potential(self, bent: Bent) -> Scalar:
        """As in `RodModel`; loads that depend on the rod's place count as if they did not."""
        potential = self.energy(bent)
        if self.compliance is not None:
            own = _along(bent.inner.clamp.axes, joined(bent.support_force, bent.base_moment))
            potential += dot(own, jnp.sum(self.compliance * own, axis=1)) / 2
        if self.load is not None:
            potential += self.beyond(bent.inner, bent.arc_length).states.sunk[-1]
        return potential

    def largest_curvature(self, bent: Bent) -> Scalar:
        """As in `RodModel`: the largest at a node."""
        line = bent.inner.line
        bend = jnp.sqrt(jnp.sum(line.rates.tangent**2, axis=1))
        return jnp.max(jnp.where(line.nodes <= bent.arc_length + _ROUNDING, bend, 0.0))

    def largest_bend(self, bent: Bent) -> Scalar:
        """As in `RodModel`: the largest at a node."""
        line = bent.inner.line
        at = self._strain(line, bent.inner.push)
        if self.steps.local.girth is not None:
            girth = self.steps.local.girth
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
            own = row_of((self.steps.local.bending, self.steps.local.torsion), place)
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
        # It begins where `points` do.
        shift = bent.inner.line.at(s)[0] - rest.at(s)[0]
        points: Float[Array, "n 3"] = jax.vmap(
            lambda part: clamp + shift + rest.at(s + part * place)[0]
        )(jnp.asarray(share))
        return points

    @property
    def candidates(self) -> int:
        """As in `RodModel`: a straight rod would have to be bent to and fro to have several."""
        return 1 if self.steps.local.rest is None else _CANDIDATES

    @_traced_once
    def contact(
        self,
        force: Vector,
        moment: Vector,
        clamp: Clamp,
        which: Int[Any, ""] | int = 0,
    ) -> Contact:
        """As in `RodModel`: a place along the rod where the moment in it is least, once that of the
        loads behind it is taken off.
        """
        crossing, _ = self._crossings(clamp, Push(-force, -moment))
        return crossing(which)

    @_traced_once
    def contacts(self, force: Vector, moment: Vector, clamp: Clamp) -> Contact:
        """As in `RodModel`."""
        crossing, count = self._crossings(clamp, Push(-force, -moment))
        none: Contact = jax.tree.map(
            lambda part: jnp.full((self.candidates, *part.shape), jnp.nan),
            jax.eval_shape(crossing, 0),
        )

        def put(which: Array, found: Contact) -> Contact:
            return with_row(found, crossing(which), which)

        found: Contact = lax.fori_loop(0, jnp.minimum(count, self.candidates), put, none)
        return found

    def _crossings(
        self, clamp: Clamp, push: Push
    ) -> tuple[Callable[[Any], Contact], Int[Array, ""]]:
        """The contact at a crossing of the rod and the force's line of action, in order, and up to
        how many there are.
        """
        if self.load is not None:
            return self._loaded_crossings(clamp, push)
        line, f = self.line(clamp, push), jnp.sqrt(dot(push.force, push.force))

        def falling(s: Scalar) -> tuple[Scalar, Scalar]:
            at, along, bend = line.curve(s)
            inside, lever = push.moment - jnp.cross(at, push.force), jnp.cross(along, push.force)
            rate = dot(lever, lever) - dot(jnp.cross(bend, push.force), inside)
            return -dot(lever, inside) / (f * f), rate / (f * f)

        inside = push.moment - jnp.cross(line.reach, push.force)
        slopes = -jnp.sum(jnp.cross(line.tangent, push.force) * inside, 1) / (f * f)
        return lambda which: self._crossing(
            Inner(line, clamp, push), zero(falling, line, slopes, which)
        ), most_zeros(slopes)

    def _crossing(self, inner: Inner, s: Scalar) -> Contact:
        """The contact near an arc length, without loads."""
        line, _, push, *_ = inner
        f, here = jnp.sqrt(dot(push.force, push.force)), self._at(inner, s)
        at, along = here.reach, here.tangent
        lever, inside = jnp.cross(along, push.force) / f, push.moment - jnp.cross(at, push.force)
        # Before the next step: where rod and force are parallel, that step goes anywhere.
        gap = jnp.sqrt(dot(inside, inside)) / f
        # From what is interpolated to what is as exact as the nodes.
        step = dot(lever, inside) / (f * dot(lever, lever))
        *_, bend = line.curve(s)
        s, at, along = s + step, at + step * along, along + step * bend
        d = push.force / f
        incidence = (1 + dot(along, d)) / 2
        # Where rod and force cross at a small angle, the crossing moves further than the rod.
        error = self._error_at(inner, s) / jnp.sqrt(dot(lever, lever))
        return Contact(at, d, s, incidence, here.energy, gap, error=error)

    def _loaded_crossings(
        self, clamp: Clamp, push: Push
    ) -> tuple[Callable[[Any], Contact], Int[Array, ""]]:
        """Where the moment is that of the loads behind the contact: the place, and how their
        resultants differ from those on a rod that nothing but the reactions bends, by Newton's
        method. With the latter taken off, a single force is left of the reactions.
        """
        line = self.line(clamp, push, jnp.zeros(6))
        inner, last = Inner(line, clamp, push), row_of(line.states, len(line.nodes) - 1)
        weight = -last.load[:3]
        about = jnp.cross(last.reach, weight) - last.load[3:]
        single = Push(push.force - weight, push.moment - about)
        inside = single.moment - jnp.cross(line.reach, single.force)
        slopes = -jnp.sum(jnp.cross(line.tangent, single.force) * inside, 1)

        def asked(rows: Array) -> Array:
            """Without those of a force that is known."""
            return jnp.concatenate([rows[:1], rows[7 - self.unknowns :]])

        def left(unknowns: Float[Array, "k"]) -> tuple[Array, Any]:
            """The lever about the force, and what is left at the tip."""
            s, more = unknowns[0], joined(np.zeros(6 - self.unknowns), unknowns[1:])
            here = self._at(inner, s)
            t, beyond = here.tangent, jnp.maximum(s - 1.0, 0.0)
            force, moment = single.force - more[:3], _of_push(single, here.reach) - more[3:]
            own = joined(weight, about - jnp.cross(here.reach - beyond * t, weight))
            rest = self._rest(inner, s, here._replace(load=here.load + own + more))
            across = jnp.cross(t, force) / dot(force, force)
            # Slopes as if the rod behind were stiff, and its load the same wherever it is.
            by_place = dot(across, jnp.cross(t, single.force))
            levers = joined(by_place, np.zeros(3), across)
            lever = -cross_matrix(rest.reach[-1] - here.reach)
            moments = jnp.concatenate([np.zeros((3, 1)), lever, np.eye(3)], axis=1)
            stiff = jnp.concatenate([levers[None], np.eye(3, 7, 1), moments])
            told = here, force, moment, rest.states.energy[-1], rest.error[-1]
            value = joined(-dot(across, moment), rest.states.load[-1])
            return asked(value), (asked(asked(stiff).T).T, told)

        def crossing(which: Any) -> Contact:
            start = joined(zero(None, line, slopes, which), jnp.zeros(self.unknowns))
            unknowns, (here, force, moment, energy, error) = balanced(left, start)
            f, reach = jnp.sqrt(dot(force, force)), here.reach
            total = joined(-push.force, -push.moment)
            load = total + joined(force, jnp.cross(reach, force) + moment)
            incidence = (1 + dot(here.tangent, force) / f) / 2
            gap = jnp.sqrt(dot(moment, moment)) / f
            lever = jnp.cross(here.tangent, force) / f
            error = (self._error_at(inner, unknowns[0]) + error) / jnp.sqrt(dot(lever, lever))
            return Contact(reach, force / f, unknowns[0], incidence, energy, gap, load, error)

        return crossing, most_zeros(slopes)


def _pulls(load: Load, steps: Steps) -> Float[Array, "steps 3"]:
    """Resultants on each step of a load that depends on the arc length alone."""
    h, none = jnp.diff(steps.nodes), jnp.zeros(3)
    s = steps.nodes[:-1, None] + h[:, None] * steps.scheme.nodes

    def at(s: Scalar, loaded: Any) -> Vector:
        return load.per_length(s, none, none, loaded)

    q = jax.vmap(jax.vmap(at))(s, steps.stages.loaded)
    return h[:, None] * jnp.sum(steps.scheme.weights[:, None] * q, axis=1)


def _rough_steps(pulls: Float[Array, "steps 3"], steps: Steps) -> Scalar:
    """Steps of order 5 that give slopes of a rod under such loads to a thirtieth: with λ = √(W/B)
    for a uniform rod of weight W, what is changed at the clamp grows as exp λ up to the tip, and so
    does the error of n steps, about n (λ/n)⁶/6!.
    """
    behind = jnp.cumsum(pulls[::-1], axis=0)[::-1]
    weight = jnp.sqrt(jnp.sum(behind**2, axis=1)) / steps.local.bending[:, 0]
    # λ = ∫ 3/2 √(W(s)/B) ds, also for others.
    rate = 1.5 * jnp.sum(jnp.diff(steps.nodes) * jnp.sqrt(weight))
    return jnp.ceil((rate**6 * jnp.exp(rate) * _ROUGH / math.factorial(6)) ** 0.2)


def _at_tip(load: Wrench, share: Any, rod: Kirchhoff, clamp: Clamp) -> tuple[Tip, Scalar]:
    """What a share of a rod's load leaves at its tip, and the rod's largest elastic curvature."""
    line = rod._under(clamp, load, share)
    return Tip(line.states.load[-1], line.tangent[-1]), jnp.max(rod._strain(line, _NO_PUSH))


def _along(axes: tuple[Vector, ...], wrench: Wrench) -> Wrench:
    """A wrench's parts along axes."""
    return joined(*(dot(part, axis) for part in (wrench[:3], wrench[3:]) for axis in axes))


def _moment(push: Push, at: State) -> Vector:
    """Moment in the rod."""
    m = _of_push(push, at.reach)
    return m if at.load is None else m + at.load[3:]


def _of_push(push: Push, reach: Vector) -> Vector:
    """Its moment about a point."""
    m: Vector = push.moment - jnp.cross(reach, push.force)
    return m
