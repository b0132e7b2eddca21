"""Forward in closed form, back by integration and in closed form; through SI, and through a
sensor's log on disk.
"""

import csv
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa.inverse import reconstruct_by_integration

UNIT = vb.Rod.unit()
WIRE = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
TURN, SHIFT = Rotation.from_rotvec([0.4, -0.6, 1.0]), np.array([0.2, -0.1, 0.3])


def paper() -> vb.Scan:
    """The paper's eleven trails without the middle one."""
    trails = [
        vb.Trail.line(start=(1.2, y, 0), stop=(-1.2, y, 0), count=61)
        for y in (0.1, 0.2, 0.3, 0.4, 0.5, -0.1, -0.25, -0.35)
    ]
    return vb.scan(
        UNIT, vb.surfaces.EllipticParaboloid(a=0.5, b=1.0, h=0.4), vb.Trail.stack(trails)
    )


def turned_paper() -> vb.Scan:
    """The same object elsewhere, with a clamp that turns on its way."""
    surface = vb.surfaces.EllipticParaboloid(a=0.5, b=1.0, h=0.4).placed(TURN, SHIFT)
    position = np.stack([np.linspace(1.2, -1.2, 61), np.full(61, 0.25), np.zeros(61)], axis=1)
    orientation = TURN * Rotation.from_rotvec(np.outer(np.linspace(-0.2, 0.2, 61), [1.0, 0.5, 0.2]))
    return vb.scan(UNIT, surface, vb.Trail(TURN.apply(position) + SHIFT, orientation))


def wire_on_a_ball() -> vb.Scan:
    """The published experiment's scale, SI units: 50 mm of wire, a 60 mm ball."""
    trails = [
        vb.Trail.line(start=(0.045, y, 0), stop=(-0.045, y, 0), count=61)
        for y in (0.005, -0.01, 0.015, -0.02)
    ]
    return vb.scan(
        WIRE, vb.surfaces.Sphere(center=(0, 0, 0.0575), radius=0.03), vb.Trail.stack(trails)
    )


@pytest.fixture(
    scope="module", params=[paper, turned_paper, wire_on_a_ball], ids=lambda case: case.__name__
)
def scan(request: pytest.FixtureRequest) -> vb.Scan:
    scan = request.param()
    kinds = {vb.ContactKind(int(kind)).name for kind in np.unique(scan.kind)}
    assert kinds == {"NONE", "TIP", "TANGENTIAL"}
    assert np.all(scan.status == vb.Status.OK)
    return scan


def test_integrating_the_paper_s_equations_leads_back(scan: vb.Scan) -> None:
    """The forward closed form against eqs. (10) and (16): two routes that share no formula."""
    shown = slice(None, None, 3)
    trail = vb.Trail(scan.trail.position[..., shown, :], scan.trail.orientation[..., shown, :])
    reactions = vb.Reactions(
        trail, scan.reactions.force[..., shown, :], scan.reactions.moment[..., shown, :]
    )
    point, direction, arc_length = reconstruct_by_integration(scan.rod, reactions)
    rows = scan.in_contact[..., shown]
    L = scan.rod.length
    np.testing.assert_allclose(
        point[rows] / L, scan.point[..., shown, :][rows] / L, rtol=0, atol=1e-8
    )
    np.testing.assert_allclose(direction[rows], scan.normal[..., shown, :][rows], rtol=0, atol=1e-8)
    np.testing.assert_allclose(
        arc_length[rows] / L, scan.arc_length[..., shown][rows] / L, rtol=0, atol=1e-8
    )
    assert np.all(np.isnan(point[~rows]))


def test_the_closed_form_leads_back(scan: vb.Scan) -> None:
    found, L = vb.reconstruct(scan.rod, scan.reactions), scan.rod.length
    rows = scan.in_contact
    np.testing.assert_array_equal(found.in_contact, rows)
    np.testing.assert_array_equal(found.status, vb.Status.OK)
    np.testing.assert_allclose(found.point[rows] / L, scan.point[rows] / L, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.normal[rows], scan.normal[rows], rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        found.arc_length[rows] / L, scan.arc_length[rows] / L, rtol=0, atol=1e-12
    )
    scale = scan.rod.moment_scale
    np.testing.assert_allclose(
        found.energy[rows] / scale, scan.energy[rows] / scale, rtol=0, atol=1e-12
    )
    tangential = scan.kind == vb.ContactKind.TANGENTIAL
    np.testing.assert_allclose(found.modulus[tangential], 0.5, rtol=0, atol=1e-12)


def test_both_see_the_same_kind_of_contact(scan: vb.Scan) -> None:
    np.testing.assert_array_equal(vb.reconstruct(scan.rod, scan.reactions).kind, scan.kind)


def test_both_draw_the_same_rod(scan: vb.Scan) -> None:
    found = vb.reconstruct(scan.rod, scan.reactions)
    rows = np.argwhere(scan.in_contact)[::20]
    for row in map(tuple, rows.tolist()):
        index = row if len(row) > 1 else row[0]
        ours, theirs = scan.elastic_line(index, 50), found.elastic_line(index, 50)
        np.testing.assert_allclose(
            ours / scan.rod.length, theirs / scan.rod.length, rtol=0, atol=1e-10
        )


def test_the_oracle_s_reactions_lead_to_the_oracle_s_contacts(oracle: Path) -> None:
    with oracle.open() as file:
        rows = list(csv.DictReader(file))

    def columns(*names: str) -> np.ndarray:
        return np.array([[float(row[name]) for name in names] for row in rows])

    position = np.column_stack([columns("x0", "y0"), np.zeros(len(rows))])
    reactions = vb.Reactions(
        vb.Trail(position), columns("f0x", "f0y", "f0z"), columns("m0x", "m0y", "m0z")
    )
    found = vb.reconstruct(UNIT, reactions)
    np.testing.assert_allclose(found.point, columns("xi", "eta", "theta"), rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.normal, columns("n_x", "n_y", "n_z"), rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.arc_length, columns("s1")[:, 0], rtol=0, atol=1e-10)
    np.testing.assert_array_equal(
        found.kind, [vb.ContactKind[row["contact"].upper()] for row in rows]
    )
    np.testing.assert_array_equal(found.status, vb.Status.OK)


def test_model_units_and_si_are_one_experiment() -> None:
    """Scanned in model units, brought to SI, reconstructed there, and brought back."""
    scan, L = paper(), WIRE.length
    reactions = vb.Reactions(
        vb.Trail(scan.trail.position * L, scan.trail.orientation),
        scan.reactions.force * WIRE.force_scale,
        scan.reactions.moment * WIRE.moment_scale,
    )
    found, rows = vb.reconstruct(WIRE, reactions), scan.in_contact
    np.testing.assert_allclose(found.point[rows] / L, scan.point[rows], rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        found.energy[rows] / WIRE.moment_scale, scan.energy[rows], rtol=0, atol=1e-12
    )


SETUP = """\
[rod]
kind = "cylinder"
length = 0.05
radius = 0.25e-3
youngs_modulus = 206e9
[sensor]
clamp_position = [0.004, -0.003, 0.025]
clamp_orientation = [0.1, 0.2, 0.3, 0.9]
wrench = "on_sensor"
wrench_frame = "{frame}"
wrench_point = [0.001, 0.002, 0.005]
tare_seconds = 0.1
"""


@pytest.mark.parametrize("frame", ["sensor", "world"])
def test_through_a_sensor_s_log(tmp_path: Path, frame: str) -> None:
    """What the contact does to a sensor that carries the clamp off its centre, turned and tared, is
    undone by reading the log.
    """
    scan = wire_on_a_ball()
    lane, mount = 1, Rotation.from_quat([0.1, 0.2, 0.3, 0.9])
    clamp, orientation = scan.trail.position[lane], Rotation.from_quat(scan.trail.orientation[lane])
    pose = orientation * mount.inv()
    position = clamp - pose.apply([0.004, -0.003, 0.025])
    force = np.where(scan.in_contact[lane][:, None], -scan.reactions.force[lane], 0)
    arm = np.where(
        scan.in_contact[lane][:, None],
        scan.point[lane] - position - pose.apply([0.001, 0.002, 0.005]),
        0,
    )
    wrench = np.stack([force, np.cross(arm, force)])
    if frame == "sensor":
        wrench = np.stack([pose.inv().apply(part) for part in wrench])
    wrench += np.array([[0.31, -0.12, 1.93], [2e-3, -4e-3, 7e-4]])[:, None]
    table = np.column_stack([0.02 + 0.02 * np.arange(61), position, pose.as_quat(), *wrench])
    (tmp_path / "setup.toml").write_text(SETUP.format(frame=frame))
    header = "time,px,py,pz,qx,qy,qz,qw,fx,fy,fz,tx,ty,tz"
    np.savetxt(tmp_path / "log.csv", table, fmt="%.17g", delimiter=",", header=header, comments="")
    setup = vb.load_setup(tmp_path / "setup.toml")
    found = vb.reconstruct(setup.rod, vb.read_recording(tmp_path / "log.csv", setup))
    rows = scan.in_contact[lane]
    strong = rows & (np.linalg.norm(force, axis=1) > 1e-3)
    np.testing.assert_allclose(found.point[strong], scan.point[lane][strong], rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.normal[strong], scan.normal[lane][strong], rtol=0, atol=1e-10)
