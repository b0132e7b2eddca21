"""How errors of the setup change the measured wrench and the apparent contact, at fixed coordinates
of the contact on the rod.

All is exact to first order and linear in the wrench, so no derivatives need be computed. Let θ be
true minus stated values of `vibrissa.tolerances.PARAMETERS`, and w = (f, m) the wrench in clamp
axes and model units (L = EI = 1). At the same coordinates in its own units, the true rod exerts a
larger wrench if it is stiffer and a smaller one if it is longer: δf = (θ_EI − 2 θ_L) f, δm =
(θ_EI − θ_L) m, δr = θ_L r. If the true clamp is shifted by s and rotated by φ from the stated one,
δf = φ × f, δm = φ × m + s × f, δr = s + φ × r, δn = φ × n. Gains act on the six channels in sensor
axes. If poses come late by τ, the clamp has moved on: it is shifted by v τ and rotated by ω τ, and
a wrench in world axes rotates with it.
"""

from functools import lru_cache
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.inverse.arrays import Frame, Scalar, Vector, Wrench, Wrenches
from vibrissa.numerics.lanes import AnyArray, lanes
from vibrissa.numerics.rotation import cross_matrix
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.tolerances import PARAMETERS, SetupErrors

COUNT = len(PARAMETERS)
_NO_ERRORS = SetupErrors(np.zeros((COUNT, COUNT)), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3))


class Rig(NamedTuple):
    """How the sensor sits relative to the clamp: clamp axes, model units."""

    turn: Frame
    """From sensor to clamp axes."""
    arm: Vector
    """From the torque reference point to the clamp."""
    in_world_axes: Scalar
    """1 if the wrench was logged in world axes."""


class Changes(NamedTuple):
    """Derivatives with respect to `PARAMETERS`, lengths in rod lengths: for one sample, or one row
    per sample.
    """

    wrench: Float[AnyArray, "*n 6 setup"]
    """Of the measured wrench (f0, m0), in stated clamp axes and model units of the stated rod."""
    reach: Float[AnyArray, "*n 3 setup"]
    """Of the contact as seen from the stated clamp."""
    direction: Float[AnyArray, "*n 3 setup"]
    """Of the unit vector of the contact force."""


def changes(
    rig: Rig | None,
    wrench: Wrench,
    reach: Vector,
    direction: Vector,
    velocity: Wrench,
) -> Changes:
    """For one sample, clamp axes and model units; `velocity` is the clamp's linear and angular
    velocity, per second.
    """
    assert rig is not None
    force, moment = wrench[:3], wrench[3:]
    zero, turn, arm = jnp.zeros((3, 3)), jnp.asarray(rig.turn), cross_matrix(jnp.asarray(rig.arm))
    f, m, r, n = (-cross_matrix(vector) for vector in (force, moment, reach, direction))
    shift, spin = velocity[:3], velocity[3:]
    about = moment + arm @ force
    gain_force, gain_torque = turn * (turn.T @ force), turn * (turn.T @ about)
    # About the torque reference point, where a logged wrench is taken.
    turned = jnp.cross(spin, force) * rig.in_world_axes
    late = jnp.cross(spin, about) * rig.in_world_axes - arm @ turned
    seen = shift + jnp.cross(spin, reach)
    # By stiffness, length, clamp position and rotation, force and torque gains, and delay.
    none = jnp.zeros(3)
    of_force = (force, -2 * force, zero, f, gain_force, zero, turned)
    of_moment = (moment, -moment, f @ turn, m, -arm @ gain_force, gain_torque, late)
    of_reach = (none, reach, turn, r, zero, zero, seen)
    of_direction = (none, none, zero, n, zero, zero, jnp.cross(spin, direction))
    by_force, by_moment, by_reach, by_direction = (
        jnp.column_stack(parts) for parts in (of_force, of_moment, of_reach, of_direction)
    )
    return Changes(jnp.concatenate([by_force, by_moment]), by_reach, by_direction)


changes_of_rows = lanes()(changes)
"""`changes` of many samples, one row each."""


class Known(NamedTuple):
    """The setup errors that are stated, for one rod: lengths in rod lengths."""

    rig: Rig
    factor: Float[np.ndarray, "setup p"]
    """Of the covariance; (15, 0) if the setup states none."""
    covariance: Float[np.ndarray, "setup setup"]


@lru_cache(maxsize=64)
def prepared(rod: Rod, errors: SetupErrors | None) -> Known:
    """Errors of a setup for this rod; without any, sensor axes are clamp axes."""
    given = errors or _NO_ERRORS
    turn = rotation_matrices(given.clamp_orientation).T
    rig = Rig(turn, turn @ given.arm / rod.length, np.array(float(given.in_world_axes)))
    lengths = [name.startswith(("length", "clamp_position")) for name in PARAMETERS]
    factor = given.factor / np.where(lengths, rod.length, 1.0)[:, None]
    return Known(rig, factor, factor @ factor.T)


def velocities_of(rod: Rod, reactions: Reactions) -> Wrenches:
    """Of the clamp: clamp axes, rod lengths and radians per second."""
    parts = reactions.clamp_velocity().reshape(*reactions.trail.shape, 2, 3)
    parts = parts / [[rod.length], [1.0]] @ reactions.trail.rotation
    return parts.reshape(*reactions.trail.shape, 6)
