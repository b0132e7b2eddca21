"""A simulated sweep, smoothed: errors and their bars, start and end, outliers, what is not smoothed
across, and the causal form.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom, chi2
from sweeps import BALL, RATE, SENSOR, SPEED, WIRE, Sweep, at_rest, sweep

import vibrissa as vb
from vibrissa.cli.reconstruct import reconstruct
from vibrissa.io import InputError, write_recording
from vibrissa.io.contacts import COLUMNS
from vibrissa.reactions import turned_covariance

SETUP = """\
[rod]
kind = "cylinder"
length = 0.05
radius = 0.25e-3
youngs_modulus = 206e9

[sensor]
clamp_position = [0.0, 0.0, 0.025]
clamp_orientation = [0.0, 0.0, 0.0, 1.0]
wrench = "on_sensor"
tare_seconds = 0.95
force_noise = 2.0e-3
torque_noise = 4.0e-5
position_noise = 1.0e-5
"""
SPIKES = (300, 440, 560)


@pytest.fixture(scope="module")
def swept() -> Sweep:
    """With three spikes of a newton, ten times what the sensor's noise could be."""
    made = sweep(0.01, seed=4, drift=0.1)
    force = made.reactions.force.copy()
    force[list(SPIKES), 1] += 1.0
    return made._replace(reactions=replace_force(made.reactions, force))


def replace_force(given: vb.Reactions, force: np.ndarray) -> vb.Reactions:
    return vb.Reactions(
        given.trail,
        force,
        given.moment,
        time=given.time,
        covariance=given.covariance,
        position_covariance=given.position_covariance,
    )


@pytest.fixture(scope="module")
def found(swept: Sweep) -> vb.Reconstruction:
    return vb.reconstruct(WIRE, swept.reactions)


@pytest.fixture(scope="module")
def smooth(found: vb.Reconstruction) -> vb.Reconstruction:
    return vb.smooth(found)


def core(swept: Sweep) -> np.ndarray:
    rows = np.flatnonzero(np.isfinite(swept.point[:, 0]))
    return rows[len(rows) // 20 : -(len(rows) // 20)]


def test_smoothed_points_are_much_better_than_raw_ones(
    swept: Sweep, found: vb.Reconstruction, smooth: vb.Reconstruction
) -> None:
    rows = core(swept)
    raw, better = (
        np.linalg.norm(part.point[rows] - swept.point[rows], axis=1) for part in (found, smooth)
    )
    assert np.median(better) < np.nanmedian(raw) / 3
    assert np.quantile(better, 0.95) < 0.6e-3
    assert np.all(np.isfinite(better))


def test_the_ellipsoids_hold_the_true_points(swept: Sweep, smooth: vb.Reconstruction) -> None:
    rows = core(swept)
    assert smooth.covariance is not None
    error = smooth.point[rows] - swept.point[rows]
    distance = np.einsum("ni,nij,nj->n", error, np.linalg.inv(smooth.covariance[rows]), error)
    # Neighbouring errors are nearly the same: a sweep counts as about a dozen independent ones, so
    # that its share scatters by 0.06 about 0.95.
    assert np.mean(distance < chi2.isf(0.05, 3)) > 0.8
    # And they are not larger than need be.
    assert np.mean(distance) > 0.5


def test_start_and_end_lie_within_their_errors(swept: Sweep, smooth: vb.Reconstruction) -> None:
    assert smooth.smoothing is not None
    (touch,) = smooth.smoothing[0].touches
    for name, true in zip(("start", "end"), swept.span, strict=True):
        time, deviation, limit = (
            getattr(touch, part) for part in (name, f"{name}_deviation", f"{name}_limit")
        )
        assert abs(time - true) < 4 * deviation
        assert limit < 1.2 * deviation
        assert deviation < 2 * limit
        assert deviation < 0.02
    assert touch.jumps == ()


def test_outliers_are_found_and_do_not_pull(swept: Sweep, smooth: vb.Reconstruction) -> None:
    assert smooth.smoothing is not None
    assert set(SPIKES) <= set(np.flatnonzero(smooth.smoothing[0].outlier))
    assert np.count_nonzero(smooth.smoothing[0].outlier) < len(SPIKES) + 3
    assert (
        np.linalg.norm(smooth.point[list(SPIKES)] - swept.point[list(SPIKES)], axis=1).max()
        < 0.5e-3
    )


def test_phases_change_where_the_scan_s_do(swept: Sweep, smooth: vb.Reconstruction) -> None:
    assert smooth.smoothing is not None
    kind = np.concatenate(
        [np.zeros(len(swept.point) - len(swept.scan.kind), dtype=int), swept.scan.kind]
    )
    assert np.mean(smooth.kind == kind) > 0.95
    assert smooth.arc_length_deviation is not None
    certain = (smooth.kind == vb.ContactKind.TIP) & (smooth.arc_length_deviation == 0)
    assert np.count_nonzero(certain) > 0.8 * np.count_nonzero(kind == vb.ContactKind.TIP)
    np.testing.assert_array_equal(smooth.arc_length[certain], WIRE.length)


def test_a_change_lies_within_its_error_and_widens_the_ellipsoids(
    swept: Sweep, smooth: vb.Reconstruction
) -> None:
    assert smooth.smoothing is not None
    (touch,) = smooth.smoothing[0].touches
    first = len(swept.point) - len(swept.scan.kind)
    either = swept.scan.in_contact[1:] & swept.scan.in_contact[:-1]
    true = first + 1 + np.flatnonzero(either & (np.diff(swept.scan.kind) != 0))
    assert len(touch.changes) == len(touch.change_deviations) == len(true)
    assert smooth.arc_length_deviation is not None
    for change, deviation, place in zip(touch.changes, touch.change_deviations, true, strict=True):
        assert abs(change - place) / RATE < 4 * deviation
        assert smooth.arc_length_deviation[change] > 0


def test_noise_of_the_robot_s_orientation_stays_in_full(
    found: vb.Reconstruction, smooth: vb.Reconstruction
) -> None:
    """It is not taken to be another in each sample; by cause it is the robot's."""
    given, center = found.reactions, found.reactions.trail.position - [0, 0, 0.025]
    turned = vb.Reactions(
        given.trail,
        given.force,
        given.moment,
        time=given.time,
        covariance=given.covariance,
        position_covariance=given.position_covariance,
        rotation_covariance=np.eye(3) * 2e-3**2,
        rotation_center=center,
    )
    also = vb.smooth(vb.reconstruct(WIRE, turned))
    rows = also.in_contact
    expected = turned_covariance(np.eye(3) * 2e-3**2, also.point[rows] - center[rows])
    np.testing.assert_allclose(
        (also.covariance - smooth.covariance)[rows], expected, rtol=1e-6, atol=1e-15
    )
    np.testing.assert_allclose(
        vb.contact_errors(also).total[rows], also.covariance[rows], rtol=1e-6, atol=1e-15
    )


def test_without_contact_the_alarm_is_false_as_often_as_stated() -> None:
    """With the tare's error and a drifting zero; loads shorter than eight samples are no contacts,
    so the rate is below the stated one.
    """
    given = at_rest(460, seed=11, drift=0.1)
    quiet = vb.smooth(vb.reconstruct(WIRE, given), false_alarm=1e-2)
    assert np.count_nonzero(quiet.in_contact) <= binom.ppf(0.999, 460, 1e-2)


def test_live_contacts_are_nearly_as_good(swept: Sweep, smooth: vb.Reconstruction) -> None:
    given = swept.reactions
    assert given.covariance is not None
    live = vb.CausalSmoother(
        WIRE, given.covariance, position_covariance=given.position_covariance, speed=SPEED
    )
    rows = zip(
        given.time,
        given.trail.position,
        given.trail.orientation,
        given.force,
        given.moment,
        strict=True,
    )
    contacts = [live.update(*row) for row in rows]
    point = np.array([contact.point for contact in contacts])
    together = vb.CausalSmoother(
        WIRE, given.covariance, position_covariance=given.position_covariance, speed=SPEED
    ).update_all(given)
    np.testing.assert_allclose(together.contacts.point, point, rtol=0, atol=1e-12)
    assert together.contacts.kind is not None
    assert together.contacts.kind.tolist() == [contact.kind for contact in contacts]
    assert contacts[300].contacts.normal.shape == (3,)
    inner = core(swept)
    error = np.linalg.norm(point[inner] - swept.point[inner], axis=1)
    assert np.mean(np.isfinite(error)) > 0.9
    assert np.nanmedian(error) < 0.3e-3
    before = np.flatnonzero(np.isfinite(swept.point[:, 0]))[0]
    assert sum(contact.kind != vb.ContactKind.NONE for contact in contacts[:before]) <= 1
    again = live.update(
        100.0, given.trail.position[0], given.trail.orientation[0], [np.nan] * 3, [0.0] * 3
    )
    assert again.status == vb.Status.BAD_DATA
    with pytest.raises(ValueError, match=r"time = 99.0; allowed are finite increasing times"):
        live.update(99.0, given.trail.position[0], given.trail.orientation[0], [0.0] * 3, [0.0] * 3)


def test_what_is_given_is_checked(found: vb.Reconstruction) -> None:
    with pytest.raises(ValueError, match="false_alarm = 0; allowed"):
        vb.smooth(found, false_alarm=0)
    with pytest.raises(ValueError, match=r"model_error = -1.*allowed"):
        vb.smooth(found, model_error=-1.0)
    bare = replace(
        found,
        reactions=vb.Reactions(
            found.reactions.trail, found.reactions.force, found.reactions.moment
        ),
    )
    with pytest.raises(ValueError, match="smoothing needs the noise"):
        vb.smooth(bare)


def test_the_command_line_smooths(
    swept: Sweep, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The recording as a file: same columns, contacts of the same quality, start and end in the
    summary.
    """
    setup = tmp_path / "setup.toml"
    setup.write_text(SETUP, encoding="utf-8")
    recording, contacts = (
        write_recording(tmp_path / "trail.csv", swept.raw),
        tmp_path / "contacts.csv",
    )
    reconstruct(recording, setup, output=[contacts], smooth=True, as_json=True)
    summary = json.loads(capsys.readouterr().out)
    (contact,) = summary["contacts"]
    assert abs(contact["start"] - swept.span[0]) < 4 * contact["start_deviation"]
    table = np.genfromtxt(contacts, delimiter=",", names=True)
    assert table.dtype.names == COLUMNS
    rows = core(swept)
    error = np.linalg.norm(
        np.stack([table[axis] for axis in "xyz"], axis=1)[rows] - swept.point[rows], axis=1
    )
    assert np.median(error) < 0.15e-3
    setup.write_text(
        SETUP.replace("force_noise", "# force_noise").replace("torque_noise", "# torque_noise"),
        encoding="utf-8",
    )
    with pytest.raises(InputError, match=r"--smooth: .* gives no noise; allowed"):
        reconstruct(recording, setup, smooth=True)


def test_a_constraint_is_no_evidence_for_its_phase() -> None:
    """Without friction k² = ½ holds in tangential contact. Were its density counted, tangential
    phases would reach into tip contact, and normals there be sure and wrong.
    """
    quick, distance = vb.Trail(np.linspace([0.03, 0.005, 0.0], [-0.03, 0.005, 0.0], 240)), []
    scan = vb.scan(WIRE, BALL, quick)
    sensor = replace(SENSOR, force_noise=1e-3, torque_noise=1e-5, tare_seconds=0.5)
    rows = np.maximum(np.arange(300) - 60, 0)
    true = vb.Reactions(
        vb.Trail(quick.position[rows]),
        scan.reactions.force[rows],
        scan.reactions.moment[rows],
        time=np.arange(300) / 100.0,
    )
    changes = (
        np.flatnonzero((np.diff(scan.kind) != 0) & (scan.kind[1:] > 0) & (scan.kind[:-1] > 0)) + 61
    )
    for seed in range(3):
        found = vb.smooth(
            vb.reconstruct(
                WIRE,
                sensor.reactions(sensor.measure(true, np.random.default_rng(seed))),
                friction=0.0,
            )
        )
        assert found.smoothing is not None and found.normal_covariance is not None
        (touch,) = found.smoothing[0].touches
        assert np.all(
            np.abs(np.array(touch.changes) - changes)
            < 3 + 3 * 100 * np.array(touch.change_deviations)
        )
        both = np.flatnonzero(found.in_contact[60:] & scan.in_contact)
        plane = np.linalg.svd(scan.normal[both][:, :, None])[0][:, :, 1:]
        error = np.einsum("nik,ni->nk", plane, found.normal[60:][both] - scan.normal[both])
        spread = np.swapaxes(plane, 1, 2) @ found.normal_covariance[60:][both] @ plane
        distance.append(
            np.einsum("ni,ni->n", error, np.linalg.solve(spread, error[..., None])[..., 0])
        )
    assert np.mean(np.concatenate(distance) < chi2.isf(0.05, 2)) > 0.92
