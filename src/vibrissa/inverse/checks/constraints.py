"""What over-determines a contact, and how each cause of error would show in it.

A straight uniform rod with one contact force bends in a plane, so m·n̂ = 0 (one force carries no
couple) and m·t = 0 (no torsion); and either s₁ = L (tip) or t·n̂ = 0 (tangential contact without
friction: incidence ½), of which the rod obeys one. All are taken where the ideal rod's curvature
vanishes; the tip's as g (L − s₁), with g = ‖t × n‖ the slope of the moment there, which is linear
in the noise through first contact.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from vibrissa.inverse.inverse import invert
from vibrissa.mechanics.imperfect import End, Imperfect, contact_near, rod_end
from vibrissa.numerics.lanes import AnyArray, lanes

COUPLE, TORSION, TIP, TANGENT = range(4)
"""Rows of the constraints."""


class Slopes(NamedTuple):
    """Of the constraints and the contact point, clamp axes and model units, by what could be
    wrong.
    """

    constraints: Float[AnyArray, "*k 4 p"]
    point: Float[AnyArray, "*k 3 p"]

    def __matmul__(self, step: Float[np.ndarray, "k p q"]) -> "Slopes":
        return Slopes(self.constraints @ step, self.point @ step)


class Constraints(NamedTuple):
    """Values at the stretches in contact (k, …), and their derivatives.

    Attributes
    ----------
    value
        (k, 4) of m·n̂, m·t, g (1 − s₁) and t·n̂.
    reach, tangent, force
        (k, 3) of the contact, clamp axes; `force` on the rod.
    arc_length
        (k,).
    steepness
        (k,) g.
    by_wrench, by_taper, by_curvature, by_load
        Derivatives by base wrench (6), share of the radius lost at the tip (1), rest curvature (2),
        load per length (3), clamp axes.
    """

    value: Float[AnyArray, "*k 4"]
    reach: Float[AnyArray, "*k 3"]
    tangent: Float[AnyArray, "*k 3"]
    force: Float[AnyArray, "*k 3"]
    arc_length: Float[AnyArray, "*k"]
    steepness: Float[AnyArray, "*k"]
    by_wrench: Slopes
    by_taper: Slopes
    by_curvature: Slopes
    by_load: Slopes


@lanes(width=96, blocks=1)
def constraints_of(length: Float[Array, ""], rod: Imperfect) -> Constraints:
    """Constraints for rods by their base wrenches, clamp axes, of this length."""
    wrench = jnp.asarray(rod.wrench)
    ideal = invert(wrench[:3], wrench[3:], jnp.array([0.0, 0.0, 1.0])).arc_length
    off_ideal = jnp.any(rod.load != 0) | jnp.any(rod.curvature != 0) | (rod.taper != 0)
    arc_length = jnp.where(off_ideal, contact_near(rod, ideal), ideal)

    def end(rod: Imperfect) -> tuple[End, End]:
        value = rod_end(rod, arc_length)
        return value, value

    slopes, here = jax.jacfwd(end, has_aux=True)(rod)
    t, f = here.tangent, jnp.sqrt(jnp.sum(here.force**2))
    direction, rate = here.force / f, -jnp.cross(t, here.force)
    g = jnp.sqrt(jnp.sum(rate**2))
    across = rate / g

    def by(*parts: Float[Array, "3 *p"]) -> Slopes:
        moment, force, tangent, reach = (part.reshape(3, -1) for part in parts)
        beyond, turning = across @ moment, (force - jnp.outer(direction, direction @ force)) / f
        # Where the constraints hold, the moment is zero: what turns its axes says nothing, and
        # noise times it would look like a cause.
        rows = [direction @ moment, t @ moment, beyond, direction @ tangent + t @ turning]
        return Slopes(jnp.stack(rows), reach - jnp.outer(t, beyond / g))

    couple, torsion, off = (here.moment @ axis for axis in (direction, t, across))
    return Constraints(
        jnp.stack([couple, torsion, g * (length - arc_length) + off, t @ direction]),
        here.reach - t * off / g,
        t,
        here.force,
        arc_length - off / g,
        g,
        *(by(*parts) for parts in zip(*slopes, strict=True)),
    )
