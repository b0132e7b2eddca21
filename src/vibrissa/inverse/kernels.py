"""The inverse map in batches: without noise, and with what the noise implies."""

import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float

from vibrissa.inverse.inverse import invert, single_contact
from vibrissa.inverse.parameters import Rig, changes
from vibrissa.numerics.blocks import AnyArray
from vibrissa.numerics.compiled import compiled
from vibrissa.numerics.linear import solve_3x3
from vibrissa.numerics.rotation import cross_matrix, rotation_matrix, third_axis

WIDTH = 11
"""r (3), n̂ (3), s₁, k², energy, f, and m0·f0 / (‖m0‖ f)."""
NOISY_WIDTH = WIDTH + 9 + 9 + 3
"""The same; covariance of r, covariance of n̂, standard deviations of s₁ and k², m0·f0 in standard
deviations.
"""

# The tip is imposed where s₁ comes out longer than the rod by less than this many standard
# deviations.
TIP_DEVIATIONS = 5.0
_TIP_STEPS = 10
# Deviations of the force from which errors are carried to first order, which then holds nine in ten
# and more: below, second moments are taken.
_FIRST_ORDER = 20.0
_AT_TIP = 1e-6


@jax.jit
def invert_blocks(
    scales: Float[Array, "2"],
    force: Float[Array, "blocks 3 width"],
    moment: Float[Array, "blocks 3 width"],
    orientation: Float[Array, "blocks 4 width"],
) -> Array:
    """`invert` for the units of force and moment, and blocks of support reactions and clamp
    orientations: (blocks, 11, width).
    """

    def one(
        force: Float[Array, "3"], moment: Float[Array, "3"], orientation: Float[Array, "4"]
    ) -> Float[Array, "11"]:
        return _packed(
            jnp.concatenate([force / scales[0], moment / scales[1]]), third_axis(orientation)
        )

    return _in_lanes(one, force, moment, orientation)


@compiled
def invert_noisy_blocks(
    wrench: Float[Array, "blocks 6 width"],
    orientation: Float[Array, "blocks 4 width"],
    root: Float[Array, "blocks 6 6 width"],
    precision: Float[Array, "blocks 6 6 width"],
) -> Array:
    """`invert` of the most probable wrench (model units) of a single contact on this rod, with its
    errors: (blocks, 32, width).

    `root` is a factor of the wrench's covariance, `precision` the inverse of that.
    """

    def one(wrench: Array, orientation: Array, root: Array, precision: Array) -> Float[Array, "32"]:
        return _noisy(wrench, third_axis(orientation), root, precision).packed

    return _in_lanes(one, wrench, orientation, root, precision)


@compiled
def invert_shared_blocks(
    rig: Rig,
    errors: Float[AnyArray, "15 15"],
    wrench: Float[Array, "blocks 6 width"],
    orientation: Float[Array, "blocks 4 width"],
    root: Float[Array, "blocks 6 6 width"],
    precision: Float[Array, "blocks 6 6 width"],
    velocity: Float[Array, "blocks 6 width"],
) -> Array:
    """`invert_noisy_blocks`, and what errors of the setup of this covariance (model units) add:
    (blocks, 50, width). `velocity` is the clamp's, in its axes.

    Deviations of s₁, k² and m0·f0 are here those by noise and setup.
    """

    def one(
        wrench: Array, orientation: Array, root: Array, precision: Array, velocity: Array
    ) -> Float[Array, "50"]:
        found = _noisy(wrench, third_axis(orientation), root, precision)
        slope = _sensitivity(found, orientation, velocity, rig)
        of_reach, of_direction = (
            _product(_product(part, errors), part.T) for part in (slope[:3], slope[3:6])
        )
        arc_length, modulus, single = found.packed[NOISY_WIDTH - 3 :]
        more = jnp.sum(_product(slope[6:], errors) * slope[6:], axis=1)
        told = [
            jnp.sqrt(arc_length**2 + more[0]),
            jnp.sqrt(modulus**2 + more[1]),
            single / jnp.sqrt(1 + more[2]),
        ]
        return jnp.concatenate(
            [
                found.packed[: NOISY_WIDTH - 3],
                jnp.stack(told),
                of_reach.ravel(),
                of_direction.ravel(),
            ]
        )

    return _in_lanes(one, wrench, orientation, root, precision, velocity)


@compiled
def sensitivity_blocks(
    rig: Rig,
    wrench: Float[Array, "blocks 6 width"],
    orientation: Float[Array, "blocks 4 width"],
    root: Float[Array, "blocks 6 6 width"],
    precision: Float[Array, "blocks 6 6 width"],
    velocity: Float[Array, "blocks 6 width"],
) -> Array:
    """Derivatives of r and n̂, world axes, by `vibrissa.tolerances.PARAMETERS` for given readings:
    (blocks, 6, 15, width).
    """

    def one(
        wrench: Array, orientation: Array, root: Array, precision: Array, velocity: Array
    ) -> Float[Array, "6 15"]:
        return _sensitivity(
            _noisy(wrench, third_axis(orientation), root, precision), orientation, velocity, rig
        )[:6]

    return _in_lanes(one, wrench, orientation, root, precision, velocity)


def _in_lanes(one: Callable[..., Array], *blocks: Array) -> Array:
    """A function of one sample, applied to blocks with the samples on their last axis."""
    lanes = jax.vmap(one, in_axes=-1, out_axes=-1)
    return lax.map(lambda block: lanes(*block), blocks)


class _Found(NamedTuple):
    packed: Float[Array, "32"]
    wrench: Float[Array, "6"]
    """Most probable, world axes."""
    jacobian: Float[Array, "9 6"]
    """By the measured wrench: of r and n̂, at s₁ = L where that was imposed; of s₁ and k² without
    it; of m0·f0 in its standard deviations.
    """


def _packed(wrench: Float[Array, "6"], tangent: Float[Array, "3"]) -> Float[Array, "11"]:
    force, moment = wrench[:3], wrench[3:]
    contact = invert(force, moment, tangent)
    f, m = jnp.sqrt(jnp.sum(force * force)), jnp.sqrt(jnp.sum(moment * moment))
    single = jnp.dot(force, moment) / (f * m)
    return jnp.concatenate(
        [
            contact.reach,
            contact.direction,
            jnp.stack([contact.arc_length, contact.modulus, contact.energy, f, single]),
        ]
    )


def _noisy(
    wrench: Float[Array, "6"],
    tangent: Float[Array, "3"],
    root: Float[Array, "6 6"],
    precision: Float[Array, "6 6"],
) -> _Found:
    covariance = _product(root, root.T)
    single, deviation = single_contact(wrench, covariance)
    straight = _straight_tip(single, tangent, precision)
    within = _within_the_rod(single, straight, tangent, covariance)

    def observed(measured: Float[Array, "6"]) -> Float[Array, "8"]:
        # Errors pass through the projection on a single contact, but not through the limit at the
        # tip, where they would be cut.
        shifted, _ = single_contact(measured, covariance)
        return _packed(shifted, tangent)[:8]

    jacobian = jax.jacfwd(observed)(within)
    errors = jacobian @ covariance @ jacobian.T
    values = _packed(within, tangent)
    values = values.at[:3].set(_within_reach(values[:3]))
    of_reach, of_direction = _second_moments(observed, within, root, values)
    # A contact that says flank may be one at the tip of a rod that is still straight, as likely as
    # noise makes of one the other.
    towards = tangent - values[:3]
    of_reach = of_reach + jnp.exp(-(straight.deviations**2) / 2) * jnp.outer(towards, towards)
    strong = (
        jnp.sum(within[:3] ** 2)
        > _FIRST_ORDER**2 * (covariance[0, 0] + covariance[1, 1] + covariance[2, 2]) / 3
    )
    of_reach, of_direction = (
        jnp.where(strong, first, second)
        for first, second in ((errors[:3, :3], of_reach), (errors[3:6, 3:6], of_direction))
    )
    extra = jnp.stack([jnp.sqrt(errors[6, 6]), jnp.sqrt(errors[7, 7]), deviation])
    # A wrench that was moved to the tip stays there, however the setup's numbers change it.
    along = covariance @ jacobian[6] / jnp.maximum(errors[6, 6], 1e-300) * jnp.any(within != single)
    pinned = jacobian[:6] - jnp.outer(jacobian[:6] @ along, jacobian[6])
    couple = jnp.concatenate([wrench[3:], wrench[:3]])
    couple = couple / jnp.sqrt(couple @ covariance @ couple)
    slopes = jnp.concatenate([pinned, jacobian[6:], couple[None]])
    return _Found(
        jnp.concatenate([values, of_reach.ravel(), of_direction.ravel(), extra]), within, slopes
    )


def _second_moments(
    observed: Callable[[Array], Array],
    wrench: Float[Array, "6"],
    root: Float[Array, "6 6"],
    values: Float[Array, "11"],
) -> tuple[Float[Array, "3 3"], Float[Array, "3 3"]]:
    """Mean squares of the errors of r and n̂ under noise, by the points √6 deviations to either
    side along each axis of its ellipsoid.

    They match the noise's mean and covariance, and two moments more along each axis (S. J. Julier,
    J. K. Uhlmann, Proc. IEEE 92 (2004) 401-422): where the force is a few deviations, the contact
    is far from linear in them.
    """
    size = len(wrench)
    steps = math.sqrt(size) * jnp.concatenate([root.T, -root.T])
    found = jax.vmap(observed)(wrench + steps)
    reach = jax.vmap(_within_reach)(found[:, :3]) - values[:3]
    # Square to n̂: a unit vector can only turn.
    direction = (
        found[:, 3:6] - jnp.sum(found[:, 3:6] * values[3:6], axis=1, keepdims=True) * values[3:6]
    )
    by_reach, by_direction = (_product(part.T, part) / (2 * size) for part in (reach, direction))
    return by_reach, by_direction


def _within_reach(reach: Float[Array, "3"]) -> Float[Array, "3"]:
    """No contact lies farther from the clamp than the rod is long: near first contact noise may say
    so.
    """
    return reach / jnp.maximum(jnp.sqrt(jnp.sum(reach * reach)), 1.0)


def _sensitivity(
    found: _Found, orientation: Float[Array, "4"], velocity: Float[Array, "6"], rig: Rig
) -> Float[Array, "9 15"]:
    """With other numbers of the setup the same readings are another wrench on another rod, seen
    from another place: of r, n̂, s₁, k² and m0·f0.
    """
    turn = rotation_matrix(orientation)
    force, moment, reach, direction = (
        part @ turn
        for part in (found.wrench[:3], found.wrench[3:], found.packed[:3], found.packed[3:6])
    )
    seen = changes(jnp.concatenate([force, moment]), reach, direction, velocity, rig)
    jacobian = jnp.concatenate(
        [_product(found.jacobian[:, :3], turn), _product(found.jacobian[:, 3:], turn)], axis=1
    )
    on_wrench, on_reach, on_direction = map(jnp.asarray, seen)
    seen_from = [
        _product(turn, on_reach),
        _product(turn, on_direction),
        jnp.zeros((3, on_wrench.shape[1])),
    ]
    return jnp.concatenate(seen_from) - _product(jacobian, on_wrench)


def _product(first: Float[AnyArray, "k l"], second: Float[AnyArray, "l m"]) -> Float[Array, "k m"]:
    """Matrix product as plain arithmetic, which keeps the lanes together."""
    return jnp.sum(jnp.asarray(first)[:, :, None] * jnp.asarray(second)[None], axis=1)


class _Straight(NamedTuple):
    wrench: Float[Array, "6"]
    deviations: Float[Array, ""]


def _within_the_rod(
    wrench: Float[Array, "6"],
    straight: _Straight,
    tangent: Float[Array, "3"],
    covariance: Float[Array, "6 6"],
) -> Float[Array, "6"]:
    """The most probable wrench with s₁ ≤ L: a contact beyond the tip, by less than the noise
    explains, is one at the tip.
    """

    def log_arc_length(wrench: Float[Array, "6"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        value = jnp.log(invert(wrench[:3], wrench[3:], tangent).arc_length)
        return value, value

    def step(_: Array | int, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        current, _, _ = state
        slope, value = jax.jacfwd(log_arc_length, has_aux=True)(current)
        spread = covariance @ slope
        multiplier = (value + slope @ (wrench - current)) / (slope @ spread)
        # The change of the wrench, Σ · slope · multiplier, in standard deviations.
        return wrench - spread * multiplier, multiplier * jnp.sqrt(slope @ spread), value

    beyond = log_arc_length(wrench)[0] > 0
    limited, deviations, value = lax.fori_loop(
        0, _TIP_STEPS, step, (wrench, jnp.zeros(()), jnp.zeros(()))
    )
    near = (jnp.abs(value) < _AT_TIP) & (jnp.abs(deviations) < TIP_DEVIATIONS)
    chosen = jnp.where(
        near, limited, jnp.where(straight.deviations < TIP_DEVIATIONS, straight.wrench, wrench)
    )
    return jnp.where(beyond, chosen, wrench)


def _straight_tip(
    wrench: Float[Array, "6"], tangent: Float[Array, "3"], precision: Float[Array, "6 6"]
) -> _Straight:
    """Most probable wrench of a force at the tip of the rod while it is still straight, and its
    distance in standard deviations.

    Near first contact noise may move s₁ by rod lengths, and the bent rod's equations are of no use.
    """
    # f0 = −F and m0 = −t0 × F, so m0 = t0 × f0.
    design = jnp.concatenate([jnp.eye(3), cross_matrix(tangent)])
    weighted = precision @ design
    straight = design @ solve_3x3(design.T @ weighted, weighted.T @ wrench)
    # At the minimum the square of the distance is wᵀΣ⁻¹w less what the design explains.
    weighted_wrench = precision @ wrench
    return _Straight(straight, jnp.sqrt(jnp.maximum((wrench - straight) @ weighted_wrench, 0.0)))
