"""Where a tapered rod that is curved at rest gives way sideways: bent in a plane of symmetry, it does so
where the derivatives of shooting's conditions, by differences, are first singular.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from shooting import Level, paraboloid, quadric
from test_random_rods import Whisker, equilibrium, unbalanced

import vibrissa as vb

WHISKER = Whisker(0.5, (0.3, 0.2), 0.0)
ROD, LENGTH = WHISKER.rod, WHISKER.rod.length
POSE = Rotation.identity()
BESIDE, STEP = 1e-4, 1e-6
A, B, HEIGHT = 0.5, 1.0, 0.4
CENTER, SEMI_AXES = np.array([0.0, 0.0, 0.9]), np.array([0.6, 0.4, 0.4])
SURFACES = {
    "bowl": (
        vb.surfaces.EllipticParaboloid(a=A / LENGTH, b=B / LENGTH, h=HEIGHT * LENGTH),
        paraboloid(A, B, HEIGHT),
    ),
    "ellipsoid": (
        vb.surfaces.Ellipsoid(center=CENTER * LENGTH, semi_axes=SEMI_AXES * LENGTH),
        quadric(CENTER, SEMI_AXES),
    ),
}


def determinant(above: Level, scan: vb.Scan, row: int) -> float:
    """Of the conditions' derivatives by the unknowns, at shooting's equilibrium next to a row."""
    clamp, tip = scan.trail.position[0, row] / LENGTH, scan.kind[0, row] == vb.ContactKind.TIP
    level = Level(lambda p: above.value(p + clamp), lambda p: above.gradient(p + clamp))
    force = np.linalg.norm(scan.reactions.force[0, row]) / ROD.force_scale
    moment, point = -scan.reactions.moment[0, row] / ROD.moment_scale, scan.point[0, row] / LENGTH
    guess = np.array([*moment, force, *(point - clamp), scan.arc_length[0, row] / LENGTH])
    u, _ = equilibrium(WHISKER, level, POSE, guess, tip=tip)
    np.testing.assert_allclose(u, guess, rtol=0, atol=1e-7)
    ends = [
        unbalanced(WHISKER, level, POSE, u + step, tip=tip)
        for unit in STEP * np.eye(8)
        for step in (unit, -unit)
    ]
    return float(np.linalg.det((np.array(ends[::2]) - ends[1::2]) / (2 * STEP)))


@pytest.mark.parametrize("name", ["bowl", pytest.param("ellipsoid", marks=pytest.mark.slow)])
def test_a_tapered_curved_rod_gives_way_where_shooting_is_singular(name: str) -> None:
    surface, above = SURFACES[name]
    way = np.arange(1.2, -0.3, -0.02)
    position = np.stack([np.column_stack([way, 0 * way + y, 0 * way]) for y in (0, BESIDE)])
    scan = vb.scan(ROD, surface, vb.Trail(position * LENGTH))
    (event,) = (event for event in scan.events if event.kind == vb.EventKind.LATERAL_INSTABILITY)
    assert event.trail == 0
    place = event.clamp[0] / LENGTH
    after = int(np.argmax(way < place))
    rows = np.arange(after - 3, after + 3)
    assert np.all(
        scan.status[0, rows] == np.repeat([vb.Status.OK, vb.Status.LATERALLY_UNSTABLE], 3)
    )
    assert set(scan.kind[0, rows]) == {vb.ContactKind.TANGENTIAL}
    values = [determinant(above, scan, row) for row in rows]
    assert np.all(np.diff(np.sign(values)) == [0, 0, -2, 0, 0])
    zeros = np.polynomial.Polynomial.fit(way[rows], values, 5).roots()
    assert np.min(abs(zeros - place)) < 1e-8
    # A rod a little beside the plane of symmetry leaves it there.
    aside = scan.point[1, :, 1] / LENGTH
    assert np.all(np.diff(aside[after - 5 : after + 5]) > 0)
    assert aside[after - 3] < 20 * BESIDE and aside[after + 3] > 1000 * BESIDE


def test_it_gives_way_at_one_place_with_any_steps() -> None:
    """Where steps are short, slopes of the conditions are foretold at two positions of three."""
    surface, _ = SURFACES["bowl"]
    way = 1.2 - 0.005 * np.arange(241)
    position = np.stack([np.column_stack([way, 0 * way + y, 0 * way]) for y in (0, BESIDE)])
    coarse, fine = (vb.scan(ROD, surface, vb.Trail(position[:, ::n] * LENGTH)) for n in (8, 1))
    np.testing.assert_array_equal(coarse.status, fine.status[:, ::8])
    np.testing.assert_array_equal(coarse.kind, fine.kind[:, ::8])
    for few, many, unit in (
        (coarse.point, fine.point, LENGTH),
        (coarse.reactions.force, fine.reactions.force, ROD.force_scale),
    ):
        np.testing.assert_allclose(few / unit, many[:, ::8] / unit, rtol=0, atol=1e-10)
    events = [[(event.kind, event.trail) for event in scan.events] for scan in (coarse, fine)]
    assert events[0] == events[1]
    places = [[event.parameter for event in scan.events] for scan in (coarse, fine)]
    np.testing.assert_allclose(*places, rtol=0, atol=1e-9)
