"""The sensor as a model, and back: what `measure` adds, `reactions` takes off, with the errors that
it states.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from simulated import (
    CONTACT,
    FORCE_TARE,
    RATE,
    REST,
    TORQUE_TARE,
    changed,
    logged,
    only,
    pushed,
    sensor,
)

import vibrissa as vb
from vibrissa.sensor import PRESETS, LowPass, Mount, RawRecording, Sensor, preset

QUIET = {
    "force_noise": None,
    "torque_noise": None,
    "force_resolution": 0.0,
    "torque_resolution": 0.0,
    "position_noise": 0.0,
}
CROSS_TALK = np.eye(6) + np.random.default_rng(4).normal(scale=0.02, size=(6, 6)) * np.outer(
    [1, 1, 1, 0.02, 0.02, 0.02], [1, 1, 1, 50, 50, 50]
)
EXTRAS = {
    "cross_talk": CROSS_TALK,
    "mount": Mount(0.031, (0.002, -0.001, 0.014)),
    "force_drift": (1e-3, -2e-3, 4e-3),
    "torque_drift": (2e-6, 1e-6, -5e-6),
}


@pytest.mark.parametrize("wrench_frame", ["sensor", "world"])
@pytest.mark.parametrize("wrench", ["on_sensor", "on_rod"])
@pytest.mark.parametrize(
    "parts",
    [["cross_talk"], ["mount"], ["force_drift", "torque_drift"], list(EXTRAS)],
    ids="-".join,
)
def test_what_is_measured_is_undone(wrench: str, wrench_frame: str, parts: list[str]) -> None:
    """On a sensor that turns."""
    truth = pushed(turning=1.2)
    of = sensor(
        **QUIET, wrench=wrench, wrench_frame=wrench_frame, **{name: EXTRAS[name] for name in parts}
    )
    found = of.reactions(logged(of, truth))
    np.testing.assert_allclose(found.force, truth.force, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.moment, truth.moment, rtol=0, atol=1e-11)
    np.testing.assert_allclose(found.trail.position, truth.trail.position, rtol=0, atol=1e-14)


@pytest.mark.parametrize("wrench_frame", ["sensor", "world"])
def test_gains_left_out_are_factors_of_the_true_channels_whatever_the_cross_talk(
    wrench_frame: str,
) -> None:
    """What a calibration of gains multiplies: with the cross-talk undone alone, the wrench in
    sensor axes is the true one times the gains.
    """
    gain = (1.1, 0.9, 1.05, 0.8, 1.2, 0.95)
    talk = np.eye(6) + 0.03 * np.random.default_rng(2).normal(size=(6, 6))
    options = {
        "wrench_frame": wrench_frame,
        "wrench": "on_rod",
        "cross_talk": talk,
        "wrench_point": (0.001, 0.002, 0.025),
        "tare_seconds": 0.0,
    }
    options |= {
        "force_noise": None,
        "torque_noise": None,
        "force_resolution": 0.0,
        "torque_resolution": 0.0,
        "position_noise": 0.0,
    }
    given = pushed(turning=0.5)
    raw = sensor(**options, gain=gain).measure(given, np.random.default_rng(0))
    found = sensor(**options).reactions(raw)
    turn = Rotation.from_quat(raw.orientation).inv()
    for part, of, factors in (
        (found.force, given.force, gain[:3]),
        (found.moment, given.moment, gain[3:]),
    ):
        np.testing.assert_allclose(turn.apply(part), turn.apply(of) * factors, rtol=0, atol=1e-12)


def test_a_mount_weighs_by_the_lever_arm_of_its_centre() -> None:
    """One pose by hand: the sensor upside down, 100 g 20 mm beside its origin; the torque about a
    point 5 mm away.
    """
    of = Sensor(
        np.zeros(3),
        np.array([0, 0, 0, 1.0]),
        "on_sensor",
        wrench_point=(0.0, 0.0, 0.005),
        mount=Mount(0.1, (0.02, 0.0, 0.0), (0.0, 0.0, -10.0)),
    )
    still = vb.Reactions(
        vb.Trail(np.zeros((2, 3)), (1.0, 0.0, 0.0, 0.0)),
        np.zeros((2, 3)),
        np.zeros((2, 3)),
        time=[0.0, 1.0],
    )
    raw = of.measure(still, np.random.default_rng(0))
    np.testing.assert_allclose(raw.force, np.tile([0.0, 0.0, 1.0], (2, 1)), atol=1e-15)
    np.testing.assert_allclose(raw.torque, np.tile([0.0, -0.02, 0.0], (2, 1)), atol=1e-15)


def test_the_default_draws_are_white_noise_of_position_force_and_torque_in_this_order() -> None:
    of, truth = sensor(), pushed()
    raw, rng = logged(of, truth, seed=3), np.random.default_rng(3)
    exact = logged(sensor(**QUIET), truth)
    np.testing.assert_array_equal(
        raw.position, exact.position + rng.normal(0, 1e-5, exact.position.shape)
    )
    for part, noise, step in (("force", 2e-3, 1.5625e-3), ("torque", 4e-5, 7.8125e-6)):
        noisy = getattr(exact, part) + rng.normal(0, noise, exact.force.shape)
        np.testing.assert_allclose(
            getattr(raw, part), np.round(noisy / step) * step, rtol=0, atol=1e-12
        )


def test_the_same_state_gives_the_same_recording() -> None:
    of = sensor(
        noise_corner=3.0, force_random_walk=1e-3, torque_random_walk=1e-5, orientation_noise=1e-4
    )
    first, second, third = (logged(of, pushed(), seed=seed) for seed in (5, 5, 6))
    for name in ("time", "position", "orientation", "force", "torque"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert not np.array_equal(first.force, third.force)


def test_readings_end_at_the_range_on_a_step() -> None:
    of = sensor(force_range=(0.5, 0.2, 1.999), torque_range=(0.004, 0.01, 0.01))
    raw = logged(of, pushed())
    step = of.force_resolution
    assert raw.force[:, 2].max() == pytest.approx(np.floor(1.999 / step) * step, abs=1e-12)
    assert np.abs(raw.force[:, 1]).max() <= 0.2
    assert np.abs(raw.torque[:, 0]).max() <= 0.004
    np.testing.assert_allclose(raw.force / step, np.round(raw.force / step), atol=1e-6)


def test_the_robots_orientation_is_noisy_as_stated() -> None:
    of = sensor(orientation_noise=2e-3)
    truth = logged(sensor(), pushed(turning=1.0)).orientation
    turns = (
        Rotation.from_quat(logged(of, pushed(turning=1.0)).orientation)
        * Rotation.from_quat(truth).inv()
    ).as_rotvec()
    low, high = chi2.interval(0.9999, turns.size) / np.float64(turns.size)
    assert low < np.mean(turns**2) / 2e-3**2 < high


def test_a_filtered_recording_comes_late_by_the_lag() -> None:
    truth, late = pushed(), LowPass(30.0, 2, delay=0.02)
    raw, shifted = logged(sensor(**QUIET), truth), logged(sensor(**QUIET, low_pass=late), truth)
    slow = np.stack(
        [np.interp(raw.time - late.lag, raw.time, column) for column in raw.wrench.T], axis=1
    )
    scale = np.ptp(raw.wrench, axis=0)
    assert (
        np.abs((shifted.wrench - slow) / scale).max()
        < 0.01
        < np.abs((shifted.wrench - raw.wrench) / scale).max()
    )


COLOURED = {"noise_corner": 5.0, "force_random_walk": 1.5e-3, "torque_random_walk": 3e-5}


@pytest.mark.parametrize(
    ("options", "turning"),
    [
        ({"tare_seconds": 0.2}, 0.0),
        ({"tare_seconds": 0.2, **COLOURED}, 0.0),
        ({"rest_intervals": ((0.0, 0.2), (0.9, 1.1)), "estimate_drift": True}, 1.0),
        (
            {
                "rest_intervals": ((0.0, 0.2), (0.9, 1.1)),
                "estimate_drift": True,
                "cross_talk": CROSS_TALK,
                **COLOURED,
            },
            1.0,
        ),
        ({"tare_seconds": 0.2, "force_resolution": 8e-3, "torque_resolution": 1.6e-4}, 0.0),
        ({"tare_seconds": 0.0, **COLOURED}, 1.0),
    ],
    ids=["white", "coloured", "drift", "all", "coarse", "no tare"],
)
def test_the_stated_covariance_is_that_of_many_recordings(
    options: dict[str, object], turning: float
) -> None:
    """Of rows during rest, in contact and at the end. Coarse steps are judged over all offsets, as
    a mean of a constant rounds always the same way.
    """
    of, truth = sensor(**options), pushed(turning=turning, before=60, during=150, after=70)
    reader = replace(
        of,
        force_noise=None,
        torque_noise=None,
        noise_corner=0.0,
        force_random_walk=0.0,
        torque_random_walk=0.0,
    )
    rows, trials = [120, 190, 275], 400
    samples, rng = np.empty((trials, len(rows), 6)), np.random.default_rng(12)
    offset = 0.0 if of.tare_seconds == 0 else 1.0
    for sample in samples:
        tare = offset * rng.uniform(-0.01, 0.01, 3), offset * rng.uniform(-2e-4, 2e-4, 3)
        raw = of.measure(truth, rng, force_tare=tare[0], torque_tare=tare[1])
        found = reader.reactions(raw)
        sample[:] = np.concatenate(
            [found.force - truth.force, found.moment - truth.moment], axis=1
        )[rows]
    covariance = of.reactions(raw).covariance
    assert covariance is not None
    stated = np.broadcast_to(covariance, (len(truth.force), 6, 6))[rows]
    for row in range(len(rows)):
        root = np.linalg.inv(np.linalg.cholesky(stated[row]))
        seen = root @ (samples[:, row].T @ samples[:, row] / trials) @ root.T
        np.testing.assert_allclose(seen, np.eye(6), rtol=0, atol=4.5 * np.sqrt(2 / trials))


def poses(count: int, seconds: float = 1.0) -> vb.Reactions:
    """A sensor that rests in several orientations, and turns quickly from one to the next."""
    rows = int(seconds * RATE)
    turns = np.repeat(Rotation.random(count, random_state=8).as_quat(), rows, axis=0)
    return vb.Reactions(
        vb.Trail(np.zeros((len(turns), 3)), turns),
        np.zeros((len(turns), 3)),
        np.zeros((len(turns), 3)),
        time=np.arange(len(turns)) / RATE,
    )


@pytest.mark.parametrize("wrench", ["on_sensor", "on_rod"])
@pytest.mark.parametrize("given", [True, False], ids=["rest given", "rest found"])
def test_a_mounts_mass_and_centre_are_found_from_rest_in_several_orientations(
    wrench: str, *, given: bool
) -> None:
    weight = Mount(0.05, (0.004, -0.003, 0.02))
    of = sensor(wrench=wrench, mount=weight, cross_talk=CROSS_TALK)
    raw = logged(of, poses(6), seed=2)
    intervals = tuple((second + 0.1, second + 0.9) for second in range(6)) if given else ()
    tare = replace(of, mount=Mount(estimated=True), rest_intervals=intervals).tare(raw)
    assert tare.mount is not None
    # 2 mN over the root of 200 samples and six poses, against 0.5 N: some 1e-4 of the weight, and
    # as much of the centre's arm.
    assert tare.mount.mass == pytest.approx(0.05, rel=1e-3)
    np.testing.assert_allclose(tare.mount.center, weight.center, rtol=0, atol=5e-5)
    np.testing.assert_allclose(tare.offset, [*FORCE_TARE, *TORQUE_TARE], rtol=0, atol=1e-3)
    assert len(tare.intervals) == 6


def test_a_mount_that_the_poses_do_not_determine_is_refused() -> None:
    of = sensor(mount=Mount(0.05, (0.004, -0.003, 0.02)))
    unknown = replace(of, mount=Mount(estimated=True))
    with pytest.raises(
        ValueError,
        match=r"do not determine it .*rest intervals in at least three orientations",
    ):
        unknown.tare(logged(of, poses(1)))
    pushed_on = changed(logged(of, poses(6)), slice(500, 740), 0, 1.0)
    with pytest.raises(
        ValueError,
        match=r"scatter by .* standard deviations about those of a weight; allowed is noise",
    ):
        unknown.tare(pushed_on)
    turning = replace(unknown, rest_intervals=((0.1, 1.5), (2.1, 2.9), (3.1, 3.9)))
    with pytest.raises(
        ValueError, match=r"turns by .*° within a rest interval; allowed is at most 0.5°"
    ):
        turning.tare(logged(of, poses(6)))


def test_rest_is_found_and_ends_before_the_contact() -> None:
    of = sensor()
    tare = of.tare(logged(of, pushed()))
    assert tare.found == "found automatically"
    ((start, stop),) = tare.intervals
    assert start == 2.0
    # The load exceeds six standard errors of a block a few hundredths of a second after its start.
    assert 2.5 < stop <= 2.0 + REST / RATE + 0.05
    spread = np.sqrt(of.reading_variance / tare.counts[0])
    assert np.all(np.abs(tare.offset - [*FORCE_TARE, *TORQUE_TARE]) < 5 * spread)


def test_drift_is_found_from_rest_at_both_ends() -> None:
    drift = {"force_drift": (5e-3, -2e-3, 1e-3), "torque_drift": (1e-4, 0.0, -5e-5)}
    of, truth = sensor(**drift), pushed()
    raw = logged(of, truth)
    unknown = sensor(estimate_drift=True)
    tare = unknown.tare(raw)
    # The mean of 100 samples at either end, 4 s apart.
    np.testing.assert_allclose(
        tare.drift[:3], drift["force_drift"], rtol=0, atol=5 * 2.1e-3 * np.sqrt(2 / 100) / 4
    )
    np.testing.assert_allclose(
        tare.drift[3:], drift["torque_drift"], rtol=0, atol=5 * 4e-5 * np.sqrt(2 / 100) / 4
    )
    error = unknown.reactions(raw).force - truth.force
    without = sensor().reactions(raw).force - truth.force
    assert (
        np.linalg.norm(error[REST:-REST].mean(axis=0))
        < 5e-4
        < np.linalg.norm(without[REST:-REST].mean(axis=0))
    )


def test_a_recording_that_starts_in_contact_is_refused() -> None:
    of = sensor()
    raw = logged(of, pushed())
    words = r"starts in contact or under a changing load \(the wrench does not change from .* s to .* s after its start\); allowed are tare_seconds or rest_intervals"
    with pytest.raises(ValueError, match=words):
        of.tare(only(raw, np.arange(REST + 100, len(raw.time))))
    # The clamp stands still in contact, at a wrench that does not change, before the sweep goes on
    # and ends free.
    held = np.concatenate([np.full(300, REST + 400), np.arange(REST + 400, len(raw.time))])
    truth = pushed()
    still = vb.Reactions(
        vb.Trail(truth.trail.position[held], truth.trail.orientation[held]),
        truth.force[held],
        truth.moment[held],
        time=np.arange(len(held)) / RATE,
    )
    with pytest.raises(
        ValueError,
        match=r"the rest at the start, to .* s, seems to be in contact: the one at the end",
    ):
        of.tare(logged(of, still))
    # The other way round it starts free, and ends while the clamp stands still in contact.
    ending = np.concatenate([np.arange(REST + 400), np.full(300, REST + 400)])
    stopped = vb.Reactions(
        vb.Trail(truth.trail.position[ending], truth.trail.orientation[ending]),
        truth.force[ending],
        truth.moment[ending],
        time=np.arange(len(ending)) / RATE,
    )
    assert of.tare(logged(of, stopped)).intervals[0][0] == 0.0


def test_a_short_or_noiseless_recording_has_its_rest_too() -> None:
    exact = sensor(**QUIET)
    assert exact.tare(logged(exact, pushed())).counts[0] > 150
    with pytest.raises(ValueError, match="tare_seconds is not given"):
        exact.tare(only(logged(exact, pushed()), np.arange(5)))


def test_rows_without_numbers_are_left_out_of_the_tare_and_stay_without() -> None:
    of = sensor(tare_seconds=0.5)
    raw = logged(of, pushed())
    holes = changed(raw, slice(20, 30), slice(0, 6), np.nan)
    found = of.reactions(holes)
    assert np.flatnonzero(np.isnan(found.force).any(axis=1)).tolist() == list(range(20, 30))
    left = np.delete(np.arange(125), np.arange(20, 30))
    np.testing.assert_allclose(of.tare(holes).offset, raw.wrench[left].mean(axis=0), rtol=1e-12)
    one = of.reactions(changed(raw, 700, 2, np.nan))
    assert np.isnan(one.force[700]).all()
    assert np.isnan(one.moment[700]).all()


BAD = {
    "walk": (
        {"force_random_walk": -1.0},
        "force_random_walk = -1.0; allowed is a finite number of at least 0",
    ),
    "corner": (
        {"noise_corner": np.inf},
        "noise_corner = inf; allowed is a finite number of at least 0",
    ),
    "colour without white": (
        {**QUIET, "noise_corner": 1.0},
        "noise_corner = 1.0 without force_noise and torque_noise; allowed is 0",
    ),
    "range": (
        {"force_range": (1.0, 0.0, 1.0)},
        "force_range = (1.0, 0.0, 1.0); allowed are 3 finite numbers greater than 0",
    ),
    "drift": (
        {"torque_drift": (0.0, np.nan, 0.0)},
        "torque_drift[1] = nan; allowed are finite numbers",
    ),
    "singular": ({"cross_talk": np.ones((6, 6))}, "cross_talk has the condition"),
    "shape": ({"cross_talk": np.ones((5, 6))}, "cross_talk has shape (5, 6); allowed is (6, 6)"),
    "order": (
        {"rest_intervals": ((1.0, 2.0), (0.0, 0.5))},
        "rest_intervals = ((1.0, 2.0), (0.0, 0.5)); allowed are pairs",
    ),
    "overlap": (
        {"rest_intervals": ((0.0, 2.0), (1.0, 3.0))},
        "allowed are pairs (start, stop) of at least 0, in order, that do not overlap",
    ),
    "empty": ({"rest_intervals": ((1.0, 1.0),)}, "allowed are pairs"),
}


@pytest.mark.usefixtures("no_shape_checks")
@pytest.mark.parametrize("what", BAD)
def test_what_is_wrong_is_named(what: str) -> None:
    options, message = BAD[what]
    with pytest.raises(ValueError, match=re.escape(message)):
        sensor(**options)


UNFIT = {
    "empty rest": (
        {"rest_intervals": ((100.0, 101.0),)},
        "rest from 100 s to 101 s holds 0 good samples; allowed are at least 2",
    ),
    "one rest": (
        {"rest_intervals": ((0.0, 0.5),), "estimate_drift": True},
        "estimate_drift = True with 1 rest intervals, which do not determine it",
    ),
    "no tare": (
        {"tare_seconds": 0.0, "estimate_drift": True},
        "estimate_drift = True with tare_seconds = 0; allowed are rest_intervals",
    ),
    "no mount": (
        {"tare_seconds": 0.0, "mount": Mount(estimated=True)},
        "mount.estimated = True with tare_seconds = 0",
    ),
}


@pytest.mark.parametrize("what", UNFIT)
def test_what_does_not_fit_the_recording_is_named(what: str) -> None:
    options, message = UNFIT[what]
    with pytest.raises(ValueError, match=re.escape(message)):
        sensor(**options).tare(logged(sensor(), pushed()))


def test_no_rest_at_the_end_is_no_drift() -> None:
    raw = only(logged(sensor(), pushed()), np.arange(REST + CONTACT // 2))
    for seconds in (None, 0.5):
        with pytest.raises(
            ValueError,
            match="estimate_drift = True: no rest is found at the end of the recording; allowed are rest_intervals",
        ):
            sensor(tare_seconds=seconds, estimate_drift=True).tare(raw)


def test_presets_hold_a_sheets_figures() -> None:
    """Robotiq states 300 N and 30 N m; ATI 12 N, 17 N along z, 1/320 N and 1/64 N mm for the finest
    calibration of the Nano17, and twice and four times these steps.
    """
    for name in PRESETS:
        of = preset(name, clamp_position=(0, 0, 0.02))
        if name.startswith("ati_axia80"):
            assert of.force_noise is None
        else:
            assert of.force_noise is not None
            assert np.all(of.noise.white >= of.noise.resolution)
    assert preset("ati_axia80_m20_si_500_20").force_range == (500.0, 500.0, 900.0)
    nano = preset("ati_nano17_si_12_0_12")
    assert (nano.force_range, nano.torque_range) == ((12.0, 12.0, 17.0), (0.12, 0.12, 0.12))
    assert (nano.force_resolution, nano.torque_resolution) == (1 / 320, pytest.approx(1e-3 / 64))
    assert preset("ati_nano17_si_25_0_25").force_resolution == 1 / 160
    assert preset("ati_nano17_si_50_0_5").torque_resolution == pytest.approx(1e-3 / 16)
    np.testing.assert_allclose(
        preset("ati_mini40_si_40_2").noise.white, [0.01, 0.01, 0.02, 2.5e-4, 2.5e-4, 2.5e-4]
    )
    assert preset("ati_mini45_si_145_5").torque_resolution == (1 / 752, 1 / 752, 1 / 1504)
    assert preset("robotiq_ft_300_s").force_range == (300.0, 300.0, 300.0)
    with pytest.raises(ValueError, match="preset = 'nano'; allowed are ati_nano17_si_12_0_12"):
        preset("nano")


def test_each_axis_has_its_own_noise_steps_and_walk() -> None:
    """Three numbers in place of one: what is logged scatters so, is rounded so, and the covariance
    of reactions and the tare say the same.
    """
    figures = {
        "force_noise": (1e-3, 2e-3, 5e-3),
        "torque_noise": (4e-5, 1e-5, 8e-5),
        "force_resolution": (0.0, 1e-4, 2e-3),
    }
    own = sensor(**figures, torque_random_walk=(0.0, 0.0, 1e-5), tare_seconds=1.0)
    time = np.arange(20_000) / 1000
    still = vb.Reactions(
        vb.Trail(np.zeros((len(time), 3))),
        np.zeros((len(time), 3)),
        np.zeros((len(time), 3)),
        time=time,
    )
    raw = own.measure(still, np.random.default_rng(3))
    np.testing.assert_allclose(
        np.std(np.diff(raw.wrench, axis=0), axis=0) / np.sqrt(2),
        np.sqrt(own.reading_variance),
        rtol=0.02,
    )
    np.testing.assert_allclose(raw.force[:, 2] / 2e-3, np.round(raw.force[:, 2] / 2e-3), atol=1e-9)
    ends = np.std(
        [
            own.measure(still, np.random.default_rng(seed)).torque[-50:].mean(axis=0)
            for seed in range(24)
        ],
        axis=0,
    )
    assert ends[2] == pytest.approx(1e-5 * np.sqrt(20), rel=0.5)
    assert ends[0] < 1e-5
    told = own.tare(raw).covariance(own, raw.time, raw.orientation)[-1]
    np.testing.assert_allclose(np.diag(told)[:5], own.reading_variance[:5], rtol=5e-3)
    assert np.sqrt(told[5, 5] - own.reading_variance[5]) == pytest.approx(
        1e-5 * np.sqrt(20), rel=0.05
    )
    one = sensor(force_noise=2e-3, torque_noise=3e-5, force_resolution=1e-3)
    same = sensor(force_noise=(2e-3,) * 3, torque_noise=(3e-5,) * 3, force_resolution=(1e-3,) * 3)
    first, second = (which.measure(pushed(), np.random.default_rng(5)) for which in (one, same))
    np.testing.assert_array_equal(first.wrench, second.wrench)


def test_measured_rows_are_those_of_a_recording() -> None:
    raw = logged(sensor(), pushed())
    assert isinstance(raw, RawRecording)
    assert raw.rate == pytest.approx(RATE)


def test_coarse_steps_leave_a_random_walk_as_it_is() -> None:
    """A tare from noise far below a step: the walk's share of the covariance is that of fine steps,
    its variance since the tare's mean.
    """
    walk, rest, count, rate = 4e-4, 0.5, 1000, 250.0
    time = np.arange(count) / rate
    still = np.zeros((count, 3))
    trail = vb.Trail(still)
    shares = []
    for step in (0.0, 0.02):
        coarse = sensor(
            tare_seconds=rest,
            force_noise=1e-3,
            force_resolution=step,
            force_random_walk=walk,
            clamp_orientation=np.array([0.0, 0, 0, 1]),
        )
        truth = vb.Reactions(trail, still, still, time=time)
        rough, plain = (
            each.reactions(each.measure(truth, np.random.default_rng(0))).covariance
            for each in (coarse, replace(coarse, force_random_walk=0.0))
        )
        assert rough is not None
        assert plain is not None
        shares.append(rough[:, 0, 0] - np.broadcast_to(plain, rough.shape)[:, 0, 0])
    later = time > rest
    np.testing.assert_allclose(
        shares[0][later], walk**2 * (time[later] - rest + rest / 3), rtol=1e-6
    )
    np.testing.assert_allclose(shares[1][later], shares[0][later], rtol=1e-6)
