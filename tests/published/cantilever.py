"""Cantilevers under a force of fixed direction at the tip, and what they tell of the contact."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

import vibrissa as vb
from vibrissa.mechanics.kirchhoff import Kirchhoff, Push
from vibrissa.mechanics.line import Line
from vibrissa.mechanics.model import AT_ORIGIN
from vibrissa.numerics.compiled import compiled

STEPS = 32
_SETTLED, _ITERATIONS = 1e-13, 25
ANY_FRICTION = 1e9
"""With friction the force on the tip may have any direction."""


def bent_by(rod: Kirchhoff, forces: np.ndarray) -> list[Line]:
    """A rod clamped at the origin along z under each of a sequence of forces (n, 3) on its tip, each
    bend begun from the last.
    """

    def under(tip: jax.Array, push: jax.Array) -> tuple[jax.Array, Line]:
        line = rod.line(AT_ORIGIN, Push(push, jnp.cross(tip, push)))
        return line.reach[-1] - tip, line

    @partial(compiled, quick=True)
    def both(tip: jax.Array, push: jax.Array) -> tuple[jax.Array, jax.Array, Line]:
        off, line = under(tip, push)
        return off, jax.jacfwd(lambda tip: under(tip, push)[0])(tip), line

    tip, lines = np.asarray(both(jnp.zeros(3), jnp.zeros(3))[0]), []
    for force in forces:
        for _ in range(_ITERATIONS):
            off, slopes, line = both(tip, force)
            step = np.linalg.solve(slopes, off)
            tip = tip - step
            if abs(step).max() < _SETTLED:
                break
        else:
            raise ArithmeticError(f"step {step} after {_ITERATIONS} iterations")
        lines.append(line)
    return lines


def felt(rod: vb.Rod, force: np.ndarray, tip: np.ndarray) -> vb.Reconstruction:
    """Contacts from what a clamp at the origin feels of forces (n, 3) on the rod at points (n, 3)."""
    trail = vb.Trail(np.zeros((len(force), 3)))
    reactions = vb.Reactions(trail, -force, -np.cross(tip, force))
    return vb.reconstruct(rod, reactions, friction=ANY_FRICTION)
