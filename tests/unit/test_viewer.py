"""What the viewer shows, as numbers; the browser itself is in test_viewer_browser.py."""

import io
import sys
import time
from base64 import b64decode
from pathlib import Path
from time import monotonic

import numpy as np
import pytest
import trimesh
import zstandard
from command_line import vibrissa
from matplotlib import pyplot as plt
from matplotlib.colors import LogNorm
from touched import rings

import vibrissa as vb
from vibrissa.drawing import BEHIND, FREE, KIND_COLOURS, half_axes
from vibrissa.io.recordings.read import read_cleaned
from vibrissa.io.sweeps import read_sweep
from vibrissa.viewer.axes import tick_step, ticked_box
from vibrissa.viewer.colours import Painter, modes_of, rgb, surface_legend
from vibrissa.viewer.content import Content, Instant, Rows, joined
from vibrissa.viewer.files import of_file
from vibrissa.viewer.growing import GrowingSurface
from vibrissa.viewer.html import legend_html, numbers_html
from vibrissa.viewer.page import Viewer, serve, stop
from vibrissa.viewer.stream import ViewerSink
from vibrissa.viewer.sweeps import fitted_of, of_contacts, of_setup, of_sweep

EXAMPLES = Path(__file__).parents[2] / "examples"
LOG = EXAMPLES / "recordings/sphere_60mm/trail.csv"
SETUP = EXAMPLES / "recordings/sphere_60mm/setup.toml"
ROD = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
ELLIPSOID = vb.surfaces.Ellipsoid(center=(0, 0, 0), semi_axes=(0.026, 0.021, 0.017))
SPHERE = vb.surfaces.Sphere(center=(0, 0, 0.0575), radius=0.03)
TRAILS = vb.Trail.raster(
    start=(0.04, 0.005, 0), stop=(-0.04, 0.005, 0), count=21, step=(0, 0.004, 0), trails=2
)


@pytest.fixture(scope="module")
def scan() -> vb.Scan:
    return vb.scan(ROD, SPHERE, TRAILS)


@pytest.fixture(scope="module")
def setup() -> vb.Setup:
    return vb.load_setup(SETUP)


@pytest.fixture(scope="module")
def found(setup: vb.Setup) -> vb.Reconstruction:
    return vb.reconstruct(setup.rod, vb.read_recording(LOG, setup))


def pieces(instant: Instant) -> np.ndarray:
    return np.concatenate([*instant.rods.values()])


def test_rods_are_those_of_the_scan_in_millimetres(scan: vb.Scan) -> None:
    content = of_sweep(scan, SPHERE)
    assert (content.unit, content.force_unit, content.size) == ("mm", "N", 50.0)
    assert len(content.instants) == 21
    for number, instant in enumerate(content.instants):
        lengths = np.linalg.norm(np.diff(pieces(instant), axis=1), axis=-1)
        assert lengths.sum() == pytest.approx(2 * 50, rel=1e-3)
        for trail in range(2):
            for end in scan.elastic_line((trail, number), 2):
                apart = np.linalg.norm(pieces(instant) - 1e3 * end, axis=-1)
                assert apart.min() < 1e-9
    assert content.instants[0].rods.keys() == {FREE}
    kinds = {KIND_COLOURS[vb.ContactKind(k)] for k in scan.kind[:, 10]}
    assert content.instants[10].rods.keys() <= kinds | {BEHIND}


def test_the_object_is_drawn_where_it_is(scan: vb.Scan) -> None:
    corners = of_sweep(scan, SPHERE).triangles.reshape(-1, 3)
    assert len(corners) > 10_000
    radius = np.linalg.norm(corners - [0, 0, 57.5], axis=1)
    assert np.abs(radius - 30).max() < 0.1
    np.testing.assert_allclose(corners.max(axis=0), [30, 30, 87.5], atol=0.1)


def test_contacts_come_with_the_rods_that_make_them(scan: vb.Scan) -> None:
    content = of_sweep(scan, None)
    assert len(content.contacts) == scan.in_contact.sum()
    for number, instant in enumerate(content.instants):
        touching = scan.in_contact[:, number]
        np.testing.assert_array_equal(instant.contacts.point, 1e3 * scan.point[touching, number])
        force = np.linalg.norm(scan.reactions.force[touching, number], axis=-1)
        np.testing.assert_array_equal(instant.contacts.force, force)


def test_long_recordings_are_thinned_in_rods_but_not_in_contacts(found: vb.Reconstruction) -> None:
    content = of_sweep(found, None)
    assert len(content.instants) == 240 < found.kind.size == 901
    assert len(content.contacts) == found.in_contact.sum()
    assert (content.instants[0].label, content.instants[-1].label) == ("0.00 s", "9.00 s")
    trace = np.trace(found.covariance[found.in_contact], axis1=1, axis2=2)
    np.testing.assert_allclose(content.contacts.deviation, 1e3 * np.sqrt(trace))


def test_files_show_what_the_results_show(
    scan: vb.Scan, found: vb.Reconstruction, tmp_path: Path
) -> None:
    for name, result in (("scan.nc", scan), ("found.nc", found)):
        vb.io.write_dataset(tmp_path / name, result.to_dataset())
        stored, own = of_sweep(read_sweep(tmp_path / name), None), of_sweep(result, None)
        assert stored.unit == own.unit
        for one, other in zip(stored.instants, own.instants, strict=True):
            assert one.label == other.label
            np.testing.assert_allclose(pieces(one), pieces(other), atol=1e-9)
            np.testing.assert_array_equal(one.contacts.point, other.contacts.point)
            np.testing.assert_array_equal(one.contacts.force, other.contacts.force)


def test_a_rod_of_finite_radius_is_drawn_beside_the_object(tmp_path: Path) -> None:
    scan = vb.scan(ROD, SPHERE, TRAILS[0], finite_radius=True)
    vb.io.write_dataset(tmp_path / "scan.nc", scan.to_dataset())
    row = int(np.flatnonzero(scan.in_contact)[3])
    stored = read_sweep(tmp_path / "scan.nc")
    np.testing.assert_allclose(stored.elastic_lines(row)[0], scan.elastic_line(row), atol=1e-12)


def test_contacts_alone_have_no_unit_unless_a_rod_gives_it(
    found: vb.Reconstruction, tmp_path: Path
) -> None:
    contacts = vb.read_contacts(vb.write_contacts(tmp_path / "contacts.csv", found))
    alone, with_rod = of_contacts(contacts, None, None), of_contacts(contacts, None, found.rod)
    assert (alone.unit, with_rod.unit) == ("", "mm")
    np.testing.assert_allclose(1e3 * alone.contacts.point, with_rod.contacts.point)
    # They come in the order of their rows.
    np.testing.assert_array_equal(
        with_rod.contacts.point, 1e3 * contacts.point[contacts.kind != vb.ContactKind.NONE]
    )


def test_sweeps_of_several_results_run_side_by_side(
    scan: vb.Scan, found: vb.Reconstruction
) -> None:
    one, other = of_sweep(scan, SPHERE), of_sweep(found, None)
    both = joined([one, other])
    assert len(both.instants) == 240
    assert len(both.contacts) == len(one.contacts) + len(other.contacts)
    assert len(both.trails) == 3
    for number, source in ((0, 0), (239, -1)):
        drawn = pieces(both.instants[number])
        own = [*one.instants[source].rods.values(), *other.instants[source].rods.values()]
        assert len(drawn) == sum(map(len, own))
    assert both.instants[-1].label == "100 %"


def test_lengths_in_two_units_are_refused(scan: vb.Scan) -> None:
    unit = of_contacts(scan.contacts, None, vb.Rod.unit())
    with pytest.raises(ValueError, match="lengths in L and in mm on one page"):
        joined([of_sweep(scan, None), unit])


def test_contacts_of_files_are_in_millimetres_beside_what_is(
    scan: vb.Scan, found: vb.Reconstruction
) -> None:
    alone = of_contacts(found.contacts, None, None)
    both = joined([of_sweep(scan, None), alone])
    assert both.unit == "mm"
    shown = both.contacts.point
    for point in 1e3 * alone.contacts.point[::50]:
        assert np.abs(shown - point).max(axis=1).min() < 1e-9
    covariance = 1e6 * alone.contacts.covariance[-1]
    np.testing.assert_allclose(both.contacts.covariance[-1], covariance)


@pytest.fixture(scope="module")
def shape() -> vb.Shape:
    """Of two girths of an ellipsoid, with one contact 2 mm off."""
    contacts = rings(ELLIPSOID, np.random.default_rng(0), sweeps=2)
    contacts.point[30] *= 1.1
    return vb.fit_shape(contacts)


def test_a_shape_is_shown_in_millimetres_with_its_contacts(
    shape: vb.Shape, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = shape.mesh(shape.extent / 20)
    monkeypatch.setattr(vb.Shape, "mesh", lambda _: mesh)
    page = tmp_path / "shape.html"
    with vb.view(shape, port=8180) as viewer:
        (fitted,) = viewer.content.fitted
        contacts = viewer.content.contacts
        handle = viewer.scene._scene.get_handle_by_name("/surface/0")
        viewer.save(page)
    assert viewer.content.unit == "mm"
    np.testing.assert_array_equal(fitted.vertices, 1e3 * mesh.vertices)
    away = np.abs(ELLIPSOID.distances(fitted.vertices / 1e3))
    assert away.max() < 0.4e-3
    assert np.mean(1e3 * away < 1.96 * fitted.deviation) > 0.9
    np.testing.assert_array_equal(fitted.outlier, 1e3 * shape.contacts[0].point[[30]])
    assert len(contacts) == 80
    text = page.read_text(encoding="utf-8")
    # What the browser draws is what the page holds: a length, then data that zstandard packed.
    packed = b64decode(text.split('__VISER_EMBED_DATA__="')[1].split('"')[0])
    assert handle.glb_data in zstandard.decompress(packed[8:], int.from_bytes(packed[:8], "little"))
    drawn = trimesh.load(io.BytesIO(handle.glb_data), "glb", force="mesh")
    np.testing.assert_allclose(drawn.vertices, fitted.vertices, atol=1e-5)
    for said in ("Surface: standard deviation [mm]", "contact that it contradicts (1)"):
        assert said in text


def test_surfaces_are_coloured_as_in_figures(shape: vb.Shape) -> None:
    mesh = shape.mesh(shape.extent / 10)
    fitted = fitted_of(mesh, np.zeros((0, 3)), 1e3)
    scale = surface_legend([fitted], "mm").scale
    assert scale is not None
    low, high = np.quantile(1e3 * mesh.deviation, (0.02, 0.98))
    norm = LogNorm(low, high, clip=True)
    some = fitted.deviation[::50]
    own = scale.colours(scale.place(some)) / 255
    # Nine colours stand for viridis.
    np.testing.assert_allclose(own, plt.get_cmap("viridis_r")(norm(some))[:, :3], atol=0.03)
    assert scale.middle == pytest.approx(np.sqrt(low * high))


def test_a_shape_from_its_file_beside_contacts(
    shape: vb.Shape, found: vb.Reconstruction, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, page = tmp_path / "shape.ply", tmp_path / "page.html"
    mesh = shape.mesh(shape.extent / 20)
    vb.io.write_shape(file, mesh, fitted=shape)
    content = of_file(file, None, None)
    (fitted,) = content.fitted
    for own, stored in zip(
        fitted_of(mesh, shape.contacts[0].point[[30]], 1e3), fitted, strict=True
    ):
        np.testing.assert_array_equal(stored, own)
    assert len(content.contacts) == 80
    more = vb.write_contacts(tmp_path / "contacts.vtp", found)
    run = vibrissa(capsys, "view", file, more, "--save", page)
    assert run.out == f"646 contacts, 240 instants → {page}\n"
    bare = vb.io.write_shape(tmp_path / "bare.ply", mesh)
    run = vibrissa(capsys, "view", bare, "--save", page)
    assert (run.status, run.out) == (2, "")
    assert "bare.ply: a mesh without the contacts it was fitted to; allowed is" in run.err


def test_nothing_to_show_says_why(found: vb.Reconstruction) -> None:
    empty = vb.Contacts(np.full((3, 3), np.nan), np.full((3, 3), np.nan))
    with pytest.raises(ValueError, match="nothing to show: none of"):
        vb.view(empty)
    with pytest.raises(ValueError, match="nothing to show; allowed is at least one"):
        vb.view()


def test_a_setup_shows_its_rod_at_its_sensor(setup: vb.Setup) -> None:
    bare = vb.Setup(setup.rod, setup.sensor)
    content = of_setup(bare)
    sensor, clamp = content.poses
    np.testing.assert_allclose(sensor.position, 0)
    np.testing.assert_allclose(clamp.position, 1e3 * setup.sensor.clamp_position)
    line = pieces(content.instants[0])
    np.testing.assert_allclose(line[0, 0], clamp.position)
    assert np.linalg.norm(line[0, 1] - line[0, 0]) == pytest.approx(1e3 * setup.rod.length)


def test_a_setup_with_an_object_but_no_pose_shows_the_object_only(setup: vb.Setup) -> None:
    assert setup.surface is not None
    assert setup.pose is None
    content = of_setup(setup)
    assert (content.poses, content.instants) == ((), ())
    assert np.abs(setup.surface.levels(content.triangles.mean(axis=1) / 1e3)).max() < 1e-3
    np.testing.assert_allclose(np.ptp(content.triangles.reshape(-1, 3), axis=0), 60, atol=0.2)
    assert "does not say where the sensor is" in content.notes[0]


def test_ellipsoids_hold_a_contact_with_95_percent() -> None:
    rng, root = np.random.default_rng(1), np.array([[1.0, 0, 0], [0.5, 0.3, 0], [0.1, 0.2, 0.02]])
    axes = half_axes((root @ root.T)[None])[0]
    points = rng.standard_normal((200_000, 3)) @ root.T
    inside = np.sum((np.linalg.solve(axes, points.T)) ** 2, axis=0) < 1
    assert inside.mean() == pytest.approx(0.95, abs=0.002)


def rows(**fields: list[float]) -> Rows:
    count = len(next(iter(fields.values())))
    nothing = Rows(
        np.zeros((count, 3)),
        np.tile([0.0, 0, 1], (count, 1)),
        np.full(count, 2),
        np.zeros(count, int),
        *np.full((3, count), np.nan),
        np.full((count, 3, 3), np.nan),
    )
    return Rows(**vars(nothing) | {name: np.array(part) for name, part in fields.items()})


def content_of(contacts: Rows) -> Content:
    instants = (Instant("now", {}, contacts),)
    return Content("mm", "N", 50.0, np.zeros((0, 3, 3)), instants=instants)


def test_colours_say_kind_status_force_and_uncertainty() -> None:
    spread = np.array([1.0, 2.0, 3.0])[:, None, None] * np.eye(3)
    contacts = rows(kind=[1, 2, 2], status=[0, 0, 13], force=[0.1, 0.2, np.nan], covariance=spread)
    content = content_of(contacts)
    assert modes_of(content) == ("kind", "status", "force", "uncertainty")
    assert modes_of(content_of(rows(kind=[1]))) == ("kind", "status")

    kind = Painter("kind", contacts, content)
    tip, tangential, faint = kind(contacts).tolist()
    assert (tuple(tip), tuple(tangential)) == tuple(map(rgb, KIND_COLOURS.values()))
    assert min(faint) > max(tip[1:]) and faint[2] > faint[0]
    said = [text for _, text in kind.legend.entries]
    assert said == ["tip contact (1)", "tangential contact (2)", "faint: status not OK (1)"]

    status = Painter("status", contacts, content)
    assert [text for _, text in status.legend.entries] == ["OK (2)", "NOT_UNIQUE (1)"]
    assert [rgb(colour) for colour, _ in status.legend.entries] == [
        tuple(colour) for colour in status(contacts)[1:].tolist()
    ]

    force = Painter("force", contacts, content)
    assert force.legend.title == "support force [N]"
    assert force.legend.scale is not None
    assert force.legend.scale[:2] == pytest.approx((0.102, 0.198))
    low, high, unknown = force(contacts).tolist()
    assert (low, high) == ([68, 1, 84], [253, 231, 37])
    assert len(set(unknown)) == 1
    uncertain = Painter("uncertainty", contacts, content)
    assert uncertain.legend.title == "standard deviation [mm]"
    assert uncertain.legend.scale is not None
    assert uncertain.legend.scale[:2] == pytest.approx((3**0.5, 3), rel=0.03)
    html = legend_html(uncertain.legend, content.instants, ["One in 3."])
    assert "≤ 1.7" in html and "One in 3." in html and "95 %" in html and "Rod" not in html


def test_the_numbers_of_a_contact() -> None:
    contact = rows(
        point=[[1.25, -2.5, 40]],
        status=[10],
        arc_length=[33.25],
        force=[0.125],
        covariance=[np.diag([0.01, 0.04, 0.09])],
    )
    html = numbers_html(contact, content_of(contact))
    for text in (
        "(1.25, -2.5, 40) mm",
        "tangential",
        f"NO_CURVATURE_ZERO: {vb.Status.NO_CURVATURE_ZERO.text}".replace("'", "&#x27;"),
        "33.25 mm",
        "0.125 N",
        "(0.1, 0.2, 0.3) mm",
    ):
        assert text in html
    assert "time" not in html


def test_ticks_are_round_numbers_around_the_scene() -> None:
    assert [tick_step(span) for span in (0.7, 3, 100, 650)] == [0.1, 0.5, 20, 100]
    low, high = np.array([-31.0, 2, 0]), np.array([44.0, 9, 61])
    lines, labels = ticked_box(low, high, "mm", np.array([0.5, -0.8, 0.2]))
    assert (lines.min(axis=(0, 1)) <= low).all()
    assert (lines.max(axis=(0, 1)) >= high).all()
    texts = [text for _, text in labels]
    assert texts[:8] == ["−40", "−20", "0", "20", "40", "60", "x [mm]", "0"]
    assert texts[-1] == "z [mm]"
    # x runs along the side of the floor nearest to the eye.
    assert all(place[1] < low[1] for place, text in labels[:7])


def test_clicks_pick_the_foremost_contact_shown(scan: vb.Scan) -> None:
    content = of_sweep(scan, SPHERE)
    viewer = Viewer(serve("127.0.0.1", 8180), content, "kind")
    with viewer:
        assert viewer.instant == 20
        assert viewer.url.startswith("http://127.0.0.1:")
        contact = content.instants[10].contacts[:1]
        origin = contact.point[0] + [0, 0, -100.0]
        picked = viewer.scene.picked(origin, np.array([0, 0, 1.0]))
        assert picked is not None
        np.testing.assert_array_equal(picked.point, contact.point)
        viewer.show(5)
        assert viewer.scene.picked(origin, np.array([0, 0, 1.0])) is None
        with pytest.raises(ValueError, match="instant = 21; allowed are 0 to 20"):
            viewer.show(21)


def test_view_takes_results_and_says_what_is_missing(
    scan: vb.Scan, setup: vb.Setup, found: vb.Reconstruction
) -> None:
    with vb.view(found.reactions, setup=setup, port=8180, colour="uncertainty") as viewer:
        assert len(viewer.content.contacts) == found.in_contact.sum()
        assert len(viewer.content.triangles)
        assert viewer.scene.painter.legend.title == "standard deviation [mm]"
    with pytest.raises(ValueError, match="setup = None; reactions need it"):
        vb.view(found.reactions)
    with pytest.raises(vb.io.InputError, match="'uncertainty' is not known of these contacts"):
        vb.view(scan, colour="uncertainty")


def fits_that_fail(monkeypatch: pytest.MonkeyPatch) -> list[vb.Contacts]:
    """The contacts that a stream's surface is fitted to, in vain."""
    given: list[vb.Contacts] = []

    def fit(contacts: vb.Contacts) -> vb.Shape:
        given.append(contacts)
        raise ValueError

    monkeypatch.setattr("vibrissa.viewer.growing.fit_shape", fit)
    return given


def test_a_stream_grows_and_is_thinned(
    found: vb.Reconstruction, setup: vb.Setup, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("vibrissa.viewer.stream._PERIOD", 0.01)
    monkeypatch.setattr("vibrissa.viewer.stream._MOST", 6)
    fits_that_fail(monkeypatch)
    sink = ViewerSink(setup.rod, setup.surface, port=8180)
    assert sink.viewer is None
    source = vb.live.ReplaySource(read_cleaned(LOG, setup), 4.0)
    report = vb.live.stream(
        source, vb.live.Processor(setup.rod, setup.sensor, vb.live.ConstantPose()), [sink]
    )
    assert report.rows == found.kind.size
    viewer = sink.viewer
    assert viewer is not None
    instants = viewer.scene.instants
    assert 2 <= len(instants) <= 6
    assert viewer.instant == len(instants) - 1
    assert instants[-1].label == "9.00 s"
    end = 1e3 * found.reactions.trail.position[-1]
    assert np.linalg.norm(pieces(instants[-1]) - end, axis=-1).min() < 1e-9
    contacts = viewer.scene.contacts
    assert 0 < len(contacts) <= 4 * len(instants)
    every = 1e3 * found.point[found.in_contact]
    assert all((np.abs(every - point).max(axis=1) < 1e-6).any() for point in contacts.point)
    sink.end()


def test_the_surface_of_a_stream_grows(
    found: vb.Reconstruction, setup: vb.Setup, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("vibrissa.viewer.stream._PERIOD", 0.01)
    monkeypatch.setattr("vibrissa.viewer.growing._PAUSE", 0.01)
    assert setup.surface is not None
    stamp = np.round(1e9 * found.reactions.time).astype(np.int64)  # type: ignore[operator]
    sink = ViewerSink(setup.rod, None, port=8180)
    raw = read_cleaned(LOG, setup)

    def give(rows: range) -> None:
        for first in rows[::60]:
            chosen = slice(first, first + 60, 2)
            sink.contacts(stamp[chosen], raw, found[chosen])
            time.sleep(0.05)

    def area() -> float:
        fitted = sink.viewer.scene.fitted  # type: ignore[union-attr]
        return sum(trimesh.Trimesh(one.vertices, one.faces, process=False).area for one in fitted)

    until = monotonic() + 60
    while sink.viewer is None:
        give(range(60))
    give(range(60, 420))
    while not area():
        assert monotonic() < until
        time.sleep(0.05)
    half = area()
    give(range(420, 900))
    sink.close()
    (fitted,) = sink.viewer.scene.fitted  # type: ignore[union-attr]
    assert area() > 1.5 * half > 0
    away = np.abs(setup.surface.distances(fitted.vertices / 1e3))
    assert np.median(away) < 0.3e-3
    assert away.max() < 1.5e-3
    assert found.covariance is not None
    sharp = np.trace(found.covariance, axis1=1, axis2=2) < 0.5e-3**2
    last = found.point[found.in_contact & (found.status == vb.Status.OK) & sharp][-10:]
    assert np.linalg.norm(1e3 * last[:, None] - fitted.vertices, axis=2).min(axis=1).max() < 1.5
    assert "Surface: standard deviation [mm]" in sink.viewer.scene.legend  # type: ignore[union-attr]
    sink.end()


def test_a_long_stream_is_fitted_to_few_contacts_of_one_sweep(
    found: vb.Reconstruction, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And where that fails nothing is shown, and nothing said."""
    given = fits_that_fail(monkeypatch)
    monkeypatch.setattr("vibrissa.viewer.growing._MOST", 100)
    surface = GrowingSurface(found.rod)
    for first in range(0, 900, 30):
        surface.add(found[first : first + 30])
    surface.close()
    assert surface.take() is None
    contacts = given[-1]
    assert 50 <= len(contacts) <= 100
    assert contacts.sweep is None
    assert contacts.covariance is not None
    assert contacts.time is not None
    assert found.covariance is not None
    deviation = np.sqrt(np.trace(contacts.covariance, axis1=1, axis2=2))
    assert deviation.max() < 0.1 * found.rod.length
    certain = np.sqrt(np.trace(found.covariance, axis1=1, axis2=2)) < 0.1 * found.rod.length
    sound = found.in_contact & (found.status == vb.Status.OK) & certain
    every = round(sound.sum() / len(contacts))
    np.testing.assert_array_equal(contacts.point, found.point[sound][::every])


def test_view_from_the_command_line(
    scan: vb.Scan, found: vb.Reconstruction, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page, ply, log = tmp_path / "scene.html", tmp_path / "contacts.ply", tmp_path / "contacts.csv"
    vb.write_contacts(ply, found)
    vb.write_contacts(log, found)
    cloud = vb.write_contacts(tmp_path / "contacts.mcap", found)
    matlab = vb.write_contacts(tmp_path / "contacts.mat", found)
    vb.write_contacts(tmp_path / "scan.nc", scan)
    for files, contacts, instants in (
        ((LOG, "--setup", SETUP), 566, 240),
        ((tmp_path / "scan.nc",), scan.in_contact.sum(), 21),
        ((ply,), 566, 240),
        ((log,), 566, 240),
        ((matlab,), 566, 240),
        ((matlab, "--setup", SETUP), 566, 240),
        ((cloud, "--setup", SETUP), 566, 240),
        ((SETUP,), 0, 0),
    ):
        run = vibrissa(capsys, "view", *files, "--save", page)
        assert run.status == 0, run.err
        assert run.out == f"{contacts} contacts, {instants} instants → {page}\n"
        assert page.read_text(encoding="utf-8").startswith("<!")


WRONG = {
    "no file": (("none.nc",), "none.nc: cannot be read"),
    "no setup": ((LOG,), "is a recording; allowed is one with a setup (--setup)"),
    "suffix": ((SETUP, "--save", "x.png"), "x.png: suffix '.png'; allowed is .html"),
    "colour": ((SETUP, "--colour", "force"), "'force' is not known of these contacts"),
    "no colour": ((SETUP, "--colour", "red"), "colour = 'red'; allowed are kind, status"),
    "address": ((SETUP, "--host", "192.0.2.1"), "allowed is an address of this machine"),
}


@pytest.mark.parametrize("what", WRONG)
def test_invalid_input_is_one_line(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    arguments, message = WRONG[what]
    run = vibrissa(capsys, "view", *arguments)
    assert (run.status, run.out) == (2, "")
    assert message in run.err.splitlines()[-1]
    assert list(tmp_path.iterdir()) == []


def test_without_viser_one_line_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    run = vibrissa(capsys, "view", SETUP)
    assert run.status == 2
    assert "viser is not installed; the viewer needs it: " in run.err
    assert "'vibrissa[view]'" in run.err


def test_a_server_is_found_on_this_machine_only() -> None:
    server = serve("127.0.0.1", 8180)
    assert server.get_host() == "127.0.0.1"
    stop(server)
