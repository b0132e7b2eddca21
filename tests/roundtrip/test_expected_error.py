"""What is expected of a sensor over a scene is what many simulated recordings of it give."""

from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

import vibrissa as vb
from vibrissa import plot
from vibrissa.sensor import LowPass, Sensor, preset

WIRE = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
BALL = vb.surfaces.Sphere(center=(0, 0, 0.0575), radius=0.03)
LINE = vb.Trail.line(start=(0.02, 0.005, 0), stop=(-0.02, 0.005, 0), count=41)
RATE, REST, SPEED = 250.0, 0.4, 0.05
SMALL = Sensor(
    np.array([0.0, 0.0, 0.025]),
    np.array([0.0, 0.0, 0.0, 1.0]),
    "on_sensor",
    force_noise=5e-4,
    torque_noise=1e-5,
    force_resolution=5e-4,
    torque_resolution=1e-5,
    position_noise=2e-5,
)


@pytest.fixture(scope="module")
def scene() -> vb.Scan:
    return vb.scan(WIRE, BALL, LINE)


def recorded(scene: vb.Scan, sensor: Sensor, rng: np.random.Generator) -> vb.Reactions:
    """Rest, and then the scan's positions, at the times that the expectation takes."""
    rest = int(REST * RATE)
    place = np.r_[np.zeros(rest, dtype=int), np.arange(LINE.count)]
    still = np.arange(len(place)) < rest
    step = np.linalg.norm(LINE.position[1] - LINE.position[0]) / SPEED
    time = np.r_[np.arange(rest) / RATE, REST + 1 / RATE + step * np.arange(LINE.count)]
    force, moment = (
        np.where(still[:, None], 0.0, part[place])
        for part in (scene.reactions.force, scene.reactions.moment)
    )
    truth = vb.Reactions(vb.Trail(LINE.position[place]), force, moment, time=time)
    raw = sensor.measure(
        truth, rng, force_tare=rng.uniform(-0.1, 0.1, 3), torque_tare=rng.uniform(-1e-3, 1e-3, 3)
    )
    found = replace(sensor, tare_seconds=REST).reactions(raw)
    rows = np.flatnonzero(~still)
    assert found.covariance is not None
    covariance = found.covariance[rows] if found.covariance.ndim == 3 else found.covariance
    trail = vb.Trail(found.trail.position[rows], found.trail.orientation[rows])
    return vb.Reactions(
        trail,
        found.force[rows],
        found.moment[rows],
        covariance=covariance,
        position_covariance=found.position_covariance,
    )


def stacked(logs: list[vb.Reactions]) -> vb.Reactions:
    """Recordings as the trails of one batch."""
    return vb.Reactions(
        vb.Trail.stack([log.trail for log in logs]),
        np.stack([log.force for log in logs]),
        np.stack([log.moment for log in logs]),
        covariance=np.stack(
            [np.broadcast_to(log.covariance, (len(log.force), 6, 6)) for log in logs]
        ),
        position_covariance=logs[0].position_covariance,
    )


SENSORS = {
    "white": SMALL,
    "coloured": replace(SMALL, noise_corner=3.0, force_random_walk=4e-4, torque_random_walk=8e-6),
    "turning": replace(SMALL, orientation_noise=2e-3),
}


@pytest.mark.parametrize("kind", SENSORS)
def test_the_expected_covariance_is_that_of_many_recordings(scene: vb.Scan, kind: str) -> None:
    """In units of the expected deviations the errors' covariance is the identity, away from the
    tip, where a limit cuts them off.
    """
    sensor, rng, trials = SENSORS[kind], np.random.default_rng(21), 250
    expected = vb.expected_error(WIRE, BALL, LINE, sensor, rate=RATE, rest=REST, speed=SPEED)
    rows = np.flatnonzero(
        (scene.kind == vb.ContactKind.TANGENTIAL) & (scene.arc_length < 0.97 * WIRE.length)
    )[::4]
    assert len(rows) >= 3
    found = vb.reconstruct(WIRE, stacked([recorded(scene, sensor, rng) for _ in range(trials)]))
    errors = found.point[:, rows] - scene.point[rows]
    for index, row in enumerate(rows):
        root = np.linalg.inv(np.linalg.cholesky(expected.covariance[row]))
        seen = root @ (errors[:, index].T @ errors[:, index] / trials) @ root.T
        np.testing.assert_allclose(seen, np.eye(3), rtol=0, atol=4.5 * np.sqrt(2 / trials))


TAPERED = vb.Rod.tapered(length=0.05, base_radius=0.25e-3, tip_radius=0.1e-3, youngs_modulus=206e9)
HEAVY = vb.Rod.cylinder(length=0.05, radius=0.1e-3, youngs_modulus=6e9, density=7000.0)
REAL = {
    "heavy": (HEAVY.loaded(vb.Loads(gravity=(0, -9.81, 0))), (0.04, 0.024, 0.022, 0.01, 0.0)),
    "curved": (TAPERED.curved(vb.RestShape.arc(0.1, roll=0.7)), (0.04, 0.01, 0.004, -0.004)),
    "pivot": (WIRE.on(vb.Support.pivot((0.1, 0.15, 0.5))), (0.04, 0.022, 0.01, 0.0)),
}
"""Rods that hang in the y direction by 7 % of their length, are bent at rest or turn in their support,
and places of the clamp: one without contact, and from the tip inwards.
"""


@pytest.mark.parametrize(
    "name",
    ["heavy", *(pytest.param(name, marks=pytest.mark.slow) for name in ("curved", "pivot"))],
)
def test_real_rods_err_as_expected(name: str) -> None:
    """Tared at rest, where the heavy rod's own weight is no part of the zero; a tip contact, whose
    estimate cannot pass the tip, errs less than stated along the rod, and not more aside.
    """
    rod, places = REAL[name]
    trail = vb.Trail([(x, 0.005, 0.0) for x in places])
    units, wire = (np.array([part.force_scale, part.moment_scale]) for part in (rod, WIRE))
    force, torque = units / wire * [5e-4, 1e-5]
    sensor = replace(
        SMALL,
        force_noise=force,
        force_resolution=force,
        torque_noise=torque,
        torque_resolution=torque,
    ).carrying(rod)
    expected = vb.expected_error(rod, BALL, trail, sensor, rate=RATE, rest=REST)
    scene, rng, trials = expected.scan, np.random.default_rng(4), 150
    kinds = scene.kind.tolist()
    assert kinds[0] == vb.ContactKind.NONE and all(kinds[1:])
    rest = np.arange(int(REST * RATE)) * 0
    rows = np.r_[rest, np.arange(len(places))]
    true = vb.Reactions(
        trail[rows],
        scene.reactions.force[rows],
        scene.reactions.moment[rows],
        time=np.arange(len(rows)) / RATE,
    )
    tared = sensor.updated(tare_seconds=REST)
    logs = []
    for _ in range(trials):
        zero = {"force_tare": rng.uniform(-0.1, 0.1, 3), "torque_tare": rng.uniform(-1e-3, 1e-3, 3)}
        logs.append(tared.reactions(sensor.measure(true, rng, **zero))[len(rest) + 1 :])
    found = vb.reconstruct(rod, stacked(logs), check=False)
    assert found.in_contact.all()
    for index, row in enumerate(range(1, len(places))):
        errors = found.point[:, index] - scene.point[row]
        root = np.linalg.inv(np.linalg.cholesky(expected.covariance[row]))
        square = np.sum((errors @ root.T) ** 2, axis=1)
        print(  # noqa: T201
            f"{name}, {vb.ContactKind(scene.kind[row]).name}: mean square {square.mean():.2f} of 3, "
            f"inside {np.mean(square < 7.815):.3f}"
        )
        if scene.arc_length[row] < 0.97 * rod.length:
            assert abs(square.mean() - 3) < 4.5 * np.sqrt(6 / trials)
        else:
            assert 1 < square.mean() < 3 + 4.5 * np.sqrt(6 / trials)
        assert np.mean(square < 7.815) > 0.9


def test_averages_tare_and_noise_go_as_they_must() -> None:
    fine = replace(SMALL, force_resolution=0.0, torque_resolution=0.0, position_noise=0.0)
    one, nine, double = (
        vb.expected_error(WIRE, BALL, LINE, sensor, rest=0.0, samples=samples)
        for sensor, samples in (
            (fine, 1),
            (fine, 9),
            (replace(fine, force_noise=1e-3, torque_noise=2e-5), 1),
        )
    )
    sound = (
        one.detected
        & (one.scan.kind == vb.ContactKind.TANGENTIAL)
        & (one.standard_deviations[:, 2] < 2e-3)
    )
    # To first order; where the tip is near, its limit bends the errors.
    sound &= one.scan.arc_length < 0.9 * WIRE.length
    assert sound.sum() > 3
    np.testing.assert_allclose(
        nine.standard_deviations[sound], one.standard_deviations[sound] / 3, rtol=0.02
    )
    np.testing.assert_allclose(
        double.standard_deviations[sound], 2 * one.standard_deviations[sound], rtol=0.02
    )
    np.testing.assert_allclose(one.semi_axes, np.sqrt(7.814727903251179) * one.standard_deviations)
    short = vb.expected_error(WIRE, BALL, LINE, fine, rate=100.0, rest=0.04)
    np.testing.assert_allclose(
        short.standard_deviations[sound],
        np.sqrt(1 + 1 / 4) * one.standard_deviations[sound],
        rtol=0.02,
    )


def test_a_lag_shifts_contacts_in_proportion_to_the_speed() -> None:
    late = replace(SMALL, low_pass=LowPass(20.0, 1, 0.002))
    slow, fast = (vb.expected_error(WIRE, BALL, LINE, late, speed=speed) for speed in (2e-4, 4e-4))
    rows = slow.detected & (np.linalg.norm(slow.lag, axis=1) > 1e-8)
    rows[:3] = False
    assert rows.sum() > 20
    ratio = np.linalg.norm(fast.lag[rows], axis=1) / np.linalg.norm(slow.lag[rows], axis=1)
    assert np.median(ratio) == pytest.approx(2, rel=0.05)
    assert np.all(vb.expected_error(WIRE, BALL, LINE, late).lag == 0)


def test_several_trails_are_the_trails_one_by_one() -> None:
    other = vb.Trail(LINE.position + [0, 0.003, 0])
    both = vb.expected_error(
        WIRE, BALL, vb.Trail.stack([LINE, other]), SENSORS["coloured"], speed=SPEED
    )
    alone = vb.expected_error(WIRE, BALL, other, SENSORS["coloured"], speed=SPEED)
    np.testing.assert_allclose(both.covariance[1], alone.covariance, rtol=1e-9, atol=1e-20)


def test_a_coarse_sensor_detects_little_and_a_small_range_saturates() -> None:
    coarse = vb.expected_error(
        WIRE, BALL, LINE, preset("robotiq_ft_300_s", clamp_position=(0, 0, 0.025))
    )
    fine = vb.expected_error(
        WIRE, BALL, LINE, preset("ati_nano17_si_12_0_12", clamp_position=(0, 0, 0.025))
    )
    assert fine.detected.sum() > coarse.detected.sum()
    assert np.all(np.isnan(coarse.covariance[~coarse.detected]))
    assert not fine.saturated.any()
    force = np.abs(fine.scan.reactions.force)
    small = vb.expected_error(
        WIRE, BALL, LINE, replace(SMALL, force_range=(1.0, 1.0, float(np.median(force[:, 2]))))
    )
    np.testing.assert_array_equal(small.saturated, force[:, 2] > np.median(force[:, 2]))


def test_a_position_that_cannot_be_solved_is_on_no_map() -> None:
    """Pushed straight up at the ball's lowest point the rod may bend to any side, and the scan has
    no contact to show.
    """
    mpl.use("Agg")
    up = vb.Trail.line(start=(0, 0, -0.03), stop=(0, 0, 0.01), count=41)
    error = vb.expected_error(WIRE, BALL, vb.Trail.stack([LINE, up]), SMALL)
    unsolved = error.scan.status >= vb.Status.HEAD_ON
    assert unsolved.any()
    assert not error.detected[unsolved].any()
    assert np.isnan(error.covariance[unsolved]).all()
    for axes in plot.expected_error_map(error):
        assert np.abs(axes.collections[0].get_offsets()).max() < 60


def test_what_does_not_fit_is_named() -> None:
    unknown = replace(SMALL, force_noise=None, torque_noise=None)
    with pytest.raises(
        ValueError,
        match=r"sensor.force_noise = None; allowed is a sensor with force_noise and torque_noise, or a preset",
    ):
        vb.expected_error(WIRE, BALL, LINE, unknown)
    for name, value in (("rate", 0.0), ("rest", -1.0), ("speed", 0.0), ("samples", 0)):
        with pytest.raises(ValueError, match=f"{name} = {value}; allowed"):
            vb.expected_error(WIRE, BALL, LINE, SMALL, **{name: value})


def test_the_map_shows_every_position_once(tmp_path: Path) -> None:
    mpl.use("Agg")
    two = vb.Trail.stack([LINE, vb.Trail(LINE.position + [0, 0.003, 0])])
    error = vb.expected_error(
        WIRE, BALL, two, preset("robotiq_ft_300_s", clamp_position=(0, 0, 0.025))
    )
    assert 0 < error.detected.sum() < error.detected.size
    over_clamp, over_object = plot.expected_error_map(error)
    shown = int(error.detected.sum())
    assert [len(axes.collections[0].get_offsets()) for axes in (over_clamp, over_object)] == [
        shown,
        shown,
    ]
    assert len(over_clamp.lines[0].get_xdata()) == error.detected.size - shown
    assert plot.save_as([over_clamp, over_object], tmp_path / "map.png").stat().st_size > 10_000
    with pytest.raises(ValueError, match="no contact of the scan is detected"):
        plot.expected_error_map(
            vb.expected_error(WIRE, BALL, vb.Trail(LINE.position + [0.1, 0, 0]), SMALL)
        )
