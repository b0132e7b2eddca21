"""Shapes of rods that taper, are curved, loaded and softly held: their length, where they begin and
what they pass, and one by an independent integration.
"""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa.drawing import drawn_rods
from vibrissa.io.sweeps import read_sweep
from vibrissa.mechanics.shape import free_lines

LENGTH, MODULUS, DENSITY = 0.05, 3e9, 1200.0
RADIUS, TIP, CURVATURE, ROLL = 0.2e-3, 0.08e-3, 4.0, 0.6
PIVOT = np.array([2e-4, 3e-4, 2e-3])
GRAVITY = np.array([0.0, 0.0, -9.81])
TURN = Rotation.from_euler("zyx", [0.7, 0.1, -0.05])
SPHERE = vb.surfaces.Sphere(center=(0, 0, 0.06), radius=0.025)
COUNT = 401


@cache
def rod() -> vb.Rod:
    """A soft tapered one, curved, heavy and on a pivot."""
    tapered = vb.Rod.tapered(
        length=LENGTH,
        base_radius=RADIUS,
        tip_radius=TIP,
        youngs_modulus=MODULUS,
        density=DENSITY,
        poisson_ratio=0.4,
    )
    curved = tapered.curved(vb.RestShape.polynomial((CURVATURE,), roll=ROLL))
    return curved.loaded(vb.Loads(gravity=tuple(GRAVITY))).on(vb.Support.pivot(PIVOT))


@cache
def scan() -> vb.Scan:
    """With a clamp that is rolled and tilted."""
    x = np.linspace(0.03, -0.02, 41)
    position = np.column_stack([x, np.full(41, 0.004), np.zeros(41)])
    return vb.scan(rod(), SPHERE, vb.Trail(position, TURN.as_quat()))


def _integrated(found: vb.Scan, row: int, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (count, 3), and force and moment left at the tip, from the support reactions on."""
    f0, m0 = found.reactions.force[row], found.reactions.moment[row]
    clamp, turn = found.trail.position[row], Rotation.from_quat(found.trail.orientation[row])

    def density(s: float) -> float:
        return DENSITY * np.pi * (RADIUS + (TIP - RADIUS) * s / LENGTH) ** 2

    def slope(s: float, y: np.ndarray) -> np.ndarray:
        axes, n, m = y[3:12].reshape(3, 3), y[12:15], y[15:]
        stiff = MODULUS * np.pi / 4 * (RADIUS + (TIP - RADIUS) * s / LENGTH) ** 4
        rest = CURVATURE * np.array([-np.sin(ROLL), np.cos(ROLL), 0.0])
        u = axes @ m / (stiff * np.array([1.0, 1.0, 1 / 1.4])) + rest
        kappa = u @ axes
        turned = np.cross(kappa, axes)
        return np.concatenate(
            [axes[2], turned.ravel(), -density(s) * GRAVITY, -np.cross(axes[2], n)]
        )

    # The pivot turns with the moment that the rod exerts on it.
    yields = Rotation.from_rotvec(turn.apply(turn.inv().apply(-m0) / PIVOT))
    start = (yields * turn).as_matrix().T
    y = np.concatenate([clamp, start.ravel(), -f0, -m0])
    s1 = found.arc_length[row] if found.in_contact[row] else LENGTH
    options = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-13}
    first = solve_ivp(slope, (0, s1), y, dense_output=True, **options)
    points = [first.sol(s[s <= s1])[:3].T]
    end = first.y[:, -1]
    if found.in_contact[row]:
        mean = RADIUS**2 + RADIUS * TIP + TIP**2
        weight = DENSITY * np.pi * LENGTH * mean / 3 * GRAVITY
        end[12:15] -= -f0 - weight
    if s1 < LENGTH:
        rest = solve_ivp(slope, (s1, LENGTH), end, dense_output=True, **options)
        points.append(rest.sol(s[s > s1])[:3].T)
        end = rest.y[:, -1]
    return np.concatenate(points), end[12:]


def test_scan_is_worth_looking_at() -> None:
    found = scan()
    assert np.all(found.status == vb.Status.OK)
    assert np.sum(found.kind == vb.ContactKind.TIP) > 3
    assert np.sum(found.kind == vb.ContactKind.TANGENTIAL) > 3


@pytest.mark.parametrize("kind", list(vb.ContactKind))
def test_shape_is_that_of_an_independent_integration(kind: vb.ContactKind) -> None:
    found = scan()
    row = int(np.flatnonzero(found.kind == kind)[-2])
    theirs, left = _integrated(found, row, np.linspace(0, LENGTH, COUNT))
    assert np.abs(left[:3]).max() < 1e-8 * rod().force_scale
    assert np.abs(left[3:]).max() < 1e-7 * rod().moment_scale
    np.testing.assert_allclose(found.elastic_line(row, COUNT), theirs, atol=1e-6 * LENGTH)


def test_shapes_begin_at_the_clamp_keep_their_length_and_pass_their_contact() -> None:
    found = scan()
    rows = found.in_contact
    lines = found.elastic_lines(rows, COUNT)
    clamps = found.trail.position[rows]
    np.testing.assert_allclose(lines[:, 0], clamps, atol=1e-12 * LENGTH)
    pieces = np.linalg.norm(np.diff(lines, axis=1), axis=-1)
    np.testing.assert_allclose(pieces.sum(1), LENGTH, rtol=1e-5)
    # Between two points the chord of a curvature of at most 100/m is shorter by 2e-6.
    np.testing.assert_allclose(pieces, LENGTH / (COUNT - 1), rtol=1e-5)
    at = found.arc_length[rows] / LENGTH * (COUNT - 1)
    before = np.minimum(at.astype(int), COUNT - 2)
    share = (at - before)[:, None]
    each = np.arange(len(lines))
    passed = (1 - share) * lines[each, before] + share * lines[each, before + 1]
    np.testing.assert_allclose(passed, found.point[rows], atol=2e-5 * LENGTH)


def test_free_rod_leaves_a_rigid_clamp_along_its_axis_and_curves_towards_its_roll() -> None:
    plain = vb.Rod.cylinder(length=LENGTH, radius=RADIUS, youngs_modulus=MODULUS)
    bow = plain.curved(vb.RestShape.arc(0.1, roll=ROLL))
    trail = vb.Trail([[0.1, 0.2, 0.3]], TURN.as_quat())
    (line,) = free_lines(bow, trail, COUNT)
    own = TURN.inv().apply(line - trail.position[0])
    s = np.linspace(0, LENGTH, COUNT)
    side = 0.1 * (1 - np.cos(s / 0.1))
    towards = [np.cos(ROLL) * side, np.sin(ROLL) * side, 0.1 * np.sin(s / 0.1)]
    np.testing.assert_allclose(own, np.array(towards).T, atol=1e-9)


def test_a_level_wire_sags_under_its_weight() -> None:
    wire = vb.rods.spring_steel(0.1, 0.1e-3).loaded(vb.Loads(gravity=(0, 0, -9.81)))
    level = vb.Trail(np.zeros((1, 3)), Rotation.from_euler("y", 90, degrees=True).as_quat())
    (line,) = free_lines(wire, level, 50)
    sag = wire.own_sag()
    assert sag is not None
    # Linear theory, at a sag of a hundredth of the length.
    assert line[-1, 2] == pytest.approx(-sag * 9.81 / 9.80665, rel=1e-3)


def test_a_support_that_moves_takes_the_rod_along() -> None:
    stiffness = np.diag([50.0, 60.0, 70.0, 2e-3, 2e-3, 2e-3])
    held = vb.Rod.cylinder(length=LENGTH, radius=RADIUS, youngs_modulus=MODULUS).on(
        vb.Support.compliant(stiffness)
    )
    trail = vb.Trail.line(start=(0.03, 0.004, 0), stop=(0.0, 0.004, 0), count=31)
    found = vb.scan(held, SPHERE, trail)
    row = int(np.flatnonzero(found.in_contact)[-1])
    moved = found.elastic_line(row, 5)[0] - trail.position[row]
    np.testing.assert_allclose(moved, -found.reactions.force[row] / [50, 60, 70], rtol=1e-9)


def test_exact_reconstruction_has_the_shape_of_the_scan() -> None:
    found = scan()
    back = vb.reconstruct(rod(), found.reactions)
    np.testing.assert_allclose(
        back.elastic_lines(back.in_contact, 60),
        found.elastic_lines(found.in_contact, 60),
        atol=1e-6 * LENGTH,
    )


@pytest.mark.slow
def test_noisy_shapes_pass_their_contact_within_its_ellipsoid() -> None:
    tapered = vb.Rod.tapered(
        length=LENGTH, base_radius=RADIUS, tip_radius=TIP, youngs_modulus=MODULUS
    )
    held = tapered.on(vb.Support.pivot(PIVOT))
    exact = vb.scan(held, SPHERE, scan().trail).reactions
    rng = np.random.default_rng(3)
    units = np.repeat([held.force_scale, held.moment_scale], 3)
    covariance = np.diag((2e-3 * units) ** 2)
    noise = rng.multivariate_normal(np.zeros(6), covariance, size=len(exact.force))
    noisy = vb.Reactions(
        exact.trail, exact.force + noise[:, :3], exact.moment + noise[:, 3:], covariance=covariance
    )
    found = vb.reconstruct(held, noisy)
    rows = found.in_contact & (found.status == vb.Status.OK)
    assert rows.sum() > 10
    lines = found.elastic_lines(rows, COUNT)
    np.testing.assert_allclose(lines[:, 0], exact.trail.position[rows], atol=1e-12)
    assert found.covariance is not None
    inverse = np.linalg.inv(found.covariance[rows])
    off = lines - found.point[rows][:, None]
    assert np.einsum("nki,nij,nkj->nk", off, inverse, off).min(axis=1).max() < 1.0


def test_file_keeps_rod_and_shapes(tmp_path: Path) -> None:
    found = scan()
    vb.io.write_dataset(tmp_path / "scan.nc", found.to_dataset())
    stored = read_sweep(tmp_path / "scan.nc")
    assert stored.rod == rod()
    np.testing.assert_array_equal(stored.reactions.force, found.reactions.force)
    everything = np.ones(found.kind.shape, dtype=bool)
    lines = found.elastic_lines(everything, 40)
    np.testing.assert_allclose(stored.elastic_lines(everything, 40), lines, atol=1e-12)
    assert len(list(drawn_rods(stored, everything, 40))) == len(lines)


def test_speed_is_judged_by_the_frequency_of_the_tapered_rod() -> None:
    uniform = vb.Rod.cylinder(length=LENGTH, radius=RADIUS, youngs_modulus=MODULUS, density=DENSITY)
    check = scan().quasi_static(0.01)
    assert check.natural_frequency == rod().first_natural_frequency()
    assert check.natural_frequency > 1.2 * uniform.first_natural_frequency()
    assert check.holds


def test_description_tells_what_differs() -> None:
    said = repr(rod())
    for part in ("Section", "Polynomial", "Loads(gravity=", "Support(kind='pivot'"):
        assert part in said
    assert str(scan().to_dataset()["rod"].item()).startswith('{"is": "Rod"')
