"""Calibration: errors on another engine's recordings from many wrong starts, and how often
intervals contain the truth in simulated repeats.

    python benchmarks/calibration.py RECORDINGS   the first table, from the folder sphere_60mm
    python benchmarks/calibration.py              the second

Both start with EI off by 20 %, L by 3 %, the clamp by 2 mm and 3°, in random directions and with
all signs.
"""

import itertools
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import vibrissa as vb

STARTS, REPEATS = 20, 100
RATE, SPEED, REST = 250.0, 0.0135, 250
SENSOR = vb.Sensor(
    np.array([0.003, -0.002, 0.02]),
    Rotation.from_rotvec([0.1, 0.2, -0.4]).as_quat(),
    "on_sensor",
    tare_seconds=0.9,
    force_noise=2e-3,
    torque_noise=4e-5,
    force_resolution=1.5625e-3,
    torque_resolution=7.8125e-6,
    position_noise=1e-5,
)
WIRE = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
SPHERE = vb.surfaces.Sphere(center=(0, 0, 0.0575), radius=0.03)


def wrong(setup: vb.Setup, index: int, rng: np.random.Generator) -> vb.Setup:
    """A wrong setup, with the combination of signs that belongs to the index."""
    stiffness, length = list(itertools.product((0.8, 1.2), (0.97, 1.03)))[index % 4]
    move, turn = rng.normal(size=3), rng.normal(size=3)
    turn[2] = 0.0
    move, turn = 2e-3 * move / np.linalg.norm(move), np.radians(3) * turn / np.linalg.norm(turn)
    rod = replace(
        setup.rod,
        bending_stiffness=stiffness * setup.rod.bending_stiffness,
        length=length * setup.rod.length,
    )
    orientation = Rotation.from_quat(setup.sensor.clamp_orientation) * Rotation.from_rotvec(turn)
    sensor = replace(
        setup.sensor,
        clamp_position=setup.sensor.clamp_position + move,
        clamp_orientation=orientation.as_quat(),
    )
    return replace(setup, rod=rod, sensor=sensor)


def errors(found: vb.Setup, truth: vb.Setup) -> np.ndarray:
    """EI and L [%], clamp position [mm], direction of the rod [°]."""
    axes = [
        Rotation.from_quat(setup.sensor.clamp_orientation).apply([0, 0, 1])
        for setup in (found, truth)
    ]
    return np.array(
        [
            100 * abs(found.rod.bending_stiffness / truth.rod.bending_stiffness - 1),
            100 * abs(found.rod.length / truth.rod.length - 1),
            1e3 * np.linalg.norm(found.sensor.clamp_position - truth.sensor.clamp_position),
            np.degrees(np.arccos(min(1.0, axes[0] @ axes[1]))),
        ]
    )


def recorded(folder: Path) -> None:
    """Every pair of the trails without friction."""
    truth, rng = vb.load_setup(folder / "setup.toml"), np.random.default_rng(1)
    print(
        "| trails | largest error of EI, % | L, % | clamp, mm | axis, ° | half of the 95 % interval of EI, % | L, % |"
    )
    print("|---|---|---|---|---|---|---|")
    for pair in itertools.combinations(
        sorted(
            path
            for path in (folder / "frictionless").glob("trail_y*.csv")
            if "truth" not in path.name
        ),
        2,
    ):
        worst, half = np.zeros(4), np.zeros(2)
        for index in range(STARTS):
            setup = wrong(truth, index, rng)
            result = vb.calibrate([vb.read_recording(path, setup) for path in pair], setup)
            worst = np.maximum(worst, errors(result.setup, truth))
            one = [result.estimates[name] for name in ("youngs_modulus", "length")]
            half = np.array([100 * 1.96 * estimate.deviation / estimate.value for estimate in one])
        names = " and ".join(path.stem.removeprefix("trail_y") for path in pair)
        print(
            f"| {names} | " + " | ".join(f"{value:.3f}" for value in (*worst, *half)) + " |",
            flush=True,
        )


def simulated() -> None:
    """Two trails, measured again each time: coverage of the 95 % intervals, and scatter relative to
    the Cramér–Rao bound.
    """
    truth, rng = vb.Setup(WIRE, SENSOR, SPHERE), np.random.default_rng(2)
    swept = [sweep(y) for y in (0.005, -0.01)]
    inside: dict[str, int] = {}
    scaled: dict[str, list[float]] = {}
    for index in range(REPEATS):
        recordings = [
            SENSOR.measure(one, rng, force_tare=(0.3, -0.1, 1.9), torque_tare=(2e-3, -4e-3, 7e-4))
            for one in swept
        ]
        setup = wrong(truth, index, rng)
        result = vb.calibrate(recordings, setup)
        for name, value in true_values(setup, truth).items():
            estimate = result.estimates[name]
            low, high = estimate.interval()
            inside[name] = inside.get(name, 0) + (low <= value <= high)
            scaled.setdefault(name, []).append((estimate.value - value) / estimate.deviation)
    print(
        f"| parameter | truth inside the 95 % interval, of {REPEATS} | scatter over the Cramér–Rao limit | mean error over it |"
    )
    print("|---|---|---|---|")
    for name, pulls in scaled.items():
        print(
            f"| {name} | {inside[name]} | {np.sqrt(np.mean(np.square(pulls))):.2f} | {np.mean(pulls):+.2f} |"
        )


def sweep(y: float) -> vb.Reactions:
    """Reactions of a sweep at the height of the recordings, after a second at rest."""
    start, stop = np.array([0.04, y, 0.0]), np.array([-0.0475, y, 0.0])
    count = int(RATE * np.linalg.norm(stop - start) / SPEED)
    position = np.vstack([np.repeat(start[None], REST, axis=0), np.linspace(start, stop, count)])
    scan = vb.scan(WIRE, SPHERE, vb.Trail(position))
    return vb.Reactions(
        scan.trail,
        scan.reactions.force,
        scan.reactions.moment,
        time=np.arange(len(position)) / RATE,
    )


def true_values(setup: vb.Setup, truth: vb.Setup) -> dict[str, float]:
    """True values of what the data determine, seen from a wrong setup; orientation without roll."""
    axis = Rotation.from_quat(truth.sensor.clamp_orientation).apply([0, 0, 1])
    x, y, z = Rotation.from_quat(setup.sensor.clamp_orientation).inv().apply(axis)
    turn = np.arccos(min(1.0, z)) * np.array([-y, x]) / np.hypot(x, y)
    values = {"youngs_modulus": 206e9, "length": truth.rod.length}
    values |= {
        f"clamp_position_{name}": value
        for name, value in zip("xyz", truth.sensor.clamp_position, strict=True)
    }
    return values | {
        f"clamp_orientation_{name}": value for name, value in zip("xy", turn, strict=True)
    }


if __name__ == "__main__":
    if len(sys.argv) > 1:
        recorded(Path(sys.argv[1]))
    else:
        simulated()
