"""The forward problem as a root of the inverse map (mechanics.md, "Contact conditions").

Unknown are the contact point p on the object, the magnitude f of the contact force, and what the
law of contact adds. The line of the force fixes the lever arm, and with it the whole rod; for any
rod and any law these conditions are left:

    g(p) = 0             the point lies on the object,
    misses = 0           the rod lies in the plane of clamp axis and force, and reaches the point,
    min(1 − s₁, away)    tip contact, or the rod tangent to the object,

and those of the law. With friction a state depends on the one before.
"""

from typing import Any, NamedTuple

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
        """What is handed on."""
        return Reached(state, self.bent.arc_length, self.tangent)


def touching(
    scene: Scene,
    law: Law,
    state: State,
    clamp: Clamp,
    before: Reached | None = None,
    side: Vector | None = None,
) -> Touching:
    """Evaluate the conditions of contact.

    `before` is what the position before has reached, for friction; `side` is r there, in whose
    plane a rod stays that is pushed along its own axis.
    """
    push = law.push(scene, state)
    bent = scene.rod.bent(clamp, state.point, state.force, push.direction, side)
    tangent = scene.rod.tangent(bent)
    left, away = 1 - bent.arc_length, law.away(bent, tangent, push.normal)
    rubs, beyond = law.rubs(scene, state, push.normal, bent, tangent, before)
    placed = law.placed(left, away)
    residual = joined(push.gaps, bent.misses, placed, rubs)
    return Touching(residual, push, bent, tangent, left - away, beyond)
