"""Contact with the skin of a rod that gets thinner: distances between lines and a ball."""

from pathlib import Path

import numpy as np
import pytest

import vibrissa as vb
from vibrissa.io.sweeps import read_sweep

CENTER, RADIUS = np.array([0.3, 0.0, 1.05]), 0.25
ROD = vb.Rod.tapered(length=1.0, base_radius=0.04, tip_radius=0.01, youngs_modulus=5e5)


@pytest.mark.parametrize(
    "rod",
    [
        pytest.param(ROD, marks=pytest.mark.slow),
        ROD.curved(vb.RestShape.arc(radius=3.0, roll=0.4)),
    ],
)
def test_the_skin_touches_once_and_nowhere_else_enters(rod: vb.Rod, tmp_path: Path) -> None:
    """At the contact the centre line is one local radius away from the ball, nowhere nearer; the
    point lies on the ball, and the skin is tangent to it unless the tip touches.
    """
    trail = vb.Trail.line(start=(1.0, 0.06, 0), stop=(-0.4, 0.06, 0), count=57)
    ball = vb.surfaces.Sphere(center=CENTER, radius=RADIUS)
    scan = vb.scan(rod, ball, trail, finite_radius=True)
    assert np.all(scan.status == vb.Status.OK) and scan.in_contact.sum() > 15
    assert {1, 2} <= set(scan.kind[scan.in_contact].tolist())
    for i in np.flatnonzero(scan.in_contact):
        line = scan.elastic_line(int(i), 2001)
        gap = np.linalg.norm(line - CENTER, axis=1) - RADIUS - 0.04 + 0.03 * np.linspace(0, 1, 2001)
        assert gap.min() > -1e-7
        place = scan.arc_length[i] * 2000
        assert abs(np.interp(place, np.arange(2001), gap)) < 1e-6
        assert abs(np.linalg.norm(scan.point[i] - CENTER) - RADIUS) < 1e-9
        lean = scan.contact_tangent[i] @ scan.normal[i]
        tangential = scan.kind[i] == vb.ContactKind.TANGENTIAL
        assert abs(lean + 0.03) < 1e-8 if tangential else lean < -0.03 + 1e-8
    found = vb.reconstruct(rod, scan.reactions, friction=0.1)
    error = np.linalg.norm(found.point - scan.centre, axis=1)[scan.in_contact]
    assert error.max() < 1e-9
    # A file draws the same rods.
    vb.io.write_dataset(tmp_path / "scan.nc", scan.to_dataset())
    lines = scan.elastic_lines(scan.in_contact, 20)
    stored = read_sweep(tmp_path / "scan.nc").elastic_lines(scan.in_contact, 20)
    np.testing.assert_allclose(stored, lines, rtol=0, atol=1e-9)
