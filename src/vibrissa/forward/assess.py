"""What an equilibrium implies: reactions, energy, and the checks of the returned state."""

from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float

from vibrissa.contact import Law, Reached, Scene, State, touching
from vibrissa.forward.path import chosen
from vibrissa.mechanics.model import Bent, Clamp, is_neutral
from vibrissa.numerics.lanes import FEW, lanes

Scalar = Float[Any, ""]
Vector = Float[Any, "3"]


class Assessment(NamedTuple):
    """One equilibrium in model units; arrays when assessed in a batch."""

    point: Vector
    force: Scalar
    normal: Vector
    arc_length: Scalar
    support: Vector
    """Support force on the rod."""
    moment: Vector
    """Support moment on the rod."""
    energy: Scalar
    potential: Scalar
    """As in `RodModel`."""
    largest_curvature: Scalar
    """Along the rod [1/L]."""
    largest_bend: Scalar
    """As in `RodModel`."""
    phase: Scalar
    residual: Scalar
    depth: Scalar
    """Upper bound on how deep the elastic line enters the object [L]; rounding where it does not,
    otherwise left to `deepest`.
    """
    tangent: Vector
    """Of the rod at the contact."""
    plane_normal: Vector
    direction: Vector
    """Unit vector of the contact force on the rod: the normal without friction."""


class Deepest(NamedTuple):
    """Where the elastic line lies deepest in the object, and how deep [L]."""

    point: Vector
    depth: Scalar


DEPTH_TOLERANCE = 1e-7
"""Depth [L] by which the elastic line may enter the object: the error of its points."""
_BEND, _TAIL = np.linspace(0, 1, 25), np.linspace(0, 1, 9)
"""Points of the bent part, from the contact back to the clamp, and of the rest behind it: so few
that one position in a hundred is left to `deepest`.
"""
_FINE_BEND, _FINE_TAIL = np.linspace(0, 1, 385), np.linspace(0, 1, 193)
_NEAR_BEND, _NEAR_TAIL = _FINE_BEND[:34:2], _TAIL[1] * np.linspace(0, 1, 9)
"""Close to the contact, where a crease may hide between these few points."""
_LOWEST, _BETWEEN = 4, 33
"""How many lowest points are refined, and with how many points between their neighbours."""
_APART = 1e-12
"""Distance [L] below which two points are one: a rod touching with its tip has no straight rest."""
_LEAST_GROWTH, _MOST_GROWTH = 1.6, 7.0
"""Bounds on the growth of the level from the first point to the second: along a straight line from
the contact it doubles, along a parabola it quadruples, and by more where the bend soon grows; from
eightfold on, the growth of s³, it would dip into the object first.
"""
_ROUNDING = 1e-9
_AT_ONCE = 512
"""Rods that `deepest` handles at a time: their points take 10 MB."""
_SELDOM = 64
"""Up to so many, one after another take less time than lanes take to compile."""


def assessment(
    scene: Scene, state: State, clamp: Clamp, law: Law
) -> tuple[Assessment, Bent, Scalar]:
    """Reactions, energy and residual of a state at a clamp pose, without the depth; also the rod,
    and the steepness of the level function.
    """
    # The law of friction itself needs the previous step; where the force lies in the cone does not.
    # The residual is that of a finer rod, so that it holds the error of the discretisation.
    scene = scene._replace(rod=scene.rod.finer)
    found = touching(scene, law, state, clamp)
    bent, push = found.bent, found.push
    axis = clamp.tangent
    neutral = is_neutral(push.direction, axis)
    across = jnp.cross(axis, jnp.where(neutral, bent.to_contact, push.direction))
    across = across / jnp.sqrt(jnp.sum(across * across))
    values = Assessment(
        state.point,
        state.force,
        push.normal,
        bent.arc_length,
        bent.support_force,
        bent.base_moment,
        scene.rod.energy(bent),
        scene.rod.potential(bent),
        scene.rod.largest_curvature(bent),
        scene.rod.largest_bend(bent),
        found.phase,
        jnp.max(jnp.abs(found.residual)),
        jnp.zeros(()),
        found.tangent,
        across,
        push.direction,
    )
    return values, bent, push.steepness


@lanes(blocks=64, alone=FEW)
def assess(scene: Scene, state: State, clamp: Clamp, law: Law) -> Assessment:
    """Assessments of states at several clamp poses, with the depth."""
    values, bent, steepness = assessment(scene, state, clamp, law)
    # Keeps XLA from evaluating the whole state again for each of the points.
    bent, steepness = lax.optimization_barrier(  # type: ignore[no-untyped-call]
        (bent, steepness)
    )
    depth = _depth(scene._replace(rod=scene.rod.finer), bent, steepness)
    return values._replace(depth=depth)


def _depth(scene: Scene, bent: Bent, steepness: Scalar) -> Scalar:
    """Upper bound on the rod's depth in the object, as far as a few of its points can tell."""
    s1, rest = bent.arc_length, jnp.maximum(1 - bent.arc_length, 0.0)
    bends, tails = [_BEND], [_TAIL]
    # Between points the object may come closer by half their spacing, which along the bend varies
    # by up to √2.
    near = [(steepness * s1 * _BEND[1] / np.sqrt(2), steepness * rest * _TAIL[1] / 2)]
    solids = scene.surface.solids
    if any(solid.may_crease for solid in solids):
        bends, tails = [*bends, _NEAR_BEND], [*tails, _NEAR_TAIL]
        closer = _FINE_BEND[1] * np.sqrt(2), _NEAR_TAIL[1] / 2
        near.append((steepness * s1 * closer[0], steepness * rest * closer[1]))
    points = jnp.concatenate(
        [
            scene.rod.points(bent, np.concatenate(bends)),
            scene.rod.tail(bent, np.concatenate(tails)),
        ]
    )
    ends = np.cumsum([len(part) for part in bends + tails])
    levels = scene.each(scene.part_levels, points) + _slack(scene, bent, bends, tails)
    found = jnp.split(levels, ends[:-1])
    bounds = [by for pair in zip(*near, strict=True) for by in pair]
    least = reduce(jnp.minimum, map(_least, (jnp.min(part, axis=1) for part in found), bounds))
    if len(solids) > 1:
        # The tail begins at the contact.
        first = len(bends)
        touched = np.arange(len(solids)) == jnp.argmin(found[first][0])
        for at in (0, first):
            part, by = found[at], bounds[at]
            others = jnp.min(jnp.where(touched, jnp.inf, part), axis=1)
            least = jnp.minimum(least, jnp.min((others[1:] + others[:-1]) / 2) - by)
    return -least / steepness


def _slack(
    scene: Scene, bent: Bent, bends: list[np.ndarray], tails: list[np.ndarray]
) -> Float[Array, "n 1"] | float:
    """How much thinner a rod whose skin touches is at such points than at its clamp."""
    if not scene.slims:
        return 0.0
    s1 = bent.arc_length
    s = [(1 - share) * s1 for share in bends] + [s1 + share * (1 - s1) for share in tails]
    return jax.vmap(scene.slack)(jnp.concatenate(s))[:, None]


def _least(levels: Float[Array, "n"], near: Scalar) -> Scalar:
    """Lowest level of points, reduced by `near` where a point is lower than its neighbours, or
    where the first ones do not rise as they do next to a contact.
    """
    first, second = levels[1], levels[2]
    # They rise as s from a tip, as s² from a tangential contact.
    rises = (second - _LEAST_GROWTH * first > -_ROUNDING) & (
        _MOST_GROWTH * first - second > -_ROUNDING
    )
    inner = levels[1:-1]
    lower = jnp.append(inner < jnp.minimum(levels[:-2], levels[2:]), levels[-1] < levels[-2])
    beyond = jnp.min(levels[1:] - jnp.where(lower, near, 0.0))
    return jnp.minimum(jnp.minimum(levels[0], first - jnp.where(rises, 0.0, near)), beyond)


def deepest(scene: Scene, state: State, clamp: Clamp, law: Law) -> Deepest:
    """Deepest of many points of each rod (k, …): the second contact that was left out, if there is
    one.

    The depth is a lower bound, off by up to h²/(8R) for points h ≈ L/6000 apart at the deepest
    place and an object that is round with radius R there, and by h/2 where it is sharp.
    """
    line: Any = _fine_line(scene, state, clamp, law)
    points, slack, steepness = line
    coarse = levels(scene, points) + slack
    padded = np.pad(coarse, ((0, 0), (1, 1)), constant_values=np.inf)
    lower = (coarse < padded[:, :-2]) & (coarse <= padded[:, 2:])
    lowest = np.argsort(np.where(lower, coarse, np.inf), axis=1, kind="stable")[:, :_LOWEST]
    places = np.clip(lowest, 1, points.shape[1] - 2)[..., None]
    between = parabolas(*(np.take_along_axis(points, places + k, axis=1) for k in (-1, 0, 1)))
    between = np.moveaxis(between, 0, 1).reshape(len(points), _BETWEEN * _LOWEST, 3)
    everywhere = np.concatenate([points, between], axis=1)
    share = np.linspace(-1.0, 1.0, _BETWEEN)[:, None]
    before, here, after = (
        np.take_along_axis(slack, places[..., 0] + k, axis=1)[:, None] for k in (-1, 0, 1)
    )
    thinner = here + share * np.where(share < 0, here - before, after - here)
    closer = levels(scene, between) + thinner.reshape(len(points), _BETWEEN * _LOWEST)
    found = np.concatenate([coarse, closer], axis=1)
    rows, place = np.arange(len(found)), np.argmin(found, axis=1)
    return Deepest(everywhere[rows, place], -found[rows, place] / steepness)


@lanes(width=16, blocks=_AT_ONCE // 16, alone=_SELDOM)
def _fine_line(
    scene: Scene, state: State, clamp: Clamp, law: Law
) -> tuple[Float[Array, "n 3"], Float[Array, "n"], Scalar]:
    """Many points of a rod from tip to clamp, the contact only once, and how much thinner the rod
    is there; with the steepness of the level function at the contact.
    """
    _, bent, steepness = assessment(scene, state, clamp, law)
    bent = lax.optimization_barrier(bent)  # type: ignore[no-untyped-call]
    scene = scene._replace(rod=scene.rod.finer)
    bend, tail = scene.rod.points(bent, _FINE_BEND), scene.rod.tail(bent, _FINE_TAIL)
    points = jnp.concatenate([tail[:0:-1], bend])
    slack = _slack(scene, bent, [_FINE_BEND], [_FINE_TAIL])
    if isinstance(slack, float):
        return points, jnp.zeros(len(points)), steepness
    bends, tails = jnp.split(slack[:, 0], [len(_FINE_BEND)])
    return points, jnp.concatenate([tails[:0:-1], bends]), steepness


def levels(scene: Scene, points: Float[np.ndarray, "k n 3"]) -> Float[np.ndarray, "k n"]:
    """Level function of the object at points."""
    return np.asarray(_level(scene.alone, points.reshape(-1, 3))).reshape(points.shape[:2])


@lanes(width=1024, blocks=8)
def _level(scene: Scene, point: Float[Array, "3"]) -> Scalar:
    return scene.level(point)


def parabolas(
    before: Float[np.ndarray, "*k 3"],
    here: Float[np.ndarray, "*k 3"],
    after: Float[np.ndarray, "*k 3"],
) -> Float[np.ndarray, "n *k 3"]:
    """Points on parabolas through three points each, by distance: the spacing on the bent part
    differs from that on the straight rest.
    """
    back, onward = here - before, after - here
    behind, ahead = (
        np.maximum(np.linalg.norm(step, axis=-1, keepdims=True), _APART) for step in (back, onward)
    )
    share = np.linspace(-1.0, 1.0, _BETWEEN).reshape(-1, *(1,) * here.ndim)
    t = share * np.where(share < 0, behind, ahead)
    slope = (onward / ahead * (t + behind) + back / behind * (ahead - t)) / (behind + ahead)
    return np.asarray(here + t * slope)


def assessed(
    scene: Scene, law: Law, state: State, clamp: Clamp
) -> tuple[Assessment, Float[np.ndarray, "k 3"]]:
    """Assessments of states (k, …), with refined depths; and the deepest points [L] of those that
    are deep or nearly so, NaN for the others. A law holds one row per state, if anything.
    """
    values = assess(scene, state, clamp, law)
    places, depth = np.full(state.point.shape, np.nan), values.depth.copy()
    left_open = np.flatnonzero(depth > DEPTH_TOLERANCE)
    for first in range(0, len(left_open), _AT_ONCE):
        rows = left_open[first : first + _AT_ONCE]
        found = deepest(scene, *chosen((state, clamp, law), rows))
        depth[rows], places[rows] = found.depth, found.point
    return values._replace(depth=depth), places


def reached_by(values: Assessment, state: State) -> Reached:
    """What assessed states pass on to the next position."""
    return Reached(state, values.arc_length, values.tangent)
