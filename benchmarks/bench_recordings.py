"""Recordings made by the independent engine, each with one deviation from its setup: `python
benchmarks/bench_recordings.py FOLDER [NAME ...]`.

Unless stated otherwise, a steel wire of 50 mm and 0.5 mm diameter is swept at 10 mm/s under a ball
of 30 mm radius. FOLDER gets NAME.csv; NAME.toml, the setup as a user would have written it; and
NAME.truth.npz with t [s] (n,), p [m] (n, 3), the engine's contacts, and ic (n,): in contact, at one
place. The engine's runs are kept in FOLDER/runs.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import vibrissa as vb
from engine import GRAVITY, Body, Run, Wire, remembered, swept
from logs import Faults, Log, Sensor, logged

SPEED = 10e-3
SPACING = 0.25e-3
CENTER = (0.0, 0.0, 0.0575)
_TILT = Rotation.align_vectors([(0.3, 1, 0.2)], [(0, 0, 1)])[0]
_SKEW = Rotation.from_quat((0.25, -0.1, 0.3, 1.0))


@dataclass(frozen=True)
class Scene:
    """What the engine runs: wire, object, path of the clamp, friction."""

    wire: Wire
    bodies: tuple[Body, ...]
    path: vb.Trail
    friction: float = 0.0


@dataclass(frozen=True)
class Recording:
    """A scene as logged: what is off, by how much in words, and the number of passes, back and
    forth.
    """

    scene: str
    effect: str = "none"
    size: str = ""
    faults: Faults = field(default_factory=Faults)
    passes: int = 1
    sensor: Sensor = field(default_factory=Sensor)
    tolerance: str = ""
    """Line of [tolerances] that allows for it as one standard deviation."""
    misread: Callable[[np.ndarray], np.ndarray] | None = None
    """What a user got wrong in the rows of the file (n, 14)."""


def _line(start: tuple[float, float, float], stop: tuple[float, float, float]) -> vb.Trail:
    return vb.Trail.line(
        start=start, stop=stop, count=1 + round(np.linalg.norm(np.subtract(stop, start)) / SPACING)
    )


def _across(offset: float, reach: float = 0.04, depth: float = 0.0) -> vb.Trail:
    return _line((reach, offset, depth), (-reach, offset, depth))


def _ball(radius: float = 0.03, center: tuple[float, float, float] = CENTER) -> tuple[Body, ...]:
    return (Body("sphere", (radius,), center),)


_STEEL = Wire()
_THIN = Wire(length=0.06, radius=0.1e-3, density=7850.0, down=(0.0, -1.0, 0.0))
_BLOB = (
    Body("sphere", (0.02,), (-0.015, 0.012, 0.0535)),
    Body("sphere", (0.02,), (0.015, -0.012, 0.0535)),
)
_ARC = vb.Trail.arc(
    center=(0, 0.005, 0.15),
    axis=(0, 1, 0),
    start=(0.0562, 0.005, 0.01092),
    angle=np.deg2rad(44),
    count=461,
    rod_axis=(-0.0562, 0, 0.13908),
    turning=True,
)

SCENES = {
    "ball5": Scene(_STEEL, _ball(), _across(0.005)),
    "ball1": Scene(_STEEL, _ball(), _across(0.001)),
    "ball12": Scene(_STEEL, _ball(), _across(-0.012)),
    "ball_far": Scene(_STEEL, _ball(), _across(0.018)),
    "ball_arc": Scene(_STEEL, _ball(), _ARC),
    "taper_5": Scene(Wire(tip=0.95), _ball(), _across(0.005)),
    "taper_half": Scene(Wire(tip=0.5), _ball(), _across(0.005)),
    "sag_x": Scene(Wire(sagitta=(1e-3, 0.0)), _ball(), _across(0.005)),
    "sag_y": Scene(Wire(sagitta=(0.0, 1e-3)), _ball(), _across(0.005)),
    "thin": Scene(_THIN, _ball(center=(0.0, 0.0, 0.0675)), _across(0.005)),
    "oblique": Scene(
        _STEEL, (Body("capsule", (0.015, 0.03), CENTER, _TILT),), _across(0.004, depth=0.012)
    ),
    "ellipsoid": Scene(
        _STEEL,
        (Body("ellipsoid", (0.035, 0.025, 0.03), CENTER),),
        _line((0.01, 0.035, 0), (0.01, -0.035, 0)),
    ),
    "box": Scene(
        _STEEL,
        (Body("box", (0.017, 0.013, 0.012), CENTER, _SKEW, rounding=0.005),),
        _across(0.004, depth=0.008),
    ),
    "blob": Scene(_STEEL, _BLOB, _across(0.003)),
    "rubbing": Scene(_STEEL, _ball(), _across(0.005), friction=0.25),
    "weak": Scene(Wire(radius=0.125e-3), _ball(), _across(0.004)),
}

_ALL, _HALF_TORQUE = (1.02,) * 6, (1.0, 1.0, 1.0, 1.02, 1.02, 1.02)
_WARMING = (15e-3, -9e-3, 20e-3, 0.15e-3, 0.2e-3, -0.05e-3)
_HUM = (5e-3, 3e-3, 5e-3, 1e-4, 1e-4, 4e-5)
_FINE = Sensor(force_noise=0.2e-3, torque_noise=4e-6, force_step=1 / 6400, torque_step=1 / 1280e3)


def _scaled(position: float, wrench: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda table: table * ([1.0] + [position] * 3 + [1.0] * 4 + [wrench] * 6)


RECORDINGS = {
    "ei_plus5": Recording(
        "ball5",
        "EI stated too high",
        "5 %",
        Faults(modulus=1.05),
        tolerance="youngs_modulus = 0.05",
    ),
    "ei_plus1": Recording(
        "ball5",
        "EI stated too high",
        "1 %",
        Faults(modulus=1.01),
        tolerance="youngs_modulus = 0.01",
    ),
    "ei_minus5": Recording(
        "ball12",
        "EI stated too low",
        "5 %",
        Faults(modulus=0.95),
        tolerance="youngs_modulus = 0.05",
    ),
    "ei_plus5_arc": Recording(
        "ball_arc",
        "EI stated too high, arc",
        "5 %",
        Faults(modulus=1.05),
        tolerance="youngs_modulus = 0.05",
    ),
    "length_plus1mm": Recording(
        "ball5", "length stated too long", "1 mm", Faults(length=1.02), tolerance="length = 1e-3"
    ),
    "clamp_ry": Recording(
        "ball5",
        "clamp turned about y",
        "0.3°",
        Faults(turned=(0, 5.236e-3, 0)),
        tolerance="clamp_orientation = 5.2e-3",
    ),
    "clamp_rx": Recording(
        "ball5",
        "clamp turned about x",
        "0.3°",
        Faults(turned=(5.236e-3, 0, 0)),
        tolerance="clamp_orientation = 5.2e-3",
    ),
    "clamp_x": Recording(
        "ball5",
        "clamp shifted along x",
        "0.3 mm",
        Faults(shifted=(0.3e-3, 0, 0)),
        tolerance="clamp_position = 0.3e-3",
    ),
    "clamp_z": Recording(
        "ball5",
        "clamp shifted along z",
        "0.5 mm",
        Faults(shifted=(0, 0, 0.5e-3)),
        tolerance="clamp_position = 0.5e-3",
    ),
    "late5": Recording(
        "ball5", "poses late", "5 ms", Faults(delay=5e-3), tolerance="pose_delay = 5e-3"
    ),
    "late50": Recording(
        "ball5", "poses late", "50 ms", Faults(delay=50e-3), tolerance="pose_delay = 50e-3"
    ),
    "late5_to_and_fro": Recording(
        "ball5",
        "poses late, to and fro",
        "5 ms",
        Faults(delay=5e-3),
        passes=2,
        tolerance="pose_delay = 5e-3",
    ),
    "late50_to_and_fro": Recording(
        "ball5",
        "poses late, to and fro",
        "50 ms",
        Faults(delay=50e-3),
        passes=2,
        tolerance="pose_delay = 50e-3",
    ),
    "gain_all": Recording(
        "ball5", "all channels read too much", "2 %", Faults(gain=_ALL), tolerance="gain = 0.02"
    ),
    "gain_torque": Recording(
        "ball5", "torques read too much", "2 %", Faults(gain=_HALF_TORQUE), tolerance="gain = 0.02"
    ),
    "gain_fx": Recording(
        "ball12",
        "fx reads too much",
        "2 %",
        Faults(gain=(1.02, 1, 1, 1, 1, 1)),
        tolerance="gain = 0.02",
    ),
    "drift_fx": Recording(
        "ball5", "zero of fx drifts", "1 mN/s", Faults(drift=(1e-3, 0, 0, 0, 0, 0))
    ),
    "drift_ty": Recording(
        "ball12", "zero of ty drifts", "0.03 N mm/s", Faults(drift=(0, 0, 0, 0, 3e-5, 0))
    ),
    "warming": Recording("ball5", "sensor warms, 4 s", "15, -9, 20 mN", Faults(warming=_WARMING)),
    "noise3": Recording("ball5", "noise over the stated one", "3", Faults(noise=3.0)),
    "pose_noise5": Recording(
        "ball5", "noise of poses over the stated one", "5", Faults(pose_noise=5.0)
    ),
    "hum50": Recording("ball5", "hum of 50 Hz", "5 mN", Faults(hum=_HUM)),
    "hum60": Recording(
        "ball5", "hum of 60 Hz, an alias at 250 Hz", "5 mN", Faults(hum=_HUM, hum_hertz=60.0)
    ),
    "taper_5": Recording("taper_5", "radius at the tip smaller", "5 %"),
    "taper_half": Recording("taper_half", "radius at the tip smaller", "50 %"),
    "sag_x": Recording("sag_x", "sagitta in the plane of the sweep", "1 mm"),
    "sag_y": Recording("sag_y", "sagitta sideways", "1 mm"),
    "thin_weight": Recording("thin", "own weight of a thin wire", "3 % of EI/L²", sensor=_FINE),
    "rubbing": Recording("rubbing", "friction, not said", "0.25"),
    "centimetres": Recording("ball5", "centimetres for metres", misread=_scaled(100.0, 1.0)),
    "inches": Recording("ball5", "inches for metres", misread=_scaled(1 / 0.0254, 1.0)),
    "kgf": Recording("ball5", "kgf for N", misread=_scaled(1.0, 1 / GRAVITY)),
    "sign": Recording("ball5", "sign of the wrench", misread=_scaled(1.0, -1.0)),
    "w_first": Recording(
        "ball_arc",
        "quaternions with w first",
        misread=lambda t: t[:, [0, 1, 2, 3, 7, 4, 5, 6, *range(8, 14)]],
    ),
    "conjugated": Recording(
        "ball_arc",
        "quaternions conjugated",
        misread=lambda t: t * ([1.0] * 4 + [-1.0] * 3 + [1.0] * 7),
    ),
    "turned_180": Recording(
        "ball5",
        "sensor turned about z",
        "180°",
        misread=lambda t: t * ([1.0] * 8 + [-1.0, -1, 1] * 2),
    ),
    "good_ball1": Recording("ball1"),
    "good_ball5": Recording("ball5"),
    "good_ball12": Recording("ball12"),
    "good_ball_far": Recording("ball_far"),
    "good_arc": Recording("ball_arc"),
    "good_to_and_fro": Recording("ball5", passes=2),
    "good_oblique": Recording("oblique"),
    "good_ellipsoid": Recording("ellipsoid"),
    "good_box": Recording("box"),
    "good_blob": Recording("blob"),
    "good_weak": Recording("weak"),
}


def run_of(scene: Scene) -> Run:
    """The engine's run of a scene."""
    return swept(
        scene.wire, list(scene.bodies), scene.path.position, scene.path.orientation, scene.friction
    )


def to_and_fro(run: Run, passes: int) -> Run:
    """The run passed through several times, in alternating directions: without friction and jumps,
    equilibria do not depend on the direction.
    """
    rows = np.concatenate([np.arange(len(run.position))[:: (-1) ** k] for k in range(passes)])
    return Run(**{name: values[rows] for name, values in vars(run).items()})


def made(recording: Recording, runs: Path, seed: int) -> Log:
    """One recording; the engine's runs are kept in a folder."""
    scene = SCENES[recording.scene]
    run = to_and_fro(
        remembered(runs / f"{recording.scene}.npz", lambda: run_of(scene)), recording.passes
    )
    way = np.linalg.norm(np.diff(scene.path.position, axis=0), axis=1).sum() * recording.passes
    log = logged(
        run,
        scene.wire,
        seconds=way / SPEED,
        faults=recording.faults,
        seed=seed,
        sensor=recording.sensor,
    )
    return log if recording.misread is None else replace(log, table=recording.misread(log.table))


def seed_of(name: str) -> int:
    """Seed for the noise of the recording with this name."""
    return sum(map(ord, name))


def main(folder: Path, names: list[str]) -> None:
    """Write recordings that are not there yet."""
    for name in names or RECORDINGS:
        log = made(RECORDINGS[name], folder / "runs", seed_of(name))
        log.write(folder, name)
        touching = np.isfinite(log.point[:, 0])
        print(f"{name:<20}{len(log.table):>6} rows, {touching.sum():>5} in contact", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
