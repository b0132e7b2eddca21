"""What the figures show: everything there is, said in their legends, or why there is nothing."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from command_line import vibrissa
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection

import vibrissa as vb
from vibrissa.calibration import Identifiability, Residuals
from vibrissa.sensor import CHANNELS, preset

FOLDER = Path(__file__).parents[2] / "examples/recordings/sphere_60mm"
UNIT = vb.Rod.unit()
BALL = vb.surfaces.Sphere(center=(0, 0, 1.15), radius=0.6)
STATUS = vb.Status


@pytest.fixture(autouse=True)
def _closed() -> object:
    mpl.use("Agg")
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def setup() -> vb.Setup:
    return vb.load_setup(FOLDER / "setup.toml")


@pytest.fixture(scope="module")
def found(setup: vb.Setup) -> vb.Reconstruction:
    return vb.reconstruct(setup.rod, vb.read_recording(FOLDER / "trail.csv", setup))


@pytest.fixture(scope="module")
def sweeps() -> vb.Scan:
    """Three trails under a ball; the middle one, y0 = 0, is laterally unstable past its apex."""
    trail = vb.Trail.raster(
        start=(0.8, -0.2, 0), stop=(-0.8, -0.2, 0), count=33, step=(0, 0.2, 0), trails=3
    )
    return vb.scan(UNIT, BALL, trail)


@pytest.fixture(scope="module")
def sweep() -> vb.Scan:
    return vb.scan(UNIT, BALL, vb.Trail.line(start=(0.2, 0.8, 0), stop=(0.2, -0.8, 0), count=41))


def legend(axes: Sequence[Axes]) -> tuple[str, list[str]]:
    """Title and labels of a figure's legend, wherever it is."""
    figure = axes[0].get_figure(root=True)
    assert figure is not None
    boxes = [*figure.legends, *(part.get_legend() for part in figure.axes if part.get_legend())]
    return boxes[0].get_title().get_text(), [text.get_text() for text in boxes[0].get_texts()]


def counts(axes: Axes) -> dict[str, int]:
    """Points that are drawn, by label."""
    return {str(line.get_label()): len(line.get_xdata()) for line in axes.lines}


def nowhere(scan: vb.Scan) -> vb.Scan:
    nan = np.full_like(scan.point, np.nan)
    return replace(
        scan, kind=np.zeros_like(scan.kind), point=nan, arc_length=nan[..., 0], events=[]
    )


# Contacts


def test_every_contact_is_drawn_by_how_far_it_can_be_trusted(found: vb.Reconstruction) -> None:
    """Few of a good recording are wide; of one whose noise were forty times as large all are, and
    they fill the same place, faintly.
    """
    assert found.covariance is not None
    panels = vb.plot.contacts_figure(found)
    shown = counts(panels[0])
    assert sum(shown.values()) == np.count_nonzero(found.in_contact)
    assert sum(n for label, n in shown.items() if "σ above 2.5 mm" in label) < 100
    assert all(label.endswith(f"({n})") for label, n in shown.items())
    noisy = vb.plot.contacts_figure(replace(found, covariance=1600 * found.covariance))
    wide = {label: n for label, n in counts(noisy[0]).items() if "σ above 2.5 mm" in label}
    assert sum(wide.values()) == sum(shown.values())
    assert all(line.get_alpha() < 0.5 for line in noisy[0].lines)
    np.testing.assert_allclose(noisy[0].get_xlim(), panels[0].get_xlim(), atol=10)


def test_ellipses_hold_95_per_cent_and_are_named(found: vb.Reconstruction) -> None:
    """The ellipses that are drawn are those of the covariance, in each view; of a single contact
    the whole one is seen.
    """
    row = int(np.flatnonzero(found.in_contact)[50])
    panels = vb.plot.contacts_figure(found[row : row + 1])
    assert "95 % ellipse of 1 contact" in legend(panels)[1]
    assert found.covariance is not None
    for axes, view in zip(panels, ([0, 1], [2, 1], [0, 2]), strict=True):
        spread = 1e6 * found.covariance[row][np.ix_(view, view)]
        (ellipse,) = (c for c in axes.collections if isinstance(c, EllipseCollection))
        longest = 2 * np.sqrt(5.991 * np.linalg.eigvalsh(spread)[-1])
        assert ellipse.get_widths() == pytest.approx([longest], rel=1e-3)
        limits = np.array([axes.get_xlim(), axes.get_ylim()])
        center, half = 1e3 * found.point[row][view], np.sqrt(5.991 * np.diag(spread))
        assert np.all(limits[:, 0] < center - half)
        assert np.all(limits[:, 1] > center + half)
    many = legend(vb.plot.contacts_figure(found))[1]
    assert [label for label in many if label.startswith("95 % ellipses of ")]


def test_views_have_one_scale(found: vb.Reconstruction) -> None:
    """A millimetre is as long in each view and along each axis, and no label is cut off."""
    panels = vb.plot.contacts_figure(found)
    figure = panels[0].get_figure(root=True)
    assert figure is not None
    figure.canvas.draw()
    scales = []
    for axes in panels:
        box = axes.get_window_extent()
        scales += [box.width / np.ptp(axes.get_xlim()), box.height / np.ptp(axes.get_ylim())]
    np.testing.assert_allclose(scales, scales[0], rtol=0.02)
    labels = [(axes.get_xlabel(), axes.get_ylabel()) for axes in panels]
    assert labels == [("$x$ [mm]", "$y$ [mm]"), ("$z$ [mm]", "$y$ [mm]"), ("$x$ [mm]", "$z$ [mm]")]


def test_statuses_are_crosses_named_with_their_counts(found: vb.Reconstruction) -> None:
    status = np.full_like(found.status, STATUS.SETUP_CONTRADICTED)
    contacts = np.count_nonzero(found.in_contact)
    panels = vb.plot.contacts_figure(replace(found, status=status))
    assert counts(panels[0]) == {f"setup contradicted ({contacts})": contacts}
    assert panels[0].lines[0].get_marker() == "x"
    assert np.ptp(panels[0].get_xlim()) < 100


def test_no_contact_is_an_error_that_says_why(found: vb.Reconstruction) -> None:
    status = np.full_like(found.status, STATUS.BAD_DATA)
    nothing = replace(
        found, point=np.full_like(found.point, np.nan), status=status, kind=0 * found.kind
    )
    with pytest.raises(ValueError, match=r"nothing to draw: no contact in 901 samples \(901 BAD_"):
        vb.plot.contacts_figure(nothing)


# Reactions


def lines(axes: Axes) -> list[LineCollection]:
    return [part for part in axes.collections if isinstance(part, LineCollection)]


def test_a_zero_moment_has_no_panel_and_a_left_out_trail_a_name(sweeps: vb.Scan) -> None:
    panels = vb.plot.reactions_over_plane(sweeps, skip=(1,))
    names = [axes.get_title() for axes in panels]
    assert names == [f"${kind}_{{0{i}}}$ [$EI/{unit}$]"
                     for kind, axis, unit in (("f", "xyz", "L^2"), ("m", "xy", "L")) for i in axis]  # fmt: skip
    title, labels = legend(panels)
    assert title == "$m_{0z}$ = 0 throughout"
    assert "left out: $y_0/L$ = 0" in labels
    assert all(axes.get_aspect() == 1 for axes in panels)


def test_unstable_rows_are_marked_and_do_not_decide_the_scale(sweeps: vb.Scan) -> None:
    """With the y0 = 0 trail's force made a hundred times as large, the colours stay."""
    kind = sweeps.in_contact
    status = np.zeros_like(sweeps.status)
    status[1] = STATUS.LATERALLY_UNSTABLE
    force = sweeps.reactions.force.copy()
    force[1] *= 100
    loud = replace(sweeps, status=status, reactions=replace(sweeps.reactions, force=force))
    sound = np.abs(sweeps.reactions.force[[0, 2]][kind[[0, 2]]]).max(axis=0)
    panels = vb.plot.reactions_over_plane(loud)
    for axes, largest in zip(panels[:3], sound, strict=True):
        coloured, marked = lines(axes)
        assert coloured.norm.vmax == pytest.approx(largest)
        assert len(marked.get_segments()) == kind[1].sum()
    _, labels = legend(panels)
    assert f"laterally unstable ({kind[1].sum()})" in [" ".join(x.split()) for x in labels]
    # If there are no others, they have to.
    alone = vb.plot.reactions_over_plane(replace(loud, status=np.full_like(status, 2)))
    assert lines(alone[2])[0].norm.vmax == pytest.approx(np.abs(force[..., 2][kind]).max())


def test_trails_in_any_direction_lie_in_their_own_plane(sweeps: vb.Scan) -> None:
    """Trails side by side in x and z are drawn over x and z, in millimetres for a real rod."""
    position = sweeps.trail.position[..., [0, 2, 1]]
    turned = replace(sweeps, rod=vb.Rod.cylinder(length=1.0, radius=1e-3, youngs_modulus=1e11),
                     trail=vb.Trail(position))  # fmt: skip
    panels = vb.plot.reactions_over_plane(turned)
    assert panels[0].get_ylabel() == "$z_0$ [mm]"
    assert panels[-1].get_xlabel() == "$x_0$ [mm]"
    assert panels[0].get_xlim()[1] > 800
    assert panels[-1].get_title().endswith("[N mm]")


def test_trails_that_cannot_be_shown_are_named(sweeps: vb.Scan) -> None:
    """Those that do not exist, all of them, and clamps that only turn."""
    for skip in ((0, 1, 2), (3,), (-1,)):
        with pytest.raises(ValueError, match=f"skip = .*{skip[-1]}.*; allowed are numbers from 0 "):
            vb.plot.reactions_over_plane(sweeps, skip=skip)
    still = np.repeat(sweeps.trail.position[:, :1], 33, axis=1)
    with pytest.raises(ValueError, match="nothing to draw: the clamp turns about one point"):
        vb.plot.reactions_over_plane(replace(sweeps, trail=vb.Trail(still)))


def test_curves_follow_the_sweep_and_begin_with_the_contact(sweep: vb.Scan) -> None:
    force, length = vb.plot.reactions_along(sweep)
    assert length.get_xlabel() == "$y_0/L$"
    low, high = length.get_xlim()
    assert low > high  # the sweep runs from left to right
    _, labels = legend([force])
    assert labels[0] == "stable"
    first = sweep.events[0]
    assert labels[1] == "first contact"
    curve = force.lines[0].get_xydata()
    np.testing.assert_allclose(curve[0], [first.clamp[1], 0.0], atol=1e-9)
    reach = np.linalg.norm(first.point - first.clamp)
    np.testing.assert_allclose(length.lines[0].get_xydata()[0], [first.clamp[1], reach], rtol=1e-6)
    assert len(curve) == sweep.in_contact.sum() + 2


def test_curves_say_where_they_are_unstable_or_not_to_be_trusted(sweep: vb.Scan) -> None:
    status, rows = np.zeros_like(sweep.status), np.flatnonzero(sweep.in_contact)
    status[rows[5:9]], status[rows[9:11]] = STATUS.LATERALLY_UNSTABLE, STATUS.PENETRATING
    force, _ = vb.plot.reactions_along(replace(sweep, status=status))
    _, labels = legend([force])
    assert labels[:3] == ["stable", "laterally unstable (4)", "penetrating (2)"]
    styles = {str(line.get_label()): line.get_linestyle() for line in force.lines[:4]}
    assert styles == {labels[0]: "-", labels[1]: "--", labels[2]: ":"}


def test_a_curve_breaks_off_at_a_snap(sweep: vb.Scan) -> None:
    rows = np.flatnonzero(sweep.in_contact)
    middle = sweep.trail.parameter[rows[6:8]].mean()
    snap = vb.Event(
        vb.EventKind.SNAP, 0, float(middle), sweep.trail.position[rows[6]], sweep.point[rows[6]]
    )
    force, _ = vb.plot.reactions_along(replace(sweep, events=[*sweep.events, snap]))
    assert np.isnan(force.lines[0].get_ydata()).sum() == 1
    value = np.linalg.norm(sweep.reactions.force[rows[6]])
    assert force.lines[-1].get_ydata() == pytest.approx([value])


def test_scans_without_contact_say_so(sweep: vb.Scan, sweeps: vb.Scan) -> None:
    with pytest.raises(ValueError, match=r"no contact in 41 positions \(41 OK\)"):
        vb.plot.reactions_along(nowhere(sweep))
    with pytest.raises(ValueError, match="no contact in 99 positions"):
        vb.plot.reactions_over_plane(nowhere(sweeps))
    with pytest.raises(ValueError, match=r"allowed is one trail \(n,\)"):
        vb.plot.reactions_along(sweeps)
    with pytest.raises(ValueError, match="allowed are several trails"):
        vb.plot.reactions_over_plane(sweep)


# Coverage


def test_coverage_shows_what_is_covered_and_names_it() -> None:
    """Samples right of x = 0 are covered: so is the right half of the picture."""
    x, y = np.meshgrid(np.linspace(-1, 1, 41), np.linspace(-0.5, 0.5, 21))
    samples = np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()])
    contacts = np.array([[0.5, 0.0, 0.0], [np.nan] * 3, [3.0, 0.0, 0.0]])
    (axes,) = vb.plot.coverage_figure(
        samples, [("half", contacts, samples[:, 0] > 0, 0.5)], within=0.05
    )
    picture = axes.images[0].get_array()
    columns = picture.shape[1] // 2
    assert not picture[:, : columns - 5].any()
    assert picture[:, columns + 5 :].all()
    assert axes.get_title() == "half:\n50% covered"
    assert len(axes.lines[0].get_xdata()) == 1  # the other lies outside of the region
    assert max(axes.get_xlim()) < 1.1
    _, labels = legend([axes])
    assert labels == ["covered (within 0.05 $L$ of a contact)", "not covered", "contact"]


def test_coverage_says_which_argument_is_wrong() -> None:
    grid = np.stack(np.meshgrid([0.0, 1.0], [0.0, 1.0], [0.0]), axis=-1).reshape(-1, 3)

    def case(count: int) -> list:
        return [("one", grid, np.ones(count, dtype=bool), 1.0)]

    for samples, cases, said in (
        (grid, [], "0 cases; allowed is at least one"),
        (grid[:1], case(1), "1 sample without an extent over x and y"),
        (grid * [0, 1, 1], case(4), "4 samples without an extent"),
        (np.full((4, 3), np.nan), case(4), "samples"),
        (grid, case(3), r"covered of 'one' has the shape \(3,\); allowed is \(4,\)"),
    ):
        with pytest.raises(ValueError, match=said):
            vb.plot.coverage_figure(samples, cases)


# Recordings


def test_rows_that_are_not_used_are_counted(setup: vb.Setup, tmp_path: Path) -> None:
    text = (FOLDER / "trail.csv").read_text(encoding="utf-8").splitlines()
    rows = [line.split(",") for line in text]
    for row in rows[300:304]:
        row[8:] = ["nan"] * 6
    path = tmp_path / "faulty.csv"
    path.write_text("\n".join(map(",".join, rows)) + "\n", encoding="utf-8")
    inspection = vb.io.inspect_recording(path, setup)
    axes = vb.plot.recording_figure(inspection, setup.sensor)
    _, labels = legend(axes)
    assert labels == ["tare", "drop-out", "rows not used (4)"]
    units = [part.get_ylabel() for part in axes]
    assert units[:3] == ["force [N]", "torque [N mm]", "moved [mm]"]
    assert len(axes[0].lines) == len(CHANNELS)
    raw = inspection.raw
    one = replace(inspection, raw=replace(raw, **{k: v[:1] for k, v in vars(raw).items()}))
    with pytest.raises(ValueError, match="nothing to draw: 1 row"):
        vb.plot.recording_figure(one, setup.sensor)
    silent = replace(inspection, raw=raw.with_wrench(np.full((901, 6), np.nan)))
    with pytest.raises(ValueError, match="901 rows, of which 0 hold readings"):
        vb.plot.recording_figure(silent, setup.sensor)


# Design


def test_a_map_marks_unstable_positions_and_scales_without_them() -> None:
    """The best contacts of the map, if they are of an unstable branch, do not decide its colours."""
    rod = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
    ball = vb.surfaces.Sphere(center=(0, 0, 0.0575), radius=0.03)
    trail = vb.Trail.line(start=(0.02, 0.005, 0), stop=(-0.02, 0.005, 0), count=41)
    sensor = preset("ati_nano17_si_12_0_12", clamp_position=(0, 0, 0.025))
    error = vb.expected_error(rod, ball, trail, sensor)
    longest = 1e3 * error.semi_axes[..., -1]
    status = np.where(longest < np.nanmedian(longest), 2, 0)
    panels = vb.plot.expected_error_map(replace(error, scan=replace(error.scan, status=status)))
    count, touching = np.count_nonzero(status), error.scan.in_contact
    free, missed = np.count_nonzero(~touching), np.count_nonzero(touching & ~error.detected)
    named = {"no contact": free, "contact not detected": missed, "laterally unstable": count}
    assert legend(panels)[1] == [f"{word} ({n})" for word, n in named.items() if n]
    for axes in panels:
        assert axes.collections[0].norm.vmin == pytest.approx(longest[status == 0].min())
        assert count in [len(line.get_xdata()) for line in axes.lines]
    bar = panels[0].get_figure(root=True).axes[-1]
    assert bar.get_ylabel() == "longest semi-axis,\n95 % [mm]"
    # Contacts whose load goes unnoticed are told apart from positions without any.
    kind, noticed = error.scan.kind.copy(), error.found.kind.copy()
    kind[:4], noticed[:7] = 0, 0
    deaf = replace(
        error, scan=replace(error.scan, kind=kind), found=replace(error.found, kind=noticed)
    )
    over, on = map(counts, vb.plot.expected_error_map(deaf))
    assert over["no contact (4)"] == 4
    assert over["contact not detected (3)"] == on["contact not detected (3)"] == 3


@pytest.mark.parametrize("count", [1, 11])
def test_a_map_of_a_standing_clamp_is_one_over_the_contact_point(count: int) -> None:
    rod = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
    ball = vb.surfaces.Sphere(center=(0, 0, 0.0575), radius=0.03)
    place = (0.005, 0.001, 0)
    sensor = preset("ati_nano17_si_12_0_12", clamp_position=(0, 0, 0.025))
    trail = vb.Trail.line(start=place, stop=place, count=count)
    (axes,) = vb.plot.expected_error_map(vb.expected_error(rod, ball, trail, sensor))
    assert axes.get_title() == "over the contact point"
    assert len(axes.collections[0].get_offsets()) == count


# Calibrations


def test_residuals_that_lie_outside_are_counted(setup: vb.Setup) -> None:
    """Three outliers do not decide the limits; the legend counts them, and names what is drawn."""
    rng, count = np.random.default_rng(5), 400
    noise = rng.normal(size=(count, 6))
    noise[[20, 150, 300], [0, 2, 5]] = 80.0
    residuals = Residuals(
        recording=np.repeat([0, 1], count // 2),
        time=np.linspace(0, 8, count),
        contact=np.ones(count, dtype=bool),
        reading=noise,
        predicted=np.zeros((count, 6)),
        whitened=noise,
        weight=np.ones(count),
        chi_square=(noise**2).sum(axis=1),
    )
    calibration = object.__new__(vb.Calibration)
    vars(calibration).update(residuals=residuals, setup=setup)
    over_time = vb.plot.residuals_over_time(calibration)
    outside = int((np.abs(noise) > 5).sum())
    title, labels = legend(over_time)
    assert title == f"{outside} of {6 * count} residuals lie outside"
    assert labels == ["one row", "running mean, recording 1", "running mean, recording 2"]
    over_force = vb.plot.residuals_over_force(calibration)
    assert legend(over_force) == (title, ["one row", "running mean"])
    for axes in (*over_time, *over_force):
        assert axes.get_ylim() == (-5, 5)
    assert [axes.get_ylabel()[1] for axes in over_time] == [*"fffmmm"]
    assert legend([vb.plot.residual_histogram(calibration)])[1] == [
        "residuals",
        "normal distribution",
    ]


def test_correlations_are_written_out_with_readable_names() -> None:
    correlation = np.array([[1.0, -0.9], [-0.9, 1.0]])
    names = ("youngs_modulus", "clamp_position_x")
    calibration = object.__new__(vb.Calibration)
    one = np.ones(2)
    vars(calibration)["identifiability"] = Identifiability(
        names, correlation, np.eye(2), one, one, {}
    )
    axes = vb.plot.parameter_correlation(calibration)
    assert [text.get_text() for text in axes.get_xticklabels()] == [
        "Young's modulus",
        "clamp position x",
    ]
    assert [text.get_text() for text in axes.texts] == ["1.00", "−0.90", "−0.90", "1.00"]


@pytest.mark.parametrize(
    ("figure", "said"),
    [
        (vb.plot.contacts_figure, "found is a str; allowed is Reconstruction"),
        (vb.plot.reactions_along, "scan is a str; allowed is Scan"),
        (vb.plot.expected_error_map, "error is a str; allowed is ExpectedError"),
        (vb.plot.residual_histogram, "calibration is a str; allowed is Calibration"),
    ],
)
def test_a_path_is_not_a_result(figure: Callable[[object], object], said: str) -> None:
    with pytest.raises(TypeError, match=said):
        figure("scan.nc")


# Files


@pytest.mark.parametrize(
    ("suffix", "start"), [(".png", b"\x89PNG"), (".pdf", b"%PDF"), (".svg", b"<?xml")]
)
def test_files_in_three_formats_are_the_same_each_time(
    suffix: str, start: bytes, tmp_path: Path
) -> None:
    contents = []
    for path in (tmp_path / f"first{suffix}", str(tmp_path / f"SECOND{suffix.upper()}")):
        with vb.plot.journal():
            axes = plt.figure(figsize=(2, 2)).add_subplot()
            axes.plot([0, 1], [0, 1], label="line")
            axes.legend()
        written = vb.plot.save_as(axes, path)
        assert written == Path(path)
        contents.append(written.read_bytes())
    assert contents[0].startswith(start)
    assert contents[0] == contents[1]
    assert not plt.get_fignums()


def test_another_suffix_is_refused(tmp_path: Path) -> None:
    axes = plt.figure().add_subplot()
    with pytest.raises(ValueError, match=r"suffix '.gif'; allowed are .png, .pdf, .svg"):
        vb.plot.save_as(axes, tmp_path / "figure.gif")


def test_a_command_says_why_there_is_no_figure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The warning with the likeliest cause comes first; nothing is written."""
    case, figure = tmp_path / "case.toml", tmp_path / "scan.svg"
    near = """
    rod = {kind = "unit"}
    object = {kind = "sphere", center = [0, 0, 1.15], radius = 0.6}
    trail = [{kind = "line", start = [0.2, 0.8, 0], stop = [0.2, -0.8, 0], count = 41}]
    """
    case.write_text(near.replace("1.15", "3.15"), encoding="utf-8")
    run = vibrissa(capsys, "scan", case, "-o", tmp_path / "scan.nc", "--figure", figure)
    assert run.status == 1
    assert run.err.index("likeliest cause") < run.err.index(
        f"{figure}: nothing to draw: no contact"
    )
    assert run.out.endswith(f"0 contacts, 0 sound → {tmp_path / 'scan.nc'}\n")
    assert (tmp_path / "scan.nc").exists()
    assert not figure.exists()
    rest = tmp_path / "rest.csv"
    rows = (FOLDER / "trail.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    rest.write_text("".join(rows[:130]), encoding="utf-8")
    setup, cloud = FOLDER / "setup.toml", tmp_path / "rest.ply"
    run = vibrissa(capsys, "reconstruct", rest, "--setup", setup, "-o", cloud, "--figure", figure)
    assert (run.status, cloud.exists(), figure.exists()) == (1, True, False)
    assert run.out.endswith(f"0 contacts, 0 sound → {cloud}\n")
    assert f"{figure}: nothing to draw: no contact in 129 samples" in run.err
    case.write_text(near, encoding="utf-8")
    run = vibrissa(capsys, "scan", case, "--figure", figure)
    assert run.status == 0
    assert figure.read_bytes().startswith(b"<?xml")
    run = vibrissa(capsys, "scan", case, "--figure", tmp_path / "scan.gif")
    assert run.status == 2
    assert "suffix '.gif'; allowed are .png, .pdf, .svg" in run.err


def test_figures_are_wide_enough_for_their_letters(found: vb.Reconstruction) -> None:
    """At three quarters of a page's width, as on a slide, no letter is less than 6.5 points high;
    nothing is wider than a page.
    """
    with vb.plot.journal():
        panels = vb.plot.contacts_figure(found)
    figure = panels[0].get_figure(root=True)
    assert figure is not None
    assert figure.get_size_inches()[0] <= 6.3
    texts = [text for text in figure.findobj(mpl.text.Text) if text.get_text()]
    assert 0.75 * min(text.get_fontsize() for text in texts) > 6.5


# Texts of results


def test_results_print_in_few_lines(found: vb.Reconstruction, sweeps: vb.Scan) -> None:
    text = repr(sweeps)
    assert text.splitlines()[0] == "Scan of Sphere at 99 positions (3, 33)"
    assert "EI/L²" in text
    assert f"{np.count_nonzero(sweeps.kind == vb.ContactKind.TIP)} TIP" in text
    assert "FIRST_CONTACT" in text
    for result in (sweeps, found, found.contacts, found.reactions, sweeps.contacts):
        assert len(repr(result).splitlines()) == 5
        assert max(map(len, repr(result).splitlines())) < 120
    assert repr(found.contacts).startswith("Contacts in 566 of 901 rows (901,)\n")
    assert repr(sweeps.trail) == "Trail of 99 poses (3, 33) from (0.8, -0.2, 0) to (-0.8, 0.2, 0)"
    assert repr(sweeps.slip) == (
        "Slip(axial=<array (3, 33)>, longitudinal=<array (3, 33)>, lateral=<array (3, 33)>, "
        "sliding=<array (3, 33, 3)>)"
    )
