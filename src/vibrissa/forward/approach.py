"""First contact of the free rod with the object: geometry, but for loads that bend it.

Either the tip touches first, or the flank, where the rod meets the object tangentially.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Bool, Float, Int

from vibrissa.contact import Reached, Scene, State
from vibrissa.forward.path import Path, Stretch, chosen
from vibrissa.geometry.rotation import lengths
from vibrissa.mechanics.elastica import Elastica
from vibrissa.mechanics.free import at_rest
from vibrissa.mechanics.model import NEUTRAL, Clamp, Resting
from vibrissa.numerics.bracket import roots
from vibrissa.numerics.lanes import FEW, lanes
from vibrissa.numerics.vectors import dot

Scalar = Float[Any, ""]

CLEAR = -1e-10
"""Least clearance [L] at which the free rod counts as outside the object: rounding."""
HEAD_ON_COSINE = -1 + 1e-9
"""Cosine between normal and rod below which the rod meets the object along its own axis; the margin
is the rounding of a normal.
"""
_SAMPLES = 16
_REFINEMENTS = 16
"""Newton steps, kept within a bracket: bisection alone would get to 3e-5 of the spacing."""
_STILL = 1e-12
"""Step [L] that, at the minimum, changes the level by no more than rounding."""
_FREE_POINTS = 193
"""Points between which a free rod is interpolated linearly, to 3e-6 L where it is curved by 1/L."""
_LOOKS = 16
"""Parts into which a step near the object is divided, so as not to pass through something thin."""


class Clearance(NamedTuple):
    """How close the free rod comes to the object."""

    distance: Scalar
    """Smallest first-order distance [L], negative inside the object."""
    arc_length: Scalar
    """Where along the rod that is [L]."""
    at_clamp: Scalar
    """Level function at the clamp."""
    cosine: Scalar
    """Cosine between the object's normal there and the rod's skin: −1 is head-on."""
    point: Float[Any, "3"]
    tangent: Float[Any, "3"]
    """Of the rod there."""
    own: Float[Any, "own"]
    """The rod's own unknowns."""
    sound: Bool[Any, ""]
    """Whether it has a stable shape."""


class _Looked(NamedTuple):
    """Level and its gradient at one arc length of the free rod."""

    arc_length: Scalar
    value: Scalar
    gradient: Float[Array, "3"]
    point: Float[Array, "3"]
    tangent: Float[Array, "3"]
    leaning: Scalar
    """How fast the rod gets thinner there."""


class _Refined(NamedTuple):
    """The search for the lowest level along the rod: where it evaluates next, between which ends,
    and its first and latest evaluations.
    """

    following: Scalar
    low: Scalar
    high: Scalar
    begin: _Looked
    here: _Looked
    looks: Array


def clearances(scene: Scene, clamps: Clamp) -> Clearance:
    """Clearance of the free rod at several clamp poses."""
    found: Clearance = _clearance(scene, clamps, at_rest(scene.rod, clamps))
    return found


@lanes(blocks=8, alone=FEW)
def _clearance(scene: Scene, clamp: Clamp, resting: Resting) -> Clearance:
    """Clearance of the free rod.

    The level function is sampled at 17 points; the lowest is refined by Newton's method on its
    derivative along the rod.
    """
    free = scene.rod.free(clamp, resting)
    samples = np.linspace(0, 1, _SAMPLES + 1)
    sampled = scene.each(scene.level, jax.vmap(lambda s: free.at(s)[0])(samples))
    sampled = sampled + (jax.vmap(scene.slack)(jnp.asarray(samples)) if scene.slims else 0.0)
    start = jnp.argmin(sampled) / _SAMPLES
    sloped = jax.value_and_grad(scene.level)

    def refine(state: _Refined) -> _Refined:
        s = state.following
        point, tangent, curved = free.at(s)
        (value, gradient), (first, bend) = jax.jvp(sloped, (point,), (tangent,))
        leaning = jnp.zeros(())
        if scene.slims:
            slack, leaning = jax.jvp(scene.slack, (s,), (jnp.ones(()),))
            value, first = value + slack, first + leaning
        here = _Looked(s, value, gradient, point, tangent, leaning)
        begin = jax.tree.map(partial(jnp.where, state.looks == 0), here, state.begin)
        second = dot(bend, tangent)
        second = second if curved is None else second + dot(gradient, curved)
        low, high = jnp.where(first < 0, s, state.low), jnp.where(first < 0, state.high, s)
        target = s - first / jnp.where(second > 0, second, 1.0)
        inside = (second > 0) & (target > low) & (target < high)
        following = jnp.where(inside, target, (low + high) / 2)
        return _Refined(following, low, high, begin, here, state.looks + 1)

    def moving(state: _Refined) -> Array:
        # The point that the last step leads to is evaluated too.
        moves = abs(state.following - state.here.arc_length) > _STILL
        return (state.looks == 0) | (moves & (state.looks <= _REFINEMENTS))

    ends = jnp.maximum(start - 1 / _SAMPLES, 0.0), jnp.minimum(start + 1 / _SAMPLES, 1.0)
    unknown = _Looked(start, sampled[0], *(clamp.tangent,) * 3, jnp.zeros(()))
    first = _Refined(start, *ends, unknown, unknown, jnp.zeros((), dtype=int))
    *_, begin, end, _ = lax.while_loop(moving, refine, first)
    found = jax.tree.map(partial(jnp.where, end.value <= begin.value), end, begin)
    steepness = jnp.sqrt(jnp.sum(found.gradient * found.gradient))
    cosine = dot(found.gradient, found.tangent) / steepness + found.leaning
    distance = found.value / steepness
    own, sound = -free.reactions[6 - scene.rod.unknowns :], jnp.asarray(free.sound)
    place = found.point, found.tangent
    return Clearance(distance, found.arc_length, sampled[0], cosine, *place, own, sound)


def free_rods(
    scene: Scene, clamps: Clamp
) -> tuple[Float[np.ndarray, "k n 3"], Float[np.ndarray, "k own"]]:
    """The free rod at several clamp poses: points at equally spaced arc lengths [L], and its own
    unknowns.
    """
    found: Any = _free_rods(scene, clamps, at_rest(scene.rod, clamps))
    points, own = found
    return points, own


@lanes(alone=FEW)
def _free_rods(
    scene: Scene, clamp: Clamp, resting: Resting
) -> tuple[Float[Array, "n 3"], Float[Array, "own"]]:
    free = scene.rod.free(clamp, resting)
    points = jax.vmap(lambda s: free.at(s)[0])(np.linspace(0, 1, _FREE_POINTS))
    return points, -free.reactions[6 - scene.rod.unknowns :]


def neutral(
    scene: Scene, clamps: Clamp, direction: Float[np.ndarray, "k 3"]
) -> Bool[np.ndarray, "k"]:
    """Whether nothing determines to which side rods bend: the force acts along the clamp's axis,
    and without contact they lie on it.
    """
    found = np.linalg.norm(np.cross(clamps.tangent, direction), axis=-1) < NEUTRAL
    rows = np.flatnonzero(found)
    if rows.size and not isinstance(scene.rod, Elastica):
        some = chosen(clamps, rows)
        points, _ = free_rods(scene, some)
        off = np.cross(some.tangent[:, None], points - some.point[:, None])
        found[rows] = np.linalg.norm(off, axis=-1).max(axis=-1) < NEUTRAL
    return found


class Meeting(NamedTuple):
    """First contact of the free rod on a stretch."""

    fraction: Scalar
    """Of the stretch."""
    point: Float[Any, "3"]
    arc_length: Scalar
    tangent: Float[Any, "3"]
    """Of the rod, which is still free."""
    cosine: Scalar
    """Cosine between normal and rod: −1 is head-on."""
    own: Float[Any, "own"]
    """The rod's own unknowns."""

    @property
    def phase(self) -> Float[Any, "*k"]:
        """As in `Touching`: at f = 0 the incidence is (1 + n·t0)/2."""
        return (1 - self.arc_length) + self.cosine / 2


def meetings_on(
    scene: Scene,
    stretches: Stretch,
    before: Float[np.ndarray, "k"],
    after: Float[np.ndarray, "k"],
) -> Meeting:
    """First contacts on stretches (k, …). The free rod has the clearance `before` at their
    start, where it is clear, and `after` at their end, where it is not.
    """

    def distance(
        fraction: Float[np.ndarray, "j n"], row: Int[np.ndarray, "j"]
    ) -> Float[np.ndarray, "j n"]:
        places = jax.tree.map(lambda part: part[row, None], stretches).clamps(fraction[..., None])
        flat = Clamp(*(part.reshape(-1, 3) for part in places))
        return clearances(scene, flat).distance.reshape(fraction.shape)

    count = len(stretches.first.point)
    fraction = roots(distance, (np.zeros(count), np.ones(count)), (before, after))
    clamp = stretches.clamps(fraction[:, None])
    at = clearances(scene, clamp)
    return Meeting(fraction, at.point, at.arc_length, at.tangent, at.cosine, at.own)


def begun(meeting: Meeting, unknowns: int) -> Reached:
    """States at first contact (k, …), still without force."""
    count = len(meeting.fraction)
    state = State(meeting.point, np.zeros(count), np.zeros((count, unknowns)), meeting.own)
    return Reached(state, meeting.arc_length, meeting.tangent)


class Meetings(NamedTuple):
    """First contacts on a path, one per row: on the step of a lane that ends at a position."""

    lane: Int[np.ndarray, "k"]
    position: Int[np.ndarray, "k"]
    at: Meeting


def along_path(scene: Scene, path: Path) -> Clearance:
    """Clearance of the free rod at all positions (m, n)."""
    clamps = Clamp(*(part.reshape(-1, 3) for part in path.clamps))
    shape = path.point.shape[:2]
    found = clearances(scene, clamps)
    return Clearance(*(part.reshape(*shape, *part.shape[1:]) for part in found))


def first_meetings(
    scene: Scene, path: Path, clear: Bool[np.ndarray, "m n"], distance: Float[np.ndarray, "m n"]
) -> Meetings:
    """First contacts that bend the rod, on steps from a clear position to one that is not, or
    across something thin.
    """
    lane, step = np.nonzero(clear[:, :-1] & ~clear[:, 1:])
    direct = lane, step + 1, np.ones(len(lane)), distance[lane, step + 1]
    thin = _passed_through(scene, path, clear, distance)
    lane, index, stop, after = (np.concatenate(parts) for parts in zip(direct, thin, strict=True))
    whole = path.stretch(lane, index)
    parts = whole.part(np.zeros((len(lane), 1)), stop[:, None])
    met = meetings_on(scene, parts, distance[lane, index - 1], after)
    met = met._replace(fraction=met.fraction * stop)
    return chosen(Meetings(lane, index, met), met.cosine > HEAD_ON_COSINE)


def _passed_through(
    scene: Scene, path: Path, clear: Bool[np.ndarray, "m n"], distance: Float[np.ndarray, "m n"]
) -> tuple[
    Int[np.ndarray, "k"], Int[np.ndarray, "k"], Float[np.ndarray, "k"], Float[np.ndarray, "k"]
]:
    """Steps between two clear positions on which the free rod passes through something thin:
    lane, index of the end, and the fraction at which it is first found inside, with the clearance
    there.
    """
    motion = lengths(np.diff(path.point, axis=1)) + lengths(np.diff(path.tangent, axis=1))
    near = clear[:, :-1] & clear[:, 1:] & (np.maximum(distance[:, :-1], distance[:, 1:]) < motion)
    lane, step = np.nonzero(near)
    fractions = np.arange(1, _LOOKS) / _LOOKS
    steps = jax.tree.map(lambda part: part[:, None], path.stretch(lane, step + 1))
    clamps = Clamp(*(part.reshape(-1, 3) for part in steps.clamps(fractions[:, None])))
    within = clearances(scene, clamps).distance.reshape(len(lane), _LOOKS - 1)
    hit = np.flatnonzero((within < CLEAR).any(axis=1))
    first = np.argmax(within[hit] < CLEAR, axis=1)
    return lane[hit], step[hit] + 1, fractions[first], within[hit, first]
