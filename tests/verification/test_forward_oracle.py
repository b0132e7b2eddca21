"""The paper's case, C = 0.5x² + y² + 0.4, against 40-digit arithmetic: ten trails, and
mechanics.md's table.
"""

import csv
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq
from shooting import rod_along

import vibrissa as vb

GRID = np.round(np.arange(1.2, -1.4001, -0.025), 3)

# y0: first contact, tip to tangential, (ξ, η, f) there, f at x0 = 0, smallest s₁.
TABLE = {
    0.1: (
        1.08627804912002,
        0.452652731517856,
        (0.738641881276, 0.443193332025, 1.4531300163),
        2.95275291,
        0.75006071,
    ),
    0.2: (
        1.05830052442584,
        0.37292343378556,
        (0.553931400958, 0.577266033567, 1.34586377588),
        2.04661147,
        0.84277807,
    ),
    0.3: (
        1.00995049383621,
        0.158017679525689,
        (0.220247329093, 0.68979598763, 1.25878686229),
        None,
        None,
    ),
    0.4: (0.938083151964686, None, None, None, 1.0),
    0.5: (0.836660026534076, None, None, 0.79522661, 1.0),
}
PITCHFORK, FIRST_TIP_AGAIN = 0.474512782442167, -0.870741786976819
OFFSETS = (-0.5, -0.4, -0.3, -0.2, -0.1, 0.1, 0.2, 0.3, 0.4, 0.5, 0.0, 0.3178, 0.31783)


@pytest.fixture(scope="module")
def scan() -> vb.Scan:
    """All trails in one: the oracle's positions, and those of the table."""
    special = [sign * row[1] for row in TABLE.values() if row[1] for sign in (1, -1)] + [
        PITCHFORK,
        FIRST_TIP_AGAIN,
    ]
    x = np.sort(np.concatenate([GRID, special]))[::-1]
    position = np.zeros((len(OFFSETS), len(x), 3))
    position[..., 0], position[..., 1] = x, np.array(OFFSETS)[:, None]
    return vb.scan(
        vb.Rod.unit(), vb.surfaces.EllipticParaboloid(a=0.5, b=1.0, h=0.4), vb.Trail(position)
    )


def row_at(scan: vb.Scan, y0: float, x0: float) -> tuple[int, int]:
    lane = OFFSETS.index(y0)
    return lane, int(np.flatnonzero(scan.trail.position[lane, :, 0] == x0)[0])


def events_of(scan: vb.Scan, y0: float) -> list[vb.Event]:
    return [event for event in scan.events if event.trail == OFFSETS.index(y0)]


def kinds_of(scan: vb.Scan, y0: float) -> list[str]:
    return [event.kind.name for event in events_of(scan, y0)]


def force(scan: vb.Scan, row: tuple[int, int]) -> float:
    return float(np.linalg.norm(scan.reactions.force[row]))


@pytest.fixture(scope="module")
def rows(oracle: Path) -> list[dict[str, str]]:
    with oracle.open() as file:
        return list(csv.DictReader(file))


def test_every_field_agrees_with_forty_digits(scan: vb.Scan, rows: list[dict[str, str]]) -> None:
    at = tuple(np.array([row_at(scan, float(row["y0"]), float(row["x0"])) for row in rows]).T)
    assert len(rows) == 790
    assert np.all(scan.status[at] == vb.Status.OK)

    def columns(*names: str) -> np.ndarray:
        return np.array([[float(row[name]) for name in names] for row in rows])

    def agree(found: np.ndarray, *names: str) -> None:
        np.testing.assert_allclose(found, columns(*names), rtol=0, atol=1e-9)

    agree(scan.point[at], "xi", "eta", "theta")
    agree(scan.normal[at], "n_x", "n_y", "n_z")
    agree(scan.arc_length[at][:, None], "s1")
    agree(scan.reactions.force[at], "f0x", "f0y", "f0z")
    agree(scan.reactions.moment[at], "m0x", "m0y", "m0z")
    agree(np.linalg.norm(scan.reactions.force[at], axis=-1)[:, None], "f")
    kinds = [vb.ContactKind[row["contact"].upper()] for row in rows]
    np.testing.assert_array_equal(scan.kind[at], kinds)


def test_contact_begins_and_ends_where_the_oracle_does(
    scan: vb.Scan, rows: list[dict[str, str]]
) -> None:
    known = {(float(row["y0"]), float(row["x0"])) for row in rows}
    found = {
        (y0, x0)
        for y0 in OFFSETS[:10]
        for x0 in GRID
        if scan.kind[row_at(scan, y0, x0)] != vb.ContactKind.NONE
    }
    assert found == known


@pytest.mark.parametrize("y0", TABLE)
def test_events_are_the_tables_and_mirror(scan: vb.Scan, y0: float) -> None:
    first, change, *_ = TABLE[y0]
    phases = [] if change is None else [change, -change]
    for side in (y0, -y0):
        assert kinds_of(scan, side) == [
            "FIRST_CONTACT",
            *["TIP_TO_TANGENTIAL", "TANGENTIAL_TO_TIP"][: len(phases)],
            "DETACH",
        ]
        clamps = np.array([event.clamp for event in events_of(scan, side)])
        np.testing.assert_allclose(clamps[:, 0], [first, *phases, -first], rtol=0, atol=1e-9)
        np.testing.assert_allclose(clamps[:, 1], side, rtol=0, atol=1e-15)


def test_first_contact_is_of_the_straight_tip(scan: vb.Scan) -> None:
    for y0 in OFFSETS:
        event = events_of(scan, y0)[0]
        np.testing.assert_allclose(
            event.point, [np.sqrt(2 * (0.6 - y0**2)), y0, 1.0], rtol=0, atol=1e-12
        )


@pytest.mark.parametrize("y0", [0.1, 0.2, 0.3])
def test_change_of_phase(scan: vb.Scan, y0: float) -> None:
    change, (xi, eta, f) = TABLE[y0][1:3]
    row = row_at(scan, y0, change)
    np.testing.assert_allclose(
        [*scan.point[row][:2], force(scan, row)], [xi, eta, f], rtol=0, atol=1e-9
    )
    np.testing.assert_allclose(events_of(scan, y0)[1].point[:2], [xi, eta], rtol=0, atol=1e-9)
    assert scan.arc_length[row] == pytest.approx(1.0, abs=1e-9)
    assert scan.contact_tangent[row] @ scan.normal[row] == pytest.approx(0.0, abs=1e-9)


def test_middle_of_the_trail(scan: vb.Scan) -> None:
    for y0, (*_, f, shortest) in TABLE.items():
        row = row_at(scan, y0, 0.0)
        if f is not None:
            assert force(scan, row) == pytest.approx(f, abs=1e-8)
        if shortest is not None:
            assert scan.arc_length[row] == pytest.approx(shortest, abs=1e-8)
            assert np.nanmin(scan.arc_length[row[0]]) == pytest.approx(shortest, abs=1e-8)


@pytest.mark.parametrize(("y0", "tangential"), [(0.3178, True), (0.31783, False)])
def test_tangential_contact_only_near_the_ridge(
    scan: vb.Scan, *, y0: float, tangential: bool
) -> None:
    """Tangential contact exists only for |y0| < 0.317820106279223."""
    assert ("TIP_TO_TANGENTIAL" in kinds_of(scan, y0)) == tangential
    assert bool((scan.kind[OFFSETS.index(y0)] == vb.ContactKind.TANGENTIAL).any()) == tangential


def test_bending_energy(scan: vb.Scan) -> None:
    energies = [scan.energy[row_at(scan, 0.2, x0)] for x0 in (0.6, 0.3, 0.0)]
    np.testing.assert_allclose(energies, [0.171, 0.323, 0.400], rtol=0, atol=5e-4)


def test_the_plane_branch_loses_lateral_stability(scan: vb.Scan) -> None:
    assert kinds_of(scan, 0.0) == [
        "FIRST_CONTACT",
        "LATERAL_INSTABILITY",
        "TIP_TO_TANGENTIAL",
        "TANGENTIAL_TO_TIP",
        "SNAP",
    ]
    _, pitchfork, _, tip_again, _ = events_of(scan, 0.0)
    np.testing.assert_allclose(
        [pitchfork.clamp[0], pitchfork.point[0]], [PITCHFORK, 0.949025564884334], rtol=0, atol=1e-9
    )
    assert force(scan, row_at(scan, 0.0, PITCHFORK)) == pytest.approx(1.57567831969, abs=1e-9)
    assert tip_again.clamp[0] == pytest.approx(FIRST_TIP_AGAIN, abs=1e-9)
    assert force(scan, row_at(scan, 0.0, FIRST_TIP_AGAIN)) == pytest.approx(
        3.68949810669125, abs=1e-9
    )


def test_rows_beyond_the_pitchfork_are_marked(scan: vb.Scan) -> None:
    lane = OFFSETS.index(0.0)
    x0, contact = scan.trail.position[lane, :, 0], scan.in_contact[lane]
    beyond = x0 < PITCHFORK - 1e-6
    assert np.all(scan.status[lane, contact & beyond] == vb.Status.LATERALLY_UNSTABLE)
    assert np.all(scan.status[lane, x0 > PITCHFORK + 1e-6] == vb.Status.OK)


def test_the_plane_branch_ends_in_a_fold(scan: vb.Scan) -> None:
    snap = events_of(scan, 0.0)[-1]
    assert snap.clamp[0] == pytest.approx(-1.34212374, abs=1e-8)
    assert snap.point[0] == pytest.approx(-0.743728, abs=1e-6)
    assert snap_force(snap) == pytest.approx(8.285685, abs=1e-5)
    x0 = scan.trail.position[OFFSETS.index(0.0), :, 0]
    np.testing.assert_array_equal(
        scan.in_contact[OFFSETS.index(0.0)], (x0 < np.sqrt(1.2)) & (x0 > snap.clamp[0])
    )


def snap_force(snap: vb.Event) -> float:
    """Contact force under which the rod, integrated from its clamp with m(0) = r × F, is free of
    moment at its tip.
    """
    slope = snap.point[0]
    normal = np.array([slope, 0.0, -1.0]) / np.hypot(slope, 1.0)

    def tip_moment(f: float) -> float:
        moment = np.cross(snap.point - snap.clamp, f * normal)
        return rod_along(snap.clamp, [0.0, 0.0, 1.0], moment, f * normal, 1.0)[-1, 7]

    return brentq(tip_moment, 8.0, 8.6, xtol=1e-12)
