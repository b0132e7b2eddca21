"""Whether an equilibrium is stable: the sign of the second variation of the energy under the
constraint of contact.

The rod is described by its unit tangents t(s), and η = u e_n + v e_b is a small variation of them,
u in the bending plane and v out of it, both zero at the clamp. With the contact force F = f n and
the Lagrange multiplier |t'|² − F·t of the constraint |t| = 1,

    δ²Π = ∫ u'² + (F·t) u² + v'² + (F·t − κ²) v² ds − f δrᵀ G δr,    δr = ∫ η ds,    n·δr = 0,

over 0 ≤ s ≤ s₁. G is the Hessian of the distance from the object; in tangential contact, where the
rod may touch at another of its points, less h hᵀ/(tᵀGt) with h·η = tᵀG δr + n·η(s₁), as it is the
least distance along the rod that stays zero. The rest of the rod beyond the contact is free and
contributes nothing negative. Linear finite elements; the sign of the least eigenvalue decides.
"""

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax import Array
from jaxtyping import Float

from vibrissa.contact import Scene

_ELEMENTS = 96


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


def least_second_variation(
    scene: Scene,
    point: Float[np.ndarray, "3"],
    force: float,
    tangent: Float[np.ndarray, "nodes 3"],
    curvature: Float[np.ndarray, "nodes"],
    plane_normal: Float[np.ndarray, "3"],
    arc_length: float,
    *,
    tangential: bool,
) -> float:
    """Least eigenvalue of the second variation per ∫ |η|² ds [EI/L²]; negative where the
    equilibrium is unstable.

    Parameters
    ----------
    scene, point, force
        Object, contact point [L] and magnitude f [EI/L²] of the contact force.
    tangent, curvature
        t and signed curvature [1/L] about `plane_normal` at equally spaced nodes from clamp to
        contact.
    plane_normal, arc_length
        Unit normal of the bending plane, and s₁ [L].
    tangential
        Whether the contact may move along the rod.
    """
    n, hessian = distance_hessian(scene, point)
    count = len(tangent)
    h = arc_length / (count - 1)
    in_plane = np.cross(plane_normal, tangent)
    along = force * tangent @ n
    stiffness, mass = _second_differences(count, h), _mass(np.ones(count), h)
    zero = np.zeros((count, count))
    form = np.block(
        [[stiffness + _mass(along, h), zero], [zero, stiffness + _mass(along - curvature**2, h)]]
    )
    norm = np.block([[mass, zero], [zero, mass]])
    # δr as a linear map of the nodal values, each element's mean times its length.
    share = np.full(count, h)
    share[[0, -1]] = h / 2
    moves = np.concatenate(
        [share * in_plane.T, np.tile(share, (3, 1)) * plane_normal[:, None]], axis=1
    )
    effective = hessian
    form = form - force * moves.T @ effective @ moves
    if tangential:
        t = tangent[-1]
        bend = float(t @ hessian @ t)
        if bend > 0:
            end = np.zeros(2 * count)
            end[count - 1], end[-1] = n @ in_plane[-1], n @ plane_normal
            shift = t @ hessian @ moves + end
            form = form + force * np.outer(shift, shift) / bend
    free = np.ones(2 * count, dtype=bool)
    free[[0, count]] = False
    form, norm, constraint = form[np.ix_(free, free)], norm[np.ix_(free, free)], (n @ moves)[free]
    # An orthonormal basis of the variations that keep contact, by a Householder reflection.
    reflection = constraint.copy()
    reflection[0] += np.copysign(np.linalg.norm(constraint), constraint[0])
    basis = (
        np.eye(len(constraint)) - 2 * np.outer(reflection, reflection) / (reflection @ reflection)
    )[:, 1:]
    return float(
        scipy.linalg.eigh(
            basis.T @ form @ basis,
            basis.T @ norm @ basis,
            eigvals_only=True,
            subset_by_index=[0, 0],
        )[0]
    )


def _second_differences(count: int, h: float) -> Float[np.ndarray, "n n"]:
    matrix = (
        np.diag(np.full(count, 2 / h))
        - np.diag(np.full(count - 1, 1 / h), 1)
        - np.diag(np.full(count - 1, 1 / h), -1)
    )
    matrix[0, 0] = matrix[-1, -1] = 1 / h
    return matrix


def _mass(weight: Float[np.ndarray, "n"], h: float) -> Float[np.ndarray, "n n"]:
    """∫ w φᵢ φⱼ ds of linear elements, w linear in each."""
    left, right = weight[:-1], weight[1:]
    matrix = np.diag(np.append(h * (3 * left + right) / 12, 0)) + np.diag(
        np.append(0, h * (left + 3 * right) / 12)
    )
    coupling = h * (left + right) / 12
    return np.asarray(matrix + np.diag(coupling, 1) + np.diag(coupling, -1))


NODES = _ELEMENTS + 1
