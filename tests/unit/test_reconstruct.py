"""The inverse, sample by sample: contacts of integrated rods, the statistics of one contact, and
what cannot be solved.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bent_rods import RODS, TANGENTIAL, TIP, BentRod, bent_rod, reactions_of
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation
from scipy.stats import kstest

import vibrissa as vb
from vibrissa.inverse.inverse import single_contact

UNIT = vb.Rod.unit()
WIRE = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
SPREAD = np.diag([4e-6, 1e-6, 2e-6, 1e-6, 3e-6, 1e-6])
KIND, STATUS = vb.ContactKind, vb.Status


@pytest.mark.parametrize("rod", [UNIT, WIRE], ids=["model units", "SI"])
def test_finds_the_contacts_of_integrated_rods(rod: vb.Rod) -> None:
    found = vb.reconstruct(rod, reactions_of(RODS, rod))
    L = rod.length
    np.testing.assert_allclose(found.point / L, [part.point for part in RODS], rtol=0, atol=1e-11)
    np.testing.assert_allclose(
        found.arc_length / L, [part.arc_length for part in RODS], rtol=0, atol=1e-11
    )
    directions = [part.force / np.linalg.norm(part.force) for part in RODS]
    np.testing.assert_allclose(found.normal, directions, rtol=0, atol=1e-14)
    np.testing.assert_allclose(
        found.energy / rod.moment_scale, [part.energy for part in RODS], rtol=1e-10
    )
    np.testing.assert_array_equal(
        found.kind, [KIND.TIP] * len(TIP) + [KIND.TANGENTIAL] * len(TANGENTIAL)
    )
    np.testing.assert_array_equal(found.status, STATUS.OK)
    np.testing.assert_allclose(found.single_contact_residual, 0, atol=1e-11)


def test_a_stiffer_rod_in_the_setup_moves_the_contact_along_the_line_of_the_force_only() -> None:
    """Statics alone gives the line; the rod gives the place on it (mechanics.md)."""
    reactions = reactions_of(TANGENTIAL, UNIT)
    right, wrong = vb.reconstruct(UNIT, reactions), vb.reconstruct(vb.Rod(1.0, 1.1), reactions)
    shift = wrong.point - right.point
    assert np.all(np.linalg.norm(shift, axis=1) > 1e-3)
    np.testing.assert_allclose(np.cross(shift, right.normal), 0, atol=1e-12)


def test_rows_do_not_disturb_each_other() -> None:
    """What cannot be solved gets a status; the others get the results that they have alone."""
    good = reactions_of(RODS, UNIT)
    force, moment = good.force.copy(), good.moment.copy()
    force[0], moment[2] = np.nan, np.inf
    found = vb.reconstruct(UNIT, vb.Reactions(good.trail, force, moment))
    alone = vb.reconstruct(UNIT, good)
    np.testing.assert_array_equal(
        found.status, [STATUS.BAD_DATA, STATUS.OK, STATUS.BAD_DATA, STATUS.OK]
    )
    np.testing.assert_array_equal(found.kind[[0, 2]], KIND.NONE)
    assert np.all(np.isnan(found.point[[0, 2]]))
    assert np.all(np.isnan(found.energy[[0, 2]]))
    np.testing.assert_array_equal(found.point[[1, 3]], alone.point[[1, 3]])


def test_bad_rows_are_marked_also_where_the_noise_is_known() -> None:
    good = reactions_of(RODS, UNIT, SPREAD)
    force = good.force.copy()
    force[1, 0] = np.nan
    found = vb.reconstruct(
        UNIT, vb.Reactions(good.trail, force, good.moment, covariance=good.covariance)
    )
    np.testing.assert_array_equal(found.status, [STATUS.OK, STATUS.BAD_DATA, STATUS.OK, STATUS.OK])
    assert found.covariance is not None
    assert np.all(np.isnan(found.covariance[1]))
    np.testing.assert_allclose(
        found.point[[0, 2, 3]], [RODS[i].point for i in (0, 2, 3)], rtol=0, atol=1e-9
    )


def test_a_rod_at_rest_touches_nothing() -> None:
    zero = np.zeros((2, 3))
    found = vb.reconstruct(UNIT, vb.Reactions(vb.Trail(zero), zero, zero))
    np.testing.assert_array_equal(found.kind, KIND.NONE)
    np.testing.assert_array_equal(found.status, STATUS.OK)
    np.testing.assert_array_equal(found.energy, 0)
    assert np.all(np.isnan(found.point))


def test_a_couple_is_no_single_contact() -> None:
    """A second contact, or a wrong tare, leaves a moment along the force."""
    good = reactions_of(RODS, UNIT)
    found = vb.reconstruct(
        UNIT, vb.Reactions(good.trail, good.force, good.moment + 0.01 * good.force)
    )
    noisy = vb.Reactions(good.trail, good.force, good.moment + 0.05 * good.force, covariance=SPREAD)
    for status in (found.status, vb.reconstruct(UNIT, noisy).status):
        np.testing.assert_array_equal(status[len(TIP) :], STATUS.NOT_SINGLE_CONTACT)
        # Of two findings the worse is told: the contact may come out beyond the tip as well.
        assert set(status[: len(TIP)].tolist()) <= {
            int(STATUS.NOT_SINGLE_CONTACT),
            int(STATUS.BEYOND_TIP),
        }


def test_a_short_rod_cannot_reach_that_far() -> None:
    """Taken 2 % shorter than it is, a rod that touches with its tip is touched beyond it."""
    reactions = reactions_of(TIP, UNIT)
    np.testing.assert_array_equal(
        vb.reconstruct(vb.Rod(0.98, 1.0), reactions).status, STATUS.BEYOND_TIP
    )
    exact = vb.Reactions(
        reactions.trail, reactions.force, reactions.moment, covariance=1e-4 * SPREAD
    )
    np.testing.assert_array_equal(
        vb.reconstruct(vb.Rod(0.98, 1.0), exact).status, STATUS.BEYOND_TIP
    )


def test_a_wrench_of_the_wrong_sign_has_no_contact() -> None:
    """The rod would bend away from the force that bends it."""
    good = reactions_of(TANGENTIAL, UNIT)
    found = vb.reconstruct(UNIT, vb.Reactions(good.trail, -good.force, good.moment))
    assert set(found.status.tolist()) <= {
        int(STATUS.NO_CURVATURE_ZERO),
        int(STATUS.BEYOND_TIP),
        int(STATUS.STEEP_TANGENT),
    }
    strong = vb.Reactions(good.trail, good.force, 3 * good.moment)
    np.testing.assert_array_equal(vb.reconstruct(UNIT, strong).status, STATUS.NO_CURVATURE_ZERO)


def leaning(mu: float) -> BentRod:
    """A rod tangent to an object whose force leans against the tangent by atan μ: a(s₁) = π/4 +
    atan(μ)/2, k² = sin² a(s₁).
    """
    modulus, sin2_a0 = (1 + np.sin(np.arctan(mu))) / 2, 0.3
    delta = np.pi - 2 * np.arcsin(np.sqrt(sin2_a0))
    return bent_rod(
        1.0, delta, 2 * np.sqrt(modulus - sin2_a0), 0.8, Rotation.from_rotvec([0.2, 0.5, -0.3])
    )


@pytest.mark.parametrize(
    ("mu", "status"),
    [(0.0, STATUS.OK), (0.25, STATUS.OK), (0.7, STATUS.OK), (2.0, STATUS.STEEP_TANGENT)],
)
def test_friction_is_admitted_and_a_rod_that_points_into_the_object_is_not(
    mu: float, status: vb.Status
) -> None:
    rod = leaning(mu)
    found = vb.reconstruct(UNIT, reactions_of([rod], UNIT))
    assert found.status[0] == status
    assert found.modulus[0] == pytest.approx((1 + np.sin(np.arctan(mu))) / 2, abs=1e-11)
    np.testing.assert_allclose(found.point[0], rod.point, rtol=0, atol=1e-11)
    # The tangent at the contact makes 90° − atan μ with the force: it is straight from there on.
    line = found.elastic_line(0, 1001)
    tangent = (line[1000] - line[900]) / np.linalg.norm(line[1000] - line[900])
    assert tangent @ found.normal[0] == pytest.approx(np.sin(np.arctan(mu)), abs=1e-9)


@pytest.mark.parametrize("value", [0.0, 1.0, -0.1, float("nan")])
def test_false_alarm_is_a_share(value: float) -> None:
    with pytest.raises(
        ValueError, match=rf"^false_alarm = {value}; allowed is a number between 0 and 1$"
    ):
        vb.reconstruct(UNIT, reactions_of(RODS, UNIT), false_alarm=value)


def test_several_trails_are_solved_as_each_alone() -> None:
    one = reactions_of(RODS, UNIT, SPREAD)
    two = vb.Reactions(
        vb.Trail.stack([one.trail, one.trail]),
        np.stack([one.force] * 2),
        np.stack([one.moment] * 2),
        covariance=SPREAD,
    )
    found, alone = vb.reconstruct(UNIT, two), vb.reconstruct(UNIT, one)
    assert found.covariance is not None
    assert found.covariance.shape == (2, 4, 3, 3)
    np.testing.assert_allclose(found.point[1], alone.point, rtol=0, atol=1e-14)


def test_the_most_probable_single_contact_is_the_nearest_in_the_noise() -> None:
    rng = np.random.default_rng(3)
    root = rng.normal(size=(6, 6)) * 1e-2
    covariance = root @ root.T
    covariance = (covariance + covariance.T) / 2
    inverse = np.linalg.inv(covariance)
    for rod in RODS:
        measured = rod.wrench + root @ rng.normal(size=6)
        found, _ = single_contact(jnp.asarray(measured), jnp.asarray(covariance))
        best = minimize(
            lambda w, measured=measured: (w - measured) @ inverse @ (w - measured),
            measured,
            jac=lambda w, measured=measured: 2 * inverse @ (w - measured),
            constraints={
                "type": "eq",
                "fun": lambda w: w[:3] @ w[3:],
                "jac": lambda w: np.roll(w, 3),
            },
            method="SLSQP",
            options={"ftol": 1e-14, "maxiter": 500},
        )
        change = np.sqrt((found - best.x) @ inverse @ (found - best.x))
        assert change < 1e-2
        assert abs(found[:3] @ found[3:]) < 1e-3 * abs(measured[:3] @ measured[3:])


def test_violations_by_noise_are_standard_deviations() -> None:
    """m0·f0 of a single contact, seen through the noise, in units of its deviation, is normally
    distributed.
    """
    noise = np.random.default_rng(12).multivariate_normal(np.zeros(6), SPREAD, 4000)
    found = jax.vmap(lambda w: single_contact(w, jnp.asarray(SPREAD))[1])(
        jnp.asarray(RODS[2].wrench + noise)
    )
    assert kstest(found, "norm").pvalue > 1e-3


@pytest.mark.parametrize("rod", TANGENTIAL, ids=["slight", "strong"])
def test_covariance_is_carried_by_the_derivatives_of_the_result(rod: BentRod) -> None:
    """Central differences of what `reconstruct` returns, by each component of the wrench."""
    step = 1e-6
    pushes = np.concatenate([step * np.eye(6), -step * np.eye(6)])
    one = reactions_of([rod], UNIT)
    force, moment = one.force + pushes[:, :3], one.moment + pushes[:, 3:]
    trail = vb.Trail(np.zeros((12, 3)), np.repeat(one.trail.orientation, 12, axis=0))
    moved = vb.reconstruct(UNIT, vb.Reactions(trail, force, moment, covariance=SPREAD))
    still = vb.reconstruct(UNIT, vb.Reactions(one.trail, one.force, one.moment, covariance=SPREAD))
    for values, stated in (
        (moved.point, still.covariance),
        (moved.normal, still.normal_covariance),
        (moved.arc_length[:, None], still.arc_length_deviation[:, None, None] ** 2),
    ):
        jacobian = (values[:6] - values[6:]).T / (2 * step)
        expected = jacobian @ SPREAD @ jacobian.T
        np.testing.assert_allclose(
            stated[0], expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max()
        )


def test_errors_differ_strongly_between_directions() -> None:
    """Where on the line of the force rests on the rod's mechanics, the line itself on statics
    (mechanics.md).
    """
    found = vb.reconstruct(UNIT, reactions_of(RODS, UNIT, np.diag([1e-6] * 3 + [1e-8] * 3)))
    assert found.covariance is not None
    deviations = np.sqrt(np.linalg.eigvalsh(found.covariance))
    assert np.all(deviations[:, 2] > 4 * deviations[:, 0])


def test_the_robots_error_is_added() -> None:
    one = reactions_of(RODS, UNIT, SPREAD)
    robot = np.diag([1e-6, 4e-6, 9e-6])
    moved = vb.Reactions(
        one.trail, one.force, one.moment, covariance=SPREAD, position_covariance=robot
    )
    with_it, without = vb.reconstruct(UNIT, moved).covariance, vb.reconstruct(UNIT, one).covariance
    np.testing.assert_allclose(
        with_it - without, np.broadcast_to(robot, (4, 3, 3)), rtol=1e-9, atol=1e-15
    )


@pytest.mark.parametrize("covariance", [None, SPREAD], ids=["exact", "noisy"])
def test_elastic_line_runs_from_the_clamp_through_the_contact(
    covariance: np.ndarray | None,
) -> None:
    found = vb.reconstruct(UNIT, reactions_of(RODS, UNIT, covariance))
    for i, rod in enumerate(RODS):
        line = found.elastic_line(i, 1001)
        np.testing.assert_allclose(line[0], 0, atol=1e-10)
        np.testing.assert_allclose(line[round(rod.arc_length * 1000)], rod.point, rtol=0, atol=1e-8)
        assert np.linalg.norm(np.diff(line, axis=0), axis=1).sum() == pytest.approx(1, abs=1e-5)
        np.testing.assert_allclose(
            (line[1] - line[0]) * 1000, found.reactions.trail.axis[i], rtol=0, atol=5e-3
        )


def test_elastic_line_without_contact_is_straight_and_its_arguments_are_checked() -> None:
    zero = np.zeros((2, 3, 3))
    found = vb.reconstruct(UNIT, vb.Reactions(vb.Trail(zero), zero, zero))
    np.testing.assert_allclose(
        found.elastic_line((1, 2), 3), [(0, 0, 0), (0, 0, 0.5), (0, 0, 1)], atol=1e-15
    )
    with pytest.raises(ValueError, match=r"count = 1; allowed is at least 2"):
        found.elastic_line((0, 0), 1)
    with pytest.raises(ValueError, match=r"index = 0; allowed is \(trail, i\)"):
        found.elastic_line(0)


def test_contacts_are_the_rows_of_the_reconstruction() -> None:
    reactions = reactions_of(RODS, UNIT)
    noisy = vb.Reactions(
        reactions.trail, reactions.force, reactions.moment, np.arange(4.0), 1e-8 * np.eye(6)
    )
    found = vb.reconstruct(UNIT, noisy, check=False)
    for name in ("point", "normal", "covariance", "force_direction", "arc_length", "status"):
        np.testing.assert_array_equal(getattr(found.contacts, name), getattr(found, name))
    np.testing.assert_array_equal(found.contacts.time, noisy.time)
    assert found.contacts.sweep is None
    np.testing.assert_array_equal(found[1:].contacts.point, found.contacts[1:].point)
    pair = vb.Reactions(
        vb.Trail(np.zeros((2, 2, 3))),
        noisy.force.reshape(2, 2, 3),
        noisy.moment.reshape(2, 2, 3),
    )
    contacts = vb.reconstruct(UNIT, pair).contacts
    np.testing.assert_array_equal(contacts.sweep, [[0, 0], [1, 1]])


@pytest.mark.parametrize("friction", [None, 0.0, 0.25])
def test_friction_is_remembered_and_does_not_move_contacts(friction: float | None) -> None:
    reactions = reactions_of(RODS, UNIT)
    found = vb.reconstruct(UNIT, reactions, friction=friction)
    assert found.friction == found[:2].friction == friction
    assert found.to_dataset().attrs.get("friction") == friction
    np.testing.assert_array_equal(found.point, vb.reconstruct(UNIT, reactions).point)
