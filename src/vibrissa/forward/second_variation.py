"""Whether an equilibrium is stable: the sign of the second variation of the energy under the
constraint of contact.

Let θ(s) turn the rod's sections by a small rotation vector, so that δt = θ × t and δr = ∫ δt ds.
With m and n the moment and force in the rod, C its compliance's inverse, B for bending and B₃ for
twist, and F = f n̂ the contact force,

    δ²Π = ∫ θ'·C θ' − m·(θ × θ') − n·(θ × (θ × t)) ds − f δrᵀ G δr,    n̂·δr = 0,

over 0 ≤ s ≤ s₁, with θ(0) = 0 at a rigid clamp. G is the Hessian of the distance from the object;
in tangential contact, where the rod may touch at another of its points, less h hᵀ/(tᵀGt) with
h·θ = tᵀG δr + n̂·δt(s₁), as it is the least distance along the rod that stays zero. The rest of the
rod beyond the contact is free and contributes nothing negative, unless loads do. Linear finite
elements; twist is eliminated, and the sign of the least eigenvalue decides.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax import Array
from jaxtyping import Float

from vibrissa.contact import Scene
from vibrissa.geometry.rotation import cross_matrices

_ELEMENTS = 160
_RIGID = 1e-9
"""Compliance [L/EI] added to that of a support which does not turn about every axis."""


@jax.jit
def _derivatives(scene: Scene, point: Float[Array, "3"]) -> Float[Array, "12"]:
    gradient = jax.grad(scene.level)(point)
    hessian = jax.hessian(scene.level)(point)
    return jnp.concatenate([gradient, hessian.ravel()])


def distance_hessian(
    scene: Scene, point: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Unit normal n, and Hessian of the level function divided by the norm of its gradient: on
    tangent vectors, this is the Hessian of the distance.
    """
    values = np.asarray(_derivatives(scene, jnp.asarray(point)))
    steepness = float(np.linalg.norm(values[:3]))
    return values[:3] / steepness, values[3:].reshape(3, 3) / steepness


class Shape(NamedTuple):
    """A rod at equally spaced nodes from clamp to contact, model units."""

    tangent: Float[np.ndarray, "nodes 3"]
    moment: Float[np.ndarray, "nodes 3"]
    """m, which the rod ahead exerts on the rod behind."""
    force: Float[np.ndarray, "nodes 3"]
    """n, the same."""
    bending: Float[np.ndarray, "nodes"]
    torsion: Float[np.ndarray, "nodes"]
    support: Float[np.ndarray, "3 3"] | None = None
    """Rotational compliance of the clamp, world axes; None if it is rigid."""


def least_second_variation(
    scene: Scene,
    point: Float[np.ndarray, "3"],
    force: float,
    shape: Shape,
    arc_length: float,
    *,
    tangential: bool,
    turns_about: Float[np.ndarray, "3"] | None = None,
) -> float:
    """Least eigenvalue of the second variation per ∫ |δt|² ds [EI/L²]; negative where the
    equilibrium is unstable.

    Parameters
    ----------
    scene, point, force
        Object, contact point [L] and magnitude f [EI/L²] of the contact force.
    shape, arc_length
        The rod up to the contact, and s₁ [L].
    tangential
        Whether the contact may move along the rod.
    turns_about
        Axis (3,) about which the rod may turn as one, if there is one: the eigenvalue is that of
        the changes square to that, which has none.
    """
    n, hessian = distance_hessian(scene, point)
    t, count = shape.tangent, len(shape.tangent)
    h, one = arc_length / (count - 1), np.eye(3)
    outer = t[:, :, None] * t[:, None, :]
    stiff = shape.bending[:, None, None] * (one - outer) + shape.torsion[:, None, None] * outer
    leaning = shape.force[:, :, None] * t[:, None, :]
    along = np.einsum("ni,ni->n", shape.force, t)
    geometric = along[:, None, None] * one - (leaning + np.swapaxes(leaning, 1, 2)) / 2
    form, norm = np.zeros((2, count, 3, count, 3))
    first, second = np.arange(count - 1), np.arange(1, count)

    def middle(values: Float[np.ndarray, "nodes *k"]) -> Float[np.ndarray, "elements *k"]:
        return (values[1:] + values[:-1]) / 2

    for a, b, sign, share in (
        (first, first, 1, 2),
        (second, second, 1, 2),
        (first, second, -1, 1),
        (second, first, -1, 1),
    ):
        form[a, :, b, :] += sign * middle(stiff) / h + share * h / 6 * middle(geometric)
        norm[a, :, b, :] += share * h / 6 * middle(one - outer)
    # ∫ m·(θ × θ') over an element is m·(θ_a × θ_b).
    turning = cross_matrices(middle(shape.moment)) / 2
    form[first, :, second, :] += turning
    form[second, :, first, :] -= turning
    if shape.support is not None:
        form[0, :, 0, :] += np.linalg.inv(shape.support + _RIGID * one)
    # In axes of the section, twist last; δr and δt depend on the others only.
    axes = _across(t)
    turn = np.zeros((count, 3, count, 3))
    turn[np.arange(count), :, np.arange(count), :] = np.stack([*axes, t], axis=2)
    turned = turn.reshape(3 * count, 3 * count)
    whole, mass = (turned.T @ part.reshape(turned.shape) @ turned for part in (form, norm))
    free = np.ones((count, 3), dtype=bool)
    free[0] = shape.support is not None
    bends, twists = (np.flatnonzero(free & kind) for kind in ([1, 1, 0], [0, 0, 1]))
    coupling = whole[np.ix_(twists, bends)]
    relaxed = scipy.linalg.solve(whole[np.ix_(twists, twists)], coupling, assume_a="sym")
    energy = whole[np.ix_(bends, bends)] - coupling.T @ relaxed
    weight = np.full(count, h)
    weight[[0, -1]] = h / 2
    tilts = np.cross(np.stack(axes, axis=1), t[:, None])  # δt by each unknown
    moves = (weight[:, None, None] * tilts)[free[:, :2]].T
    energy = energy - force * moves.T @ hessian @ moves
    if tangential:
        bend = float(t[-1] @ hessian @ t[-1])
        if bend > 0:
            shift = t[-1] @ hessian @ moves
            shift[-2:] += tilts[-1] @ n
            energy = energy + force * np.outer(shift, shift) / bend
    inertia, kept = mass[np.ix_(bends, bends)], [n @ moves]
    if turns_about is not None:
        kept.append(inertia @ (np.stack(axes, axis=1) @ turns_about)[free[:, :2]])
    basis = scipy.linalg.null_space(np.stack(kept))
    return float(
        scipy.linalg.eigh(
            basis.T @ energy @ basis,
            basis.T @ inertia @ basis,
            eigvals_only=True,
            subset_by_index=[0, 0],
        )[0]
    )


def _across(
    tangent: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Two unit vectors across each tangent."""
    first = np.cross(tangent, np.eye(3)[np.argmin(np.abs(tangent), axis=1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(tangent, first)


NODES = _ELEMENTS + 1
