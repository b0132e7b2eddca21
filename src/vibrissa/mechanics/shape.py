"""Shapes of rods at rows of a sweep, free or in contact: in closed form where the rod allows it,
else those of the spatial rod.

Total support reactions alone give the rod from its clamp to the contact. Behind it, loads leave no
force and no moment at the tip: their resultants are found by Gauss-Newton steps. Noisy reactions,
from which the contact is the most probable one, are unknown too: they are to be those of the single
contact. A few unknowns, all rows side by side, so that slopes are taken by differences and a kernel
holds nothing but one integration.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

from vibrissa.geometry.rotation import first_axis, third_axis
from vibrissa.mechanics.elastic_line import force_of, sampled_line
from vibrissa.mechanics.kirchhoff import Inner, Kirchhoff, Push
from vibrissa.mechanics.line import Line
from vibrissa.mechanics.model import Clamp
from vibrissa.mechanics.models import spatial
from vibrissa.numerics.lanes import FEW, lanes
from vibrissa.numerics.vectors import dot, joined
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.trail import Trail

_STEPS, _SETTLED = 12, 1e-8
"""Most Gauss-Newton steps, and the change [EI/L²] after which the shape no longer changes visibly;
three are usual.
"""
_DIFFERENCE = 1e-6
"""Of the unknowns [EI/L²] for slopes: half the digits."""
_LARGEST_CHANGE = 2.0
"""Of the unknowns in one step [EI/L²], as in `vibrissa.mechanics.kirchhoff`."""
_POINT_COUNTS = 100.0
"""Weight of the rod's distance from the contact [1/L] beside the direction of its force: where a
contact was moved back within reach, the rod passes it.
"""
_MISSED = 0.01
"""Of the length: distance of contact and rod from which on no bent rod explains the reactions."""


class Held(NamedTuple):
    """Rods at clamp poses (…), in their own units and world axes."""

    reactions: Reactions
    touches: Bool[np.ndarray, "*n"]
    point: Float[np.ndarray, "*n 3"]
    """Of the centre line at the contact; as what follows NaN without contact."""
    direction: Float[np.ndarray, "*n 3"]
    """Unit vector of the contact force on the rod."""
    arc_length: Float[np.ndarray, "*n"]
    incidence: Float[np.ndarray, "*n"] | None = None
    """(1 + t·d)/2 at the contact, if the contact is not exactly that of the reactions."""


class _Given(NamedTuple):
    """One rod, model units."""

    clamp: Clamp
    wrench: Float[Any, "6"]
    """Support force and moment."""
    reach: Float[Any, "3"]
    direction: Float[Any, "3"]
    arc_length: Float[Any, ""]


class CentreLine:
    """Sweeps whose rods touch an object with their skin or with their centre line."""

    rod: Rod
    point: Float[np.ndarray, "*trail n 3"]
    normal: Float[np.ndarray, "*trail n 3"]
    arc_length: Float[np.ndarray, "*trail n"]
    finite_radius: bool
    """Whether it is the skin."""
    offset: float
    """By how much the object was grown for the centre line, at the clamp."""

    @property
    def centre(self) -> Float[np.ndarray, "*trail n 3"]:
        """Points (…, 3) [m] of the rod's centre line at the contact: away from the object by the
        rod's radius there if its skin touches, else by how much the object was grown.
        """
        if self.finite_radius:
            radius = np.asarray(self.rod.radius_at(self.arc_length / self.rod.length))
            return np.asarray(self.point + radius[..., None] * self.normal)
        return self.point + self.offset * self.normal if self.offset else self.point


def free_lines(
    rod: Rod, trail: Trail, count: int, rows: Any = slice(None)
) -> Float[np.ndarray, "n count 3"]:
    """`count` points of the rod without contact at some poses, curved and hanging as it is."""
    nothing = np.zeros(trail.position.shape)
    along = np.zeros(trail.shape)
    held = Held(Reactions(trail, nothing, nothing), along > 0, nothing, nothing, along)
    return elastic_lines(rod, held, rows, count)


class _Posed(NamedTuple):
    """The same in rows (n, …), model units."""

    given: _Given
    touches: Bool[np.ndarray, "n"]
    incidence: Float[np.ndarray, "n"] | None


def elastic_lines(rod: Rod, held: Held, rows: Any, count: int) -> Float[np.ndarray, "n count 3"]:
    """`count` points of the rods at some rows, equally spaced in arc length from clamp to tip, one
    row after another; NaN where no rod takes this shape under this force, or nothing is known.

    Raises
    ------
    ValueError
        If `count` is less than 2.
    """
    if count < 2:
        raise ValueError(f"count = {count}; allowed is at least 2")
    posed = _posed(rod, held, rows)
    lines = _closed(posed, count) if rod.plain else _spatial(spatial(rod), posed, count)
    clamps = held.reactions.trail.position[rows].reshape(-1, 1, 3)
    return np.asarray(clamps + rod.length * lines)


def _posed(rod: Rod, held: Held, rows: Any) -> _Posed:
    """Some rows; those without contact touch nothing at their tip."""
    trail, (force, moment) = held.reactions.trail, (held.reactions.force, held.reactions.moment)

    def chosen(part: np.ndarray, *own: int) -> np.ndarray:
        return np.asarray(part[rows]).reshape(-1, *own)

    turn = chosen(trail.orientation, 4)
    clamp = Clamp(chosen(trail.position, 3) / rod.length, third_axis(turn), first_axis(turn))
    wrench = [chosen(force, 3) / rod.force_scale, chosen(moment, 3) / rod.moment_scale]
    touches = chosen(held.touches)
    reach = chosen(held.point, 3) / rod.length - clamp.point
    given = _Given(
        clamp,
        np.concatenate(wrench, axis=1),
        np.where(touches[:, None], reach, clamp.tangent),
        np.where(touches[:, None], chosen(held.direction, 3), clamp.tangent),
        np.where(touches, chosen(held.arc_length) / rod.length, 1.0),
    )
    return _Posed(given, touches, None if held.incidence is None else chosen(held.incidence))


def _closed(posed: _Posed, count: int) -> Float[np.ndarray, "n count 3"]:
    """Plain rods, seen from the clamp."""
    given, zero = posed.given, np.zeros(3)
    measured = np.linalg.norm(given.wrench[:, :3], axis=1)
    lines = np.zeros((len(measured), count, 3))
    for row, touching in enumerate(posed.touches.tolist()):
        axis, reach = given.clamp.tangent[row], given.reach[row]
        direction, s1 = given.direction[row], float(given.arc_length[row])
        force = float(measured[row]) if touching else 0.0
        if posed.incidence is not None and touching:
            # The force that matches point and arc length, which noise and the limit at the tip may
            # have moved away from the measured one.
            force = force_of(float(posed.incidence[row]), reach, direction, axis)
        lines[row] = sampled_line(zero, axis, 1.0, reach, direction, force, s1, count)
    return lines


def _spatial(model: Kirchhoff, posed: _Posed, count: int) -> Float[np.ndarray, "n count 3"]:
    """Rods of the spatial model, seen from the clamp."""
    given, lines = posed.given, np.full((len(posed.touches), count, 3), np.nan)
    known = np.all([np.isfinite(part).all(axis=1) for part in given[1:4]], axis=0)
    known &= np.isfinite(given.arc_length)
    for touching in (False, True):
        rows = np.flatnonzero(known & (posed.touches == touching))
        if len(rows):
            own = _Given(
                Clamp(*(part[rows] for part in given.clamp)), *(part[rows] for part in given[1:])
            )
            found = _settled(model, own, touching=touching, exact=posed.incidence is None)
            points = np.array(
                _points(np.linspace(0, 1, count), found.bent, found.rest, own.arc_length)
            )
            points[found.misses[:, 0] > _MISSED] = np.nan
            lines[rows] = points
    return lines


class _Found(NamedTuple):
    """A rod under a wrench, up to its contact and behind it."""

    bent: Line
    rest: Line
    misses: Float[Any, "16"]
    """Distance from the contact [L]; that (3); the share of the force across its direction (3); the
    moment at the contact (3); and what is left at the tip (6): zero in equilibrium but for the
    first.
    """


@lanes(alone=FEW)
def _integrated(model: Kirchhoff, given: _Given, load: Float[Any, "6"]) -> _Found:
    """The rod under support reactions, with given resultants of its loads."""
    clamp, wrench, reach, direction, s1 = given
    push = Push(-wrench[:3] - load[:3], -wrench[3:] - load[3:])
    line = model.line(clamp, push, load if model.loaded else None)
    rest = model.beyond(Inner(line, clamp, push), s1)
    at, _ = line.at(s1)
    off, force = at - reach, push.force
    across = force - dot(force, direction) * direction
    inside = push.moment - jnp.cross(at, force)
    left = rest.states.load[-1] if model.loaded else jnp.zeros(6)
    return _Found(line, rest, joined(jnp.sqrt(dot(off, off)), off, across, inside, left))


@lanes(alone=FEW)
def _points(
    s: Float[Any, "count"], bent: Line, rest: Line, s1: Float[Any, ""]
) -> Float[Any, "count 3"]:
    """Points at arc lengths, seen from the clamp."""

    def point(at: Any) -> Array:
        return jnp.where(at <= s1, bent.at(at)[0], rest.at(at)[0])

    points: Float[Array, "count 3"] = jax.vmap(point)(jnp.asarray(s))
    return points


def _settled(model: Kirchhoff, given: _Given, *, touching: bool, exact: bool) -> _Found:
    """The rods in equilibrium: rows with contact, or rows without."""
    count, none = len(given.arc_length), np.zeros((len(given.arc_length), 6))
    if not touching:
        given = given._replace(wrench=given.wrench if model.loaded else none)
    measured = given.wrench

    def at(unknowns: Float[np.ndarray, "n k"]) -> _Found:
        load = unknowns[:, -6:] if model.loaded else none
        wrench = measured if exact else unknowns[:, :6]
        return _integrated(model, given._replace(wrench=wrench if touching else -load), load)

    # A free rod has no unknowns but its loads; their first guess is what the contact leaves.
    parts = [] if exact or not touching else [measured]
    if model.loaded:
        lever = np.cross(given.reach, given.direction)
        along = np.maximum(-np.sum(measured[:, :3] * given.direction, axis=1), 0.0)[:, None]
        push = along * np.concatenate([given.direction, lever], axis=1)
        parts.append(-measured - push if touching else -measured)
    unknowns = np.concatenate(parts, axis=1) if parts else np.zeros((count, 0))
    found = at(unknowns)
    weights = np.repeat([0.0, _POINT_COUNTS if touching else 0.0, 1.0], [1, 3, 12])
    for _ in range(_STEPS if parts else 0):
        steps = _DIFFERENCE * np.eye(unknowns.shape[1])
        moved = [(at(unknowns + step).misses - found.misses) / _DIFFERENCE for step in steps]
        slopes = np.nan_to_num(np.stack(moved, axis=-1) * weights[:, None])
        value = np.nan_to_num(found.misses * weights)
        change = np.einsum("nij,nj->ni", np.linalg.pinv(slopes), value)
        size = np.abs(change).max(axis=1, keepdims=True)
        unknowns = unknowns - change * np.minimum(1.0, _LARGEST_CHANGE / np.maximum(size, 1e-300))
        found = at(unknowns)
        if size.max() < _SETTLED:
            break
    return found if touching else found._replace(misses=np.zeros_like(found.misses))
