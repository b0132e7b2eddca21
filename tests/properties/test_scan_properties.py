"""What must hold on any object and any straight trail: symmetries of space, scales, the contact
law, and energy.
"""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scenes import (
    COUNT,
    UNIT,
    UNSHRUNK,
    WIRE,
    Scene,
    Solid,
    model_units,
    motions,
    same,
    scenes,
    sound,
)
from scipy.spatial.transform import Rotation

import vibrissa as vb

FEW = settings(max_examples=5, phases=UNSHRUNK)
SOME = settings(max_examples=20, phases=UNSHRUNK)
CLOSE = 1e-9
RACING = 0.02
"""Motion of the contact [L] in a step of 0.01 L: near a fold it would take shorter steps to
integrate its work.
"""


def smooth(scan: vb.Scan) -> bool:
    """Swept without a snap, after which the equilibrium is one that a search found."""
    return (
        scan.in_contact.any()
        and bool(np.all(scan.status == vb.Status.OK))
        and vb.EventKind.SNAP not in kinds(scan)
    )


def kinds(scan: vb.Scan) -> list[vb.EventKind]:
    return [event.kind for event in scan.events]


@FEW
@given(scenes(), motions)
def test_turning_and_moving_everything_turns_and_moves_the_result(
    scene: Scene, motion: tuple[Rotation, np.ndarray]
) -> None:
    rotation, translation = motion
    still = scene.scan()
    assume(smooth(still))
    moved_trail = vb.Trail(
        rotation.apply(scene.position) + translation, rotation * scene.orientation
    )
    moved = vb.scan(UNIT, scene.solid.moved(rotation, translation).surface(), moved_trail)

    def change(name: str, values: np.ndarray) -> np.ndarray:
        turned = values @ rotation.as_matrix().T if values.ndim == 2 else values
        return turned + translation if name == "point" else turned

    same(moved, still, change, CLOSE)


@FEW
@given(scenes())
def test_a_steel_wire_is_the_unit_rod_in_other_units(scene: Scene) -> None:
    unit = scene.scan()
    assume(smooth(unit))
    same(scene.scan(WIRE), unit, lambda _, values: values, CLOSE)


@FEW
@given(scenes(), st.floats(1e-6, 1e6))
def test_stiffness_scales_the_wrench_and_nothing_else(scene: Scene, stiffness: float) -> None:
    unit = scene.scan()
    assume(smooth(unit))
    stiff = vb.scan(vb.Rod(1.0, stiffness), scene.solid.surface(), scene.trail())
    np.testing.assert_allclose(stiff.point, unit.point, rtol=0, atol=1e-13)
    for name in ("force", "moment"):
        ours, theirs = getattr(stiff.reactions, name), getattr(unit.reactions, name)
        np.testing.assert_allclose(ours, stiffness * theirs, rtol=1e-12, atol=1e-12 * stiffness)


@FEW
@given(scenes())
def test_a_mirror_shows_the_mirrored_sweep(scene: Scene) -> None:
    direct = scene.scan()
    assume(smooth(direct))
    mirror = np.array([1, -1, 1])
    image = Scene(scene.solid.mirrored(), -scene.side, scene.axis * mirror).scan()

    def change(name: str, values: np.ndarray) -> np.ndarray:
        # A moment is an axial vector: its mirror image turns the other way.
        return values * (-mirror if name == "moment" else mirror) if values.ndim == 2 else values

    same(image, direct, change, CLOSE)


@FEW
@given(scenes())
def test_without_snaps_the_way_back_is_the_way_there(scene: Scene) -> None:
    """Frictionless quasi-static sweeps are reversible."""
    there, trail = scene.scan(), scene.trail()
    back = vb.scan(
        UNIT, scene.solid.surface(), vb.Trail(trail.position[::-1], trail.orientation[::-1])
    )
    assume(smooth(there) and smooth(back))
    ours, theirs = model_units(back), model_units(there)
    for name, values in ours.items():
        np.testing.assert_allclose(values[::-1], theirs[name], rtol=0, atol=CLOSE, err_msg=name)


@FEW
@given(scenes())
def test_a_finer_trail_passes_through_the_same_equilibria(scene: Scene) -> None:
    coarse = scene.scan()
    assume(smooth(coarse))
    ends = scene.position[[0, -1]]
    finer = vb.Trail.line(start=ends[0], stop=ends[1], count=2 * COUNT - 1, axis=scene.axis)
    fine = vb.scan(UNIT, scene.solid.surface(), finer)
    assume(smooth(fine))
    for name, values in model_units(coarse).items():
        np.testing.assert_allclose(
            model_units(fine)[name][::2], values, rtol=0, atol=CLOSE, err_msg=name
        )


@SOME
@given(scenes())
def test_the_object_pushes_along_its_outward_normal(scene: Scene) -> None:
    """Contact on the surface, F = f n with f ≥ 0 and n by the object's own equation, s₁ ≤ L, no
    couple about the contact.
    """
    scan = scene.scan()
    rows = sound(scan)
    assume(rows.any())
    point, force = scan.point[rows], -scan.reactions.force[rows]
    n = scene.solid.normal(point)
    f = np.sum(force * n, axis=1)
    np.testing.assert_allclose(scene.solid.level(point), 0, atol=CLOSE)
    np.testing.assert_allclose(force, f[:, None] * n, rtol=0, atol=CLOSE)
    np.testing.assert_allclose(scan.normal[rows], n, rtol=0, atol=CLOSE)
    assert np.all(f >= 0)
    assert np.all((scan.arc_length[rows] > 0) & (scan.arc_length[rows] <= 1 + CLOSE))
    couple = scan.reactions.moment[rows] + np.cross(point - scene.position[rows], force)
    np.testing.assert_allclose(couple, 0, atol=CLOSE)


@SOME
@given(scenes())
def test_the_rod_touches_with_its_tip_or_tangentially(scene: Scene) -> None:
    """And never with its tip turned towards the object, nor tangentially beyond its end."""
    scan = scene.scan()
    rows = sound(scan)
    assume(rows.any())
    lift = -np.sum(scan.contact_tangent[rows] * scene.solid.normal(scan.point[rows]), axis=1)
    spare = 1 - scan.arc_length[rows]
    tip = scan.kind[rows] == vb.ContactKind.TIP
    np.testing.assert_allclose(np.minimum(lift, spare), 0, atol=CLOSE)
    assert np.all(np.abs(spare[tip]) < CLOSE)
    assert np.all(np.abs(lift[~tip]) < CLOSE)


@SOME
@given(scenes(), st.integers(0, COUNT - 1))
def test_the_rod_is_outside_the_object_from_clamp_to_tip(scene: Scene, start: int) -> None:
    scan = scene.scan()
    rows = np.flatnonzero(sound(scan))
    assume(rows.size)
    for i in np.roll(rows, -start)[::5]:
        line = scan.elastic_line(int(i), 1000)
        assert scene.solid.level(line).min() > -1e-6
        assert np.abs(scene.solid.level(line)).min() < 1e-3
        assert np.linalg.norm(np.diff(line, axis=0), axis=1).sum() == pytest.approx(1, abs=1e-5)


@SOME
@given(scenes())
def test_a_free_rod_is_clear_of_the_object(scene: Scene) -> None:
    """Where no contact is reported the straight rod is outside, and carries nothing."""
    scan = scene.scan()
    free = np.flatnonzero((scan.kind == vb.ContactKind.NONE) & (scan.status == vb.Status.OK))
    assume(free.size)
    s = np.linspace(0, 1, 400)
    for i in free:
        assert scene.solid.level(scene.position[i] + s[:, None] * scene.axis).min() > -1e-6
    np.testing.assert_array_equal(scan.reactions.force[free], 0)
    np.testing.assert_array_equal(scan.energy[free], 0)


def stretches(scan: vb.Scan) -> list[np.ndarray]:
    """Runs of at least 17 rows of one kind of contact, without an event within, on which the
    contact does not race over the object.
    """
    codes = np.where(sound(scan), scan.kind, 0)
    events = np.array([event.parameter for event in scan.events])
    parameter = scan.trail.parameter
    found = []
    for run in np.split(np.arange(len(codes)), np.flatnonzero(np.diff(codes)) + 1):
        rows = run[: 4 * ((len(run) - 1) // 4) + 1]
        within = np.any((events > parameter[rows[0]]) & (events < parameter[rows[-1]]))
        if codes[rows[0]] and len(rows) >= 17 and not within:
            moved = np.linalg.norm(np.diff(scan.point[rows], axis=0), axis=1)
            found += [rows] if moved.max() < RACING else []
    return found


def work(scan: vb.Scan, rows: np.ndarray) -> float:
    """∫ f0·dP0 + m0·dφ of the clamp on the rod, by the trapezoidal rule."""
    moved = np.diff(scan.trail.position[rows], axis=0)
    turns = Rotation.from_quat(scan.trail.orientation[rows])
    turned = (turns[1:] * turns[:-1].inv()).as_rotvec()
    force, moment = scan.reactions.force[rows], scan.reactions.moment[rows]
    return float(
        np.sum((force[1:] + force[:-1]) / 2 * moved)
        + np.sum((moment[1:] + moment[:-1]) / 2 * turned)
    )


def check_energy(scan: vb.Scan) -> None:
    """Work and change of energy agree to second order in the step, on every stretch of one kind of
    contact.
    """
    for rows in stretches(scan):
        stored = scan.energy[rows[-1]] - scan.energy[rows[0]]
        coarse, middle, fine = (work(scan, rows[::step]) - stored for step in (4, 2, 1))
        # Of second order, with what is left of fourth: Richardson's extrapolation of the two finer
        # ones.
        best = fine + (fine - middle) / 3
        size = max(abs(coarse), abs(middle), abs(fine))
        assert abs(best) < 0.1 * size + 1e-9


FINE = 4 * (COUNT - 1) + 1


def finely(scene: Scene, turn: tuple[float, float, float]) -> vb.Scan:
    """Steps of 0.01 L, the clamp turning by twice `turn` on the way."""
    ends = scene.position[[0, -1]]
    position = vb.Trail.line(start=ends[0], stop=ends[1], count=FINE).position
    turning = Rotation.from_rotvec(np.outer(np.linspace(-1, 1, FINE), turn)) * scene.orientation[0]
    return vb.scan(UNIT, scene.solid.surface(), vb.Trail(position, turning))


@SOME
@given(scenes())
def test_the_clamps_work_is_stored_as_bending_energy(scene: Scene) -> None:
    scan = finely(scene, (0.0, 0.0, 0.0))
    assume(stretches(scan))
    check_energy(scan)


@SOME
@given(scenes(), st.tuples(*[st.floats(-0.5, 0.5)] * 3))
def test_a_turning_clamp_does_work_with_its_moment(
    scene: Scene, turn: tuple[float, float, float]
) -> None:
    scan = finely(scene, turn)
    assume(stretches(scan))
    check_energy(scan)


@SOME
@given(scenes())
def test_slip_is_the_contacts_motion(scene: Scene) -> None:
    """Axial slip is ds₁; longitudinal and lateral slip are the two parts of dP₁, square to each
    other.
    """
    scan = scene.scan()
    both = scan.in_contact[1:] & scan.in_contact[:-1]
    assume(both.any())
    slip, moved = scan.slip, np.diff(scan.point, axis=0)
    np.testing.assert_allclose(
        slip.axial[1:][both], np.diff(scan.arc_length)[both], rtol=0, atol=1e-15
    )
    total = (slip.longitudinal**2 + slip.lateral**2)[1:][both]
    np.testing.assert_allclose(total, np.sum(moved**2, axis=1)[both], rtol=1e-9, atol=1e-18)
    assert not np.any(np.isfinite(slip.axial[1:][~both]))


@FEW
@given(scenes())
def test_trails_swept_together_are_those_swept_alone(scene: Scene) -> None:
    alone = scene.scan()
    assume(smooth(alone))
    offsets = np.array([0.0, 0.03, -0.02])
    position = scene.position + offsets[:, None, None] * [0, 1, 0]
    trail = vb.Trail(position, np.broadcast_to(scene.orientation.as_quat(), (3, COUNT, 4)))
    together = vb.scan(UNIT, scene.solid.surface(), trail)
    np.testing.assert_allclose(together.point[0], alone.point, rtol=0, atol=CLOSE)
    np.testing.assert_allclose(
        together.reactions.moment[0], alone.reactions.moment, rtol=0, atol=CLOSE
    )
    assert [event.kind for event in together.events if event.trail == 0] == kinds(alone)


def test_after_a_snap_the_rod_rests_where_the_sweep_from_the_other_side_leads() -> None:
    """The straight rod still reaches into the ball there: of the admissible equilibria it is the
    one of least energy.
    """
    turn = Rotation.from_rotvec([-0.1, 0.056, -0.099])
    ball = Solid("ellipsoid", np.array([0.0, 0.0, 1.10943, 0.3, 0.504, 0.4231]), turn, np.zeros(3))
    scene = Scene(ball, 0.1, np.array([0.0, -0.0018, 1.0]) / np.hypot(0.0018, 1.0))
    there, trail = scene.scan(), scene.trail()
    back = vb.scan(UNIT, ball.surface(), vb.Trail(trail.position[::-1], trail.orientation[::-1]))
    snap = next(event for event in there.events if event.kind == vb.EventKind.SNAP)
    behind = there.trail.parameter > snap.parameter
    assert np.all(there.status == vb.Status.OK)
    np.testing.assert_allclose(
        there.reactions.force[behind], back.reactions.force[::-1][behind], rtol=0, atol=CLOSE
    )
    energy = there.energy[np.flatnonzero(~behind)[-1]]
    assert there.energy[np.flatnonzero(behind)[0]] < energy
