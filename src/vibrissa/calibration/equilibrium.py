"""What the sensor should read at a pose of its own, and how that changes with every parameter.

The reading is that of the contact equilibrium (`forward.friction`) under a tangential force that is
given: unknown are the contact point and the magnitude of the force, x = (p, f), with R(x, θ) = 0.
Derivatives are those of the equations, not of the iterations (implicit function theorem).
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Bool, Float

from vibrissa.calibration.bench import NO_STEP, Bench, Step, moved
from vibrissa.forward.equations import Clamp, Scene, level
from vibrissa.forward.friction import rubbing_state
from vibrissa.numerics.lanes import AnyArray, lanes
from vibrissa.numerics.linear import solve_4x4
from vibrissa.surfaces import Surface

_MOST_ITERATIONS = 25
"""Of Newton's method, which needs three to six from a neighbouring state."""
_CONVERGED = 1e-11
"""Residual that ends it: a few thousand roundings of conditions of order 1."""
_SOLVED = 1e-9
"""Residual up to which a state counts as an equilibrium: a millionth of any sensor's noise."""
_LONGEST_STEP = 0.2
"""[L] by which the contact moves in an iteration: farther, the linearisation says nothing."""

Unknowns = Float[Array, "4"]


class Pose(NamedTuple):
    """Of the sensor in the world."""

    position: Float[AnyArray, "*n 3"]
    axes: Float[AnyArray, "*n 3 3"]


class State(NamedTuple):
    """Of the contact, world axes, in units of the rod."""

    point: Float[AnyArray, "*n 3"]
    force: Float[AnyArray, "*n"]
    """Magnitude of the contact force."""
    leaning: Float[AnyArray, "*n 3"]
    """Tangential force in units of the normal one."""


class Reading(NamedTuple):
    """Of rows in contact."""

    state: State
    residual: Float[AnyArray, "*n"]
    """Largest of the equilibrium, dimensionless."""
    wrench: Float[AnyArray, "*n 6"]
    """Support reaction on the rod as the sensor reads it, its own axes, without tare."""
    by_step: Step
    """Derivatives (…, 6, entries) by small steps of the bench."""
    by_leaning: Float[AnyArray, "*n 6 3"]
    """Derivatives by the tangential force."""

    @property
    def sound(self) -> Bool[np.ndarray, "n"]:
        """Rows with an equilibrium and finite derivatives."""
        finite = [
            np.isfinite(part).reshape(len(self.residual), -1).all(axis=1)
            for part in (self.wrench, self.by_leaning, *self.by_step)
        ]
        return np.logical_and.reduce(finite) & (self.residual < _SOLVED)


@lanes(blocks=4)
def _reading(shared: tuple[Surface, Bench], start: State, pose: Pose) -> Reading:
    surface, given = shared

    def read(step: Step, leaning: Float[Array, "3"]) -> tuple[Array, tuple[Array, ...]]:
        bench = moved(given, step)
        unit = bench.stiffness / bench.length**2

        def conditions(x: Unknowns) -> Unknowns:
            return _contact(surface, bench, x, leaning, pose)[0]

        guess = jnp.append(start.point / bench.length, start.force / unit)
        x, residual = lax.custom_root(conditions, guess, _solved, _tangents, has_aux=True)
        point, magnitude = x[:3] * bench.length, x[3] * unit
        direction = _contact(surface, bench, x, leaning, pose)[1]
        force = -magnitude * (pose.axes.T @ direction)
        arm = pose.axes.T @ (point - pose.position) - bench.wrench_point
        wrench = bench.gain * jnp.concatenate([force, jnp.cross(arm, force)])
        return wrench, (wrench, point, magnitude, residual)

    (by_step, by_leaning), (wrench, point, magnitude, residual) = jax.jacfwd(
        read, argnums=(0, 1), has_aux=True
    )(jax.tree.map(jnp.asarray, NO_STEP), start.leaning)
    return Reading(State(point, magnitude, start.leaning), residual, wrench, by_step, by_leaning)


def readings(surface: Surface, bench: Bench, states: State, poses: Pose) -> Reading:
    """Readings of rows in contact, each equilibrium sought from a state, under its tangential
    force.
    """
    return _reading((surface, bench), states, poses)


def _contact(
    surface: Surface, bench: Bench, x: Unknowns, leaning: Float[Array, "3"], pose: Pose
) -> tuple[Unknowns, Float[Array, "3"]]:
    """What the equilibrium leaves, and the direction of the contact force on the rod."""
    scene = Scene(bench.placed(surface), jnp.asarray(bench.length))
    clamp = Clamp(
        (pose.position + pose.axes @ bench.clamp) / bench.length, pose.axes @ bench.axes[:, 2]
    )
    gradient = jax.grad(level, argnums=1)(scene, x[:3])
    n = gradient / jnp.sqrt(jnp.sum(gradient * gradient))
    tangential = leaning - jnp.dot(leaning, n) * n
    state = rubbing_state(scene, jnp.concatenate([x, tangential]), clamp)
    return state.conditions.at[0].add(-bench.standoff / bench.length), state.direction


def _solved(
    conditions: Callable[[Unknowns], Unknowns], start: Unknowns
) -> tuple[Unknowns, Float[Array, ""]]:
    """Root by Newton's method, and what is left there."""

    def step(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        x, _, count = carry
        slope, residual = jax.jacfwd(lambda x: (conditions(x),) * 2, has_aux=True)(x)
        move, _ = solve_4x4(slope, residual)
        distance = jnp.sqrt(jnp.sum(move[:3] ** 2))
        shortened = move * _LONGEST_STEP / jnp.maximum(distance, _LONGEST_STEP)
        return x - shortened, jnp.max(jnp.abs(residual)), count + 1

    def unfinished(carry: tuple[Array, Array, Array]) -> Array:
        _, residual, count = carry
        return (residual > _CONVERGED) & (count < _MOST_ITERATIONS)

    x, residual, _ = lax.while_loop(unfinished, step, (start, jnp.asarray(jnp.inf), jnp.asarray(0)))
    return x, residual


def _tangents(linear: Callable[[Unknowns], Unknowns], right: Unknowns) -> Unknowns:
    return solve_4x4(jax.jacfwd(linear)(jnp.zeros(4)), right)[0]
