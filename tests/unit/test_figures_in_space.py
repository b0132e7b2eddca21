"""Sweeps drawn in space: what the axes hold against the numbers they were drawn from."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib import pyplot as plt
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from PIL import Image

import vibrissa as vb
from vibrissa import plot
from vibrissa.drawing import drawn_rods
from vibrissa.surfaces.outline import box_of, outline

BOWL = vb.surfaces.EllipticParaboloid(a=0.5, b=1.0, h=0.4)
BALL = vb.surfaces.Sphere(center=(0, 0, 1.15), radius=0.6)
LOW, HIGH = np.full(3, -2.0), np.full(3, 2.5)


@pytest.fixture(autouse=True)
def _without_a_screen() -> Iterator[None]:
    mpl.use("Agg")
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def scan() -> vb.Scan:
    """Two trails under the paper's bowl."""
    ends = {"start": (1.2, 0.2, 0), "stop": (-1.2, 0.2, 0), "count": 61}
    return vb.scan(vb.Rod.unit(), BOWL, vb.Trail.raster(**ends, step=(0, 0.2, 0), trails=2))


def named(axes: Axes3D) -> list[str]:
    legend = axes.get_legend()
    return [] if legend is None else [text.get_text() for text in legend.get_texts()]


def strokes(axes: Axes3D) -> np.ndarray:
    """Ends (n, 2, 3) of all drawn strokes."""
    found = [one for one in axes.collections if isinstance(one, Line3DCollection)]
    return np.concatenate([np.array(one._segments3d) for one in found])


def dots(axes: Axes3D, marker: str) -> int:
    return sum(len(line.get_data_3d()[0]) for line in axes.lines if line.get_marker() == marker)


@pytest.mark.parametrize(
    "solid",
    [
        BALL,
        vb.surfaces.Box(center=(0.1, 0, 0.4), half_extents=(0.5, 0.3, 0.2)).placed(
            (0.1, 0.2, 0.3, 1.0), (0.1, 0.2, 0.3)
        ),
        vb.surfaces.Cylinder(center=(0, 0, 0.5), axis=(0, 1, 1), radius=0.4, length=1.0),
        vb.surfaces.Cone(center=(0, 0, 0.5), axis=(1, 0, 1), radius=0.4, height=1.0),
        vb.surfaces.Torus(center=(0, 0, 1), axis=(0, 1, 1), major_radius=0.6, minor_radius=0.2),
    ],
    ids=lambda solid: type(solid).__name__,
)
def test_triangles_lie_on_the_object_and_close_around_it(solid: vb.surfaces.Surface) -> None:
    """Each edge belongs to two triangles; all corners are at distance zero, to the square of the
    grid's cells.
    """
    triangles = outline(solid, LOW, HIGH)
    corners = triangles.reshape(-1, 3)
    assert abs(solid.distances(corners)).max() < 5e-3
    box = box_of(solid, corners[:50], 2.0, 0.1)
    assert box is not None
    low, high = box
    assert np.all(low <= corners.min(axis=0)) and np.all(high >= corners.max(axis=0))
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    # The vector areas of a closed surface sum to zero; the grid's slivers may face either way.
    outwards = (
        across * np.sign(np.sum(across * solid.normal(triangles.mean(axis=1)), axis=1))[:, None]
    )
    assert abs(outwards.sum(axis=0)).max() < 0.01 * np.linalg.norm(across, axis=1).sum()


def test_a_bowl_is_drawn_up_to_the_box_and_an_endless_plane_to_its_sides() -> None:
    corners = outline(BOWL, (-1, -1, 0), (1, 1, 0.9)).reshape(-1, 3)
    assert abs(BOWL.levels(corners)).max() < 1e-12
    assert corners[:, 2].min() == 0.4 and corners[:, 2].max() == pytest.approx(0.9)
    assert np.ptp(corners[:, 0]) == pytest.approx(2.0) and np.ptp(corners[:, 1]) == pytest.approx(
        2 * np.sqrt(0.5), rel=1e-3
    )
    plane = vb.surfaces.Plane(point=(0, 0, 0.5), normal=(1, 0, -1))
    box = box_of(plane, np.array([[0.0, 0, 0.5], [0.2, 0, 0.7]]), 1.0, beyond=0.125)
    assert box is not None
    corners = outline(plane, *box).reshape(-1, 3)
    np.testing.assert_allclose(corners.min(axis=0)[1:], [-0.125, 0.375], atol=1e-6)
    np.testing.assert_allclose(corners[:, 2] - corners[:, 0], 0.5, atol=1e-6)


@pytest.mark.parametrize("radius", [1e-4, 0.03, 0.45])
def test_a_ball_of_any_size_is_found_and_shown_whole(radius: float) -> None:
    """Within a rod length of what was touched of it, beside a larger one, from a place off it."""
    ball = vb.surfaces.Sphere(center=(0.2, 0.1, 0.9), radius=radius)
    touched = np.array([[0.2, 0.1, 0.9 - radius]])
    for solid in (ball, vb.surfaces.Union([ball, vb.surfaces.Sphere((0.4, -0.9, 0.9), 0.3)])):
        box = box_of(solid, touched, 1.0, beyond=0.125)
        assert box is not None
        assert np.all(box[0] < ball.center - radius) and np.all(box[1] > ball.center + radius)
    assert box_of(ball, np.array([[5.0, 0, 0]]), 1.0, beyond=0.125) is None


def test_a_scan_is_drawn_with_its_object_rods_contacts_and_events(scan: vb.Scan) -> None:
    axes = plot.scene(scan, rods=6)
    counts = {int(kind): int(np.sum(scan.kind == kind)) for kind in vb.ContactKind}
    assert f"tip contact ({counts[1]})" in named(axes)
    assert f"tangential contact ({counts[2]})" in named(axes)
    assert f"first contact ({2})" in named(axes)
    assert any(isinstance(one, Poly3DCollection) for one in axes.collections)
    drawn = strokes(axes)
    for at in ((0, 20), (1, 30)):
        ends = np.array([scan.trail.position[at], scan.elastic_line(at, 90)[-1]])
        gaps = np.linalg.norm(drawn.reshape(-1, 1, 3) - ends, axis=-1).min(axis=0)
        np.testing.assert_allclose(gaps, 0, atol=1e-12)
    assert axes.get_xlabel() == "$x/L$"


def test_some_trails_in_given_axes_without_rods_and_events(scan: vb.Scan) -> None:
    given = plt.figure().add_subplot(projection="3d", computed_zorder=False)
    axes = plot.scene(scan, trails=(1,), rods=0, events=False, axes=given)
    assert axes is given
    names = [f"tip contact ({np.sum(scan.kind[1] == 1)})"]
    if np.any(scan.kind[1] == 2):
        names.append(f"tangential contact ({np.sum(scan.kind[1] == 2)})")
    assert named(axes) == names
    np.testing.assert_array_equal(
        [line.get_data_3d()[1] for line in axes.lines if line.get_marker() == "None"],
        [scan.trail.position[1, :, 1]],
    )


def test_what_is_behind_the_object_is_hidden() -> None:
    """Seen from in front, a ball hides the contacts on its far side."""
    sides = np.array([[0.0, -0.6, 1.15], [0.0, 0.6, 1.15], [0.6, 0.0, 1.15]])
    contacts = vb.Contacts(sides, (sides - [0, 0, 1.15]) / 0.6)
    looked = {"rod": vb.Rod.unit(), "surface": BALL}
    assert dots(plot.scene(contacts, **looked, view=(0, -90)), ".") == 2
    assert dots(plot.scene(contacts, rod=vb.Rod.unit(), view=(0, -90)), ".") == 3


def test_uncertain_contacts_are_faint_counted_and_do_not_decide_the_frame() -> None:
    rod = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
    points = np.array([[0.0, 0, 0.05], [0.01, 0, 0.05], [0.7, 0.3, -0.4]])
    covariance = np.diag([1e-4, 2e-4, 3e-4]) ** 2 * np.array([1, 1, 1e6])[:, None, None]
    axes = plot.scene(vb.Contacts(points, np.tile([0, 0, -1.0], (3, 1)), covariance), rod=rod)
    assert {"95 % ellipsoids (2)", "wider than L/10, cut (1)"} <= set(named(axes))
    assert axes.get_xlim()[1] < 20 and axes.get_xlabel() == "$x$ [mm]"
    lengths = np.linalg.norm(np.diff(strokes(axes), axis=1)[:, 0], axis=1)
    # χ² with three degrees of freedom: 95 % lie within 2.7955 standard deviations.
    np.testing.assert_allclose(np.sort(lengths)[:2], 2 * 2.7955 * 0.1, rtol=1e-4)
    assert lengths.max() <= 2 * 0.2 * 50 * (1 + 1e-9)


def test_friction_shows_the_force_beside_the_normal(scan: vb.Scan) -> None:
    assert "force on the rod" not in named(plot.scene(scan, directions=True))
    rubbing = vb.Contacts(
        scan.point[0], scan.normal[0], force_direction=np.roll(scan.normal[0], 1, axis=-1)
    )
    axes = plot.scene(rubbing, rod=scan.rod, directions=True)
    assert {"force on the rod", "normal"} <= set(named(axes))
    assert len(strokes(axes)) >= 2 * 20


def test_a_recording_shows_its_forces_on_the_unbent_rod(scan: vb.Scan) -> None:
    axes = plot.scene(scan.reactions, rod=scan.rod, rods=6)
    largest = np.linalg.norm(scan.reactions.force, axis=-1).max()
    assert named(axes) == ["free rod", f"force on the clamp, up to {largest:.3g} EI/L²"]


def test_an_object_alone_is_drawn() -> None:
    axes = plot.scene(BALL, rod=vb.Rod.unit())
    np.testing.assert_allclose(axes.get_zlim(), [0.55, 1.75], atol=0.02)


def test_nothing_to_draw_is_an_error_that_says_why(scan: vb.Scan) -> None:
    free = vb.reconstruct(scan.rod, scan.reactions[0][:4])
    with pytest.raises(ValueError, match="no contact in 4 "):
        plot.scene(free)
    with pytest.raises(ValueError, match=r"no contact in 4 rows \(4 OK\)"):
        plot.scene(scan.contacts[0][:4], rod=scan.rod)
    lost = vb.Reactions(scan.trail, scan.reactions.force * np.nan, scan.reactions.moment)
    with pytest.raises(ValueError, match="none of 122 forces is known"):
        plot.scene(lost, rod=scan.rod)
    with pytest.raises(ValueError, match="no object is found within box"):
        plot.scene(BALL, rod=scan.rod, box=((2, 2, 2), (3, 3, 3)))
    with pytest.raises(ValueError, match="rod = None: Sphere does not say its unit of length"):
        plot.scene(BALL)


def test_what_cannot_be_meant_is_refused(scan: vb.Scan, tmp_path: Path) -> None:
    for wrong, message in (
        ({"rods": -1}, "rods = -1; allowed is 0 or more"),
        ({"trails": [2]}, r"trails = \[2\]; allowed are some of 0 to 1"),
        ({"trails": []}, "allowed are some of 0 to 1"),
        ({"box": ((1, 1, 1), (0, 2, 2))}, "allowed are three least coordinates"),
    ):
        with pytest.raises(ValueError, match=message):
            plot.scene(scan, **wrong)
    with pytest.raises(TypeError, match="what"):
        plot.scene("scan.npz")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="what"):
        plot.animation(scan.reactions, tmp_path / "a.gif")  # type: ignore[arg-type]


def test_a_sweep_that_misses_the_object_shows_both_or_the_rods_alone() -> None:
    for far in (0.8, 8.0):
        path = vb.Trail.line(start=(far + 0.4, 0, 0.5), stop=(far, 0, 0.5), count=9)
        axes = plot.scene(vb.scan(vb.Rod.unit(), BALL, path))
        assert named(axes) == ["free rod"]
        bodies = [one for one in axes.collections if isinstance(one, Poly3DCollection)]
        assert len(bodies) == (far < 1)


def test_rows_without_readings_are_counted(scan: vb.Scan) -> None:
    force = scan.reactions.force.copy()
    bad = scan.kind[0] == vb.ContactKind.TIP
    force[0, bad] = np.nan
    lacking = vb.Reactions(scan.trail, force, scan.reactions.moment)
    found = vb.reconstruct(scan.rod, lacking)
    assert f"not drawn: bad data ({bad.sum()})" in named(plot.scene(found))
    drawn = strokes(plot.scene(lacking, rod=scan.rod, rods=4))
    assert np.isfinite(drawn).all()


def test_each_drawn_rod_begins_at_its_clamp(scan: vb.Scan) -> None:
    """With the wrong sign of the readings most lines do not: they are left out."""
    turned = vb.Reactions(scan.trail, -scan.reactions.force, -scan.reactions.moment)
    found = vb.reconstruct(scan.rod, turned)
    rows = found.in_contact
    drawn = list(drawn_rods(found, rows, 90))
    for at, rod in drawn:
        np.testing.assert_allclose(rod.line[0], scan.trail.position[at], atol=0.01)
    assert len(drawn) < rows.sum()
    assert len(list(drawn_rods(scan, scan.in_contact, 90))) == scan.in_contact.sum()


def test_one_contact_is_framed_and_no_number_lies_on_another(scan: vb.Scan) -> None:
    one = int(np.flatnonzero(scan.in_contact[0])[0])
    for axes in (plot.scene(scan.contacts[0][[one]], rod=scan.rod), plot.scene(scan)):
        figure = axes.get_figure(root=True)
        assert figure is not None
        figure.canvas.draw()
        assert np.ptp(axes.get_xlim()) > 0.05
        every = axes.xaxis, axes.yaxis, axes.zaxis
        boxes = [tick.label1.get_window_extent() for a in every for tick in a.get_major_ticks()]
        boxes += [axis.label.get_window_extent() for axis in every]
        assert all(box.count_overlaps(boxes) == 1 for box in boxes)


def test_the_eye_is_where_contacts_face_it() -> None:
    for side in ((1.0, 0, 0), (0, 1.0, 0), (-1.0, 0, 0), (0, -1.0, 0), (0, 0, -1.0)):
        normal = np.array([side])
        touched = vb.Contacts(BALL.center + 0.6 * normal, normal)
        assert dots(plot.scene(touched, rod=vb.Rod.unit(), surface=BALL), ".") == 1


def test_a_film_shows_the_rod_at_one_position_after_the_other(
    scan: vb.Scan, tmp_path: Path
) -> None:
    """Each frame differs from the one before in the columns where the rod is."""
    for suffix in ("gif", "webp"):
        path = plot.animation(
            scan, str(tmp_path / f"new/s.{suffix}"), trails=(1,), seconds=0.5, view=(15, -55)
        )
        with Image.open(path) as film:
            assert film.n_frames == 10
            frames = []
            for k in range(film.n_frames):
                film.seek(k)
                frames.append(np.array(film.convert("L"), dtype=int))
    moved = [np.flatnonzero((abs(b - a) > 40).any(axis=0)) for a, b in pairwise(frames)]
    assert all(len(columns) for columns in moved)
    # The clamp goes from right to left.
    assert np.median(moved[0]) > np.median(moved[-1])


def test_a_film_of_another_kind_is_refused(scan: vb.Scan, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"allowed suffixes are .gif, .webp, .mp4"):
        plot.animation(scan, tmp_path / "sweep.avi")
    with pytest.raises(ValueError, match="seconds = 0"):
        plot.animation(scan, tmp_path / "sweep.gif", seconds=0)
