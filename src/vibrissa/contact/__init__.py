"""The equilibrium at one pose: contact laws, contact conditions, and one solver with derivatives.
Lengths in L, forces in EI/L².
"""

from vibrissa.contact.conditions import Touching, touching
from vibrissa.contact.laws import COULOMB, FRICTIONLESS, Held, Law, Leaning
from vibrissa.contact.newton import iterated, root, signed, step_from
from vibrissa.contact.scene import Reached, Scene, Skin, State

__all__ = [
    "COULOMB",
    "FRICTIONLESS",
    "Held",
    "Law",
    "Leaning",
    "Reached",
    "Scene",
    "Skin",
    "State",
    "Touching",
    "iterated",
    "root",
    "signed",
    "step_from",
    "touching",
]
