"""Do 95 % ellipsoids hold if the setup is not quite right? `python benchmarks/tolerances.py
[--repeats N]`.

Each sweep is that of a rig whose rod, clamp, gains and clocks are drawn from the stated tolerances:
it is scanned and measured with those, and read with the numbers of the setup. The table gives the
share of contacts, and of normals, whose error lies within the 95 % ellipsoid, averaged over
repeats.
"""

import argparse
import warnings
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation, Slerp
from scipy.stats import chi2

import vibrissa as vb
from vibrissa.sensor import RawRecording, Sensor
from vibrissa.tolerances import PARAMETERS

ROD = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
MOUNT = Rotation.from_rotvec([0.3, -0.2, 0.5])
SENSOR = Sensor(
    np.array([0.001, 0.002, 0.025]),
    MOUNT.as_quat(),
    "on_sensor",
    tare_seconds=0.5,
    force_noise=1e-3,
    torque_noise=1e-5,
    force_resolution=1.5625e-4,
    torque_resolution=7.8125e-7,
    position_noise=1e-5,
)
TOLERANCES = vb.Tolerances(
    youngs_modulus=0.04,
    radius=0.01,
    length=0.4e-3,
    clamp_position=0.4e-3,
    clamp_orientation=0.01,
    gain=0.015,
    pose_delay=5e-3,
)
RATE, REST, COUNT = 100.0, 60, 240


class Sweep(NamedTuple):
    """An object, and how the clamp is meant to move: at rest, then along the path."""

    name: str
    surface: vb.surfaces.Surface
    trail: vb.Trail


def sweeps() -> list[Sweep]:
    """Three objects under a clamp that moves, and one beside a clamp that turns."""

    def line(offset: float, height: float = 0.0) -> vb.Trail:
        return vb.Trail.line(
            start=(0.03, offset, height), stop=(-0.03, offset, height), count=COUNT
        )

    ball = vb.surfaces.Sphere(center=(0, 0, 0.0575), radius=0.03)
    capsule = vb.surfaces.Capsule(
        center=(0, 0, 0.046), axis=(0.25, 1, 0), radius=0.015, length=0.06
    )
    ellipsoid = vb.surfaces.Superquadric(
        center=(0, 0, 0.06), semi_axes=(0.022, 0.03, 0.028), exponents=(1.0, 1.0)
    )
    whisk = vb.Trail.whisk(
        pivot=(0, 0, 0),
        axis=(0, 0, 1),
        position=(0.01, 0, 0),
        start_angle=-0.1,
        stop_angle=0.75,
        count=COUNT,
        rod_axis=(1, 0, 0),
    )
    side = vb.surfaces.Sphere(center=(0.042, 0.027, 0.004), radius=0.02)
    return [
        Sweep("ball", ball, line(0.005)),
        Sweep("capsule", capsule, line(0.002)),
        Sweep("ellipsoid", ellipsoid, line(-0.004)),
        Sweep("ball, whisking", side, whisk),
    ]


class Drawn(NamedTuple):
    """A rig with its true numbers."""

    rod: vb.Rod
    sensor: Sensor
    delay: float


def rig(errors: Float[np.ndarray, "15"]) -> Drawn:
    """The rig whose numbers are off from the setup's by these, in the order of `PARAMETERS`."""
    of = dict(zip(PARAMETERS, errors.tolist(), strict=True))
    shift, turn = (
        np.array([of[f"{name}_{axis}"] for axis in "xyz"])
        for name in ("clamp_position", "clamp_orientation")
    )
    gain = [1 + of[name] for name in PARAMETERS if name.startswith("gain")]
    rod = vb.Rod(ROD.length + of["length"], ROD.bending_stiffness * (1 + of["bending_stiffness"]))
    sensor = replace(
        SENSOR,
        clamp_position=SENSOR.clamp_position + shift,
        clamp_orientation=(
            Rotation.from_quat(SENSOR.clamp_orientation) * Rotation.from_rotvec(turn)
        ).as_quat(),
        gain=tuple(gain),
    )
    return Drawn(rod, sensor, of["pose_delay"])


class Logged(NamedTuple):
    """A recording, and the scan it was made from."""

    raw: RawRecording
    scan: vb.Scan


def logged(sweep: Sweep, drawn: Drawn, rng: np.random.Generator) -> Logged:
    """What the drawn rig logs while its sensor moves as the setup's would along the trail."""
    nominal = Rotation.from_quat(SENSOR.clamp_orientation)
    turn = Rotation.from_quat(sweep.trail.orientation) * nominal.inv()
    place = sweep.trail.position - turn.apply(SENSOR.clamp_position)
    time = np.arange(REST + COUNT) / RATE
    rows = np.maximum(np.arange(REST + COUNT) - REST, 0)
    clamp = vb.Trail(
        place + turn.apply(drawn.sensor.clamp_position),
        (turn * Rotation.from_quat(drawn.sensor.clamp_orientation)).as_quat(),
    )
    scan = vb.scan(drawn.rod, sweep.surface, clamp)
    force, moment = (
        np.nan_to_num(part)[rows] for part in (scan.reactions.force, scan.reactions.moment)
    )
    raw = drawn.sensor.measure(
        vb.Reactions(
            vb.Trail(clamp.position[rows], clamp.orientation[rows]), force, moment, time=time
        ),
        rng,
    )
    if not drawn.delay:
        return Logged(raw, scan)
    # Late poses, at the stamps of the wrenches.
    at = np.clip((time - drawn.delay) * RATE, 0, len(time) - 1)
    moved = (
        np.stack([np.interp(at, np.arange(len(time)), part[rows]) for part in place.T], axis=1)
        - place[rows]
    )
    late = Slerp(np.arange(len(time)), turn[rows])(at) * turn[rows].inv()
    orientation = (late * Rotation.from_quat(raw.orientation)).as_quat()
    return Logged(replace(raw, position=raw.position + moved, orientation=orientation), scan)


def within(
    error: Float[np.ndarray, "n k"], covariance: Float[np.ndarray, "n k k"]
) -> Float[np.ndarray, "n"]:
    """Whether errors lie within their 95 % ellipsoids."""
    distance = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0])
    return distance < chi2.ppf(0.95, error.shape[1])


def across(normal: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 2"]:
    """Two directions perpendicular to each normal."""
    return np.linalg.svd(normal[:, :, None])[0][:, :, 1:]


class Held(NamedTuple):
    """Shares of one sweep, and root mean square errors [m]."""

    points: float
    normals: float
    error: float
    stated: float
    ok: float


def held(found: vb.Reconstruction, scan: vb.Scan) -> Held:
    """Figures of contacts that really exist and are OK."""
    assert found.covariance is not None and found.normal_covariance is not None
    sound = (
        found.in_contact
        & (found.status == vb.Status.OK)
        & np.isfinite(found.normal_covariance).all(axis=(1, 2))
    )
    row = np.flatnonzero(sound[REST:] & scan.in_contact)
    ok = len(row) / np.count_nonzero(found.in_contact[REST:] & scan.in_contact)
    if not len(row):
        return Held(np.nan, np.nan, np.nan, np.nan, ok)
    error, covariance = found.point[REST:][row] - scan.point[row], found.covariance[REST:][row]
    plane = across(found.normal[REST:][row])
    tilt = np.einsum("nik,ni->nk", plane, found.normal[REST:][row] - scan.normal[row])
    spread = np.swapaxes(plane, 1, 2) @ found.normal_covariance[REST:][row] @ plane
    size, stated = (
        float(np.sqrt(np.mean(values)))
        for values in (np.sum(error**2, axis=1), np.trace(covariance, axis1=1, axis2=2))
    )
    return Held(
        float(within(error, covariance).mean()),
        float(within(tilt, spread).mean()),
        size,
        stated,
        ok,
    )


def main(repeats: int, seed: int) -> None:
    """Print the table."""
    warnings.simplefilter("ignore", vb.RecordingWarning)
    factor = np.sqrt(np.diag(TOLERANCES.covariance))
    print(
        f"{'sweep':16}{'contacts':>22}{'normals':>10}{'points':>10}{'rms error':>12}{'stated':>10} mm"
    )
    for sweep in sweeps():
        rng = np.random.default_rng(seed)
        results: dict[str, list[Held]] = {"raw": [], "smoothed": []}
        for _ in range(repeats):
            raw, scan = logged(sweep, rig(rng.normal(size=len(PARAMETERS)) * factor), rng)
            found = vb.reconstruct(ROD, SENSOR.reactions(raw, tolerances=TOLERANCES), friction=0.0)
            for name, contacts in (("raw", found), ("smoothed", vb.smooth(found))):
                results[name].append(held(contacts, scan))
        for name, shares in results.items():
            points, normals, error, stated, ok = np.nanmean(shares, axis=0)
            print(
                f"{sweep.name:16}{f'{name}, {ok:.0%} OK':>22}{normals:10.1%}{points:10.1%}{1e3 * error:12.3f}{1e3 * stated:10.3f}",
                flush=True,
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    main(given.repeats, given.seed)
