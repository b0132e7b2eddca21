"""The sweep with friction: the march, single stretches with care, and events. A state has a memory,
so that steps only go forward.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float, Int

from vibrissa.contacts import Status
from vibrissa.forward.equations import Clamp, Scene
from vibrissa.forward.events import EventKind
from vibrissa.forward.friction import UNKNOWNS, Rub, rub, rubbing_state
from vibrissa.forward.landing import (
    AFTER_CONTACT,
    CLEAR,
    MOST_CHANGES,
    NO_FORCE,
    Outcome,
    clearance_at,
    failed,
    first_contact_on,
    settled_at_the_end,
    settled_on,
)
from vibrissa.forward.locate import WIDTH as EVENT_LANES
from vibrissa.forward.locate import Indicator
from vibrissa.forward.march import (
    JUMP,
    JUMP_FLOOR,
    TOLERANCE,
    Mode,
    Solved,
    Solver,
    iterated,
    marching,
)
from vibrissa.forward.path import clamp_between
from vibrissa.forward.search import ENERGY_MARGIN, Equilibrium
from vibrissa.mechanics.elastica import bending_energy
from vibrissa.numerics.blocks import AnyArray
from vibrissa.numerics.bracket import bracketed_root
from vibrissa.numerics.compiled import compiled

Scalar = Float[Array, ""]
Stretch = Float[np.ndarray, "14"]
State = Float[np.ndarray, "11"]

_MOST_ITERATIONS = 25
_SHORTEST_STEP = 2.0**-20
# The guess improves with the bracket, so that few steps are enough.
_ITERATIONS = 4


def _with_friction(
    scene: Scene, guess: Array, clamp: Clamp, active: Array, before: Array, _clamp_before: Array
) -> Solved:
    """Position and force are extrapolated; the tangential force starts from where it was, for
    sliding may stop or turn.
    """
    rubbed = jax.vmap(rub, in_axes=(None, 1, 1, 1), out_axes=Rub(1, 0, 0, 0))  # type: ignore[arg-type]
    start = jnp.concatenate([guess[:4], before[4:]])
    return iterated(
        lambda x: Solved(*rubbed(scene, x[:UNKNOWNS], clamp, before)),
        start,
        active,
        _MOST_ITERATIONS,
    )


march_rubbing = marching(Solver(_with_friction, branch=False))


class _Step(NamedTuple):
    """A state reached within a stretch."""

    x: State
    beyond: float
    phase: float


@compiled
def _rubbed(
    scene: Scene,
    stretch: Float[AnyArray, "14"],
    fraction: Float[AnyArray, ""] | float,
    before: Float[AnyArray, "11"],
) -> Float[Array, "14"]:
    clamp = clamp_between(jnp.asarray(stretch), jnp.asarray(fraction))
    lanes = Clamp(clamp.point[:, None], clamp.tangent[:, None])
    start = jnp.asarray(before)[:, None]
    solved = _with_friction(scene, start, lanes, jnp.ones(1, dtype=bool), start, lanes.point)
    return jnp.concatenate([solved.x[:, 0], solved.residual, solved.figure, solved.phase])


@compiled
def _figures(
    scene: Scene,
    stretch: Float[AnyArray, "14"],
    fraction: Float[AnyArray, ""] | float,
    y: Float[AnyArray, "7"],
) -> Float[Array, "6"]:
    """Energy, s₁, tangent, and phase of a state."""
    state = rubbing_state(
        scene, jnp.asarray(y), clamp_between(jnp.asarray(stretch), jnp.asarray(fraction))
    )
    return jnp.concatenate(
        [
            jnp.stack([bending_energy(state.rod, y[3]), state.rod.arc_length]),
            state.tangent,
            state.phase[None],
        ]
    )


def follow_rubbing(scene: Scene, stretch: Stretch, mode: Mode, x: State) -> Outcome:
    """Resolve a stretch from mode FREE or CONTACT (with x) at its start; with mode LOST only its
    end is known, and the contact is taken to be at rest there.
    """
    outcome = Outcome(mode, x)
    if mode == Mode.LOST:
        _at_rest_at_the_end(scene, stretch, outcome)
        if outcome.mode == Mode.CONTACT:
            outcome.happened.append((EventKind.STARTED_IN_CONTACT, 1.0, outcome.x[:3]))
        return outcome
    fraction = 0.0
    here = _Step(x, 0.0, 0.0) if mode == Mode.CONTACT else None
    if here is not None:
        here = here._replace(
            phase=float(_figures(scene, stretch, 0.0, x[:UNKNOWNS])[5]), beyond=_slides(scene, x)
        )
    for _ in range(MOST_CHANGES):
        if here is None:
            outcome.mode = Mode.FREE
            met = first_contact_on(scene, stretch, fraction, outcome)
            if met is None:
                return outcome
            fraction = met.fraction
            here = _Step(
                np.concatenate([met.point, np.zeros(UNKNOWNS - 3), [met.arc_length], met.tangent]),
                -float(scene.friction),
                np.nan,
            )
        reason, fraction, here = _rub_along(scene, stretch, fraction, here, outcome)
        if reason == "arrived":
            return _arrived(outcome, here)
        if reason == "released":
            outcome.happened.append((EventKind.DETACH, fraction, here.x[:3]))
            here = None
            continue
        if here.x[3] <= NO_FORCE:
            # The straight rod met the object along a line or at an edge: the contact begins
            # elsewhere than where it was first seen.
            here, fraction = _begun(scene, stretch, fraction, here.x[:3])
            if here is None:
                return _at_rest_at_the_end(scene, stretch, outcome)
            continue
        outcome.happened.append((EventKind.SNAP, fraction, here.x[:3]))
        energy, last = float(_figures(scene, stretch, fraction, here.x[:UNKNOWNS])[0]), here.x[:3]
        here = None
        if clearance_at(scene, stretch, fraction) < CLEAR:
            here = _at_rest(scene, stretch, fraction, energy - ENERGY_MARGIN, [last])
            if here is None:
                return _at_rest_at_the_end(scene, stretch, outcome)
    return failed(outcome, Status.NOT_CONVERGED)


def _at_rest_at_the_end(scene: Scene, stretch: Stretch, outcome: Outcome) -> Outcome:
    found = settled_at_the_end(scene, stretch, outcome)
    return outcome if found is None else _arrived(outcome, _resting(scene, stretch, 1.0, found))


def _slides(scene: Scene, x: State) -> float:
    """Stand-in for the cone's figure where the step before is not known: positive on the cone,
    negative inside.
    """
    return float(np.linalg.norm(x[4:UNKNOWNS]) - scene.friction * (1 - 1e-9))


def _at_rest(
    scene: Scene,
    stretch: Stretch,
    fraction: float,
    energy: float,
    near: list[Float[np.ndarray, "3"]],
) -> _Step | None:
    """Behind a snap, or where nothing is known of the past: the equilibrium without tangential
    force.
    """
    found = settled_on(scene, stretch, fraction, energy, near)
    return None if found is None else _resting(scene, stretch, fraction, found)


def _resting(scene: Scene, stretch: Stretch, fraction: float, found: Equilibrium) -> _Step:
    y = np.append(found.x, np.zeros(3))
    figures = np.asarray(_figures(scene, stretch, fraction, y))
    return _Step(np.concatenate([y, figures[1:5]]), -float(scene.friction), float(figures[5]))


def _begun(
    scene: Scene, stretch: Stretch, fraction: float, near: Float[np.ndarray, "3"]
) -> tuple[_Step | None, float]:
    """The equilibrium of least energy a little behind a first contact, at rest."""
    for ahead in AFTER_CONTACT:
        at = min(1.0, fraction + ahead)
        rest = _at_rest(scene, stretch, at, np.inf, [near])
        if rest is not None:
            return rest, at
    return None, fraction


def _rub_along(
    scene: Scene, stretch: Stretch, fraction: float, start: _Step, outcome: Outcome
) -> tuple[str, float, _Step]:
    """Forward from `fraction` to the end, a loss of contact, or where no neighbouring state is
    left; steps are halved where one fails.
    """
    motion = float(
        np.linalg.norm(stretch[7:10] - stretch[:3])
        + 2 * np.linalg.norm(stretch[10:] - stretch[3:7])
    )
    here, step = start, (1 - fraction) / 2
    while fraction < 1:
        target = min(1.0, fraction + step)
        values = np.asarray(_rubbed(scene, stretch, target, here.x))
        following, residual = (
            _Step(values[:11], float(values[12]), float(values[13])),
            float(values[11]),
        )
        moved = float(np.linalg.norm(following.x[:3] - here.x[:3]))
        if not residual <= TOLERANCE or moved > JUMP_FLOOR * step + JUMP * motion * step:
            step /= 2
            if step < _SHORTEST_STEP:
                return "snapped", fraction, here
            continue
        if following.x[3] < 0:
            release = _root(scene, stretch, fraction, here, target, following, Indicator.FORCE)
            if clearance_at(scene, stretch, release[0]) < -1e-6:
                step /= 2
                if step < _SHORTEST_STEP:
                    return "snapped", fraction, here
                continue
            return (
                "released",
                float(release[0]),
                _Step(release[1:], following.beyond, following.phase),
            )
        _changes(scene, stretch, fraction, here, target, following, outcome)
        fraction, here, step = target, following, 2 * step
    return "arrived", 1.0, here


def _changes(
    scene: Scene,
    stretch: Stretch,
    low: float,
    here: _Step,
    high: float,
    following: _Step,
    outcome: Outcome,
) -> None:
    pairs = (
        (
            here.phase,
            following.phase,
            Indicator.PHASE,
            EventKind.TIP_TO_TANGENTIAL,
            EventKind.TANGENTIAL_TO_TIP,
        ),
        (
            here.beyond,
            following.beyond,
            Indicator.CONE,
            EventKind.STICK_TO_SLIP,
            EventKind.SLIP_TO_STICK,
        ),
    )
    happened = []
    for before, after, indicator, rises, falls in pairs:
        if np.isfinite(before) and (before > 0) != (after > 0):
            row = _root(scene, stretch, low, here, high, following, indicator)
            happened.append((rises if after > 0 else falls, float(row[0]), row[1:4]))
    outcome.happened.extend(sorted(happened, key=lambda happening: happening[1]))


def _root(
    scene: Scene,
    stretch: Stretch,
    low: float,
    here: _Step,
    high: float,
    following: _Step,
    indicator: Indicator,
) -> Float[np.ndarray, "12"]:
    ends = []
    for fraction, step in ((low, here), (high, following)):
        ends.append(
            np.concatenate([[fraction], step.x, [(step.x[3], step.phase, step.beyond)[indicator]]])
        )
    return roots_rubbing(
        scene, stretch[None], np.concatenate(ends)[None], np.array([int(indicator)])
    )[0]


def _arrived(outcome: Outcome, at: _Step) -> Outcome:
    outcome.mode, outcome.x, outcome.figure, outcome.phase = Mode.CONTACT, at.x, at.beyond, at.phase
    return outcome


def roots_rubbing(
    scene: Scene,
    stretches: Float[np.ndarray, "k 14"],
    ends: Float[np.ndarray, "k 26"],
    indicator: Int[np.ndarray, "k"],
) -> Float[np.ndarray, "k 12"]:
    """Fraction and state where the indicator is zero, each a step from the state at the first end."""
    found = scene.in_blocks(_locate, stretches, ends, indicator, width=EVENT_LANES)
    # Where a step on the way does not converge, as next to a contact that jumps, what lies between
    # the ends in proportion.
    before, after = ends[:, 12], ends[:, 25]
    share = (before / np.where(before == after, 1.0, before - after))[:, None]
    between = ends[:, :12] + share * (ends[:, 13:25] - ends[:, :12])
    return np.where(np.isfinite(found).all(axis=1, keepdims=True), found, between)


@compiled
def _locate(
    scene: Scene,
    stretches: Float[Array, "blocks 14 width"],
    ends: Float[Array, "blocks 26 width"],
    indicator: Int[Array, "blocks width"],
) -> Float[Array, "blocks 12 width"]:
    def one(
        stretch: Float[Array, "14"], ends: Float[Array, "26"], indicator: Int[Array, ""]
    ) -> Float[Array, "12"]:
        low, before, high, after = ends[0], ends[1:12], ends[13], ends[14:25]

        def solved(
            fraction: Scalar, guess: Float[Array, "11"]
        ) -> tuple[Scalar, Float[Array, "11"]]:
            clamp = clamp_between(stretch, fraction)

            def iterate(_: Array | int, state: tuple[Array, Array]) -> tuple[Array, Array]:
                step = rub(scene, state[0][:UNKNOWNS], clamp, before)
                return step.x, jnp.stack([step.x[3], step.phase, step.beyond])

            x, figures = lax.fori_loop(0, _ITERATIONS, iterate, (guess, jnp.zeros(3)))
            return figures[indicator], x

        fraction, x = bracketed_root(solved, (low, high), (ends[12], ends[25]), (before, after))
        return jnp.concatenate([jnp.stack([fraction]), x])

    return lax.map(
        lambda block: jax.vmap(one, in_axes=(1, 1, 0), out_axes=1)(*block),
        (stretches, ends, indicator),
    )
