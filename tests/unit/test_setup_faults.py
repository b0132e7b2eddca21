"""What a setup, a clock or a logger got wrong is told from what the sensor did, by physics that the
mistake breaks.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulated import CONTACT, RATE, REST, ROD, changed, logged, only, pushed, sensor

import vibrissa as vb
from vibrissa.sensor import Inspection, RawRecording, Sensor, inspect_raw

OF = sensor()
BALL = vb.surfaces.Sphere(center=(0, 0, 0.0575), radius=0.03)


@pytest.fixture(scope="module")
def swept() -> vb.Reactions:
    """A wire drawn under a ball, with rest at both ends: forces that do real work."""
    path = vb.Trail.line(start=(0.045, 0.005, 0), stop=(-0.045, 0.005, 0), count=1501)
    found = vb.scan(ROD, BALL, path).reactions
    return vb.Reactions(path, found.force, found.moment, time=np.arange(1501) / RATE)


def kinds(found: Inspection) -> list[tuple[str, tuple[str, ...], int]]:
    return [(str(fault.kind), fault.channels, fault.count) for fault in found.faults]


def texts(raw: RawRecording, of: Sensor, rod: vb.Rod = ROD) -> list[str]:
    return [f"{fault.kind}: {fault.text}" for fault in inspect_raw(raw, of, rod).faults]


def test_the_other_sign_makes_a_pushed_rod_do_work(swept: vb.Reactions) -> None:
    """The bending energy at the largest load is what the clamp did until there: 3 mJ here, by the
    scan's own energy.
    """
    raw = logged(OF, swept, seed=3)
    assert texts(raw, OF) == []
    told = texts(raw, sensor(wrench="on_rod"))
    assert len(told) == 1
    assert told[0].startswith("mount: the rod is pulled from its clamp and does ")
    assert "a wrench of the other sign" in told[0]
    work = float(told[0].split(" mJ")[0].split()[-1])
    trail = swept.trail
    assert work == pytest.approx(1e3 * float(np.nanmax(vb.scan(ROD, BALL, trail).energy)), rel=0.1)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (
            {
                "clamp_orientation": (
                    Rotation.from_quat(OF.clamp_orientation) * Rotation.from_rotvec([np.pi, 0, 0])
                ).as_quat()
            },
            "behind the clamp",
        ),
        (
            {"wrench_point": (0.0, 0.0, 0.06)},
            "rod lengths from the clamp in the median, where no rod is",
        ),
        (
            {"clamp_position": OF.clamp_position + [0.0, 0.06, 0.0]},
            "rod lengths from the clamp in the median, where no rod is",
        ),
    ],
    ids=["turned over", "another reference point", "another place"],
)
def test_a_clamp_elsewhere_is_told_by_the_lines_of_the_forces(
    swept: vb.Reactions, wrong: dict[str, object], words: str
) -> None:
    raw = logged(OF, swept, seed=3)
    assert [words in text for text in texts(raw, sensor(**wrong)) if text.startswith("mount")] == [
        True
    ]


MISTAKES = {
    "clamp_position in mm": ({"clamp_position": 1e3 * OF.clamp_position}, ROD),
    "the rod's length in mm": ({}, vb.Rod(50.0, ROD.bending_stiffness)),
    "youngs_modulus in GPa": ({}, vb.Rod(0.05, 1e-9 * ROD.bending_stiffness)),
    "the rod's radius in mm": ({}, vb.Rod(0.05, 1e12 * ROD.bending_stiffness)),
}


@pytest.mark.parametrize("words", MISTAKES)
def test_mistaken_units_of_the_setup_are_named(words: str) -> None:
    options, rod = MISTAKES[words]
    told = inspect_raw(logged(OF, pushed(), seed=1), sensor(**options), rod).unusable
    assert [str(fault.kind) for fault in told] == ["units"]
    assert f"({words}?)" in told[0].text


def test_swapped_columns_are_named() -> None:
    good = logged(OF, pushed(), seed=1)
    told = inspect_raw(replace(good, force=good.torque, torque=good.force), OF, ROD).unusable
    assert "(forces and torques swapped?)" in told[0].text


def test_a_work_that_is_not_known_is_not_judged(swept: vb.Reactions) -> None:
    """Without the readings at the largest load, and where it begins under load, what the rod gives
    back is all that is seen.
    """
    raw = logged(OF, swept, seed=3)
    top = int(np.argmax(np.linalg.norm(np.nan_to_num(swept.force), axis=1)))
    lost = changed(raw, slice(top - 250, top + 60), slice(0, 6), np.nan)
    assert not any(text.startswith("mount") for text in texts(lost, OF))
    tail = only(raw, np.arange(top, len(raw.time)))
    late = sensor(
        rest_intervals=(
            (float(tail.time[-1] - tail.time[0]) - 0.4, float(tail.time[-1] - tail.time[0])),
        )
    )
    assert not any(text.startswith("mount") for text in texts(tail, late))


@pytest.mark.parametrize(
    "options",
    [{"tare_seconds": 1.6}, {"rest_intervals": ((0.2, 1.6),)}],
    ids=["tare_seconds", "rest_intervals"],
)
def test_a_tare_that_reaches_into_the_contact_is_told_with_its_moment(
    options: dict[str, object],
) -> None:
    raw = logged(OF, pushed(), seed=1)
    assert [
        kind
        for kind in kinds(inspect_raw(raw, sensor(tare_seconds=0.99), ROD))
        if kind[0] == "no rest"
    ] == []
    told = [
        fault
        for fault in inspect_raw(raw, sensor(**options), ROD).faults
        if str(fault.kind) == "no rest"
    ]
    assert len(told) == 1
    assert not told[0].unusable
    # The load rises with the square of the time: it is seen within a tenth of a second of the first
    # contact.
    assert 1.0 - 0.04 <= told[0].start - raw.time[0] <= 1.15
    assert told[0].stop - raw.time[0] == pytest.approx(1.6, abs=0.05)
    assert "is not taken at rest" in told[0].text


def test_held_readings_are_found_though_no_channel_alone_shows_them() -> None:
    raw = logged(OF, pushed(), seed=1)
    held = changed(raw, slice(601, 604), slice(0, 6), raw.wrench[600])
    found = inspect_raw(held, OF, ROD)
    assert kinds(found) == [("held readings", tuple(vb.sensor.CHANNELS), 3)]
    assert np.flatnonzero(~found.usable).tolist() == [601, 602, 603]


def test_a_sensor_slower_than_the_log_is_one_finding() -> None:
    raw = logged(OF, pushed(), seed=1)
    slow = changed(raw, slice(None), slice(0, 6), raw.wrench[np.arange(len(raw.time)) // 4 * 4])
    found = inspect_raw(slow, OF, ROD)
    assert [
        kind for kind in kinds(found) if kind[0] in {"held readings", "stuck channel", "no rest"}
    ] == [("held readings", tuple(vb.sensor.CHANNELS), 1125)]
    assert "as from a sensor of 62.5 readings a second in a log of 250" in next(
        f.text for f in found.faults if str(f.kind) == "held readings"
    )
    assert found.usable.all()


def test_stamps_that_jitter_hide_no_gap_and_make_none() -> None:
    raw = logged(OF, pushed(), seed=1)
    rng = np.random.default_rng(4)
    shaken = replace(raw, time=raw.time + rng.uniform(-0.4, 0.4, len(raw.time)) / RATE)
    assert kinds(inspect_raw(shaken, OF, ROD)) == []
    lost = only(shaken, np.r_[0:700, 712 : len(raw.time)])
    told = kinds(inspect_raw(lost, OF, ROD))
    assert [kind[:2] for kind in told] == [("gap", ("time",))]
    assert 11 <= told[0][2] <= 13


def test_stamps_in_bursts_are_one_finding() -> None:
    raw = logged(OF, pushed(), seed=1)
    rows = np.arange(len(raw.time))
    found = inspect_raw(replace(raw, time=rows // 4 * 4 / RATE + rows % 4 * 1e-4), OF, ROD)
    assert [
        (str(fault.kind), fault.count) for fault in found.faults if fault.channels == ("time",)
    ] == [("gap", 374)]
    assert "in bursts" in found.faults[0].text


def test_rounded_stamps_are_spread_and_cost_no_row() -> None:
    raw = logged(OF, pushed(), seed=1)
    rounded = replace(raw, time=np.floor(raw.time * 100 + 1e-6) / 100)
    found = inspect_raw(rounded, OF, ROD)
    count = len(raw.time) - len(np.unique(rounded.time))
    assert kinds(found) == [("duplicate stamp", ("time",), count)]
    assert found.usable.all()
    assert np.all(np.diff(found.cleaned.time) > 0)
    np.testing.assert_allclose(found.cleaned.time, raw.time, rtol=0, atol=0.006)


def test_rows_that_are_there_twice_are_not_spread() -> None:
    raw = logged(OF, pushed(), seed=1)
    twice = only(raw, np.sort(np.r_[np.arange(len(raw.time)), np.arange(0, len(raw.time), 5)]))
    found = inspect_raw(twice, OF, ROD)
    assert np.count_nonzero(~found.usable) == 300
    assert len(raw.time) == CONTACT + 2 * REST
