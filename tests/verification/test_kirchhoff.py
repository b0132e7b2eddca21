"""The spatial rod model against the closed form, and against SciPy's integrator."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa.contact import FRICTIONLESS, Scene, State, touching
from vibrissa.mechanics.elastica import Elastica
from vibrissa.mechanics.kirchhoff import Kirchhoff, Push
from vibrissa.mechanics.model import Clamp, Contact
from vibrissa.mechanics.models import spatial
from vibrissa.mechanics.section import Steps
from vibrissa.numerics.compiled import compiled

quickly = partial(compiled, quick=True)
AXIS = jnp.array([0.0, 0.0, 1.0])
BOWL = vb.surfaces.EllipticParaboloid(a=0.5, b=1.0, h=0.4)


ORIGIN = Clamp(jnp.zeros(3), AXIS, jnp.array([1.0, 0.0, 0.0]))


def tapered(share: float) -> Callable[[np.ndarray], np.ndarray]:
    """Bending stiffness of a round rod whose radius falls to `share` of that at the clamp."""
    return lambda s: (1 - (1 - share) * s) ** 4


def rod_of(bending: Callable, rest: Callable | None, steps: int) -> Kirchhoff:
    """A rod with ν = 0.3."""
    nodes = np.linspace(0, 1, steps + 1)
    return Kirchhoff.of(bending, lambda s: bending(s) / 1.3, rest, nodes)


uniform = tapered(1.0)


@pytest.fixture(scope="module")
def scan() -> vb.Scan:
    ends = {"start": (1.2, 0.1, 0), "stop": (-1.2, 0.1, 0), "count": 31}
    return vb.scan(vb.Rod.unit(), BOWL, vb.Trail.raster(**ends, step=(0, 0.2, 0), trails=2))


def test_the_uniform_rod_is_that_of_the_closed_form(scan: vb.Scan) -> None:
    """Contact, arc length, incidence and energy of the paper's case; the error falls by more than
    2⁷ when the steps are halved.
    """

    @quickly
    def contacts(model: Kirchhoff | Elastica, wrenches: tuple[jax.Array, jax.Array]) -> Contact:
        return lax.map(lambda wrench: model.contact(*wrench, ORIGIN), wrenches)

    worst, rows = [], scan.in_contact
    for steps in (8, 16, 32):
        rod = jax.jit(rod_of, static_argnums=(0, 1, 2))(uniform, None, steps)
        wrenches = (scan.reactions.force[rows], scan.reactions.moment[rows])
        found, exact = (contacts(model, wrenches) for model in (rod, Elastica()))
        errors = [abs(a - b).max() for a, b in zip(found[:5], exact[:5], strict=True)]
        worst.append([float(errors[0]), float(errors[2])])
        assert errors[1] < 1e-15
        assert errors[4] < 60 * worst[-1][0]
    coarse, middle, fine = np.array(worst)
    assert np.all(fine < 1e-12) and np.all(coarse / middle > 2**6)


def test_line_energy_and_curvature_are_those_of_the_closed_form(scan: vb.Scan) -> None:
    """Points between contact and clamp, at the fractions of each model; curvature at a node."""
    at = (0, 15)
    force = np.linalg.norm(scan.reactions.force[at])
    clamp = ORIGIN._replace(point=jnp.asarray(scan.trail.position[at]))
    rod = rod_of(uniform, None, 32)
    share = np.linspace(0, 1, 7)

    @quickly
    def told(*state: jax.Array) -> tuple[jax.Array, ...]:
        bent = rod.bent(clamp, *state)
        return (
            rod.points(bent, share), rod.energy(bent), rod.tangent(bent), rod.largest_curvature(bent)
        )  # fmt: skip

    points, energy, tangent, curvature = told(scan.point[at], force, scan.normal[at])
    nearest = scan.elastic_line(at, 4001)
    exact = nearest[np.rint(4000 * (1 - share) * scan.arc_length[at]).astype(int)]
    np.testing.assert_allclose(points, exact, atol=2e-4)
    np.testing.assert_allclose(points[0], scan.point[at], atol=1e-11)
    np.testing.assert_allclose(energy, scan.energy[at], atol=1e-11)
    np.testing.assert_allclose(tangent, scan.contact_tangent[at], atol=1e-9)
    np.testing.assert_allclose(curvature, scan.largest_curvature[at], rtol=1e-3)


@pytest.mark.slow
def test_equilibria_of_the_closed_form_meet_the_same_conditions(scan: vb.Scan) -> None:
    """Residual, and the sign of the determinant that tells stable from unstable."""
    rows = scan.in_contact
    force = np.linalg.norm(scan.reactions.force[rows], axis=1)
    states = jnp.asarray(np.column_stack([scan.point[rows], force]))

    def conditions(
        model: Kirchhoff | Elastica, state: jax.Array, clamp: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        scene = Scene(BOWL, 1.0, 0.0, model)

        def residual(x: jax.Array) -> jax.Array:
            found = touching(scene, FRICTIONLESS, State.of(x), ORIGIN._replace(point=clamp))
            return jnp.asarray(found.residual)

        return residual(state), jnp.linalg.det(jax.jacfwd(residual)(state))

    places = jnp.asarray(scan.trail.position[rows])
    of_rows = jax.jit(jax.vmap(conditions, (None, 0, 0)))
    both = [of_rows(model, states, places) for model in (rod_of(uniform, None, 32), Elastica())]
    assert abs(both[0][0]).max() < 1e-11
    np.testing.assert_array_equal(np.sign(both[0][1]), np.sign(both[1][1]))


def shot(
    force: np.ndarray, moment: np.ndarray, stiffness: Callable, rest: Callable
) -> tuple[float, np.ndarray, np.ndarray]:
    """Arc length, point and tangent where the moment in a rod clamped along z is least, by SciPy:
    quaternions instead of axes, and an independent formulation of the moment, m' = −t × F.
    """
    push = -force

    def slope(s: float, y: np.ndarray) -> np.ndarray:
        turn = Rotation.from_quat(y[3:7])
        tangent = turn.apply([0, 0, 1])
        own = rest(np.array(s)) + turn.inv().apply(y[7:]) / stiffness(s) * [1, 1, 1.3]
        x, y_, z, w = y[3:7]
        a, b, c = own
        spin = [w * a + y_ * c - z * b, w * b + z * a - x * c, w * c + x * b - y_ * a]
        scalar = -(x * a + y_ * b + z * c)
        return np.concatenate([tangent, 0.5 * np.array([*spin, scalar]), -np.cross(tangent, push)])

    start = np.concatenate([np.zeros(3), [0, 0, 0, 1], -moment])
    line = solve_ivp(slope, (0, 1), start, "DOP853", rtol=1e-13, atol=1e-14, dense_output=True).sol

    def falling(s: float) -> float:
        y = line(s)
        tangent = Rotation.from_quat(y[3:7]).apply([0, 0, 1])
        return float(-np.cross(tangent, push) @ y[7:])

    s = np.linspace(0, 1, 400)
    values = np.array([falling(one) for one in s])
    first = int(np.flatnonzero((values[:-1] < 0) & (values[1:] >= 0))[0])
    place = brentq(falling, s[first], s[first + 1], xtol=1e-15)
    y = line(place)
    return place, y[:3], Rotation.from_quat(y[3:7]).apply([0, 0, 1])


CURVED = {
    "tapered": (tapered(0.2), lambda s: np.zeros((*s.shape, 3))),
    "curved": (uniform, lambda s: np.stack([0 * s, 0.8 + 0.5 * s, 0 * s], -1)),
    "tapered and helical": (tapered(0.4), lambda s: np.stack([0 * s, 1 + s, 0.7 + 0 * s], -1)),
}


@pytest.mark.parametrize("name", CURVED)
def test_rods_of_varying_section_and_rest_shape_are_those_of_an_independent_integrator(
    name: str,
) -> None:
    """At random wrenches that a contact on the rod makes."""
    stiffness, rest = CURVED[name]
    rod = rod_of(stiffness, lambda s: jnp.asarray(rest(s)), 32)
    contact = quickly(lambda *wrench: rod.contact(*wrench))  # noqa: PLW0108 (no hash)
    random, count = np.random.default_rng(7), 0
    for _ in range(4):
        push = random.normal(size=3) * 0.5
        reach = np.array([0.2, 0.1, 0.7]) * random.uniform(0.5, 1.0) + random.normal(size=3) * 0.05
        force, moment = -push, -np.cross(reach, push)
        try:
            place, point, tangent = shot(force, moment, stiffness, rest)
        except IndexError:
            continue  # the moment falls all along the rod
        count += 1
        found = contact(jnp.asarray(force), jnp.asarray(moment), ORIGIN)
        np.testing.assert_allclose(found.arc_length, place, atol=1e-9)
        np.testing.assert_allclose(found.reach, point, atol=1e-9)
        np.testing.assert_allclose(
            2 * found.incidence - 1, tangent @ push / np.linalg.norm(push), atol=1e-8
        )
    assert count >= 3


def test_steps_graded_as_the_radius_resolve_a_thin_tip() -> None:
    """A force at a tip as thin as a whisker's: the contact found from the wrench that it makes."""
    taper = 0.95
    made = jax.jit(Kirchhoff.tapered, static_argnums=2)
    rod, fine = (made(taper, 0.3, steps) for steps in (24, 96))
    push = 0.8 * (1 - taper) ** 1.5 * jnp.array([0.9, 0.3, -0.3])

    def end(at: jax.Array) -> tuple[jax.Array, jax.Array]:
        line = fine.line(ORIGIN, Push(push, jnp.cross(at, push)))
        return (line.reach[-1] - at,) * 2

    newton, tip = quickly(jax.jacfwd(end, has_aux=True)), AXIS
    for _ in range(12):
        slopes, gap = newton(tip)
        tip = tip - jnp.linalg.solve(slopes, gap)
    assert abs(gap).max() < 1e-13 and tip[2] < 0.999
    found = quickly(lambda wrench: rod.contact(wrench[0], wrench[1], ORIGIN))(
        jnp.stack([-push, -jnp.cross(tip, push)])
    )
    np.testing.assert_allclose(found.reach, tip, atol=1e-8)
    np.testing.assert_allclose(found.arc_length, 1, atol=1e-8)


HEAVY = vb.Rod.tapered(
    length=0.05, base_radius=0.25e-3, tip_radius=0.1e-3, youngs_modulus=2e9, density=7850
).curved(vb.RestShape.arc(0.1, roll=0.7))


@pytest.mark.parametrize("rod", [HEAVY, HEAVY.loaded(vb.Loads(gravity=(0, 0, -9.81)))])
@pytest.mark.parametrize("reach", [0.6, 0.99, 1.02])
def test_steps_without_length_change_nothing(rod: vb.Rod, reach: float) -> None:
    """The rougher rod, with as many steps as the rod itself of which most have no length, against
    one of its true steps alone: a force before, close to and beyond the tip, resultants of the load
    at the clamp that leave something at the tip, and the thickness there.
    """
    whole = spatial(rod).rough
    steps = int(np.sum(whole.steps.nodes[:-1] < 1))
    assert steps < len(whole.steps.nodes) - 1
    nodes = whole.steps.nodes[: steps + 1]
    local = jax.tree.map(lambda part: part[:steps], whole.steps.local)
    alone = replace(whole, steps=Steps.of(nodes, local, whole.steps.scheme))
    load = jnp.array([0.0, 0.0, -0.2, 0.01, -0.02, 0.0]) if whole.loaded else None
    own = load[6 - whole.unknowns :] if whole.loaded else ()
    free = alone.line(ORIGIN, Push(jnp.zeros(3), jnp.zeros(3)), load)
    point = free.at(reach)[0] + jnp.array([0.02, 0.01, 0.0])

    def bent(model: Kirchhoff) -> tuple[jax.Array, ...]:
        found = model.bent(ORIGIN, point, 0.3, jnp.array([0.6, 0.0, -0.8]), own)
        tip = model.beyond(found.inner, found.arc_length)
        thin = model.slimmer(found.arc_length)
        return found.misses, found.arc_length, tip.reach[-1], model.tangent(found), thin

    for ours, theirs in zip(*map(quickly(bent), (whole, alone)), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-14)


def test_a_hanging_rod_changes_with_its_weight_as_its_derivatives_say() -> None:
    """What holds it, where its middle is, and its energy, against central differences; the force
    that holds it is its weight.
    """
    loaded, nodes = HEAVY.loaded(vb.Loads(gravity=np.ones(3))), np.linspace(0, 1, 13)

    def hanging(gravity: jax.Array) -> jax.Array:
        rod = eqx.tree_at(lambda rod: rod.loads.gravity, loaded, gravity)
        free = spatial(rod, nodes=nodes).free(ORIGIN)
        return jnp.concatenate([free.reactions, free.at(0.5)[0], free.energy[None]])

    @quickly
    def told(gravity: jax.Array) -> tuple[jax.Array, jax.Array]:
        return jax.jvp(hanging, (gravity,), (way,))

    gravity, way, change = jnp.array([0.5, 3.0, -9.81]), jnp.array([0.3, -0.5, 0.8]), 1e-3
    _, slope = told(gravity)
    (after, _), (before, _) = told(gravity + change * way), told(gravity - change * way)
    np.testing.assert_allclose(slope, (after - before) / (2 * change), atol=1e-9)
    mass = HEAVY.linear_density * HEAVY.length * (1 + 0.4 + 0.4**2) / 3
    np.testing.assert_allclose(slope[:3], -mass / HEAVY.force_scale * way, atol=1e-12)
