"""What the sensor should read at a given pose, and how that changes with every parameter.

The reading is that of the contact equilibrium (`vibrissa.contact`) under a given tangential force;
derivatives are those of the equations, not of the iterations (implicit function theorem).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree
from jaxtyping import Bool, Float

from vibrissa.calibration.bench import Bench, Step, moved
from vibrissa.contact import Leaning, Scene, Touching, iterated, touching
from vibrissa.contact import State as Unknowns
from vibrissa.geometry.rotation import cross_matrices
from vibrissa.mechanics.model import Clamp
from vibrissa.numerics.derivatives import implicit
from vibrissa.numerics.lanes import lanes
from vibrissa.surfaces import Surface

_SOLVED = 1e-9
"""Residual up to which a state counts as an equilibrium: a millionth of any sensor's noise."""

_ASTRAY = 0.5
"""[L] from its start beyond which a contact is another equilibrium: unloaded rows find any."""

_AT_ONCE = 256
"""Rows in one call, one after another: side by side they are a quarter faster, but their code takes
more than twice as long to compile.
"""


class Pose(NamedTuple):
    """Pose of the sensor in the world."""

    position: Float[Any, "*n 3"]
    axes: Float[Any, "*n 3 3"]


class State(NamedTuple):
    """State of the contact, world axes, in units of the rod."""

    point: Float[Any, "*n 3"]
    force: Float[Any, "*n"]
    """Magnitude of the contact force."""
    leaning: Float[Any, "*n 3"]
    """Tangential force over the normal force."""
    load: Float[Any, "*n 6"] | None = None
    """Force and moment about the clamp of the loads along the rod, if any."""


class Reading(NamedTuple):
    """What the sensor reads in rows in contact."""

    state: State
    sound: Bool[Any, "*n"]
    """Whether it is an equilibrium, with finite derivatives."""
    wrench: Float[Any, "*n 6"]
    """Support reaction on the rod as the sensor reads it, in its own axes, without tare."""
    by_step: Step
    """Derivatives (…, 6, entries) by small steps of the bench."""
    by_leaning: Float[Any, "*n 6 3"]
    """Derivatives by the tangential force."""

    def by_turn(self, arm: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 6 3"]:
        """Derivatives by a rotation of the object about points from which its pivot is offset by
        `arm`; a rotation of sensor and rod about them has the opposite sign.
        """
        return self.by_step.turn - self.by_step.shift @ cross_matrices(arm)


@lanes(width=1, blocks=_AT_ONCE)
def readings(shared: tuple[Surface, Bench], start: State, pose: Pose) -> Reading:
    """Readings of rows in contact, each equilibrium sought from a starting state, under that
    state's tangential force.
    """
    surface, given = shared
    unit = given.stiffness / given.length**2
    guess = jnp.append(start.point / given.length, start.force / unit)
    count = given.model.unknowns
    if start.load is not None:
        guess = jnp.concatenate([guess, (start.load / _units(given))[6 - count :]])
    x = iterated(
        lambda x: _touching(surface, given, Unknowns.of(x, count), start.leaning, pose).residual,
        guess,
        given.model.derivatives,
    )

    def read(
        x: Float[Array, "unknowns"], step: Step, leaning: Float[Array, "3"]
    ) -> tuple[Any, tuple[Any, ...]]:
        bench = moved(given, step)
        found = _touching(surface, bench, Unknowns.of(x, count), leaning, pose)
        point, magnitude = x[:3] * bench.length, x[3] * bench.stiffness / bench.length**2
        if found.bent.load is None:
            force = -magnitude * (pose.axes.T @ found.push.direction)
            arm = pose.axes.T @ (point - pose.position) - bench.wrench_point
            wrench = bench.gain * jnp.concatenate([force, jnp.cross(arm, force)])
        else:
            reactions = jnp.append(found.bent.support_force, found.bent.base_moment)
            wrench = _read(bench, pose, reactions)
        load = None if found.bent.load is None else found.bent.load * _units(bench)
        told = found.residual, wrench, point, magnitude, load
        return (found.residual, wrench), told

    ((by_x, *rest), (wrench_by_x, *direct)), (residual, wrench, point, magnitude, load) = (
        jax.jacfwd(read, argnums=(0, 1, 2), has_aux=True)(
            x, jax.tree.map(jnp.asarray, given.no_step), start.leaning
        )
    )
    by_step, by_leaning = jax.tree.map(
        lambda part, change: part + wrench_by_x @ change, direct, implicit(by_x, rest)
    )
    told, _ = ravel_pytree((wrench, by_step, by_leaning))
    sound = (
        jnp.isfinite(told).all()
        & (jnp.max(jnp.abs(residual)) < _SOLVED)
        & (jnp.linalg.norm(point - start.point) <= _ASTRAY * given.length)
        # An object only pushes: where it would have to pull, the rod does not touch.
        & (magnitude > 0)
    )
    state = State(point, magnitude, start.leaning, load)
    return Reading(state, sound, wrench, by_step, by_leaning)


class Free(NamedTuple):
    """The rod free of contact."""

    wrench: Float[Any, "*n 6"]
    """What its loads make the sensor read, as in `Reading`."""
    by_step: Step
    reactions: Float[Any, "*n 6"]
    """Support reactions on the rod, world axes."""
    line: Float[Any, "*n k 3"]
    """Points of it, in the world."""


@lanes(width=1, blocks=_AT_ONCE)
def free_readings(shared: tuple[Bench, Float[Array, "k"]], pose: Pose) -> Free:
    """Readings of rows without contact, and points of the rod there, at fractions of its length."""
    given, share = shared

    def read(step: Step) -> tuple[Any, tuple[Any, ...]]:
        bench = moved(given, step)
        free = bench.model.free(_clamp(bench, pose))
        reactions = free.reactions
        points = jax.vmap(lambda s: free.at(s)[0])(share) * bench.length
        wrench = _read(bench, pose, reactions)
        return wrench, (wrench, reactions * _units(bench), points)

    by_step, (wrench, reactions, points) = jax.jacfwd(read, has_aux=True)(
        jax.tree.map(jnp.asarray, given.no_step)
    )
    return Free(wrench, by_step, reactions, points)


def _units(bench: Bench) -> Float[Array, "6"]:
    force, moment = bench.stiffness / bench.length**2, bench.stiffness / bench.length
    return jnp.concatenate([jnp.full(3, force), jnp.full(3, moment)])


def _read(bench: Bench, pose: Pose, reactions: Float[Array, "6"]) -> Float[Array, "6"]:
    """What the sensor reads of reactions about the clamp, world axes and model units."""
    given = reactions * _units(bench)
    force, moment = pose.axes.T @ given[:3], pose.axes.T @ given[3:]
    moment = moment + jnp.cross(bench.clamp - bench.wrench_point, force)
    return bench.gain * jnp.concatenate([force, moment])


def _clamp(bench: Bench, pose: Pose) -> Clamp:
    return Clamp(
        (pose.position + pose.axes @ bench.clamp) / bench.length,
        pose.axes @ bench.axes[:, 2],
        pose.axes @ bench.axes[:, 0],
    )


def _touching(
    surface: Surface, bench: Bench, x: Unknowns, leaning: Float[Array, "3"], pose: Pose
) -> Touching:
    """The contact conditions, with the rod held off the object as given by the standoff."""
    scene = Scene(bench.placed(surface), jnp.asarray(bench.length), rod=bench.model)
    found = touching(scene, Leaning(leaning), x, _clamp(bench, pose))
    return found._replace(residual=found.residual.at[0].add(-bench.standoff / bench.length))
