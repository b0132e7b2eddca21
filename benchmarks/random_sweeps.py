"""Whether smoothing ever fails: `python benchmarks/random_sweeps.py N [SEED]`.

Sixteen scans, under objects of four kinds with and without friction, are measured again and again
by sensors with random noise, resolution and rate, with gaps, spikes, NaN rows, drift, ringing,
wrong signs, wrong stiffness, and truncated starts and ends. Wire, world axes and tolerances are
drawn anew each time; then the recording is reconstructed and smoothed. Exceptions are printed, and
rows that are OK but not finite. The exit code is the number of failed sweeps, at most 100.
"""

import sys
import time
import traceback
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa import surfaces
from vibrissa.tolerances import SetupErrors

WIRE = vb.Rod.cylinder(length=0.05, radius=0.2e-3, youngs_modulus=206e9)
ROWS, TRAILS = 400, 4
UP = (0.0, 0.0, 1.0)


def scans(rng: np.random.Generator) -> list[vb.Reactions]:
    """Four straight trails under each object, in one scan per object; zeros in place of NaN."""
    drawn: list[tuple[surfaces.Surface, float]] = [
        (surfaces.Sphere((0, 0, 0.0575), float(rng.uniform(0.02, 0.032))), 0.0),
        (surfaces.Capsule((0, 0, 0.054), (0, 1, 0), float(rng.uniform(0.004, 0.02)), 0.03), 0.0),
        (
            surfaces.Ellipsoid((0, 0, 0.058), rng.uniform(0.015, 0.035, 3)),
            float(rng.uniform(0.1, 0.5)),
        ),
        (surfaces.Superquadric((0, 0, 0.06), rng.uniform(0.02, 0.032, 3), (0.4, 0.4)), 0.0),
    ]
    found = []
    for surface, friction in drawn:
        along = np.linspace(0.04, -0.04, ROWS)
        position = np.zeros((TRAILS, ROWS, 3))
        position[..., 0] = along
        position[..., 1] = rng.uniform(-0.012, 0.012, (TRAILS, 1))
        position[..., 2] = rng.uniform(-0.004, 0.004, (TRAILS, 1))
        scan = vb.scan(WIRE, surface, vb.Trail(position), friction=friction)
        force, moment = np.nan_to_num(scan.reactions.force), np.nan_to_num(scan.reactions.moment)
        found += [vb.Reactions(vb.Trail(position[j]), force[j], moment[j]) for j in range(TRAILS)]
    return found


def recorded(true: vb.Reactions, rng: np.random.Generator) -> tuple[vb.Rod, vb.Reactions]:
    """The rod as stated, and one recording with its faults."""
    rest, rate = int(rng.integers(0, 120)), float(10 ** rng.uniform(1, 3))
    rows = np.concatenate([np.zeros(rest, dtype=int), np.arange(ROWS)])
    force, moment, position = (
        true.force[rows].copy(),
        true.moment[rows].copy(),
        true.trail.position[rows],
    )
    noise = max(float(np.abs(true.force).max()), 1e-3) / 10 ** rng.uniform(0.5, 3.5)
    arm = 10 ** rng.uniform(-3, -1.5)
    actual = noise * (3 if rng.random() < 0.1 else 1)
    count = len(rows)
    if rng.random() < 0.3:
        force += noise * rng.normal(size=3) * np.linspace(0, 5, count)[:, None]
    if rng.random() < 0.3:
        released = int(np.argmax(np.linalg.norm(np.diff(force, axis=0), axis=1))) + 1
        after = np.arange(count - released) / rate
        force[released:, 0] += (
            20 * noise * np.exp(-after * 3) * np.sin(2 * np.pi * min(47, rate / 3) * after)
        )
    force, moment = (
        force + rng.normal(0, actual, force.shape),
        moment + rng.normal(0, arm * actual, moment.shape),
    )
    if rng.random() < 0.4:
        force = np.round(force / noise) * noise
    if rng.random() < 0.3:
        force[rng.integers(0, count, 5)] += 1e3 * noise
    if rng.random() < 0.3:
        force[rng.integers(0, count, 20)] = np.nan
    if rng.random() < 0.1:
        force, moment = -force, -moment
    if rng.random() < 0.1:
        moment = moment * float(rng.choice([0.1, 10.0, 1.02]))
    first, last = (
        (int(rng.integers(0, count // 2)), int(rng.integers(count // 2, count)))
        if rng.random() < 0.5
        else (0, count)
    )
    kept = np.arange(first, last)
    if rng.random() < 0.2:
        kept = np.delete(
            kept, np.arange(len(kept) // 3, len(kept) // 3 + int(rng.integers(1, len(kept) // 3)))
        )
    covariance = np.diag(np.repeat([noise**2, (arm * noise) ** 2], 3))
    time_ = None if rng.random() < 0.1 else kept / rate
    # By similarity, this is the sweep of another wire, in other axes.
    wire = vb.Rod.cylinder(
        length=rng.uniform(0.02, 0.2),
        radius=10 ** rng.uniform(-4, -3),
        youngs_modulus=10 ** rng.uniform(9.5, 11.5),
    )
    scales = np.repeat(
        [wire.force_scale / WIRE.force_scale, wire.moment_scale / WIRE.moment_scale], 3
    )
    world = Rotation.random(random_state=rng)
    turn = block_diag(world.as_matrix(), world.as_matrix()) * scales
    wrench = np.concatenate([force, moment], axis=1)[kept] @ turn.T
    way = world.apply(position[kept]) * wire.length / WIRE.length
    stated = tolerances(wire, rng) if rng.random() < 0.3 else None
    given = vb.Reactions(
        vb.Trail(way, world),
        wrench[:, :3],
        wrench[:, 3:],
        time=time_,
        covariance=turn @ covariance @ turn.T,
        setup_errors=stated,
    )
    rod = replace(
        wire,
        bending_stiffness=wire.bending_stiffness * float(rng.choice([1.0, 1.0, 1.05, 0.2, 5.0])),
    )
    return rod, given


def tolerances(wire: vb.Rod, rng: np.random.Generator) -> SetupErrors:
    """What a careful or a careless bench may state."""
    careless = 10 ** rng.uniform(-1, 1)
    stated = vb.Tolerances(
        youngs_modulus=0.01 * careless,
        radius=0.005 * careless,
        length=0.002 * wire.length * careless,
        clamp_position=0.002 * wire.length * careless,
        clamp_orientation=0.003 * careless,
        gain=0.005 * careless,
        pose_delay=0.001 * careless,
    )
    return vb.Sensor((0, 0, 0), (0, 0, 0, 1), "on_rod").setup_errors(stated)


def main(count: int, seed: int = 0) -> int:
    """Print what fails; return how many sweeps fail."""
    rng = np.random.default_rng(seed)
    true, failed, start = scans(rng), 0, time.perf_counter()
    for k in range(count):
        chosen = np.random.default_rng((seed, k))
        if k % 20 == 0:
            print(f"{k} done, {failed} failed, {time.perf_counter() - start:.0f} s", flush=True)
        rod, given = recorded(true[k % len(true)], chosen)
        try:
            found = vb.smooth(
                vb.reconstruct(rod, given, friction=0.0 if chosen.random() < 0.3 else None)
            )
        except Exception:
            failed += 1
            print(f"sweep {k}: {traceback.format_exc(limit=-3)}", flush=True)
            continue
        assert found.covariance is not None
        finite = np.isfinite(found.point).all(axis=1) & np.isfinite(found.covariance).all(
            axis=(1, 2)
        )
        unsound = found.in_contact & ~finite & (found.status == vb.Status.OK)
        if unsound.any():
            failed += 1
            print(f"sweep {k}: {unsound.sum()} rows say OK and are not finite", flush=True)
    print(f"{failed} of {count} sweeps fail, {(time.perf_counter() - start) / count:.2f} s each")
    return failed


if __name__ == "__main__":
    sys.exit(min(main(*map(int, sys.argv[1:])), 100))
