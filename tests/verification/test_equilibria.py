"""All equilibria at a pose: what is known of the paper's case, and the rod's equation in space for
lines with inflections.
"""

import numpy as np
import pytest
import shooting
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa.forward.equilibria import Equilibrium

UNIT = vb.Rod.unit()
PARABOLOID = vb.surfaces.EllipticParaboloid(a=0.5, b=1.0, h=0.4)
LEVEL = shooting.paraboloid(0.5, 1.0, 0.4)
PLANE, TILT = vb.surfaces.Plane((0.3, 0, 0), (-1, 0, 0)), Rotation.from_rotvec([0, np.pi / 6, 0])
PITCHFORK = 0.474512782442167
LEAST = {0.6: 4, 0.3: 3, 0.0: 5, -0.3: 4}


@pytest.fixture(scope="module")
def found() -> dict[float, list[Equilibrium]]:
    return {x0: vb.equilibria(UNIT, PARABOLOID, position=(x0, 0.2, 0)) for x0 in LEAST}


@pytest.fixture(scope="module")
def sweep() -> vb.Scan:
    return vb.scan(
        UNIT, PARABOLOID, vb.Trail.line(start=(1.2, 0.2, 0), stop=(-1.2, 0.2, 0), count=241)
    )


@pytest.mark.parametrize("x0", LEAST)
def test_as_many_as_are_known_and_the_sweep_s_is_the_lowest(
    found: dict[float, list[Equilibrium]], sweep: vb.Scan, x0: float
) -> None:
    here = found[x0]
    i = int(np.argmin(np.abs(sweep.trail.position[:, 0] - x0)))
    assert len(here) >= LEAST[x0]
    np.testing.assert_allclose(here[0].point, sweep.point[i], rtol=0, atol=1e-10)
    assert here[0].energy == pytest.approx(sweep.energy[i], abs=1e-12)
    assert here[0].stable
    assert all(other.energy > here[0].energy + 0.5 for other in here[1:])
    # With one change of sign in the curvature, at about twenty times the force.
    once = [np.linalg.norm(one.reactions.force) for one in here if one.inflections == 1]
    assert len(once) >= 1
    assert 24 <= round(min(once)) <= round(max(once)) <= 41


@pytest.mark.parametrize("x0", LEAST)
def test_each_is_an_equilibrium_of_a_rod_in_space(
    found: dict[float, list[Equilibrium]], x0: float
) -> None:
    """An initial value problem from the clamp with the support reactions: place, moment, energy,
    direction and changes of sign.
    """
    for one in found[x0]:
        force, moment = -one.reactions.force[0], -one.reactions.moment[0]
        s = np.linspace(0, 1, 401)
        s1 = one.arc_length
        rod = shooting.rod_along(
            (x0, 0.2, 0), (0, 0, 1), moment, force, np.append(s[s < s1 - 1e-12], s1)
        )
        # A line with inflections is unstable as an initial value problem too: errors grow by tens.
        allowed = 1e-9 if one.inflections == 0 else 1e-7
        np.testing.assert_allclose(rod[-1, :3], one.point, rtol=0, atol=allowed)
        np.testing.assert_allclose(rod[-1, 6:9], 0, atol=100 * allowed)
        np.testing.assert_allclose(
            rod[:-1, :3], one.elastic_line[s < s1 - 1e-12], rtol=0, atol=allowed
        )
        assert rod[-1, 9] == pytest.approx(one.energy, rel=1e-7)
        n = LEVEL.normal(one.point)
        np.testing.assert_allclose(np.cross(force, n), 0, atol=1e-8)
        assert force @ n > 0
        assert LEVEL.value(one.point) == pytest.approx(0, abs=1e-10)
        assert rod[-1, 3:6] @ n < 1e-8
        if one.kind == vb.ContactKind.TIP:
            assert s1 == pytest.approx(1, abs=1e-12)
        else:
            assert rod[-1, 3:6] @ n == pytest.approx(0, abs=1e-7)
        # The moment keeps its direction, but for its sign.
        along = rod[:-1, 6:9] @ moment
        assert np.count_nonzero(np.diff(np.sign(along))) == one.inflections
        outside = np.min([LEVEL.value(p) for p in one.elastic_line])
        assert outside > -1e-6


def test_the_second_variation_changes_its_sign_at_the_pitchfork() -> None:
    """On the plane branch, linearly in the distance from it; and the branch beside it is stable
    where that in the plane no longer is.
    """

    def at(x0: float) -> list[Equilibrium]:
        return vb.equilibria(UNIT, PARABOLOID, position=(x0, 0, 0))

    beyond, before = (
        next(one for one in at(PITCHFORK + by) if one.inflections == 0 and abs(one.point[1]) < 1e-9)
        for by in (-2e-3, 2e-3)
    )
    assert before.stable
    assert not beyond.stable
    root = (
        PITCHFORK
        - 2e-3
        + 4e-3 * beyond.second_variation / (beyond.second_variation - before.second_variation)
    )
    assert root == pytest.approx(PITCHFORK, abs=2e-5)
    beside = [one for one in at(PITCHFORK - 2e-3) if one.stable]
    assert sorted(np.sign(one.point[1]) for one in beside) == [-1, 1]
    assert all(one.energy < beyond.energy for one in beside)


def test_the_second_variation_converges() -> None:
    """Of a tip contact with a plane, whose Hessian is zero: the least eigenvalue of −v'' + (F·t −
    κ²) v and of its like in the plane, by shooting.
    """
    axis = np.array([0.5, 0.0, np.sqrt(0.75)])
    np.testing.assert_allclose(TILT.apply([0, 0, 1]), axis, atol=1e-15)
    one = next(
        one
        for one in vb.equilibria(UNIT, PLANE, position=(0, 0, 0), orientation=TILT)
        if one.stable and one.kind == vb.ContactKind.TIP
    )
    force, moment, n = -one.reactions.force[0], -one.reactions.moment[0], np.array([-1.0, 0, 0])

    values = np.linspace(-1, 40, 200)

    def slope(_s: float, y: np.ndarray) -> np.ndarray:
        """Changes out of the plane from v' = 1, and in it, where the multiplier of n·δr = 0 adds a
        second solution; of all values at once.
        """
        t, m = y[:3], y[3:6]
        v, dv, first, dfirst, _rise, second, dsecond, _rise2 = y[6:].reshape(8, -1)
        u, tension = np.cross([0, 1.0, 0], t) @ n, force @ t
        changes = [
            dv,
            (tension - m @ m - values) * v,
            dfirst,
            (tension - values) * first,
            u * first,
            dsecond,
            (tension - values) * second + u,
            u * second,
        ]
        return np.concatenate([np.cross(m, t), np.cross(force, t), *changes])

    start = np.repeat([0.0, 1, 0, 1, 0, 0, 0, 0], len(values))
    y = (
        solve_ivp(slope, (0, 1), np.concatenate([axis, moment, start]), rtol=1e-11, atol=1e-12)
        .y[6:, -1]
        .reshape(8, -1)
    )
    # v(1)' of the one, the determinant of (u'(1), n·δr) of the other.
    least = []
    for column in (y[1], y[3] * y[7] - y[6] * y[4]):
        k = int(np.flatnonzero(np.sign(column[1:]) != np.sign(column[:-1]))[0])
        least.append(
            values[k] - column[k] * (values[k + 1] - values[k]) / (column[k + 1] - column[k])
        )
    assert one.second_variation == pytest.approx(min(least), rel=5e-3)


def test_turned_and_moved_they_are_the_same(found: dict[float, list[Equilibrium]]) -> None:
    """All that are known, at the least; the search's starting points turn with the clamp."""
    turn, shift = Rotation.from_rotvec([0.4, 1.2, -0.7]), np.array([0.2, 1.0, -3.0])
    here = found[0.3]
    there = vb.equilibria(
        UNIT,
        PARABOLOID.placed(turn, shift),
        position=turn.apply([0.3, 0.2, 0]) + shift,
        orientation=turn,
    )
    assert len(there) == len(here)
    for one, other in zip(here, there, strict=True):
        np.testing.assert_allclose(other.point, turn.apply(one.point) + shift, rtol=0, atol=1e-8)
        np.testing.assert_allclose(
            other.reactions.force, turn.apply(one.reactions.force), rtol=1e-8, atol=1e-8
        )
        assert other.second_variation == pytest.approx(one.second_variation, rel=1e-6)
        assert (other.kind, other.inflections, other.stable) == (
            one.kind,
            one.inflections,
            one.stable,
        )


def test_si_and_the_model_s_units_agree(found: dict[float, list[Equilibrium]]) -> None:
    length, stiffness = 0.05, 6.3e-4
    rod = vb.Rod(length=length, bending_stiffness=stiffness)
    surface = vb.surfaces.EllipticParaboloid(a=0.5 / length, b=1.0 / length, h=0.4 * length)
    si = vb.equilibria(rod, surface, position=(0.3 * length, 0.2 * length, 0))
    assert len(si) == len(found[0.3])
    for one, model in zip(si, found[0.3], strict=True):
        np.testing.assert_allclose(one.elastic_line / length, model.elastic_line, rtol=0, atol=1e-8)
        assert one.energy * length / stiffness == pytest.approx(model.energy, rel=1e-9)
        assert one.second_variation * length**2 / stiffness == pytest.approx(
            model.second_variation, rel=1e-6
        )


def test_out_of_reach_there_are_none_and_inside_none_may_be_asked_for() -> None:
    assert vb.equilibria(UNIT, PARABOLOID, position=(5, 0, 0)) == []
    with pytest.raises(ValueError, match="inside the object; allowed is outside"):
        vb.equilibria(UNIT, PARABOLOID, position=(0, 0, 1))
    with pytest.raises(ValueError, match=r"allowed is one quaternion"):
        vb.equilibria(
            UNIT, PARABOLOID, position=(0, 0, 0), orientation=[(0, 0, 0, 1), (0, 0, 0, 1)]
        )
