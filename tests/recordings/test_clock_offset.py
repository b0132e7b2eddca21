"""The offset between two clocks, found again after a recording's poses were put on another one:
where the motion tells it, and refused where it does not.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import vibrissa as vb
from vibrissa.io import InputError, RecordingWarning
from vibrissa.io.recordings.clock import ClockOffset, estimated_offset
from vibrissa.io.recordings.streams import Poses, Wrenches

EXAMPLE = Path(__file__).parents[2] / "examples" / "recordings" / "sphere_60mm" / "trail.csv"
LENGTH = 0.05
WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")
POSE = ("px", "py", "pz", "qx", "qy", "qz", "qw")


class Stream(NamedTuple):
    """Stamps, and numbers of `WRENCH` or `POSE`."""

    time: np.ndarray
    values: np.ndarray


def streams(file: Path) -> tuple[Stream, Stream]:
    table = np.genfromtxt(file, delimiter=",", names=True)
    wrench, pose = (np.column_stack([table[name] for name in names]) for names in (WRENCH, POSE))
    return Stream(table["time"], wrench), Stream(table["time"], pose)


def in_order(stream: Stream, rows: np.ndarray, step: float) -> Stream:
    return Stream(step * np.arange(len(rows)), stream.values[rows])


def with_stops(stream: Stream, stops: list[int], step: float, rest: slice) -> Stream:
    """The sweep with a stop of 0.6 s at each of these rows; noise there is that of the rest at the
    start, drawn again.
    """
    rng, still = np.random.default_rng(0), stream.values[rest]
    parts, last = [], 0
    for stop in stops:
        noise = still[rng.integers(len(still), size=round(0.6 / step))] - still.mean(axis=0)
        parts += [stream.values[last:stop], stream.values[stop - 6 : stop + 7].mean(axis=0) + noise]
        last = stop
    values = np.concatenate([*parts, stream.values[last:]])
    return Stream(step * np.arange(len(values)), values)


def found(wrench: Stream, pose: Stream, offset: float, largest: float = 0.5) -> ClockOffset:
    """With poses of half the rate, on a clock that is behind by `offset`."""
    return estimated_offset(
        Wrenches(wrench.time, *np.split(wrench.values, [3], axis=1)),
        Poses(pose.time[::2] - offset, *np.split(pose.values[::2], [3], axis=1)),
        largest,
        LENGTH,
    )


def check(estimate: ClockOffset, offset: float, largest_error: float) -> None:
    assert estimate.standard_error is not None
    assert estimate.standard_error < largest_error
    assert abs(estimate.seconds - offset) < 4 * estimate.standard_error


@pytest.mark.parametrize(
    ("name", "offset"),
    [
        ("frictionless/trail_y-0.20", 0.123),
        ("frictionless/trail_y+0.30", -0.31),
        ("friction_0.25/trail_y+0.10", 0.0),
    ],
)
def test_stops_under_load_tell_it(sphere_60mm: Path, name: str, offset: float) -> None:
    wrench, pose = (
        with_stops(stream, [750, 1250, 1500], 0.004, slice(10, 200))
        for stream in streams(sphere_60mm / f"{name}.csv")
    )
    check(found(wrench, pose, offset), offset, 2e-3)


def test_a_turn_under_load_tells_it(sphere_60mm: Path) -> None:
    wrench, pose = streams(sphere_60mm / "frictionless" / "trail_y+0.10.csv")
    rows = np.concatenate([np.arange(1300), np.arange(1300, 0, -1)])
    check(found(in_order(wrench, rows, 0.004), in_order(pose, rows, 0.004), 0.217), 0.217, 1e-3)


def test_a_turn_of_a_simulated_sweep_tells_it() -> None:
    """The recording of the examples, which comes from `scan`, at 100 Hz."""
    wrench, pose = streams(EXAMPLE)
    rows = np.concatenate(
        [np.arange(450), np.arange(450, 250, -1), np.arange(250, len(wrench.time))]
    )
    for offset in (-0.2, 0.35):
        check(found(in_order(wrench, rows, 0.01), in_order(pose, rows, 0.01), offset), offset, 5e-3)


@pytest.mark.parametrize(
    "name", ["frictionless/trail_y+0.10", "frictionless/trail_y-0.40", "friction_0.25/trail_y+0.10"]
)
def test_a_uniform_sweep_does_not_tell_it(sphere_60mm: Path, name: str) -> None:
    """At constant speed another offset is the same object, shifted along the trail."""
    wrench, pose = streams(sphere_60mm / f"{name}.csv")
    with pytest.raises(ValueError, match="the clamp does not stop, start or turn under load"):
        found(wrench, pose, 0.1)


def test_a_stop_before_contact_does_not_tell_it(sphere_60mm: Path) -> None:
    wrench, pose = (
        with_stops(stream, [350], 0.004, slice(10, 200))
        for stream in streams(sphere_60mm / "frictionless" / "trail_y-0.20.csv")
    )
    with pytest.raises(ValueError, match="the data do not determine it"):
        found(wrench, pose, 0.1)


def test_an_offset_beyond_the_bound_is_not_taken_for_one_within(sphere_60mm: Path) -> None:
    wrench, pose = (
        with_stops(stream, [1000], 0.004, slice(10, 200))
        for stream in streams(sphere_60mm / "frictionless" / "trail_y-0.20.csv")
    )
    with pytest.raises(ValueError, match="the data do not determine it"):
        found(wrench, pose, 0.5, largest=0.2)


def test_whisking_in_one_rhythm_leaves_periods_open() -> None:
    """By half a period the motion is mirrored, and the reactions are still a function of the pose."""
    rng, time = np.random.default_rng(3), np.arange(0, 6, 0.004)
    place = 0.02 * np.cos(2 * np.pi * 2 * time)
    load = np.column_stack(
        [
            np.sin(40 * place),
            np.cos(30 * place),
            0.5 + 10 * place,
            0.02 * place,
            0.01 * place,
            0 * place,
        ]
    )
    pose = np.column_stack([place, np.zeros((len(time), 5)), np.ones(len(time))])
    wrench = Stream(time, load + rng.normal(0, 2e-3, load.shape))
    with pytest.raises(ValueError, match="explain them equally well"):
        found(wrench, Stream(time, pose), 0.05, largest=0.4)


def write(folder: Path, wrench: Stream, pose: Stream) -> Path:
    for name, names, stream in (("ft.csv", WRENCH, wrench), ("tool.csv", POSE, pose)):
        np.savetxt(
            folder / name,
            np.column_stack([stream.time, stream.values]),
            delimiter=",",
            header=",".join(["time", *names]),
            comments="",
            fmt="%.12g",
        )
    return folder / "ft.csv"


def test_a_recording_on_two_clocks_is_brought_together_by_the_setup(
    sphere_60mm: Path, tmp_path: Path
) -> None:
    """The points found with the estimated offset are those of one clock; with none they are shifted
    along the trail.
    """
    wrench, pose = (
        with_stops(stream, [750, 1250, 1500], 0.004, slice(10, 200))
        for stream in streams(sphere_60mm / "frictionless" / "trail_y-0.20.csv")
    )
    text = (
        (sphere_60mm / "setup.toml").read_text()
        + '[recording]\npose_file = "tool.csv"\nlargest_offset = 0.5\ntime_offset = "estimate"\n'
    )
    (tmp_path / "setup.toml").write_text(text)
    file = write(tmp_path, wrench, Stream(pose.time - 0.2, pose.values))
    with pytest.warns(RecordingWarning) as caught:
        reactions = vb.read_recording(file, vb.load_setup(tmp_path / "setup.toml"))
    assert any("time offset of the poses estimated: 0." in str(one.message) for one in caught)
    assert reactions.time is not None
    expected = np.interp(reactions.time, pose.time, pose.values[:, 0])
    assert np.max(np.abs(reactions.trail.position[:, 0] - expected)) < 2e-4


def test_a_refusal_names_file_and_key(sphere_60mm: Path, tmp_path: Path) -> None:
    (tmp_path / "setup.toml").write_text(
        (sphere_60mm / "setup.toml").read_text() + '[recording]\ntime_offset = "estimate"\n'
    )
    file = sphere_60mm / "frictionless" / "trail_y+0.10.csv"
    with pytest.raises(InputError) as caught:
        vb.read_recording(file, vb.load_setup(tmp_path / "setup.toml"))
    assert str(caught.value).startswith(
        f"{file}: time_offset = 'estimate': the data do not determine it"
    )
