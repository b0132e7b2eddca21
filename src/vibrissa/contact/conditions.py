"""The forward problem as a root of the inverse map (mechanics.md, "Contact conditions").

The unknowns are the contact point p on the object, the magnitude f of the contact force, and
whatever the contact law and the rod add. The line of action of the force fixes the lever arm, and
with it the whole rod. For any rod and any law these conditions remain:

    g(p) = 0                 the point lies on the object,
    misses = 0               the rod passes through the point,
    min(1 − s₁, away) = 0    tip contact, or the rod tangent to the object,

and those of the law. With friction a state depends on the previous one.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from vibrissa.contact.laws import Law, Push
from vibrissa.contact.scene import Reached, Scene, State
from vibrissa.mechanics.model import Bent, Clamp
from vibrissa.numerics.vectors import joined

Scalar = Float[Any, ""]
Vector = Float[Any, "3"]


class Touching(NamedTuple):
    """Everything that a state implies at a clamp pose."""

    residual: Float[Any, "unknowns"]
    push: Push
    bent: Bent
    tangent: Vector
    """Of the rod at the contact."""
    phase: Scalar
    """(1 − s₁) − away: negative in tip contact, positive in tangential contact, zero where one
    turns into the other.
    """
    beyond: Scalar
    """With friction: how far outside the cone the force would lie without sliding."""

    def reached(self, state: State) -> Reached:
        """What is passed on to the next position."""
        return Reached(state, self.bent.arc_length, self.tangent)


def touching(
    scene: Scene,
    law: Law,
    state: State,
    clamp: Clamp,
    before: Reached | None = None,
    side: Vector | None = None,
    near: Scalar | None = None,
) -> Touching:
    """Evaluate the conditions of contact.

    `before` is what the previous position reached, for friction; `side` is r there: a rod pushed
    along its own axis stays in that plane. `near` is as in `RodModel.bent`.
    """
    push = law.push(scene, state)
    bent = scene.rod.bent(clamp, state.point, state.force, push.direction, state.own, side, near)
    tangent = scene.rod.tangent(bent)
    left, away = 1 - bent.arc_length, law.away(bent, tangent, push.normal)
    if scene.slims:
        # The skin leans against the centre line as the rod gets thinner.
        slack, lean = jax.jvp(scene.slack, (bent.arc_length,), (jnp.ones(()),))
        push, away = push._replace(gaps=push.gaps + slack), away - lean / 2
    rubs, beyond = law.rubs(scene, state, push.normal, bent, tangent, before)
    placed = law.placed(left, away)
    # The rod's own conditions come last, as its unknowns do: their number leaves the sign of the
    # determinant as it is.
    passes, own = bent.misses[:2], bent.misses[2:]
    residual = joined(push.gaps, passes, placed, rubs, own)
    return Touching(residual, push, bent, tangent, left - away, beyond)
