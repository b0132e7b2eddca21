"""How the rod is held."""

from dataclasses import dataclass
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite_array, positive_array
from vibrissa.rod.tree import Described, array, known, tree

_SYMMETRIC = 1e-9  # of the largest entry: rounding of a matrix that was computed or printed


@tree("kind")
@dataclass(frozen=True, eq=False, repr=False)
class Support(Described):
    """The rod's clamp yields: (force, moment) on it = K (displacement, rotation vector), in clamp
    axes, forces first. The moment is that about the clamp where it is without load, not where it
    has moved to.

    A pytree: its stiffness may be JAX numbers.

    Attributes
    ----------
    kind
        "rigid", "pivot" or "compliant".
    stiffness
        None; (3,) [N m/rad] about the clamp axes; or (6, 6) [N/m, N/rad, N, N m/rad].

    Raises
    ------
    ValueError
        If the kind is none of these, or the stiffness is not one of its kind.
    """

    kind: Literal["rigid", "pivot", "compliant"] = "rigid"
    stiffness: Any = None

    def __post_init__(self) -> None:
        stiffness: Any = self.stiffness
        match self.kind:
            case "rigid":
                if stiffness is not None:
                    raise ValueError(
                        f"stiffness = {stiffness!r}; allowed is None if kind = 'rigid'"
                    )
                return
            case "pivot":
                if known(stiffness):
                    stiffness = positive_array(stiffness, "stiffness", last=3)
            case "compliant":
                if known(stiffness):
                    stiffness = _definite(finite_array(stiffness, "stiffness"))
            case other:
                raise ValueError(f"kind = {other!r}; allowed is 'rigid', 'pivot' or 'compliant'")
        object.__setattr__(self, "stiffness", array(stiffness))

    @staticmethod
    def rigid() -> "Support":
        """A clamp that does not yield."""
        return Support()

    @staticmethod
    def pivot(stiffness: ArrayLike) -> "Support":
        """A clamp that turns about its fixed position, with a stiffness (3,) [N m/rad] about its
        axes.

        Raises
        ------
        ValueError
            If a stiffness is not positive and finite.
        """
        return Support("pivot", stiffness)

    @staticmethod
    def compliant(stiffness: ArrayLike) -> "Support":
        """A clamp that moves and turns, with a stiffness K (6, 6); its moment is about the clamp
        where it is without load.

        Raises
        ------
        ValueError
            If K is not symmetric and positive definite.
        """
        return Support("compliant", stiffness)

    @property
    def compliance(self) -> Float[Any, "6 6"]:
        """(displacement, rotation vector) by (force, moment) on the support, in clamp axes."""
        if self.stiffness is None:
            return jnp.zeros((6, 6))
        stiffness = jnp.asarray(self.stiffness)
        if stiffness.ndim == 1:
            return jnp.diag(jnp.concatenate([jnp.zeros(3), 1 / stiffness]))
        return jnp.linalg.inv(stiffness)


def _definite(matrix: Float[np.ndarray, "..."]) -> Float[np.ndarray, "6 6"]:
    if matrix.shape != (6, 6):
        raise ValueError(f"stiffness has shape {matrix.shape}; allowed is (6, 6)")
    skew = float(np.abs(matrix - matrix.T).max())
    if skew > _SYMMETRIC * float(np.abs(matrix).max()):
        raise ValueError(f"stiffness is off its transpose by {skew:g}; allowed is symmetric")
    matrix = (matrix + matrix.T) / 2
    # Forces and moments differ in unit: definite is what it is with a diagonal of ones.
    diagonal = np.diag(matrix)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    least = float(np.linalg.eigvalsh(matrix / np.outer(scale, scale)).min())
    if not (np.all(diagonal > 0) and least > _SYMMETRIC):
        raise ValueError(
            f"stiffness has the eigenvalue {least:.3g} (scaled to a diagonal of ones); "
            "allowed is positive definite"
        )
    return matrix
