"""What an equilibrium means: reactions, energy, and the checks of the state that is returned."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float

from vibrissa.contact import Law, Reached, Scene, State, touching
from vibrissa.forward.path import chosen
from vibrissa.mechanics.model import Bent, Clamp, is_neutral
from vibrissa.numerics.lanes import AnyArray, lanes

Scalar = Float[Any, ""]
Vector = Float[Any, "3"]


class Assessment(NamedTuple):
    """One equilibrium in model units; arrays when assessed in a batch."""

    point: Vector
    force: Scalar
    normal: Vector
    arc_length: Scalar
    moment: Vector
    energy: Scalar
    largest_curvature: Scalar
    """Along the rod [1/L]."""
    phase: Scalar
    residual: Scalar
    depth: Scalar
    """At most how deep the elastic line enters the object [L]; rounding where it does not, else
    `deepest` tells.
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
"""Depth [L] up to which the elastic line may enter the object: the error of its points."""
_BEND, _TAIL = np.linspace(0, 1, 25), np.linspace(0, 1, 9)
"""Points of the bent part, from the contact back to the clamp, and of the straight rest: as few as
leave one position in a hundred to `deepest`.
"""
_FINE_BEND, _FINE_TAIL = np.linspace(0, 1, 385), np.linspace(0, 1, 193)
_NEAR_BEND, _NEAR_TAIL = _FINE_BEND[:34:2], _TAIL[1] * np.linspace(0, 1, 9)
"""Close to the contact, where a crease may hide between the few."""
_LOWEST, _BETWEEN = 4, 33
"""Lowest points looked at once more, and with how many points between their neighbours."""
_APART = 1e-12
"""[L] below which two points are one: a rod that touches with its tip has no rest."""
_LEAST_GROWTH, _MOST_GROWTH = 1.6, 5.0
"""What lies on a straight line or a parabola from the contact doubles or quadruples from the first
point to the second.
"""
_ROUNDING = 1e-9


def assessment(
    scene: Scene, state: State, clamp: Clamp, law: Law
) -> tuple[Assessment, Bent, Scalar]:
    """Reactions, energy and residual of a state at a clamp pose, without the depth; the rod, and
    the steepness of the level.
    """
    # The law of friction itself needs the step before; the force's place in the cone does not.
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
        bent.base_moment,
        scene.rod.energy(bent),
        scene.rod.largest_curvature(bent),
        found.phase,
        jnp.max(jnp.abs(found.residual)),
        jnp.zeros(()),
        found.tangent,
        across,
        push.direction,
    )
    return values, bent, push.steepness


@lanes(blocks=64)
def assess(scene: Scene, state: State, clamp: Clamp, law: Law) -> Assessment:
    """Assessments of states at clamp poses."""
    values, bent, steepness = assessment(scene, state, clamp, law)
    # Lest XLA evaluate the whole state again for each of the points.
    bent, tangent, steepness = lax.optimization_barrier(  # type: ignore[no-untyped-call]
        (bent, values.tangent, steepness)
    )
    return values._replace(depth=_depth(scene, bent, tangent, steepness))


def _line(
    scene: Scene, bent: Bent, tangent: Vector, bend: Float[np.ndarray, "b"], tail: np.ndarray
) -> tuple[Float[Array, "b 3"], Float[Array, "t 3"]]:
    """Points at shares of the bent part, from the contact back, and of the straight rest."""
    rest = jnp.maximum(1 - bent.arc_length, 0.0) * tail[:, None]
    return scene.rod.points(bent, bend), bent.point + rest * tangent


def _depth(scene: Scene, bent: Bent, tangent: Vector, steepness: Scalar) -> Scalar:
    """At most how deep the rod lies in the object, as far as few of its points tell."""
    s1, rest = bent.arc_length, jnp.maximum(1 - bent.arc_length, 0.0)
    parts = _line(scene, bent, tangent, _BEND, _TAIL)
    # Between points the object may come nearer by half of their distance, which along the bend
    # varies by up to √2.
    near = steepness * s1 * _BEND[1] / np.sqrt(2), steepness * rest * _TAIL[1] / 2
    count = len(_BEND)
    levels = scene.each(scene.level, jnp.concatenate(parts))
    least = jnp.minimum(_least(levels[:count], near[0]), _least(levels[count:], near[1]))
    if any(solid.may_crease for solid in scene.surface.solids):
        close = jnp.concatenate(_line(scene, bent, tangent, _NEAR_BEND, _NEAR_TAIL))
        found, few = scene.each(scene.level, close), len(_NEAR_BEND)
        of_bend = _least(found[:few], steepness * s1 * _FINE_BEND[1] * np.sqrt(2))
        of_tail = _least(found[few:], steepness * rest * _NEAR_TAIL[1] / 2)
        least = jnp.minimum(least, jnp.minimum(of_bend, of_tail))
    if len(scene.surface.solids) > 1:
        touched = jnp.argmin(scene.part_levels(bent.point))
        levels = scene.each(scene.part_levels, jnp.concatenate(parts))
        others = jnp.min(jnp.where(jnp.arange(levels.shape[1]) == touched, jnp.inf, levels), axis=1)
        for part, by in ((others[:count], near[0]), (others[count:], near[1])):
            least = jnp.minimum(least, jnp.min((part[1:] + part[:-1]) / 2) - by)
    return -least / steepness


def _least(levels: Float[Array, "n"], near: Scalar) -> Scalar:
    """Least level of points, lessened by `near` where a point is lower than its neighbours, or
    where the first do not rise as behind a contact.
    """
    first, second = levels[1], levels[2]
    # From a tip as s, from a tangential contact as s².
    rises = (second - _LEAST_GROWTH * first > -_ROUNDING) & (
        _MOST_GROWTH * first - second > -_ROUNDING
    )
    inner = levels[1:-1]
    lower = jnp.append(inner < jnp.minimum(levels[:-2], levels[2:]), levels[-1] < levels[-2])
    beyond = jnp.min(levels[1:] - jnp.where(lower, near, 0.0))
    return jnp.minimum(jnp.minimum(levels[0], first - jnp.where(rises, 0.0, near)), beyond)


@lanes(width=16, blocks=16)
def deepest(scene: Scene, state: State, clamp: Clamp, law: Law) -> Deepest:
    """Deepest of many points of the rod: the second contact that is missing, if there is one.

    The depth is from below, by up to h²/(8R) for points h ≈ L/6000 apart at the deepest place and
    an object that is round with radius R there, and by h/2 where it is sharp.
    """
    values, bent, steepness = assessment(scene, state, clamp, law)
    bend, tail = _line(scene, bent, values.tangent, _FINE_BEND, _FINE_TAIL)
    # From tip to clamp, with the contact once.
    points = jnp.concatenate([tail[:0:-1], bend])
    coarse = scene.each(scene.level, points)
    padded = jnp.pad(coarse, 1, constant_values=jnp.inf)
    lower = (coarse < padded[:-2]) & (coarse <= padded[2:])
    lowest = lax.top_k(jnp.where(lower, -coarse, -jnp.inf), _LOWEST)[1]
    places = jnp.clip(lowest, 1, len(points) - 2)
    before, here, after = points[places - 1], points[places], points[places + 1]
    between = parabolas(before, here, after).reshape(-1, 3)
    everywhere = jnp.concatenate([points, between])
    levels = jnp.concatenate([coarse, scene.each(scene.level, between)])
    place = jnp.argmin(levels)
    return Deepest(everywhere[place], -levels[place] / steepness)


def parabolas(
    before: Float[AnyArray, "k 3"], here: Float[AnyArray, "k 3"], after: Float[AnyArray, "k 3"]
) -> Float[Array, "n k 3"]:
    """Points of parabolas through three points each, by their distances: those of the bent part and
    of the straight rest lie differently close.
    """
    back, onward = here - before, after - here
    behind, ahead = (
        jnp.maximum(jnp.linalg.norm(step, axis=1, keepdims=True), _APART) for step in (back, onward)
    )
    share = jnp.linspace(-1.0, 1.0, _BETWEEN)[:, None, None]
    t = share * jnp.where(share < 0, behind, ahead)
    slope = (onward / ahead * (t + behind) + back / behind * (ahead - t)) / (behind + ahead)
    curve: Array = here + t * slope
    return curve


def assessed(
    scene: Scene, law: Law, state: State, clamp: Clamp
) -> tuple[Assessment, Float[np.ndarray, "k 3"]]:
    """Assessments of states (k, …), their depths looked at closely; and the deepest points [L] of
    those that are deep or nearly so, NaN of the others. A law holds a row a state, if anything.
    """
    values = assess(scene, state, clamp, law)
    places = np.full(state.point.shape, np.nan)
    left_open = np.flatnonzero(values.depth > DEPTH_TOLERANCE)
    if left_open.size:
        found = deepest(scene, *chosen((state, clamp, law), left_open))
        depth = values.depth.copy()
        depth[left_open], places[left_open] = found.depth, found.point
        values = values._replace(depth=depth)
    return values, places


def reached_by(values: Assessment, state: State) -> Reached:
    """What assessed states hand on to the next position."""
    return Reached(state, values.arc_length, values.tangent)
