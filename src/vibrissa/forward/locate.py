"""Events between two positions: as roots of the conditions of contact together with what changes
sign, by Newton's method; or as bracketed roots along the stretch, where each evaluation solves an
equilibrium.
"""

from collections.abc import Callable
from enum import IntEnum
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from vibrissa.contact import Law, Reached, Scene, State, Touching, touching
from vibrissa.forward.march import SINGLE, Steps, entering, march
from vibrissa.forward.path import Stretch, chosen, either
from vibrissa.forward.solve import SHARP, newton
from vibrissa.geometry.rotation import lengths
from vibrissa.mechanics.model import RodModel
from vibrissa.numerics.bracket import roots
from vibrissa.numerics.lanes import WIDTH, lanes
from vibrissa.numerics.vectors import joined

Scalar = Float[Any, ""]

_SOUND = 1e-9
"""Residual, indicator included, up to which an event counts as found: on thin tips rounding leaves
2e-10, which is 1e-8 of a step.
"""

_NEARLY = 1e-6
"""The same where nothing better is found: where the slopes of the two phases are a thousandfold
apart, Newton's method may go to and fro across their kink, a few 1e-8 from it.
"""


class Indicator(IntEnum):
    """Which quantity changes sign."""

    FORCE = 0
    PHASE = 1
    CONE = 2


class Place(NamedTuple):
    """A state on a stretch, with its figure and phase as in `Steps`; or one per row."""

    fraction: Float[Any, "*k"]
    reached: Reached
    figure: Float[Any, "*k"]
    phase: Float[Any, "*k"]
    onward: Any = None
    """Unit tangent of the branch in weighted coordinates, where a branch is followed."""

    @property
    def indicators(self) -> Float[np.ndarray, "*k three"]:
        """Values of each `Indicator`."""
        return np.stack([self.reached.state.force, self.phase, self.figure], axis=-1)


class _Sought(NamedTuple):
    """Events (k, …): stretches, places before and behind them, where interpolation puts them, and
    what changes sign.
    """

    stretches: Stretch
    low: Place
    high: Place
    expected: Place
    indicator: Int[np.ndarray, "k"]


_Method: TypeAlias = Callable[[Scene, Law, _Sought], tuple[Place, Bool[np.ndarray, "k"]]]


def located(
    scene: Scene,
    law: Law,
    stretches: Stretch,
    low: Place,
    high: Place,
    indicator: Int[np.ndarray, "k"],
) -> Place:
    """Where indicators cross zero on stretches (k, …), between two places; by linear interpolation
    where neither method finds it, as next to a contact that jumps or when the rod comes to lie
    along a face.
    """
    before, after = (_indicated(end, indicator) for end in (low, high))
    found = _between(low, high, before / np.where(before == after, 1.0, before - after))
    sought = _Sought(stretches, low, high, found, indicator)
    methods: list[_Method] = [_bracketed]
    if law.branch:
        # Few are quicker found by code that is compiled already.
        methods.insert(int(len(indicator) <= WIDTH), _crossed)
        methods.append(_from_the_other_side)
    left = np.arange(len(indicator))
    for method in methods:
        if left.size:
            places, sound = method(scene, law, chosen(sought, left))
            jax.tree.map(partial(_put, left[sound]), found, chosen(places, sound))
            left = left[~sound]
    return found


def _indicated(place: Place, indicator: Int[np.ndarray, "k"]) -> Float[np.ndarray, "k"]:
    return np.take_along_axis(place.indicators, indicator[:, None], axis=1)[:, 0]


def _put(rows: Int[np.ndarray, "j"], whole: np.ndarray, part: np.ndarray) -> None:
    whole[rows] = part


def _crossed(scene: Scene, law: Law, sought: _Sought) -> tuple[Place, Bool[np.ndarray, "k"]]:
    """Roots of the conditions of contact and the indicator, near where they are expected; and which
    are sound: converged, between the places, and no further from there than these are apart. Their
    figures and phases are those expected.
    """
    stretches, low, high, expected, indicator = sought
    side = low.reached.state.point - stretches.at(low.fraction[:, None]).point
    start = expected.reached.state, expected.fraction
    found = _crossing((scene, law), stretches, start, side, indicator)
    before, at, between, after = (
        reached.state.point
        for reached in (low.reached, found.reached, expected.reached, high.reached)
    )
    sound = (found.residual <= _SOUND) & (lengths(at - between) <= lengths(after - before))
    sound &= (found.fraction >= low.fraction) & (found.fraction <= high.fraction)
    return expected._replace(fraction=found.fraction, reached=found.reached), sound


class _Crossing(NamedTuple):
    fraction: Scalar
    reached: Reached
    residual: Scalar


@lanes(alone=SINGLE, walks=True)
def _crossing(
    shared: tuple[Scene, Law],
    way: Stretch,
    start: tuple[State, Scalar],
    side: Float[Any, "3"],
    indicator: Int[Any, ""],
) -> _Crossing:
    """Where an indicator is zero on a stretch, near a state and fraction.

    The phase has a kink where it is zero, but (1 − s₁) − away = 0 together with min(1 − s₁, away) =
    0 is two smooth conditions, whichever of the two is less.
    """
    scene, law = shared
    of_force = indicator == Indicator.FORCE

    def conditions(y: Array, rod: RodModel, near: Scalar | None) -> tuple[Array, Touching]:
        own, state = scene._replace(rod=rod), State.of(y[:-1], rod.unknowns)
        found = touching(own, law, state, way.clamp(y[-1]), side=side, near=near)
        return joined(found.residual, jnp.where(of_force, state.force, found.phase)), found

    found = newton(scene.rod, law, conditions, joined(start[0].flat, start[1]), SHARP)
    state = State.of(found.x[:-1], scene.rod.unknowns)
    return _Crossing(found.x[-1], Reached(state, found.arc_length, found.tangent), found.residual)


def _bracketed(
    scene: Scene, law: Law, sought: _Sought, *, farther: bool = False, within: float = _SOUND
) -> tuple[Place, Bool[np.ndarray, "k"]]:
    """The same by bracketing: each equilibrium in between is one step from the first place or,
    without friction, from the one nearer to zero, or the one farther from it.
    """
    stretches, low, high, _, indicator = sought
    which = indicator[:, None, None]
    before, after = (_indicated(end, indicator) for end in (low, high))
    # With friction a state depends on its history; a branch has no memory.
    start = either(law.branch & ((np.abs(after) < np.abs(before)) != farther), high, low)

    def value(
        fraction: Float[np.ndarray, "j n"], row: Int[np.ndarray, "j"]
    ) -> Float[np.ndarray, "j n"]:
        way, begin = chosen((stretches, start), row)
        places, _ = stepped(scene, law, way, begin, fraction)
        return np.take_along_axis(places.indicators, which[row], axis=2)[..., 0]

    fraction = roots(value, (low.fraction, high.fraction), (before, after))
    places, residual = stepped(scene, law, stretches, start, fraction[:, None])
    found: Place = chosen(places, np.s_[:, 0])
    if not law.branch:
        # With friction an indicator may jump across zero.
        return found, np.isfinite(found.reached.state.flat_rows).all(axis=1)
    left = np.maximum(residual[:, 0], np.abs(_indicated(found, indicator)))
    return found, left <= within


_from_the_other_side = partial(_bracketed, farther=True, within=_NEARLY)


def _between(low: Place, high: Place, share: Float[np.ndarray, "k"]) -> Place:
    """Linear interpolation."""
    between: Place = jax.tree.map(
        lambda first, last: first + share.reshape(-1, *(1,) * (first.ndim - 1)) * (last - first),
        low,
        high,
    )
    return between


def stepped(
    scene: Scene, law: Law, way: Stretch, start: Place, fraction: Float[np.ndarray, "k n"]
) -> tuple[Place, Float[np.ndarray, "k n"]]:
    """States at fractions (k, n) of stretches (k, …), each one step of the march from the start,
    and their residuals before the last Newton step (k, n).
    """
    fractions = np.column_stack([start.fraction, fraction])
    clamps = jax.tree.map(lambda part: part[:, None], way).clamps(fractions[..., None])
    legs = entering(scene, law, clamps)._replace(
        reached=start.reached,
        sign=np.where(start.figure > 0, 1.0, -1.0),
        fanned=np.ones(len(fraction), dtype=bool),
        tolerance=np.full(len(fraction), SHARP),
    )
    steps = march(scene, law, legs)
    found: Steps = chosen(steps, np.s_[:, 1:])
    return Place(fraction, found.reached, found.figure, found.phase), found.residual
