"""The conditions of contact and their solver: derivatives against differences of scans, and laws
against each other where one is a special case of another.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vibrissa as vb
from vibrissa.contact import FRICTIONLESS, Held, Law, Leaning, Scene, State, root, touching
from vibrissa.mechanics.model import AT_ORIGIN
from vibrissa.numerics.compiled import compiled

OBJECT = vb.surfaces.EllipticParaboloid(a=0.5, b=1.0, h=0.4)
ROD = vb.Rod(length=0.9, bending_stiffness=1.3)
AXIS = np.array([0.0, 0.0, 1.0])
TRAIL = vb.Trail.line(start=(1.0, 0.15, 0), stop=(-1.0, 0.15, 0), count=81)


@pytest.fixture(scope="module")
def scan() -> vb.Scan:
    """A sweep in tip and in tangential contact."""
    return vb.scan(ROD, OBJECT, TRAIL)


def _state(scan: vb.Scan, row: int) -> jnp.ndarray:
    force = np.linalg.norm(scan.reactions.force[row]) / scan.rod.force_scale
    return jnp.append(jnp.asarray(scan.point[row]) / scan.rod.length, force)


def _solution(
    rod: vb.Rod, point: jnp.ndarray, start: jnp.ndarray, law: Law = FRICTIONLESS
) -> jnp.ndarray:
    """Contact point and force in the units of the rod."""
    scene, clamp = Scene(OBJECT, rod.length), AT_ORIGIN._replace(point=point / rod.length)
    x = root(lambda x: touching(scene, law, State.of(x), clamp).residual, start)
    return jnp.append(x[:3] * rod.length, x[3] * rod.force_scale)


_solved = compiled(_solution, quick=True)


def _rows(scan: vb.Scan) -> list[int]:
    return [int(np.flatnonzero(scan.kind == kind)[5]) for kind in (1, 2)]


def test_a_root_is_the_row_of_a_scan(scan: vb.Scan) -> None:
    for row in _rows(scan):
        start = _state(scan, row) + 1e-3
        found = _solved(ROD, jnp.asarray(TRAIL.position[row]), start)
        np.testing.assert_allclose(found[:3], scan.point[row], rtol=0, atol=1e-12)
        force = np.linalg.norm(scan.reactions.force[row])
        assert float(found[3]) == pytest.approx(force, rel=1e-11)


def test_derivatives_by_the_rod_are_those_of_other_rods(scan: vb.Scan) -> None:
    derivative = compiled(jax.jacrev(_solution), quick=True)
    for row in _rows(scan):
        point, start = jnp.asarray(TRAIL.position[row]), _state(scan, row)
        slope = derivative(ROD, point, start)
        for name, h in (("length", 1e-6), ("bending_stiffness", 1e-6)):
            around = [
                _solved(
                    vb.Rod(
                        **{"length": 0.9, "bending_stiffness": 1.3, name: getattr(ROD, name) + s}
                    ),
                    point,
                    start,
                )
                for s in (h, -h)
            ]
            difference = (around[0] - around[1]) / (2 * h)
            np.testing.assert_allclose(getattr(slope, name), difference, rtol=1e-7, atol=1e-8)


def test_derivatives_by_the_clamp_are_those_of_a_finer_scan(scan: vb.Scan) -> None:
    h, derivative = 1e-5, compiled(jax.jacfwd(_solution, argnums=1), quick=True)
    for row in _rows(scan):
        at = TRAIL.position[row]
        start = _state(scan, row)
        slope = derivative(ROD, jnp.asarray(at), start)
        near = vb.scan(
            ROD, OBJECT, vb.Trail.line(start=TRAIL.position[0], stop=at + (h, 0, 0), count=80)
        )
        far = vb.scan(
            ROD, OBJECT, vb.Trail.line(start=TRAIL.position[0], stop=at - (h, 0, 0), count=80)
        )
        difference = (near.point[-1] - far.point[-1]) / (2 * h)
        np.testing.assert_allclose(slope[:3, 0], difference, rtol=0, atol=1e-8)


def test_no_tangential_force_is_no_friction(scan: vb.Scan) -> None:
    row = _rows(scan)[1]
    point, start = jnp.asarray(TRAIL.position[row]), _state(scan, row) + 1e-3
    leaning = _solved(ROD, point, start, Leaning(jnp.zeros(3)))
    np.testing.assert_allclose(leaning, _solved(ROD, point, start), rtol=0, atol=1e-11)


def test_a_tip_between_two_halves_is_pushed_as_by_one_plane() -> None:
    """Two copies of a tilted plane: whatever their shares, the force is along their normal."""
    plane = vb.surfaces.Implicit(lambda p: 0.75 - p @ jnp.array([0.6, 0.0, 0.8]))
    both = vb.surfaces.Union([plane, plane])
    clamp = AT_ORIGIN
    start = jnp.array([0.15, 0.0, 0.85, 0.3])
    single = Scene(plane, 1.0)

    @partial(compiled, quick=True)
    def alone(start: jnp.ndarray) -> jnp.ndarray:
        return root(lambda x: touching(single, FRICTIONLESS, State.of(x), clamp).residual, start)

    @partial(compiled, quick=True)
    def shared(x: jnp.ndarray, share: jnp.ndarray) -> jnp.ndarray:
        state = State(x[:3], x[3], share)
        return touching(Scene(both, 1.0), Held(jnp.array([0, 1])), state, clamp).residual

    x = alone(start)
    for share in (0.2, 0.7):
        np.testing.assert_allclose(shared(x, jnp.array([share])), 0, atol=1e-11)
