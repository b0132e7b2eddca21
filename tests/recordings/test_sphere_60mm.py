"""Recordings of a steel wire under a ball, made by an independent dynamics engine, against the
engine's own contacts.
"""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy.stats import chi2

import vibrissa as vb
from vibrissa.io import InputError, inspect_recording, read_raw

FRICTIONLESS, FRICTION = "frictionless/trail_y+0.10", "friction_0.25/trail_y+0.10"
WITH_TRUTH = [FRICTIONLESS, "frictionless/trail_y-0.20", FRICTION]
ALL = [*WITH_TRUTH, "frictionless/trail_y+0.30", "frictionless/trail_y-0.40"]
CENTER, RADIUS = np.array([0.0, 0.0, 0.0575]), 0.03


class Sweep(NamedTuple):
    """One recording, reconstructed sample by sample, and the truth where it is given."""

    setup: vb.Setup
    found: vb.Reconstruction
    point: np.ndarray
    force: np.ndarray
    touching: np.ndarray

    @property
    def both(self) -> np.ndarray:
        """Samples in contact by the truth, and found so."""
        return self.touching & self.found.in_contact

    @property
    def error(self) -> np.ndarray:
        """Of the contact point on those samples (k, 3)."""
        return self.found.point[self.both] - self.point[self.both]

    def weaker_than(self, deviations: float) -> np.ndarray:
        """True force below so many standard deviations of a sample."""
        assert self.setup.sensor.force_noise is not None
        return np.linalg.norm(self.force, axis=1) <= deviations * self.setup.sensor.force_noise


def read(folder: Path, name: str) -> Sweep:
    setup = vb.load_setup(folder / "setup.toml")
    found = vb.reconstruct(setup.rod, vb.read_recording(folder / f"{name}.csv", setup))
    truth_file = folder / f"{name}.truth.csv"
    if not truth_file.exists():
        nothing = np.full((len(found.kind), 3), np.nan)
        return Sweep(setup, found, nothing, nothing, np.zeros(len(found.kind), dtype=bool))
    truth = np.genfromtxt(truth_file, delimiter=",", names=True)
    np.testing.assert_allclose(truth["time"], found.reactions.time, atol=1e-9)
    point, force = (
        np.stack([truth[name] for name in names], axis=1)
        for names in (("x", "y", "z"), ("fx", "fy", "fz"))
    )
    return Sweep(setup, found, point, force, truth["in_contact"] == 1)


@pytest.fixture(scope="module")
def sweeps(sphere_60mm: Path) -> dict[str, Sweep]:
    return {name: read(sphere_60mm, name) for name in ALL}


@pytest.mark.parametrize("name", WITH_TRUTH)
def test_median_error_of_the_raw_points(sweeps: dict[str, Sweep], name: str) -> None:
    """1.1 mm at most; and not less than noise allows, which would be a truth that leaks."""
    error = np.linalg.norm(sweeps[name].error, axis=1)
    assert np.count_nonzero(sweeps[name].both) > 900
    assert 0.3e-3 < np.median(error) <= 1.1e-3


@pytest.mark.parametrize("name", WITH_TRUTH)
def test_no_contact_above_three_times_the_noise_is_lost(
    sweeps: dict[str, Sweep], name: str
) -> None:
    sweep = sweeps[name]
    strong = sweep.touching & ~sweep.weaker_than(3)
    assert np.count_nonzero(strong) > 900
    assert np.all(sweep.found.in_contact[strong])
    assert np.all(np.isfinite(sweep.found.point[strong]))


@pytest.mark.parametrize("name", WITH_TRUTH)
def test_hardly_a_sample_without_contact_is_taken_for_one(
    sweeps: dict[str, Sweep], name: str
) -> None:
    """After first contact the wire still swings; before, only noise may raise the alarm."""
    sweep = sweeps[name]
    before = np.arange(len(sweep.touching)) < np.argmax(sweep.touching)
    assert np.count_nonzero(before) > 200
    assert np.mean(sweep.found.in_contact[before]) < 0.01


@pytest.mark.parametrize("name", WITH_TRUTH)
def test_the_95_percent_ellipsoids_hold_the_true_points(
    sweeps: dict[str, Sweep], name: str
) -> None:
    sweep = sweeps[name]
    assert sweep.found.covariance is not None
    distance = np.einsum(
        "ni,nij,nj->n", sweep.error, np.linalg.inv(sweep.found.covariance[sweep.both]), sweep.error
    )
    assert 0.90 <= np.mean(distance < chi2.isf(0.05, 3)) <= 0.98


@pytest.mark.parametrize("name", WITH_TRUTH)
def test_errors_are_as_anisotropic_as_stated(sweeps: dict[str, Sweep], name: str) -> None:
    """A few hundredths, some tenths and more than half a millimetre along the ellipsoids' axes, on
    samples of some force.
    """
    sweep = sweeps[name]
    rows = sweep.both & ~sweep.weaker_than(20)
    assert sweep.found.covariance is not None
    values, axes = np.linalg.eigh(sweep.found.covariance[rows])
    stated = np.median(np.sqrt(values), axis=0)
    assert stated[0] < 0.05e-3
    assert stated[2] > 3 * stated[1]
    along = np.einsum("ni,nij->nj", sweep.found.point[rows] - sweep.point[rows], axes) / np.sqrt(
        values
    )
    seen = np.median(np.abs(along), axis=0) / 0.6745
    np.testing.assert_allclose(seen, 1, atol=0.35)


@pytest.mark.parametrize("name", WITH_TRUTH)
def test_reactions_are_the_true_force_seen_from_the_clamp(
    sweeps: dict[str, Sweep], name: str
) -> None:
    """Tare, mount, lever arm and sign, before any rod mechanics: f0 = −F and m0 = −r × F, to the
    noise.
    """
    sweep = sweeps[name]
    reactions, rows = sweep.found.reactions, sweep.touching
    force_error = reactions.force[rows] + sweep.force[rows]
    arm = sweep.point[rows] - reactions.trail.position[rows]
    moment_error = reactions.moment[rows] + np.cross(arm, sweep.force[rows])
    assert np.abs(np.median(force_error, axis=0)).max() < 1.5e-3
    assert np.abs(np.median(moment_error, axis=0)).max() < 8e-5
    assert np.median(np.abs(force_error)) < 4e-3


@pytest.mark.parametrize("name", ALL)
def test_points_lie_on_the_ball(sweeps: dict[str, Sweep], name: str) -> None:
    """Also on trails without truth: the object is known. Only samples of some force say where."""
    found = sweeps[name].found
    force = np.linalg.norm(found.reactions.force, axis=1)
    rows = found.in_contact & (force > 0.06)
    assert np.count_nonzero(rows) > 500
    distance = np.linalg.norm(found.point[rows] - CENTER, axis=1) - RADIUS
    assert np.median(np.abs(distance)) < 0.6e-3
    assert abs(np.median(distance)) < 0.3e-3
    assert np.mean(found.status[rows] == vb.Status.OK) > 0.98


@pytest.mark.parametrize("name", [name for name in ALL if name != FRICTION])
def test_without_friction_the_force_is_the_ball_s_normal(
    sweeps: dict[str, Sweep], name: str
) -> None:
    found = sweeps[name].found
    rows = found.in_contact & (np.linalg.norm(found.reactions.force, axis=1) > 0.06)
    assert np.degrees(np.median(leaning(found, rows))) < 2.5


def leaning(found: vb.Reconstruction, rows: np.ndarray) -> np.ndarray:
    """Angle between the force's direction and the ball's normal at the reconstructed point's place
    on it (k,).
    """
    outward = found.point[rows] - CENTER
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    return np.arccos(np.clip(np.sum(outward * found.normal[rows], axis=1), -1, 1))


def test_with_friction_the_force_leans_by_the_angle_of_friction(sweeps: dict[str, Sweep]) -> None:
    found, sweep = sweeps[FRICTION].found, sweeps[FRICTION]
    rows = sweep.both & ~sweep.weaker_than(30)
    outward = (sweep.point[rows] - CENTER) / RADIUS
    angle = np.arccos(
        np.sum(outward * found.normal[rows], axis=1) / np.linalg.norm(outward, axis=1)
    )
    assert np.degrees(np.median(angle)) == pytest.approx(np.degrees(np.arctan(0.25)), abs=0.5)
    assert np.degrees(np.median(leaning(found, rows))) == pytest.approx(14.04, abs=1.5)


def test_with_friction_points_are_as_good_as_without(sweeps: dict[str, Sweep]) -> None:
    with_it, without = (
        np.median(np.linalg.norm(sweeps[name].error, axis=1)) for name in (FRICTION, FRICTIONLESS)
    )
    assert with_it < 1.2 * without


@pytest.mark.filterwarnings(
    "ignore::vibrissa.contacts.RecordingWarning"
)  # of all that is said, one line is asked for
def test_taking_the_wrench_for_its_opposite_finds_no_ball(
    sphere_60mm: Path, tmp_path: Path
) -> None:
    """The sign of a wrench cannot be guessed: with the other one hardly a sample is a contact."""
    text = (sphere_60mm / "setup.toml").read_text().replace('"on_sensor" ', '"on_rod" ')
    (tmp_path / "setup.toml").write_text(text)
    setup = vb.load_setup(tmp_path / "setup.toml")
    assert setup.sensor.wrench == "on_rod"
    with pytest.warns(vb.RecordingWarning, match="a wrench of the other sign"):
        found = vb.reconstruct(
            setup.rod, vb.read_recording(sphere_60mm / f"{FRICTIONLESS}.csv", setup)
        )
    assert not np.any(found.status[found.in_contact] == vb.Status.OK)
    loaded = np.linalg.norm(found.reactions.force, axis=1) > 0.1
    distance = np.linalg.norm(found.point[loaded] - CENTER, axis=1) - RADIUS
    assert not np.nanmedian(np.abs(distance)) < 5e-3


@pytest.mark.filterwarnings("ignore::vibrissa.contacts.RecordingWarning")
def test_a_wrong_clamp_position_moves_points_along_the_line_of_the_force_only(
    sphere_60mm: Path, tmp_path: Path, sweeps: dict[str, Sweep]
) -> None:
    """The clamp taken 5 mm beside where it is: statics finds the same lines, and only the rod's
    place on them is wrong.
    """
    text = (
        (sphere_60mm / "setup.toml").read_text().replace("[0.0, 0.0, 0.025]", "[0.005, 0.0, 0.025]")
    )
    (tmp_path / "setup.toml").write_text(text)
    setup, right = vb.load_setup(tmp_path / "setup.toml"), sweeps[FRICTIONLESS].found
    with pytest.warns(vb.RecordingWarning, match="clamp shifted by 5 mm along -x"):
        wrong = vb.reconstruct(
            setup.rod, vb.read_recording(sphere_60mm / f"{FRICTIONLESS}.csv", setup)
        )
    rows = (
        (np.linalg.norm(right.reactions.force, axis=1) > 0.2) & right.in_contact & wrong.in_contact
    )
    shift = wrong.point[rows] - right.point[rows]
    along = np.sum(shift * right.normal[rows], axis=1)
    across = np.linalg.norm(shift - along[:, None] * right.normal[rows], axis=1)
    assert np.median(across) < 0.15e-3
    assert np.median(np.abs(along)) > 1e-3


def lines_of(folder: Path) -> list[str]:
    return (folder / f"{FRICTIONLESS}.csv").read_text().splitlines()


def scaled(lines: list[str], columns: range, factor: float) -> list[str]:
    rows = [line.split(",") for line in lines[1:]]
    for row in rows:
        row[columns.start : columns.stop] = [
            repr(float(cell) * factor) for cell in row[columns.start : columns.stop]
        ]
    return [lines[0], *map(",".join, rows)]


def with_cell(lines: list[str], row: int, column: str, value: str) -> list[str]:
    cells = lines[row].split(",")
    cells[lines[0].split(",").index(column)] = value
    return [*lines[:row], ",".join(cells), *lines[row + 1 :]]


DAMAGE = {
    "last line truncated": (lambda lines: [*lines[:-1], lines[-1][:50]], "truncated"),
    "last number truncated": (
        lambda lines: [*lines[:-1], lines[-1][:-3]],
        "the last line is truncated",
    ),
    "columns swapped": (
        lambda lines: [lines[0].replace("fx,fy", "fy,fx"), *lines[1:]],
        "another order",
    ),
    "column missing": (lambda lines: [line.rsplit(",", 1)[0] for line in lines], "missing tz"),
    "column renamed": (
        lambda lines: [lines[0].replace("time", "t"), *lines[1:]],
        "missing time, unknown t",
    ),
    "time backwards": (
        lambda lines: [*lines[:900], lines[901], lines[900], *lines[902:]],
        "increasing times",
    ),
    "zero quaternion": (
        lambda lines: with_cell(with_cell(lines, 50, "qz", "0"), 50, "qw", "0.0"),
        "line 51: qx,qy,qz,qw = [0.0, 0.0, 0.0, 0.0] has the norm 0",
    ),
    "rest cut off": (lambda lines: lines[:100], "tare_seconds = 0.9: 99 of 99 samples"),
    "millimetres": (lambda lines: scaled(lines, range(1, 4), 1e3), "allowed are metres"),
    "newton millimetres": (lambda lines: scaled(lines, range(11, 14), 1e3), "mis-scaled"),
    "newton centimetres": (lambda lines: scaled(lines, range(11, 14), 1e2), "mis-scaled"),
    "millinewtons": (lambda lines: scaled(lines, range(8, 14), 1e3), "mis-scaled"),
    "kilonewtons": (lambda lines: scaled(lines, range(8, 14), 1e-3), "mis-scaled"),
}


@pytest.mark.parametrize("what", DAMAGE)
def test_a_damaged_file_is_told_apart(sphere_60mm: Path, tmp_path: Path, what: str) -> None:
    damage, words = DAMAGE[what]
    setup = vb.load_setup(sphere_60mm / "setup.toml")
    file = tmp_path / "damaged.csv"
    file.write_text(
        "\n".join(damage(lines_of(sphere_60mm))) + ("" if "truncated" in what else "\n")
    )
    with pytest.raises(InputError) as caught:
        vb.read_recording(file, setup)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(str(file))


@pytest.mark.parametrize("name", ALL)
def test_every_recording_is_taken_as_it_is(sweeps: dict[str, Sweep], name: str) -> None:
    """And so is its undamaged copy with the ends of lines of another system, or without the last
    one.
    """
    assert sweeps[name].found.kind.shape[0] > 2000
    assert sweeps[name].found.covariance is not None


def test_ends_of_lines_do_not_matter(sphere_60mm: Path, tmp_path: Path) -> None:
    setup, lines = vb.load_setup(sphere_60mm / "setup.toml"), lines_of(sphere_60mm)
    forces = []
    for number, text in enumerate(
        ("\n".join(lines) + "\n", "\r\n".join(lines) + "\r\n", "\n".join(lines))
    ):
        file = tmp_path / f"{number}.csv"
        file.write_bytes(text.encode())
        forces.append(vb.read_recording(file, setup).force)
    np.testing.assert_array_equal(forces[0], forces[1])
    np.testing.assert_array_equal(forces[0], forces[2])


@pytest.mark.parametrize("name", ALL)
def test_a_recording_as_it_is_has_no_faults(sphere_60mm: Path, name: str) -> None:
    told = inspect_recording(sphere_60mm / f"{name}.csv", vb.load_setup(sphere_60mm / "setup.toml"))
    assert told.faults == ()
    assert told.usable.all()
    assert told.rate == pytest.approx(250)
    # Standard deviations over 225 samples are known to a twentieth.
    np.testing.assert_allclose(told.noise, [2.05e-3] * 3 + [4.006e-5] * 3, rtol=0.2)
    assert 0.6 < told.single_contact_misfit < 0.75


@pytest.mark.parametrize("name", WITH_TRUTH)
def test_the_rest_that_is_found_ends_before_the_contact(
    sweeps: dict[str, Sweep], sphere_60mm: Path, name: str
) -> None:
    """And is longer than the 0.9 s that the setup gives, whose tare it confirms."""
    setup = vb.load_setup(sphere_60mm / "setup.toml")
    raw = read_raw(sphere_60mm / f"{name}.csv", setup).raw
    tare = replace(setup.sensor, tare_seconds=None).tare(raw)
    ((start, stop),) = tare.intervals
    touching = raw.time[sweeps[name].touching]
    assert start == raw.time[0]
    assert 0.9 * (touching[0] - start) - 0.1 < stop - start < touching[0] - start
    given = setup.sensor.tare(raw)
    spread = np.sqrt(setup.sensor.reading_variance * (1 / given.counts[0] + 1 / tare.counts[0]))
    assert np.all(np.abs(tare.offset - given.offset) < 4 * spread)
    (_, last) = replace(setup.sensor, tare_seconds=None, estimate_drift=True).tare(raw).intervals
    assert last[0] > touching[-1]


def test_a_recording_that_starts_in_contact_has_no_rest(sphere_60mm: Path, tmp_path: Path) -> None:
    text = (sphere_60mm / "setup.toml").read_text()
    (tmp_path / "setup.toml").write_text(text.replace("tare_seconds = 0.9", "#"))
    lines = lines_of(sphere_60mm)
    (tmp_path / "late.csv").write_text("\n".join([lines[0], *lines[900:]]) + "\n")
    with pytest.raises(InputError, match="starts in contact or under a changing load"):
        vb.read_recording(tmp_path / "late.csv", vb.load_setup(tmp_path / "setup.toml"))


def test_rows_with_faults_are_marked_and_the_others_are_as_good_as_before(
    sphere_60mm: Path, tmp_path: Path
) -> None:
    setup, lines = vb.load_setup(sphere_60mm / "setup.toml"), lines_of(sphere_60mm)
    rows = np.array([line.split(",") for line in lines[1:]])
    rows[1000:1005, 8:] = "nan"
    rows[850:950, 8] = rows[850, 8]
    file = tmp_path / "faulty.csv"
    file.write_text("\n".join([lines[0], *map(",".join, rows)]) + "\n")
    told = [
        (str(fault.kind), fault.channels, fault.count)
        for fault in inspect_recording(file, setup).faults
    ]
    assert told == [
        ("stuck channel", ("fx",), 100),
        ("drop-out", ("fx", "fy", "fz", "tx", "ty", "tz"), 5),
    ]
    with pytest.warns(vb.RecordingWarning, match="fx is stuck"):
        found = vb.reconstruct(setup.rod, vb.read_recording(file, setup))
    good = vb.reconstruct(setup.rod, vb.read_recording(sphere_60mm / f"{FRICTIONLESS}.csv", setup))
    bad = np.flatnonzero(found.status == vb.Status.BAD_DATA)
    assert bad.tolist() == [*range(850, 950), *range(1000, 1005)]
    kept = np.delete(np.arange(len(rows)), bad)
    np.testing.assert_array_equal(found.point[kept], good.point[kept])
