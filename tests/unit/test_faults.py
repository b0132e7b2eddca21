"""Each fault of a recording is found, with its channels, interval and count; a good recording has
none.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import erf
from simulated import CONTACT, RATE, REST, ROD, changed, logged, only, pushed, sensor

import vibrissa as vb
from vibrissa.sensor import Fault, Inspection, LowPass, Mount, RawRecording, inspect_raw
from vibrissa.sensor.readings import longest_run, repeat_chance
from vibrissa.sensor.stamps import increasing_stamps

OF = sensor()
GOOD = logged(OF, pushed(turning=0.5), seed=1)
ROWS = len(GOOD.time)


def inspected(raw: RawRecording, **options: object) -> Inspection:
    return inspect_raw(raw, sensor(**options), ROD)


def found(raw: RawRecording, **options: object) -> list[tuple[str, tuple[str, ...], int]]:
    return [
        (str(fault.kind), fault.channels, fault.count) for fault in inspected(raw, **options).faults
    ]


def times(fault: Fault) -> tuple[int, int]:
    """First and last row of a fault."""
    return int(np.argmin(np.abs(GOOD.time - fault.start))), int(
        np.argmin(np.abs(GOOD.time - fault.stop))
    )


SENSORS = {
    "white": {},
    "coarse": {"force_resolution": 0.01, "torque_resolution": 2e-4},
    "fine": {"force_resolution": 0.0, "torque_resolution": 0.0},
    "coloured": {"noise_corner": 5.0, "force_random_walk": 2e-3, "torque_random_walk": 4e-5},
    "weighed": {"mount": Mount(0.02, (0.001, 0.0, 0.01))},
    "late": {"low_pass": LowPass(60.0, 2, 0.004)},
    "drifting": {"force_drift": (1e-3, 0.0, -2e-3), "torque_drift": (0.0, 1e-5, 0.0)},
}


@pytest.mark.parametrize("kind", SENSORS)
def test_a_good_recording_has_no_faults(kind: str) -> None:
    for seed in range(6):
        of = sensor(**SENSORS[kind])
        assert found(logged(of, pushed(turning=0.3 * seed), seed=seed), **SENSORS[kind]) == []


@pytest.mark.parametrize("options", [{}, {"tare_seconds": 0.5}, {"tare_seconds": 0.0}])
def test_a_noiseless_simulation_has_no_faults_though_its_rest_repeats_itself(
    options: dict[str, object],
) -> None:
    quiet = {
        "force_noise": None,
        "torque_noise": None,
        "force_resolution": 0.0,
        "torque_resolution": 0.0,
        "position_noise": 0.0,
    }
    raw = logged(sensor(**quiet), pushed(turning=0.5))
    assert found(raw, **quiet, **options) == []
    free = sensor(**quiet).measure(pushed(), np.random.default_rng(0))
    assert inspected(free, **quiet, **options).usable.all()


def test_what_rest_tells_of_the_sensor() -> None:
    told = inspected(GOOD)
    assert told.rate == pytest.approx(RATE)
    assert told.usable.all()
    # Standard deviations over 150 samples and more are known to a tenth and better.
    np.testing.assert_allclose(told.noise, np.sqrt(OF.reading_variance), rtol=0.25)
    assert np.all(np.abs(told.drift) < 5 * told.drift_deviation)
    assert 0.5 < told.single_contact_misfit < 0.9


WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")
HIDDEN: dict[
    str, tuple[Callable[[], RawRecording], tuple[str, tuple[str, ...], int], tuple[int, int]]
] = {
    "numbers lost": (
        lambda: changed(GOOD, slice(700, 707), slice(0, 6), np.nan),
        ("drop-out", WRENCH, 7),
        (700, 706),
    ),
    "one number lost": (
        lambda: changed(GOOD, 300, 4, np.nan),
        ("drop-out", ("ty",), 1),
        (300, 300),
    ),
    "infinite": (lambda: changed(GOOD, 300, 4, np.inf), ("drop-out", ("ty",), 1), (300, 300)),
    "zeros": (
        lambda: changed(GOOD, slice(900, 903), slice(0, 6), 0.0),
        ("drop-out", WRENCH, 3),
        (900, 902),
    ),
    "stuck at rest": (
        lambda: changed(GOOD, slice(30, 70), 1, GOOD.force[30, 1]),
        ("stuck channel", ("fy",), 40),
        (30, 69),
    ),
    "stuck in contact": (
        lambda: changed(GOOD, slice(600, 700), 5, GOOD.torque[600, 2]),
        ("stuck channel", ("tz",), 100),
        (600, 699),
    ),
    "stuck to the end": (
        lambda: changed(GOOD, slice(1000, ROWS), 3, GOOD.torque[1000, 0]),
        ("stuck channel", ("tx",), ROWS - 1000),
        (1000, ROWS - 1),
    ),
    "pose lost": (
        lambda: replace(
            GOOD, position=np.where(np.arange(ROWS)[:, None] == 400, np.nan, GOOD.position)
        ),
        ("drop-out", ("position",), 1),
        (400, 400),
    ),
    "gap": (
        lambda: only(GOOD, np.delete(np.arange(ROWS), np.arange(500, 512))),
        ("gap", ("time",), 12),
        (499, 512),
    ),
    "one sample lost": (
        lambda: only(GOOD, np.delete(np.arange(ROWS), 500)),
        ("gap", ("time",), 1),
        (499, 501),
    ),
    "stamp twice": (
        lambda: only(GOOD, np.insert(np.arange(ROWS), 800, [799, 799])),
        ("duplicate stamp", ("time",), 2),
        (799, 799),
    ),
    "rows swapped": (
        lambda: only(GOOD, np.r_[np.arange(800), 801, 800, np.arange(802, ROWS)]),
        ("backward stamp", ("time",), 1),
        (800, 801),
    ),
    "place jumps": (
        lambda: replace(GOOD, position=GOOD.position + 3e-4 * (np.arange(ROWS) >= 700)[:, None]),
        ("pose jump", ("position",), 1),
        (699, 700),
    ),
}


@pytest.mark.parametrize("what", HIDDEN)
def test_a_fault_is_found_where_it_is(what: str) -> None:
    make, expected, rows = HIDDEN[what]
    raw = make()
    faults = inspected(raw).faults
    assert [(str(fault.kind), fault.channels, fault.count) for fault in faults] == [expected]
    assert times(faults[0]) == rows
    lost = {"gap": 0, "pose jump": 0, "backward stamp": 1}.get(expected[0], expected[2])
    usable = inspected(raw).usable
    assert np.count_nonzero(~usable) == lost
    assert np.array_equal(np.isnan(inspected(raw).cleaned.force).any(axis=1), ~usable)


def test_a_turn_jumps() -> None:
    turned = GOOD.orientation.copy()
    turned[900:] = np.roll(turned[900:], 1, axis=1)
    assert found(replace(GOOD, orientation=turned))[:1] == [("pose jump", ("orientation",), 1)]


def test_a_pose_that_starts_stops_or_waits_does_not_jump() -> None:
    truth = pushed()
    position = np.cumsum(
        np.r_[np.zeros(200), np.full(300, 1e-4), np.zeros(300), np.full(ROWS - 800, 4e-4)]
    )
    trail = vb.Trail(np.stack([position, 0 * position, 0 * position], axis=1))
    assert found(logged(OF, vb.Reactions(trail, truth.force, truth.moment, time=truth.time))) == []


def test_a_dead_channel_leaves_no_row() -> None:
    told = inspected(changed(GOOD, slice(0, ROWS), 2, 1.5))
    assert ("stuck channel", ("fz",), ROWS) in [
        (str(fault.kind), fault.channels, fault.count) for fault in told.faults
    ]
    assert [fault.text for fault in told.unusable] == [
        "none of 1500 rows is usable; allowed is at least one"
    ]


def test_readings_at_the_range_are_saturated_however_few() -> None:
    free = logged(OF, pushed(), seed=2)
    limit = float(0.99 * np.abs(free.force[:, 0]).max())
    limits = {"force_range": (limit, 10.0, 10.0), "torque_range": (1.0, 1.0, 1.0)}
    raw = logged(sensor(**limits), pushed(), seed=2)
    step = OF.force_resolution
    full = np.flatnonzero(np.abs(free.force[:, 0]) >= np.floor(limit / step) * step - 1e-9)
    told = inspected(raw, **limits)
    assert len(full) > 3
    assert {(str(fault.kind), fault.channels) for fault in told.faults} == {("saturation", ("fx",))}
    assert sum(fault.count for fault in told.faults) == len(full)
    assert np.array_equal(np.flatnonzero(~told.usable), full)
    assert f"at the range of {np.floor(limit / step) * step:g} N" in told.faults[0].text


def test_flat_tops_are_saturation_though_the_range_is_not_known() -> None:
    raw = logged(sensor(torque_range=(0.005, 1.0, 1.0)), pushed(), seed=2)
    flat = [fault for fault in inspected(raw).faults if fault.channels == ("tx",)]
    assert {str(fault.kind) for fault in flat} == {"saturation"}
    assert "flat-topped at -0.005 N m" in flat[0].text
    full = np.flatnonzero(np.abs(raw.torque[:, 0]) >= 0.005 - 1e-9)
    assert sum(fault.count for fault in flat) == len(full)
    assert np.flatnonzero(~inspected(raw).usable).tolist() == full.tolist()
    lost = changed(raw, int(full[len(full) // 2]), slice(0, 6), np.nan)
    assert {str(fault.kind) for fault in inspected(lost).faults if fault.channels == ("tx",)} == {
        "saturation"
    }


@pytest.mark.parametrize(("deviation", "step"), [(1.0, 1.0), (2.0, 1.0), (0.6, 1.0)])
def test_equal_readings_come_in_a_row_as_seldom_as_stated(deviation: float, step: float) -> None:
    """The bound is on the worst place of the true value: a step. There, runs of r readings start
    with the chance p^(r−1).
    """
    count, alarm = 200_000, 0.5
    same = float(repeat_chance(deviation, step))
    assert same == erf(step / (np.sqrt(8) * deviation))
    needed = longest_run(same, count, alarm)
    assert count * same ** (needed - 1) <= alarm < count * same ** (needed - 2)
    rng, seen = np.random.default_rng(3), 0
    for _ in range(20):
        equal = np.diff(np.round(rng.normal(0, deviation, count) / step)) == 0
        edges = np.flatnonzero(np.diff(np.r_[0, equal.astype(int), 0]))
        seen += int(np.max(edges[1::2] - edges[::2]) + 1 >= needed)
    assert seen <= 16
    assert longest_run(repeat_chance(0.0, step), count) == np.inf
    assert longest_run(repeat_chance(1.0, 0.0), count) == 1


@pytest.mark.parametrize(("equal", "stuck"), [(4, 0), (5, 1)])
def test_four_equal_readings_are_no_finding_however_fine_the_numbers(
    equal: int, stuck: int
) -> None:
    """Chance alone would allow no two: white noise without steps never repeats itself."""
    fine = {"force_resolution": 0.0, "torque_resolution": 0.0}
    raw = logged(sensor(**fine), pushed(turning=0.5), seed=1)
    same = changed(raw, slice(600, 600 + equal), 5, raw.torque[600, 2])
    assert found(same, **fine) == [("stuck channel", ("tz",), equal)] * stuck


UNITS = {
    "millimetres": (
        lambda: replace(GOOD, position=1e3 * GOOD.position),
        ("position",),
        "allowed are metres",
    ),
    "millinewtons": (
        lambda: changed(GOOD, slice(0, ROWS), slice(0, 3), 1e3 * GOOD.force),
        ("fx", "fy", "fz"),
        "mis-scaled (in mN?)",
    ),
    "newton millimetres": (
        lambda: changed(GOOD, slice(0, ROWS), slice(3, 6), 1e3 * GOOD.torque),
        ("tx", "ty", "tz"),
        "mis-scaled (in N mm?)",
    ),
    "degrees": (
        lambda: replace(GOOD, orientation=40 * GOOD.orientation),
        ("orientation",),
        "as if angles in degrees; allowed is 1",
    ),
}


@pytest.mark.parametrize("what", UNITS)
def test_mistaken_units_make_a_recording_unusable(what: str) -> None:
    make, channels, words = UNITS[what]
    told = [fault for fault in inspected(make()).unusable if str(fault.kind) == "units"]
    assert [fault.channels for fault in told] == [channels]
    assert words in told[0].text


@pytest.mark.parametrize("known", [True, False], ids=["noise known", "noise not known"])
@pytest.mark.parametrize(("force", "torque"), [(1e3, 1e3), (1.0, 1e3), (1e-3, 1e-3), (1e-3, 1.0)])
def test_mistaken_units_are_found_with_and_without_known_noise(
    force: float, torque: float, *, known: bool
) -> None:
    raw = changed(GOOD, slice(0, ROWS), slice(0, 6), GOOD.wrench * np.repeat([force, torque], 3))
    told = inspected(raw, **({} if known else {"force_noise": None, "torque_noise": None})).unusable
    assert [str(fault.kind) for fault in told[:1]] == ["units"]
    assert "mis-scaled" in told[0].text


def test_milliseconds_and_quaternions_written_w_first_are_pointed_out() -> None:
    late = replace(GOOD, time=1e3 * GOOD.time)
    assert ("units", ("time",), ROWS) in found(late)
    level = logged(OF, pushed())
    first = replace(level, orientation=np.tile([1.0, 0.0, 0.0, 0.0], (ROWS, 1)))
    assert found(first) == [("units", ("orientation",), ROWS)]
    assert not inspected(first).unusable


@pytest.mark.parametrize(("factor", "word"), [(1.6, "1.6"), (0.5, "0.5")])
def test_noise_other_than_stated_is_found(factor: float, word: str) -> None:
    raw = logged(sensor(force_noise=factor * 2e-3, torque_noise=factor * 4e-5), pushed(), seed=4)
    noisy = [fault for fault in inspected(raw).faults if str(fault.kind) == "noise"]
    assert [fault.channels[0] for fault in noisy] == list(WRENCH)
    assert all(fault.text.partition(", ")[2].startswith(word[:2]) for fault in noisy)


def test_drift_other_than_stated_is_found() -> None:
    raw = logged(sensor(force_drift=(0.0, 2e-3, 0.0)), pushed(), seed=4)
    assert found(raw) == [("drift", ("fy",), ROWS)]
    told = inspected(raw)
    assert told.drift[1] == pytest.approx(2e-3, abs=4 * told.drift_deviation[1])
    assert found(raw, force_drift=(0.0, 2e-3, 0.0)) == []
    assert found(raw, estimate_drift=True) == []
    assert found(raw, force_random_walk=4e-3) == []


def test_a_wrong_tare_leaves_forces_that_belong_to_no_single_contact() -> None:
    shifted = inspect_raw(GOOD, sensor(rest_intervals=((2.4, 2.6),)), ROD)
    assert [
        str(fault.kind) for fault in shifted.faults if str(fault.kind) == "no single contact"
    ] == ["no single contact"]
    assert shifted.single_contact_misfit > 1.2


def test_no_rest_is_told_and_nothing_else_is_lost() -> None:
    told = inspected(only(GOOD, np.arange(REST + 100, REST + CONTACT - 100)))
    assert [str(fault.kind) for fault in told.unusable] == ["no rest"]
    assert told.tare is None
    assert told.usable.all()
    assert np.isnan(told.noise).all()


def test_stamps_are_made_increasing_by_the_last_digit() -> None:
    time = np.array([0.0, np.nan, 0.2, 0.2, 0.2, 0.5, np.nan])
    fixed, moved = increasing_stamps(time)
    assert np.all(np.diff(fixed) > 0)
    assert moved.tolist() == [False, True, False, True, True, False, True]
    np.testing.assert_allclose(fixed, [0, 0.1, 0.2, 0.2, 0.2, 0.5, 0.5], atol=1e-15)


@pytest.mark.parametrize("rows", [1, 2, 3, 8, 40])
def test_short_recordings_are_inspected(rows: int) -> None:
    told = inspected(only(GOOD, np.arange(rows)), tare_seconds=0.0)
    assert told.usable.all()
    assert not told.unusable


def test_a_recording_without_anything_is_refused() -> None:
    nothing = replace(GOOD, time=np.full(ROWS, np.nan))
    with pytest.raises(
        ValueError, match="none of 1500 rows has a stamp; allowed are stamps in seconds"
    ):
        inspected(nothing)
    with pytest.raises(ValueError, match="no row has a pose; allowed are finite positions"):
        inspected(replace(GOOD, position=np.full((ROWS, 3), np.nan)))
    lost = inspected(changed(GOOD, slice(0, ROWS), 0, np.nan))
    assert not lost.usable.any()
    assert "none of 1500 rows is usable" in {
        fault.text.partition(";")[0] for fault in lost.unusable
    }
