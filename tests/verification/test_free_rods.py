"""Rods that hang in the wind, bent by their loads alone, against SciPy's integration from the free
tip to the clamp.
"""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa.io.sweeps import read_sweep

LENGTH, RADIUS, DENSITY, STEEL = 0.08, 1e-4, 8000.0, 2e11
WIRE = vb.Rod.cylinder(length=LENGTH, radius=RADIUS, youngs_modulus=STEEL, density=DENSITY)
FAR = vb.surfaces.Sphere(center=(0, 0, 10 * LENGTH), radius=0.01)
NONE = (0.0, 0.0, 0.0)
"""Of wind or weight: rods with the same kinds of loads share compiled code."""


def drag(speed: np.ndarray) -> np.ndarray:
    """Drag per length [N/m] of the wire across a wind: the law that `vb.Loads` names."""
    reynolds = 1.204 * speed * 2 * RADIUS / 1.825e-5
    coefficient = 1.18 + 6.8 / reynolds**0.89 + 1.96 / reynolds**0.5
    coefficient -= 4e-4 * reynolds / (1 + 3.64e-7 * reynolds**2)
    return 1.204 * RADIUS * coefficient * speed**2


def held(tip: ArrayLike, wind: float) -> np.ndarray:
    """Angle, forces along y and z and moment [N m] at the clamp of a wire along z in a wind along y
    whose tip is turned by an angle towards y: (4, …) of angles (…).
    """
    stiffness, tip = WIRE.bending_stiffness, np.asarray(tip)

    def slope(_: float, at: np.ndarray) -> np.ndarray:
        angle, along_y, along_z, moment = at.reshape(4, -1)
        y, z = np.sin(angle), np.cos(angle)
        # Across the rod; of no wind it is none.
        push = np.sign(wind * z) * drag(np.maximum(abs(wind * z), 1e-12))
        return np.concatenate([-moment / stiffness, push * z, -push * y, z * along_y - y * along_z])

    start = np.concatenate([tip.ravel(), np.zeros(3 * tip.size)])
    end = solve_ivp(slope, (0, LENGTH), start, "DOP853", rtol=1e-11, atol=1e-14)
    return end.y[:, -1].reshape(4, *tip.shape)


@pytest.mark.parametrize("wind", [15.0, 30.0, 40.0, 60.0, 100.0])
def test_a_wire_that_strong_wind_bends_far_stands(wind: float) -> None:
    """Up to 69° at the tip: the clamp's forces and moment, for the one shape that there is."""
    angles = np.linspace(0, np.pi, 200)
    left = held(angles, wind)[0]
    (place,) = np.flatnonzero(left[:-1] * left[1:] < 0)
    tip = brentq(lambda angle: held(angle, wind)[0], angles[place], angles[place + 1], xtol=1e-14)
    _, along_y, along_z, moment = held(tip, wind)
    rod = WIRE.loaded(vb.Loads(gravity=NONE, wind=(0, wind, 0)))
    scan = vb.scan(rod, FAR, vb.Trail.line(start=(0, 0, 0), stop=(0, 1e-3, 0), count=2))
    assert np.all(scan.status == vb.Status.OK)
    force = scan.reactions.force[0]
    np.testing.assert_allclose(-force, [0, along_y, along_z], atol=1e-8 * abs(along_y))
    np.testing.assert_allclose(abs(scan.reactions.moment[0, 0]), abs(moment), rtol=1e-8)


@pytest.mark.parametrize("ratio", [7.80, 8.5, 12.0, 20.0, 60.0, 85.0])
def test_an_upright_wire_falls_over_from_its_critical_weight_on(ratio: float) -> None:
    """The critical weight is 7.837 EI/L² (A. G. Greenhill 1881); far beyond it the upright shape
    is not stable again.
    """
    stiffness, mass = WIRE.bending_stiffness, DENSITY * np.pi * RADIUS**2
    gravity = ratio * stiffness / LENGTH**3 / mass
    rod = WIRE.loaded(vb.Loads(gravity=(0, 0, -gravity), wind=NONE))
    trail = vb.Trail.line(start=(0, 0, 0), stop=(0, 1e-3, 0), count=2)
    scan = vb.scan(rod, FAR, trail)
    expected = vb.Status.OK if ratio < 7.837 else vb.Status.FALLS_OVER
    assert np.all(scan.status == expected)


@pytest.mark.parametrize("angle", [30.0, 90.0, 170.0, 178.0])
@pytest.mark.parametrize("ratio", [20.0, 30.0, 40.0, 60.0, 80.0])
def test_a_wire_as_soft_as_a_rope_hangs(ratio: float, angle: float) -> None:
    """At an angle of the clamp to the weight, nearly upright too: EI ψ'' = w s sin ψ from the free
    tip, where ψ is the angle to the weight; the least turned tip is the shape that the wire takes
    as the weight grows.
    """

    def bent(tip: ArrayLike) -> np.ndarray:
        tip = np.asarray(tip)

        def slope(s: float, at: np.ndarray) -> np.ndarray:
            turned, rate = at.reshape(2, -1)
            return np.concatenate([rate, ratio * s * np.sin(turned)])

        start = np.concatenate([tip.ravel(), np.zeros(tip.size)])
        end = solve_ivp(slope, (0, 1), start, "DOP853", rtol=1e-12, atol=1e-16)
        return end.y[:, -1].reshape(2, *tip.shape)

    tips = np.geomspace(1e-6, np.pi / 2, 400)
    left = bent(tips)[0] - np.radians(angle)
    place = np.flatnonzero((left[:-1] < 0) & (left[1:] >= 0))[0]
    tip = brentq(
        lambda tip: bent(tip)[0] - np.radians(angle), tips[place], tips[place + 1], xtol=1e-16
    )
    stiffness, mass = WIRE.bending_stiffness, DENSITY * np.pi * RADIUS**2
    down = np.array([np.sin(np.radians(angle)), 0, np.cos(np.radians(angle))])
    gravity = ratio * stiffness / LENGTH**3 / mass * down
    rod = WIRE.loaded(vb.Loads(gravity=tuple(gravity), wind=NONE))
    here = vb.Trail.line(start=(0, 0, 0), stop=(0, 1e-4, 0), count=2)
    # The softest need finer steps; without them they are not said to be found.
    scan = vb.scan(rod, FAR, here, accuracy=1e-12 if ratio > 60 else 1e-10)
    assert np.all(scan.status == vb.Status.OK)
    moment = np.linalg.norm(scan.reactions.moment[0])
    assert moment == pytest.approx(bent(tip)[1] * stiffness / LENGTH, rel=1e-6)


def test_an_offset_of_the_object_is_the_same_for_every_rod(tmp_path: Path) -> None:
    """A ball of 28 mm grown by 2 mm is one of 30 mm, also for a rod that tapers."""
    rod = vb.Rod.tapered(
        length=LENGTH, base_radius=0.15e-3, tip_radius=0.05e-3, youngs_modulus=STEEL
    )
    trail = vb.Trail.line(start=(0.05, 0.01, 0), stop=(-0.05, 0.01, 0), count=31)
    center = (0, 0, 0.09)
    whole = vb.scan(rod, vb.surfaces.Sphere(center=center, radius=0.03), trail)
    small = vb.surfaces.Sphere(center=center, radius=0.028)
    grown = vb.scan(rod, vb.surfaces.Offset(small, 0.002), trail)
    assert whole.in_contact.sum() > 10
    for name in ("force", "moment"):
        found, expected = (getattr(one.reactions, name) for one in (grown, whole))
        np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
    # Its point is on the ball of 28 mm, and its centre line passes that of 30 mm.
    np.testing.assert_allclose(grown.centre, whole.point, atol=1e-9 * LENGTH)
    assert np.abs(small.distances(grown.point[grown.in_contact])).max() < 1e-9 * LENGTH
    lines = [one.elastic_lines(one.in_contact) for one in (grown, whole)]
    np.testing.assert_allclose(*lines, atol=1e-7 * LENGTH)
    vb.io.write_dataset(tmp_path / "grown.nc", grown.to_dataset())
    stored = read_sweep(tmp_path / "grown.nc").elastic_lines(grown.in_contact)
    np.testing.assert_allclose(stored, lines[0], atol=1e-7 * LENGTH)


@pytest.mark.parametrize(
    "loads",
    [
        vb.Loads(gravity=(0, 0, -9.81), wind=(0, 8.0, 0)),
        vb.Loads(gravity=(0, 0, -9.81), wind=lambda place: jnp.array([0.0, 200.0, 0.0]) * place[0]),
    ],
    ids=["alike everywhere", "wind that grows along x"],
)
def test_each_pose_is_as_if_it_were_the_only_one(loads: vb.Loads) -> None:
    """Poses that share an orientation and poses that do not, on trails of their own and in one."""
    rod = WIRE.loaded(loads)
    turns = Rotation.from_euler("xyz", [[90, 0, 0], [90, 0, 30], [120, 20, 0]], degrees=True)
    orientation = np.repeat(turns.as_quat(), 3, axis=0)
    position = np.tile([[0.02, 0, 0], [0.04, 0, 0], [0.06, 0.01, 0.01]], (3, 1))
    whole = vb.scan(rod, FAR, vb.Trail(position, orientation)).reactions.wrench
    alone = [
        vb.scan(rod, FAR, vb.Trail(position[[row]], orientation[[row]])).reactions.wrench[0]
        for row in range(len(position))
    ]
    np.testing.assert_allclose(whole, alone, rtol=1e-10, atol=1e-15)
    same = np.isclose(whole[0], whole[1], rtol=1e-10, atol=1e-15).all()
    assert same != callable(loads.wind)
