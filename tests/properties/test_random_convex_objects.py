"""Random boxes and capsules under random trails, with and without friction: equilibrium, no
penetration, the cone, scales, mirror and motions.

Levels and normals are written once more in NumPy, and the rod is integrated in space from its
support reactions.
"""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scenes import UNSHRUNK, motions, numbers, vectors
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import vibrissa as vb

COUNT = 61
RADIUS = 0.02
FEW = settings(max_examples=3, phases=UNSHRUNK, deadline=None)
KINDS = pytest.mark.parametrize("kind", ["box", "capsule"])


class Core(NamedTuple):
    """A box, or a segment along z, and how far its surface lies from that; turned about its centre."""

    kind: str
    half: np.ndarray
    grown: float
    rotation: Rotation
    center: np.ndarray

    def surface(self, length: float = 1.0) -> vb.surfaces.Surface:
        """For the package, in units in which the rod has this length."""
        half, center = self.half * length, self.center * length
        if self.kind == "box":
            return vb.surfaces.Box((0, 0, 0), half).placed(self.rotation, center)
        return vb.surfaces.Capsule(
            (0, 0, 0), (0, 0, 1), (self.grown - RADIUS) * length, 2 * half[2]
        ).placed(self.rotation, center)

    def foot(self, points: np.ndarray) -> np.ndarray:
        """Nearest points of the core (k, 3)."""
        own = self.rotation.inv().apply(points - self.center)
        half = self.half if self.kind == "box" else self.half * [0, 0, 1]
        return self.rotation.apply(np.clip(own, -half, half)) + self.center

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Of points outside the core from the object grown by the rod's radius (k,)."""
        return np.linalg.norm(points - self.foot(points), axis=1) - self.grown

    def mirrored(self) -> "Core":
        """Seen in a mirror in the plane y = 0."""
        x, y, z, w = self.rotation.as_quat()
        return self._replace(
            rotation=Rotation.from_quat([-x, y, -z, w]), center=self.center * [1, -1, 1]
        )

    def moved(self, turn: Rotation, shift: np.ndarray) -> "Core":
        """Turned and moved once more."""
        return self._replace(rotation=turn * self.rotation, center=turn.apply(self.center) + shift)


class Case(NamedTuple):
    """An object, a line of the clamp from x = 1.1 to −1.1, and a coefficient of friction."""

    core: Core
    side: float
    axis: np.ndarray
    friction: float

    def trail(self, length: float = 1.0) -> vb.Trail:
        """The path in units in which the rod has this length."""
        ends = np.array([[1.1, self.side, 0], [-1.1, self.side, 0]]) * length
        return vb.Trail.line(start=ends[0], stop=ends[1], count=COUNT, axis=self.axis)

    def scan(self, rod: vb.Rod) -> vb.Scan:
        """Scanned with a rod, in its units."""
        return vb.scan(
            rod,
            self.core.surface(rod.length),
            self.trail(rod.length),
            friction=self.friction,
            finite_radius=True,
        )


UNIT = vb.Rod(1.0, 1.0, radius=RADIUS)
WIRE = vb.Rod(0.05, 6.3e-4, radius=RADIUS * 0.05)


@st.composite
def cases(draw: st.DrawFn, kind: str) -> Case:
    """A trail past an object that is turned anyhow, with or without friction."""
    half = np.array([draw(numbers(0.15, 0.4)) for _ in range(3)])
    grown = RADIUS if kind == "box" else RADIUS + draw(numbers(0.1, 0.3))
    rotation = Rotation.from_rotvec(draw(vectors(-2.0, 2.0)))
    center = np.array([draw(numbers(-0.1, 0.1)), draw(numbers(-0.1, 0.1)), draw(numbers(0.8, 1.1))])
    axis = np.array([draw(numbers(-0.15, 0.15)), draw(numbers(-0.15, 0.15)), 1.0])
    friction = draw(st.sampled_from([0.0, 0.1, 0.3, 0.5]))
    return Case(
        Core(kind, half, grown, rotation, center),
        draw(numbers(-0.4, 0.4)),
        axis / np.linalg.norm(axis),
        friction,
    )


def before_a_snap(scan: vb.Scan) -> slice:
    """Rows that no search had a part in: directions in space are its own."""
    snaps = [
        event.parameter
        for event in scan.events
        if event.kind in (vb.EventKind.SNAP, vb.EventKind.LATERAL_INSTABILITY)
    ]
    wrong = np.flatnonzero(scan.status != vb.Status.OK)
    last = min([*np.ceil(np.array(snaps) * (COUNT - 1)).astype(int), *wrong, COUNT])
    return slice(0, int(last))


def sound(scan: vb.Scan) -> np.ndarray:
    return np.flatnonzero(scan.in_contact & (scan.status == vb.Status.OK))


def end_of_rod(scan: vb.Scan, i: int) -> tuple[np.ndarray, np.ndarray]:
    """Place of the contact cross-section, and the moment there, by integrating Kirchhoff's rod from
    the clamp under the support reactions.
    """
    force, tangent = (
        -scan.reactions.force[i],
        Rotation.from_quat(scan.trail.orientation[i]).apply([0.0, 0.0, 1.0]),
    )

    def slope(_s: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([y[3:6], np.cross(y[6:9], y[3:6]), np.cross(force, y[3:6])])

    start = np.concatenate([scan.trail.position[i], tangent, -scan.reactions.moment[i]])
    end = solve_ivp(
        slope, (0, scan.arc_length[i]), start, method="DOP853", rtol=1e-11, atol=1e-12
    ).y[:, -1]
    return end[:3], end[6:9]


@KINDS
@FEW
@given(st.data())
def test_every_row_is_an_equilibrium_outside_the_object(kind: str, data: st.DataObject) -> None:
    case = data.draw(cases(kind))
    scan = case.scan(UNIT)
    rows = sound(scan)
    assume(rows.size > 0)
    core = case.core
    for i in rows[:: max(1, rows.size // 6)]:
        place, moment = end_of_rod(scan, i)
        assert np.abs(moment).max() < 1e-8
        # The centre line there is a radius from the object, and the point reported is its foot.
        assert abs(core.distance(place[None])[0]) < 1e-8
        outward = (place - core.foot(place[None])[0]) / core.grown
        np.testing.assert_allclose(scan.normal[i], outward, rtol=0, atol=1e-6)
        np.testing.assert_allclose(scan.point[i], place - RADIUS * outward, rtol=0, atol=1e-8)
    for i in rows:
        assert core.distance(scan.elastic_line(int(i), 400)).min() > -1e-6


@KINDS
@FEW
@given(st.data())
def test_the_force_pushes_within_the_cone_and_friction_takes_work(
    kind: str, data: st.DataObject
) -> None:
    case = data.draw(cases(kind))
    scan = case.scan(UNIT)
    rows = sound(scan)
    assume(rows.size > 0)
    force = -scan.reactions.force[rows]
    size = np.linalg.norm(force, axis=1)
    rows, force, size = rows[size > 1e-6], force[size > 1e-6], size[size > 1e-6]
    push = np.sum(force * scan.normal[rows], axis=1)
    assert np.all(push > 0)
    rubbed = np.linalg.norm(force - push[:, None] * scan.normal[rows], axis=1) / push
    assert rubbed.max(initial=0) < case.friction + 1e-7
    slips = scan.motion[rows] == vb.Motion.SLIP
    if case.friction > 0:
        np.testing.assert_allclose(rubbed[slips], case.friction, rtol=0, atol=1e-7)
        # At the end of a step the tangential force opposes the sliding; the trapezoidal rule errs
        # by up to half of the force's change times the way.
        steps = np.flatnonzero(np.isfinite(scan.friction_work))
        contact = -scan.reactions.force
        along = contact - np.sum(contact * scan.normal, axis=1)[:, None] * scan.normal
        change = np.linalg.norm(along[steps] - along[steps - 1], axis=1)
        errs = change * np.linalg.norm(scan.slip.sliding[steps], axis=1) / 2
        assert np.all(scan.friction_work[steps] > -errs - 1e-6)


@KINDS
@FEW
@given(st.data())
def test_scale_mirror_and_motion_change_nothing(kind: str, data: st.DataObject) -> None:
    case, (turn, shift) = data.draw(cases(kind)), data.draw(motions)
    scan = case.scan(UNIT)
    rows = before_a_snap(scan)
    assume(scan.in_contact[rows].any())
    mirror = np.array([1.0, -1.0, 1.0])
    wire = case.scan(WIRE)
    seen = Case(case.core.mirrored(), -case.side, case.axis * mirror, case.friction).scan(UNIT)
    turned = vb.scan(
        UNIT,
        case.core.moved(turn, shift).surface(),
        vb.Trail(
            turn.apply(case.trail().position) + shift,
            turn * Rotation.from_quat(case.trail().orientation),
        ),
        friction=case.friction,
        finite_radius=True,
    )
    point, force = scan.point[rows], scan.reactions.force[rows]
    for there in (wire, seen, turned):
        np.testing.assert_array_equal(there.kind[rows], scan.kind[rows])
    np.testing.assert_allclose(wire.point[rows] / 0.05, point, rtol=0, atol=1e-7)
    np.testing.assert_allclose(
        wire.reactions.force[rows] / WIRE.force_scale, force, rtol=0, atol=1e-6
    )
    np.testing.assert_allclose(seen.point[rows], point * mirror, rtol=0, atol=1e-7)
    np.testing.assert_allclose(seen.reactions.force[rows], force * mirror, rtol=0, atol=1e-6)
    np.testing.assert_allclose(turned.point[rows], turn.apply(point) + shift, rtol=0, atol=1e-7)
    np.testing.assert_allclose(turned.reactions.force[rows], turn.apply(force), rtol=0, atol=1e-6)
