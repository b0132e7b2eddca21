"""Rod and mount from sweeps over a ball that the forward solver made, by readings that the
calibration predicts on its own.
"""

import re
import warnings
from dataclasses import replace

import jax
import numpy as np
import pytest
from calibration_bench import (
    BALL,
    CLAMP,
    NAMES,
    REST,
    TURN,
    WIRE,
    recordings,
    sensor,
    setup,
    swept,
    true_values,
    wrong,
)
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import vibrissa as vb
from vibrissa.calibration.bench import NO_STEP, bench_of, moved
from vibrissa.calibration.equilibrium import Pose, State, readings

POSE = ("youngs_modulus", "length", "clamp_position", "clamp_orientation", "tare")


@pytest.mark.parametrize("signs", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_without_noise_the_truth_is_found(signs: tuple[int, int]) -> None:
    """From 20 %, 3 %, 2 mm and 3° off, with all signs: exact forward solutions lead back to the
    numbers they were made with.
    """
    exact = sensor(1e-5)
    start = wrong(setup(exact), signs)
    found = vb.calibrate(recordings(exact), start)
    for name, value in true_values(start).items():
        assert found.estimates[name].value == pytest.approx(value, rel=2e-6, abs=2e-8), name
    axis = Rotation.from_quat(found.setup.sensor.clamp_orientation).apply([0, 0, 1])
    np.testing.assert_allclose(axis, TURN.apply([0, 0, 1]), atol=1e-7)
    np.testing.assert_allclose(found.tare, 0, atol=1e-6)
    assert found.setup.rod.bending_stiffness == pytest.approx(WIRE.bending_stiffness, rel=2e-6)
    assert found.surface is BALL


def test_errors_are_as_large_as_stated() -> None:
    """In eight repeats the squared errors in the metric of the stated covariance are those of seven
    unknowns each, and residuals are white noise.
    """
    noisy, total, inside = sensor(), 0.0, 0
    start = wrong(setup(noisy))
    truth = true_values(start)
    for seed in range(8):
        found = vb.calibrate(recordings(noisy, seed), start)
        assert found.identifiability.names == NAMES
        error = np.array([found.estimates[name].value - truth[name] for name in NAMES])
        total += float(error @ np.linalg.solve(found.covariance, error))
        inside += sum(
            low <= truth[name] <= high for name in NAMES for low, high in [found.interval(name)]
        )
        assert found.fitness.reduced_chi_square == pytest.approx(1, abs=0.15)
        np.testing.assert_array_equal(found.fitness.inflation, 1)
    assert chi2.ppf(1e-3, 56) < total < chi2.isf(1e-3, 56)
    assert inside >= 0.85 * 56


def test_reactions_and_raw_logs_say_the_same() -> None:
    noisy = sensor()
    start, raw = wrong(setup(noisy)), recordings(noisy)
    first, second = (
        vb.calibrate(rows, start) for rows in (raw, [start.sensor.reactions(one) for one in raw])
    )
    np.testing.assert_allclose(first.covariance, second.covariance, rtol=1e-6)
    assert first.estimates["length"].value == pytest.approx(
        second.estimates["length"].value, rel=1e-12
    )


def test_the_roll_about_the_rod_s_axis_is_open_and_stays() -> None:
    """A round straight rod looks alike however it is turned about its axis."""
    noisy = sensor()
    found = vb.calibrate(recordings(noisy), setup(noisy), free=POSE)
    roll = found.estimates["clamp_orientation_z"]
    assert not roll.determined
    assert roll.value == pytest.approx(0, abs=1e-12)
    assert np.isnan(roll.interval()).all()
    assert found.identifiability.held == {"clamp_orientation_z": ()}
    assert (
        "clamp_orientation_z: not determined, kept as given; the readings do not depend on it"
        in found.identifiability.text
    )


def test_a_common_gain_cannot_be_told_from_the_stiffness() -> None:
    """All six reactions grow with EI as they do with the gain: with one of the factors held, the
    others are found up to it.
    """
    gain = (1.02, 1.02, 1.02, 0.99, 0.99, 0.99)
    uneven = sensor(0.01, gain=gain)
    start = wrong(setup(sensor(0.01)))
    found = vb.calibrate(recordings(uneven), start, free=(*POSE, "force_gain", "torque_gain"))
    held = found.identifiability.held["torque_gain"]
    assert set(held) == {"youngs_modulus", "force_gain"}
    assert found.estimates["torque_gain"].value == 1
    assert found.estimates["youngs_modulus"].holds_for == ("torque_gain",)
    assert found.estimates["length"].holds_for == ()
    assert found.estimates["youngs_modulus"].value == pytest.approx(0.99 * 206e9, rel=1e-4)
    assert found.estimates["force_gain"].value == pytest.approx(1.02 / 0.99, rel=1e-4)
    assert found.estimates["length"].value == pytest.approx(0.05, rel=1e-4)


def test_with_known_stiffness_each_channel_s_gain_is_found() -> None:
    gain = (1.02, 0.98, 1.01, 0.99, 1.03, 0.97)
    uneven, truth = sensor(0.01, gain=gain), setup(sensor(0.01))
    found = vb.calibrate(recordings(uneven), truth, free=("length", "clamp_position", "gain"))
    assert found.setup.sensor.gain == pytest.approx(gain, rel=3e-4)
    errors = [
        (found.estimates[f"gain_{name}"].value - value) / found.estimates[f"gain_{name}"].deviation
        for name, value in zip(_CHANNELS, gain, strict=True)
    ]
    assert np.abs(errors).max() < 4


_CHANNELS = ("force_x", "force_y", "force_z", "torque_x", "torque_y", "torque_z")


def test_a_ball_that_is_not_where_it_was_given() -> None:
    """Its place is found along with the rod; how it is turned leaves no trace."""
    noisy = sensor(0.01)
    moved = replace(
        wrong(setup(noisy)),
        surface=vb.surfaces.Sphere(center=(0.001, -0.0015, 0.0565), radius=0.03),
    )
    found = vb.calibrate(
        recordings(noisy), moved, free=(*POSE, "object_position", "object_orientation")
    )
    shift = [found.estimates[f"object_position_{axis}"].value for axis in "xyz"]
    np.testing.assert_allclose(shift, [-0.001, 0.0015, 0.001], atol=3e-6)
    assert {f"object_orientation_{axis}" for axis in "xyz"} <= set(found.identifiability.held)
    assert found.estimates["length"].value == pytest.approx(0.05, rel=1e-4)
    on_it = np.array([0.0, 0.03, 0.0575])
    assert found.surface.levels(on_it) == pytest.approx(0, abs=5e-6)
    assert found.setup.surface is found.surface


def test_a_rod_that_touches_before_the_ball_as_given() -> None:
    """A ball that is 20 µm thicker than stated: this is found if it is free, and else taken for
    unevenness; the stiffness stays true.
    """
    noisy = sensor(0.3)
    thin = replace(
        wrong(setup(noisy)), surface=vb.surfaces.Sphere(center=BALL.center, radius=0.03 - 2e-5)
    )
    found, held = (
        vb.calibrate(recordings(noisy), thin, free=free) for free in ((*POSE, "standoff"), POSE)
    )
    assert found.estimates["standoff"].value == pytest.approx(
        2e-5, abs=4 * found.estimates["standoff"].deviation
    )
    assert found.estimates["standoff"].deviation < 4e-6
    assert found.unevenness == 0
    assert 5e-6 < held.unevenness < 5e-5
    for result in (found, held):
        stiffness = result.estimates["youngs_modulus"]
        assert abs(stiffness.value - 206e9) < 4 * stiffness.deviation


def test_a_robot_that_wanders_off_its_path() -> None:
    """By 15 µm, up and down: its size is found, and all intervals hold the truth. On its path, none
    is found.
    """
    noisy = sensor(0.3)
    start, rows = wrong(setup(noisy)), recordings(noisy)
    straight = vb.calibrate(rows, start, free=POSE)
    for index, row in enumerate(rows):
        row.position[:, 2] += 15e-6 * np.sqrt(2) * np.sin(2 * np.pi * row.time / 1.1 + index)
    found = vb.calibrate(rows, start, free=POSE)
    assert straight.unevenness == 0
    assert found.unevenness == pytest.approx(15e-6, rel=0.5)
    for name, value in true_values(start).items():
        assert abs(found.estimates[name].value - value) < 3.5 * found.estimates[name].deviation, (
            name
        )
    assert found.estimates["length"].deviation > 1.2 * straight.estimates["length"].deviation
    assert found.fitness.whiteness > 1e-3


def test_a_stretch_in_which_the_rod_swings_is_left_out() -> None:
    """Forty samples in a row that are off by some six deviations, to and fro: they are left out
    with those about them, and the rest is explained by noise.
    """
    noisy = sensor()
    start, rows = setup(noisy), recordings(noisy)
    swinging = slice(REST + 100, REST + 140)
    rows[0].force[swinging] += 0.012 * np.sin(np.arange(40) / 1.5)[:, None]
    rows[0].torque[swinging] += 2.4e-4 * np.cos(np.arange(40) / 1.5)[:, None]
    with pytest.warns(vb.RecordingWarning, match="of the rows in contact do not fit"):
        found = vb.calibrate(rows, start, free=POSE)
    left_out = found.residuals.time[
        (found.residuals.weight == 0) & (found.residuals.recording == 0)
    ]
    first, last = rows[0].time[[REST + 100, REST + 139]]
    assert left_out.min() <= first
    assert left_out.max() >= last
    assert 0.1 < found.fitness.disturbed < 0.3
    for name, value in true_values(start).items():
        assert abs(found.estimates[name].value - value) < 3.5 * found.estimates[name].deviation, (
            name
        )
    # Kept, they leave residuals correlated in time, and a spread 1.6 times the noise's.
    assert found.fitness.whiteness > 1e-3
    np.testing.assert_array_equal(found.fitness.inflation, 1)
    assert found.unevenness == 0


def test_a_prior_holds_what_the_data_do_not() -> None:
    """With EI as well as both gains free, a prior on one makes all determined: to EI's variance it
    adds its own, as EI stands for it.
    """
    noisy = sensor()
    rows, start = recordings(noisy), setup(noisy)
    without = vb.calibrate(rows, start, free=(*POSE, "force_gain"))
    found = vb.calibrate(
        rows, start, free=(*POSE, "torque_gain", "force_gain"), prior={"torque_gain": 0.005}
    )
    assert "torque_gain" not in found.identifiability.held
    alone, stiffness = (
        result.estimates["youngs_modulus"].deviation / 206e9 for result in (without, found)
    )
    assert stiffness == pytest.approx(np.hypot(alone, 0.005), rel=0.02)
    assert found.estimates["torque_gain"].deviation == pytest.approx(0.005, rel=0.02)


def test_what_is_not_free_is_as_given() -> None:
    noisy = sensor()
    truth = setup(noisy)
    found = vb.calibrate(
        recordings(noisy),
        replace(truth, rod=replace(WIRE, bending_stiffness=1.1 * WIRE.bending_stiffness)),
        free=("bending_stiffness",),
    )
    assert found.setup.rod.length == WIRE.length
    np.testing.assert_array_equal(found.setup.sensor.clamp_position, CLAMP)
    low, high = found.interval("bending_stiffness", 0.999)
    assert low < WIRE.bending_stiffness < high


@pytest.mark.parametrize("leaning", [0.0, 0.05])
def test_derivatives_are_those_of_the_readings(leaning: float) -> None:
    """Of each parameter and of the tangential force, against central differences of solved
    equilibria.
    """
    reactions = swept(0.005)
    rows = np.flatnonzero(np.linalg.norm(reactions.force, axis=1) > 0.03)[5:-5:20]
    position = reactions.trail.position[rows]
    found = vb.reconstruct(
        WIRE, vb.Reactions(vb.Trail(position), reactions.force[rows], reactions.moment[rows])
    )
    force = np.linalg.norm(reactions.force[rows], axis=1)
    states = State(found.point, force, np.full((len(rows), 3), leaning))
    poses = Pose(position - CLAMP, np.tile(np.eye(3), (len(rows), 1, 1)))
    bench = bench_of(WIRE, sensor())._replace(
        axes=Rotation.from_rotvec([0.02, -0.01, 0.3]).as_matrix(),
        gain=np.array([1.1, 0.9, 1, 1, 1.2, 1]),
        shift=np.array([1e-4, 0, 0]),
        pivot=np.array([0.01, 0.02, 0.03]),
        standoff=np.asarray(2e-5),
    )
    at = readings((BALL, bench), states, poses)
    assert at.sound.all()

    def checked(exact: np.ndarray, ends: list[np.ndarray], what: str) -> None:
        size, step = np.abs(exact).max() + 1e-6, 1e-6
        slope = (ends[0] - ends[1]) / (2 * step)
        np.testing.assert_allclose(exact / size, slope / size, atol=2e-6, err_msg=what)

    for field, part in NO_STEP._asdict().items():
        for entry in range(len(part)):
            ends = []
            for sign in (1e-6, -1e-6):
                step = NO_STEP._replace(**{field: sign * np.eye(len(part))[entry]})
                there = jax.tree.map(np.asarray, moved(bench, step))
                ends.append(readings((BALL, there), at.state, poses).wrench)
            checked(getattr(at.by_step, field)[..., entry], ends, f"{field} {entry}")
    for axis in range(3):
        ends = []
        for sign in (1e-6, -1e-6):
            there = at.state._replace(leaning=at.state.leaning + sign * np.eye(3)[axis])
            ends.append(readings((BALL, bench), there, poses).wrench)
        checked(at.by_leaning[..., axis], ends, f"leaning {axis}")


def test_errors_of_the_robot_s_orientation_weigh_on_the_rows() -> None:
    """A tenth of a degree a row, which turns sensor and rod as one body: with it stated, residuals
    are noise and errors as large as stated; taken for exact, neither.
    """
    noisy = sensor(orientation_noise=1.5e-3)
    start, blind = (wrong(setup(one)) for one in (noisy, replace(noisy, orientation_noise=0.0)))
    truth, total, unstated = true_values(start), 0.0, []
    for seed in range(4):
        rows = recordings(noisy, seed)
        found = vb.calibrate(rows, start)
        assert found.fitness.reduced_chi_square == pytest.approx(1, abs=0.15)
        error = np.array([found.estimates[name].value - truth[name] for name in NAMES])
        total += float(error @ np.linalg.solve(found.covariance, error))
        unstated.append(_told(rows, blind))
    assert chi2.ppf(1e-3, 28) < total < chi2.isf(1e-3, 28)
    assert min(unstated) > 1.3


def _told(rows: list, start: vb.Setup) -> float:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", vb.RecordingWarning)
        found = vb.calibrate(rows, start)
    return found.fitness.reduced_chi_square


def test_neighbours_are_averaged_in_long_recordings() -> None:
    """Each sample sixteen times in turn, as a log sixteen times as fast of a slow sweep would hold
    it: a quarter of the deviations.
    """
    slow = [_repeated(swept(y), 16) for y in (0.005, -0.01)]
    noisy, rng = sensor(), np.random.default_rng(4)
    few = vb.calibrate(recordings(noisy), setup(noisy), free=POSE)
    many = vb.calibrate([noisy.measure(one, rng) for one in slow], setup(noisy), free=POSE)
    assert np.count_nonzero(many.residuals.contact) < 6000
    ratio = np.array(
        [many.estimates[name].deviation / few.estimates[name].deviation for name in NAMES]
    )
    np.testing.assert_allclose(ratio, 0.25, rtol=0.1)
    assert many.fitness.reduced_chi_square == pytest.approx(1, abs=0.1)


def _repeated(reactions: vb.Reactions, times: int) -> vb.Reactions:
    """The pose moves on evenly, the wrench with it."""
    old = np.arange(len(reactions.force))
    new = np.linspace(0, old[-1], times * len(old))
    position, force, moment = (
        np.stack([np.interp(new, old, column) for column in part.T], axis=1)
        for part in (reactions.trail.position, reactions.force, reactions.moment)
    )
    loaded = np.interp(new, old, np.linalg.norm(reactions.force, axis=1)) > 0
    # Between samples on either side of first contact a straight line is no equilibrium.
    edge = (
        np.convolve(
            np.abs(np.diff(loaded.astype(float), prepend=loaded[0])),
            np.ones(4 * times),
            mode="same",
        )
        > 0
    )
    keep = ~edge
    return vb.Reactions(
        vb.Trail(position[keep]), force[keep], moment[keep], time=(new / 50.0)[keep]
    )


def _bad(noisy: vb.Sensor) -> dict:
    truth, rows = setup(noisy), recordings(noisy)
    tip = swept(0.005)
    middle = slice(REST + 80, REST + 180)
    late = vb.Reactions(
        vb.Trail(tip.trail.position[middle]),
        tip.force[middle],
        tip.moment[middle],
        time=tip.time[middle],
    )
    free = vb.Reactions(
        vb.Trail(tip.trail.position[:REST]),
        tip.force[:REST],
        tip.moment[:REST],
        time=tip.time[:REST],
    )
    rng = np.random.default_rng(0)
    untared, tared = replace(noisy, tare_seconds=0.0), noisy.reactions(rows[0])
    return {
        "unknown name": (
            rows,
            truth,
            {"free": ("stiffness",)},
            "free: 'stiffness' is no parameter; allowed are youngs_modulus, bending_stiffness, length",
        ),
        "twice": (rows, truth, {"free": ("length", "length")}, "free: 'length' is given twice"),
        "same": (
            rows,
            truth,
            {"free": ("youngs_modulus", "bending_stiffness")},
            "the same parameters",
        ),
        "nothing": (
            rows,
            truth,
            {"free": ("tare",)},
            "no parameter of rod, clamp, sensor or object",
        ),
        "prior of a held one": (
            rows,
            truth,
            {"free": ("length",), "prior": {"gain": 0.1}},
            "prior: 'gain' is not a free parameter",
        ),
        "prior of zero": (
            rows,
            truth,
            {"free": ("length",), "prior": {"length": 0.0}},
            "prior['length'] = 0.0",
        ),
        "friction": (
            rows,
            truth,
            {"friction": -0.1},
            "friction = -0.1; allowed is a finite number of at least 0",
        ),
        "no object": (
            rows,
            replace(truth, surface=None),
            {"free": ("standoff",)},
            "free: 'standoff' needs the object, and surface = None",
        ),
        "no recording": ([], truth, {}, "recordings = []; allowed is at least one"),
        "a path": (["trail.csv"], truth, {}, "recordings holds str; allowed are Reactions"),
        "no contact": (
            [noisy.reactions(untared.measure(free, rng))],
            truth,
            {},
            "recordings[0]: 0 samples are in contact",
        ),
        "a tare in contact": (
            [noisy.reactions(noisy.measure(late, rng))],
            truth,
            {},
            "recordings[0]: the force changes within tare_seconds = 1.5",
        ),
        "a zero left in": (
            [replace(tared, force=tared.force + [0.03, 0.0, -0.04])],
            truth,
            {},
            "recordings[0]: the force is 50 mN throughout tare_seconds = 1.5; allowed are reactions less",
        ),
        "no rest": (
            [untared.measure(late, rng)],
            replace(truth, sensor=untared),
            {},
            "recordings[0]: no sample is at rest",
        ),
        "another object": (
            rows,
            replace(truth, surface=vb.surfaces.Plane((0, 0, 0.03), (0.5, 0, -1))),
            {},
            "do not explain the recordings: residuals are",
        ),
    }


_NO_FIT = {"no contact", "no rest", "a tare in contact", "a zero left in", "another object"}


@pytest.mark.usefixtures("no_shape_checks")
def test_what_is_wrong_is_named() -> None:
    for what, (rows, start, options, message) in _bad(sensor()).items():
        with pytest.raises(ValueError, match=re.escape(message)) as caught:
            vb.calibrate(rows, start, **options)
        assert isinstance(caught.value, vb.CalibrationError) == (what in _NO_FIT), what


def test_a_prior_beyond_all_digits_holds_or_frees() -> None:
    """Without warnings of overflow: these are errors here."""
    noisy = sensor()
    start, rows = setup(noisy), recordings(noisy)[:1]
    held, free, plain = (
        vb.calibrate(rows, start, free=("length",), prior=prior).estimates["length"]
        for prior in ({"length": 1e-300}, {"length": 1e300}, None)
    )
    assert held.value == pytest.approx(start.rod.length, rel=1e-8)
    assert (free.value, free.deviation) == pytest.approx((plain.value, plain.deviation), rel=1e-6)


def test_rows_without_numbers_are_left_out() -> None:
    noisy = sensor()
    rows = recordings(noisy)
    rows[0].force[150:160], rows[1].torque[200] = np.nan, np.nan
    found = vb.calibrate(rows, setup(noisy), free=POSE)
    assert np.isfinite(found.residuals.reading).all()
    assert abs(found.estimates["length"].value - 0.05) < 4.5 * found.estimates["length"].deviation
