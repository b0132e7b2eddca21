"""Rods under loads: what the loads are, their resultants at the clamp by Newton's method, and
whether the rod stands.
"""

from abc import abstractmethod
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Bool, Float

from vibrissa.mechanics.line import across_of
from vibrissa.numerics.derivatives import by_differences, implicit
from vibrissa.numerics.linear import solve_pivoted, solve_small
from vibrissa.numerics.vectors import dot, joined

Scalar = Float[Any, ""]
Vector = Float[Any, "3"]
Wrench = Float[Any, "6"]
Told = TypeVar("Told")

_STEPS, _NEAR, _ROUNDED, _SETTLED, _FOUND = 25, 1e-3, 1e-10, 1e-13, 1e-8
"""Most Newton steps to the loads' resultants, and sizes [EI/L²] of a step: from which on slopes are
kept, of rounding errors, that ends them, and up to which resultants count as found.
"""
_SLOW = 0.1
"""Fraction of the last step from which on slopes were not worth keeping."""
_HARDLY_BENT = 0.5
"""Largest elastic curvature [1/L] of a rod on which the moments at tip and clamp are alike."""
_LONGEST_STEP = 2.0
"""Change of the resultants [EI/L²] in one such step."""
_LARGEST_CHANGE, _FEW_STEPS = 0.5, 8
"""Change of the resultants [EI/L²] and Newton steps beyond which a share of the load is halved: at
four times the change, rods that are clamped nearly upright fall to the wrong side.
"""
_LEAST_SHARE, _MOST_TRIED = 1e-6, 2000
"""Share of the load below which none is tried, and most steps in all."""
_LARGEST_LOAD = 90.0
"""Force at the clamp [EI/L²] up to which a rod's shape is found: derivatives at the tip with
respect to the clamp grow as the exponential of its square root.
"""
_TINY = 1e-300


class Load(eqx.Module):
    """Force per length on the rod [EI/L³], world axes."""

    @property
    @abstractmethod
    def alike_everywhere(self) -> bool:
        """Whether it does not depend on the position."""

    @property
    @abstractmethod
    def given(self) -> bool:
        """Whether it depends on the arc length alone, so that its resultant is known."""

    @abstractmethod
    def per_length(self, s: Scalar, position: Vector, tangent: Vector, section: Any) -> Vector:
        """At an arc length and a position [L]; `section` holds whatever varies along the rod."""


class Share(Load):
    """A share of another load."""

    whole: Load
    share: Scalar

    @property
    def alike_everywhere(self) -> bool:
        """As in `Load`."""
        return self.whole.alike_everywhere

    @property
    def given(self) -> bool:
        """As in `Load`."""
        return self.whole.given

    def per_length(self, s: Scalar, position: Vector, tangent: Vector, section: Any) -> Vector:
        """As in `Load`."""
        return self.share * self.whole.per_length(s, position, tangent, section)


def balanced(
    left: Callable[[Array], tuple[Array, tuple[Array, Told]]], begin: Array
) -> tuple[Array, Told]:
    """Unknowns that leave nothing, by Newton's method from given ones. What is left comes with its
    slopes, as far as they are known, and with whatever else is told there: where these slopes do
    not do, differences are taken.
    """

    def unfinished(at: _Balance) -> Array:
        return ~at.settled & (at.steps < _STEPS)

    def refine(at: _Balance) -> _Balance:
        asked = jnp.where(at.fresh, len(at.x), 0)
        taken, (value, (known, told)) = by_differences(left, at.x, count=asked)
        slopes = jnp.where(at.fresh, taken, jnp.where(at.differs, at.slopes, known))
        change, _ = solve_small(slopes, value)
        size, differs = jnp.max(jnp.abs(change)), at.differs | at.fresh
        share = jnp.minimum(1.0, _LONGEST_STEP / jnp.maximum(size, _TINY))
        # Slow steps are those past a kink, as where a contact moves onto the tip; tiny ones that do
        # not become smaller are rounding errors.
        slow, tiny = size > _SLOW * at.size, size < _ROUNDED
        return _Balance(
            x=at.x - share * change,
            slopes=slopes,
            fresh=slow | (differs & (size > _NEAR)),
            differs=differs,
            size=size,
            settled=(size <= _SETTLED) | (slow & tiny) | jnp.isnan(size),
            steps=at.steps + 1,
            told=told,
        )

    _, (_, shapes) = jax.eval_shape(left, begin)
    none = jnp.zeros((), dtype=bool)
    start = _Balance(
        x=begin,
        slopes=jnp.zeros((len(begin),) * 2),
        fresh=none,
        differs=none,
        size=jnp.asarray(jnp.inf),
        settled=none,
        steps=jnp.zeros((), dtype=int),
        told=jax.tree.map(lambda part: jnp.zeros(part.shape, part.dtype), shapes),
    )
    last: _Balance = lax.while_loop(unfinished, refine, start)
    return last.x, last.told


class _Balance(NamedTuple):
    """Newton's method on its way."""

    x: Array
    slopes: Array
    fresh: Bool[Array, ""]
    """Whether slopes are to be taken by differences."""
    differs: Bool[Array, ""]
    """Whether they have been."""
    size: Scalar
    """Of the last step."""
    settled: Bool[Array, ""]
    steps: Array
    told: Any
    """Before that step."""


class Tip(NamedTuple):
    """What a rod under resultants at its clamp has at its tip: force and moment left [EI/L²,
    EI/L], and tangent; or derivatives of both (…, 6).
    """

    load: Wrench
    tangent: Vector


class _Growth(NamedTuple):
    """Resultants under a share of the load."""

    x: Wrench
    before: Wrench
    """Under the last share that was settled."""
    given: Scalar
    """That share."""
    more: Scalar
    """By how much more it is tried."""
    slopes: Tip
    """Derivatives with respect to the resultants."""
    tangent: Vector
    strain: Scalar
    size: Scalar
    """Of the last step."""
    steps: Array
    """Under this share."""
    tried: Array
    stood: Bool[Array, ""]
    """So far."""


def grown(at_tip: Callable[..., tuple[Tip, Scalar]], *of: Any) -> tuple[Wrench, Bool[Array, ""]]:
    """Resultants at the clamp that leave nothing at the tip, as the load grows from nothing, and
    whether the rod finds them and stands all the way. `at_tip` is given resultants, a share of the
    load, and whatever these depend on (`of`); it also returns the largest elastic curvature.
    """
    load, size = _grown(at_tip, *of)
    return load, (size < _FOUND) & (dot(load[:3], load[:3]) < _LARGEST_LOAD**2)


# Unlike `jax.lax.custom_root`, this costs no tracing where nobody asks for derivatives.
@eqx.filter_custom_jvp
def _grown(at_tip: Callable[..., tuple[Tip, Scalar]], *of: Any) -> tuple[Wrench, Scalar]:
    """The resultants, and the size of the last step; infinite if the rod does not stand.

    A share of the load is halved where it changes the resultants much or takes many steps.
    """

    def refine(at: _Growth) -> _Growth:
        share, fresh = at.given + at.more, at.size > _NEAR
        asked = jnp.where(fresh, len(at.x), 0)
        new, (tip, strain) = by_differences(lambda x: at_tip(x, share, *of), at.x, count=asked)
        slopes = jax.tree.map(partial(jnp.where, fresh), new, at.slopes)
        change, _ = solve_pivoted(slopes.load, tip.load)
        x, size = at.x - change, jnp.max(jnp.abs(change))
        near = size < _NEAR
        far = ~(jnp.max(jnp.abs(x - at.before)) < _LARGEST_CHANGE)
        far |= (at.steps > _FEW_STEPS) & ~near
        done = ~far & near & (share < 1)
        stood = at.stood & (~done | stands(slopes, tip.tangent, strain))
        more = jnp.where(far, at.more / 2, jnp.where(done, 2 * at.more, at.more))
        given = jnp.where(done, share, at.given)
        return _Growth(
            x=jnp.where(far, at.before, x),
            before=jnp.where(done, x, at.before),
            given=given,
            more=jnp.minimum(more, 1 - given),
            slopes=slopes,
            tangent=tip.tangent,
            strain=strain,
            size=jnp.where(far | done, jnp.inf, size),
            steps=jnp.where(far | done, 0, at.steps + 1),
            tried=at.tried + 1,
            stood=stood,
        )

    def unfinished(at: _Growth) -> Array:
        going = at.stood & (at.tried < _MOST_TRIED) & (at.more > _LEAST_SHARE)
        return going & (at.size > _SETTLED) & (at.steps < _STEPS)

    none, count = jnp.zeros(()), jnp.zeros((), dtype=int)
    start = _Growth(
        x=jnp.zeros(6),
        before=jnp.zeros(6),
        given=none,
        more=none + 1,
        slopes=Tip(jnp.zeros((6, 6)), jnp.zeros((3, 6))),
        tangent=jnp.zeros(3),
        strain=none,
        size=none + jnp.inf,
        steps=count,
        tried=count,
        stood=none == 0,
    )
    last: _Growth = lax.while_loop(unfinished, refine, start)
    stands_there = last.stood & stands(last.slopes, last.tangent, last.strain)
    return last.x, jnp.where(stands_there, last.size, jnp.inf)


def _grown_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Any, Any]:
    """Derivatives of the resultants, from those of what is left at the tip."""
    at_tip, of = primals[0], primals[1:]
    load, size = _grown(*primals)

    def left(load: Wrench, *of: Any) -> Wrench:
        return at_tip(load, 1.0, *of)[0].load

    _, rate = eqx.filter_jvp(partial(left, load), of, tangents[1:])
    moved = implicit(jax.jacfwd(left)(load, *of), rate[:, None])[:, 0]
    return (load, size), (moved, jnp.zeros_like(size))


_grown.def_jvp(_grown_jvp)  # type: ignore[no-untyped-call]


def stands(slopes: Tip, tangent: Vector, strain: Scalar) -> Bool[Array, ""]:
    """Whether a rod without contact is stable: whether small moments across its tip turn it their
    own way. Given are the derivatives of force and moment at the tip, and of its tangent, with
    respect to force and moment at the clamp.

    Under more than its second critical load an upright column answers in that way again; but while
    the rod is hardly bent, its clamp then has to hold against the moment's sense.
    """
    none = jnp.zeros(3)
    across = across_of(tangent)
    moments = across, jnp.cross(tangent, across)
    at_clamp = [solve_pivoted(slopes.load, joined(none, moment))[0] for moment in moments]

    def positive(answers: list[Vector]) -> Bool[Array, ""]:
        (a, b), (c, d) = ([dot(moment, answer) for answer in answers] for moment in moments)
        return (a > 0) & (a * d > ((b + c) / 2) ** 2)

    turns = [jnp.cross(tangent, slopes.tangent @ answer) for answer in at_clamp]
    hardly = strain < _HARDLY_BENT
    return positive(turns) & (positive([answer[3:] for answer in at_clamp]) | ~hardly)
