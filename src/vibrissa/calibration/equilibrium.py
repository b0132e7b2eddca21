"""What the sensor should read at a pose of the clamp, and how that changes with every parameter.

The reading is that of the contact equilibrium (`scan.equations`, `scan.friction`): unknown are x =
(p, f), given by R(x, θ) = 0. Newton's method finds x. The derivatives are those of the equations,
not of the iterations (implicit function theorem): dx/dθ = −(∂R/∂x)⁻¹ ∂R/∂θ.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float

from vibrissa.contact import FRICTIONLESS, Leaning, Scene, State, touching
from vibrissa.mechanics.model import Clamp
from vibrissa.numerics.blocks import ONE_BY_ONE, AnyArray, in_blocks
from vibrissa.numerics.compiled import compiled
from vibrissa.numerics.linear import solve_4x4
from vibrissa.numerics.rotation import cross_matrix
from vibrissa.surfaces import Surface
from vibrissa.surfaces.base import Placed

CORE = 21
"""Parameters of rod, clamp, sensor and object, in the order of `Bench`."""
CLAMP_AT, SHIFT_AT, TURN_AT, STANDOFF_AT = slice(2, 5), slice(14, 17), slice(17, 20), 20
"""Where among them the clamp's place, the object's shift and turn, and the standoff are."""
STATE = 7
"""Contact point [m], magnitude of the contact force [N], and with friction the tangential force in
units of the normal one, world axes.
"""
ROW = 15
"""Position of the sensor in the world (3,), its axes (3, 3) row by row, and the point about which
the torque is given, in its axes (3,).
"""

_MOST_ITERATIONS = 25
_CONVERGED = 1e-11
_LONGEST_STEP = 0.2
_SOLVED = 1e-9
_SIZES = (16,)
"""Of blocks: a recording's rows fill about so many, and compiling once more takes longer than the
filling.
"""

Wrench = Float[Array, "6"]


class Bench(NamedTuple):
    """All that a calibration may change, in units of the rod."""

    stiffness: Float[AnyArray, ""]
    length: Float[AnyArray, ""]
    clamp: Float[AnyArray, "3"]
    """Clamp point in the sensor frame."""
    axes: Float[AnyArray, "3 3"]
    """Clamp axes as columns, in the sensor frame."""
    gain: Float[AnyArray, "6"]
    """Of the sensor's channels: reading over true value."""
    shift: Float[AnyArray, "3"]
    """By which the object is moved from where it is given, world axes."""
    turn: Float[AnyArray, "3 3"]
    """By which it is turned about `pivot` before that."""
    pivot: Float[AnyArray, "3"]
    standoff: Float[AnyArray, ""]
    """How far the centre line stays off the object as given, where it touches."""


def changed(bench: Bench, step: Float[Array, "21"]) -> Bench:
    """Parameters after a small step: ln EI, ln L, clamp point, rotation vector of the clamp in its
    own axes, ln gain, shift and turn of the object, standoff.

    Rotations are to first order, as for derivatives at zero.
    """
    return Bench(
        bench.stiffness * jnp.exp(step[0]),
        bench.length * jnp.exp(step[1]),
        bench.clamp + step[2:5],
        bench.axes @ (jnp.eye(3) + cross_matrix(step[5:8])),
        bench.gain * jnp.exp(step[8:14]),
        bench.shift + step[14:17],
        (jnp.eye(3) + cross_matrix(step[17:20])) @ bench.turn,
        bench.pivot,
        bench.standoff + step[20],
    )


class Readings(NamedTuple):
    """Of many rows."""

    state: Float[np.ndarray, "n 7"]
    solved: Float[np.ndarray, "n"]
    """Largest residual of the equilibrium, of which the equations of contact are dimensionless."""
    wrench: Float[np.ndarray, "n 6"]
    """Support reaction on the rod as the sensor reads it, its own axes, without tare."""
    jacobian: Float[np.ndarray, "n 6 21"]
    rubbing: Float[np.ndarray, "n 6 3"]
    """Derivatives with respect to the tangential force; zero without friction."""

    @property
    def sound(self) -> np.ndarray:
        """Rows with an equilibrium and finite derivatives (n,)."""
        finite = (
            np.isfinite(self.wrench).all(axis=1)
            & np.isfinite(self.jacobian).all(axis=(1, 2))
            & np.isfinite(self.rubbing).all(axis=(1, 2))
        )
        return finite & (self.solved < _SOLVED)


def unpacked(fields: Float[np.ndarray, "n width"]) -> Readings:
    """Fields of a kernel's rows by name."""
    parts = np.split(fields, np.cumsum([STATE, 1, 6, 6 * CORE]), axis=1)
    return Readings(
        parts[0],
        parts[1][:, 0],
        parts[2],
        parts[3].reshape(-1, 6, CORE),
        parts[4].reshape(-1, 6, 3),
    )


class _Contact(NamedTuple):
    """Equilibrium of one row."""

    residual: Float[Array, "4"]
    direction: Float[Array, "3"]
    """Of the contact force on the rod."""


Law = Callable[[Scene, Float[Array, "4"], Float[Array, "3"], Clamp], _Contact]


def _smooth(scene: Scene, x: Float[Array, "4"], tau: Float[Array, "3"], clamp: Clamp) -> _Contact:  # noqa: ARG001
    found = touching(scene, FRICTIONLESS, State.of(x), clamp)
    return _Contact(found.residual, found.push.direction)


def _rough(scene: Scene, x: Float[Array, "4"], tau: Float[Array, "3"], clamp: Clamp) -> _Contact:
    found = touching(scene, Leaning(tau), State.of(x), clamp)
    return _Contact(found.residual, found.push.direction)


def _predicted(
    law: Law, surface: Surface, bench: Bench, state: Float[Array, "7"], row: Float[Array, "15"]
) -> Float[Array, "158"]:
    tau = state[4:]

    def conditions(x: Float[Array, "4"]) -> Float[Array, "4"]:
        return _conditions(law, surface, bench, x, tau, row).residual

    start = jnp.concatenate(
        [state[:3] / bench.length, state[3:4] * bench.length**2 / bench.stiffness]
    )
    x = _solved(conditions, start)

    def both(
        y: Float[Array, "28"],
    ) -> tuple[tuple[Float[Array, "4"], Wrench], tuple[Float[Array, "4"], Wrench]]:
        moved, at, lean = changed(bench, y[:CORE]), x + y[CORE : CORE + 4], tau + y[CORE + 4 :]
        contact = _conditions(law, surface, moved, at, lean, row)
        values = contact.residual, _reading(moved, at, contact.direction, row)
        return values, values

    (residual_slope, reading_slope), (residual, reading) = jax.jacfwd(both, has_aux=True)(
        jnp.zeros(CORE + STATE)
    )
    known = jnp.concatenate([jnp.arange(CORE), jnp.arange(CORE + 4, CORE + STATE)])
    unknown = slice(CORE, CORE + 4)
    # What a parameter does to the equilibrium, column by column, and by this to the reading.
    follows = jax.vmap(lambda column: solve_4x4(residual_slope[:, unknown], column)[0], 1, 1)(
        residual_slope[:, known]
    )
    jacobian = reading_slope[:, known] - reading_slope[:, unknown] @ follows
    found = jnp.concatenate([x[:3] * bench.length, x[3:] * bench.stiffness / bench.length**2, tau])
    off = jnp.max(jnp.abs(residual))
    return jnp.concatenate(
        [found, off[None], reading, jacobian[:, :CORE].ravel(), jacobian[:, CORE:].ravel()]
    )


def _conditions(
    law: Law,
    surface: Surface,
    bench: Bench,
    x: Float[Array, "4"],
    tau: Float[Array, "3"],
    row: Float[Array, "15"],
) -> _Contact:
    contact = law(_scene(surface, bench), x, tau, _clamp(bench, row))
    return contact._replace(residual=contact.residual.at[0].add(-bench.standoff / bench.length))


def _scene(surface: Surface, bench: Bench) -> Scene:
    return Scene(
        Placed(surface, bench.turn, bench.pivot + bench.shift - bench.turn @ bench.pivot),
        jnp.asarray(bench.length),
    )


def _clamp(bench: Bench, row: Float[Array, "15"]) -> Clamp:
    axes = row[3:12].reshape(3, 3)
    return Clamp((row[:3] + axes @ bench.clamp) / bench.length, axes @ bench.axes[:, 2])


def _reading(
    bench: Bench, x: Float[Array, "4"], direction: Float[Array, "3"], row: Float[Array, "15"]
) -> Wrench:
    axes = row[3:12].reshape(3, 3)
    force = -x[3] * bench.stiffness / bench.length**2 * (axes.T @ direction)
    arm = axes.T @ (x[:3] * bench.length - row[:3]) - row[12:]
    return jnp.asarray(bench.gain) * jnp.concatenate([force, jnp.cross(arm, force)])


def _solved(
    conditions: Callable[[Float[Array, "4"]], Float[Array, "4"]], start: Float[Array, "4"]
) -> Float[Array, "4"]:
    """Root by Newton's method, the contact point moving by at most 0.2 L a step."""

    def both(x: Float[Array, "4"]) -> tuple[Array, Array]:
        residual = conditions(x)
        return residual, residual

    def step(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        x, _, count = carry
        slope, residual = jax.jacfwd(both, has_aux=True)(x)
        move, _ = solve_4x4(slope, residual)
        distance = jnp.sqrt(jnp.sum(move[:3] ** 2))
        return (
            x - move * jnp.minimum(1.0, _LONGEST_STEP / jnp.maximum(distance, _LONGEST_STEP)),
            jnp.max(jnp.abs(residual)),
            count + 1,
        )

    def unfinished(carry: tuple[Array, Array, Array]) -> Array:
        _, residual, count = carry
        return (residual > _CONVERGED) & (count < _MOST_ITERATIONS)

    return lax.while_loop(unfinished, step, (start, jnp.asarray(jnp.inf), jnp.asarray(0)))[0]


def _blocks(
    law: Law,
    surface: Surface,
    bench: Bench,
    states: Float[Array, "blocks 7 width"],
    rows: Float[Array, "blocks 15 width"],
) -> Float[Array, "blocks 158 width"]:
    lanes = jax.vmap(partial(_predicted, law, surface, bench), in_axes=-1, out_axes=-1)
    return lax.map(lambda block: lanes(*block), (states, rows))


_smooth_blocks = compiled(partial(_blocks, _smooth))
_rough_blocks = compiled(partial(_blocks, _rough))


def readings(
    surface: Surface,
    bench: Bench,
    states: Float[np.ndarray, "n 7"],
    rows: Float[np.ndarray, "n 15"],
    *,
    rubs: bool,
) -> Readings:
    """Readings of rows (n, …) in contact, each equilibrium sought from a state (n, 7); with `rubs`
    the tangential force is that of the state.
    """
    kernel = partial(_rough_blocks if rubs else _smooth_blocks, surface, bench)
    return unpacked(in_blocks(kernel, states, rows, sizes=ONE_BY_ONE if surface.heavy else _SIZES))
