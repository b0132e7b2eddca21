"""The package against a physics engine that steps to rest, on one core: `python
benchmarks/chains.py [SEGMENTS ...]`.

The case has the published experiment's scale: a steel wire of 50 mm, radius 0.25 mm, swept without
friction under a sphere of 60 mm in steps of 0.5 mm. The peer is MuJoCo (dependency group
`benchmark`). The rod is a chain of rigid capsules with a spring of EI/h in the middle of each
length h, so that its equilibria converge to those of the rod as h². Both have the wire's radius:
skins touch.

The chain is set up to come to rest in few steps:

- in units with L = EI = 1, where an explicit spring is stable for steps far longer than a steel
  wire's own motion would allow;
- with an armature of k τ² and a damping of k τ on each joint, k its stiffness: all joints relax at
  the same rate, whatever their number. With steel's mass in place of the armature the contact
  chatters, and a chain of 20 is not at rest after 200,000 steps;
- in steps of 0.3 τ with implicit damping, a contact time constant of two steps, and a solver
  tolerance of 1e-14, without which some positions never come to rest;
- each position from the last one, the clamp moved there as a mocap body; at rest when no joint
  moves faster than 2e-5/n rad/τ in n segments.

Joints are pairs of hinges: they take a third of the time of ball joints (which also twist) for the
same answers. Rows for ball joints and for the engine's own cable plugin, which gives the same
springs, are for comparison.
"""

import sys
from collections.abc import Callable
from typing import NamedTuple

from timing import best_of, pin_to_one_core

if __name__ == "__main__":
    pin_to_one_core()

from time import perf_counter

import mujoco
import numpy as np

import vibrissa as vb

ROD = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
CENTER, RADIUS = np.array([0.0, 0.0, 0.0575]), 0.03
TRAIL = vb.Trail.line(start=(0.04, 0.005, 0), stop=(-0.04, 0.005, 0), count=161)
SEGMENTS = (20, 40, 80)

MOST_STEPS, REST = 3000, 2e-5
_STEP, _AT_ONCE = 0.3, 5
_LEAST_MASS = 1e-3
_THICKNESS = ROD.radius / ROD.length


class Settled(NamedTuple):
    """Along the trail, in model units: force and moment of the clamp on the rod (n, 3), contact
    point (n, 3), steps taken (n,), and microseconds per position.
    """

    force: np.ndarray
    moment: np.ndarray
    point: np.ndarray
    steps: np.ndarray
    microseconds: float


def hinges(k: float) -> str:
    """Two hinges across the rod."""
    return "".join(
        f'<joint type="hinge" axis="{axis}" stiffness="{k}" armature="{k}" damping="{k}"/>'
        for axis in ("1 0 0", "0 1 0")
    )


def ball(k: float) -> str:
    """A ball joint."""
    return f'<joint type="ball" stiffness="{k}" armature="{k}" damping="{k}"/>'


def cable(k: float) -> str:
    """A ball joint whose spring comes from the cable plugin."""
    return f'<joint type="ball" armature="{k}" damping="{k}"/><plugin instance="rod"/>'


def ball_geom() -> str:
    """The sphere as MJCF, in units of the rod's length."""
    return f'<geom type="sphere" size="{RADIUS / ROD.length}" pos="0 0 {CENTER[2] / ROD.length}"/>'


def chain(segments: int, joint: Callable[[float], str], geom: str, assets: str = "") -> str:
    """The model as MJCF: an object, the clamp as a mocap body, a half segment fixed to it, then
    `segments` joints.
    """
    h, r = 1 / segments, _THICKNESS
    bodies = ""
    for i in range(segments):
        length = h / 2 if i == segments - 1 else h
        capsule = f'<geom type="capsule" size="{r}" fromto="0 0 0 0 0 {length}" mass="{_LEAST_MASS * length}"/>'
        bodies += f'<body pos="0 0 {h}">{joint(segments)}{capsule}'
    # The plugin twists about x, and a rod has twice the second moment in torsion: this makes the
    # springs EI/h about every axis.
    bend = 1 / (np.pi / 4 * r**4)
    keys = f'<config key="bend" value="{bend}"/><config key="twist" value="{bend / 2}"/>'
    plugin = (
        f'<plugin plugin="mujoco.elasticity.cable"><instance name="rod">{keys}</instance></plugin>'
    )
    own, root = (
        (f"<extension>{plugin}</extension>", '<plugin instance="rod"/>')
        if joint is cable
        else ("", "")
    )
    return f"""<mujoco>{own}
    <option timestep="{_STEP}" integrator="implicitfast" gravity="0 0 0" solver="Newton" tolerance="1e-14" iterations="100" ls_iterations="100"/>
    <default><geom condim="1" solref="{2 * _STEP} 1" solimp="0.9999 0.9999 0.001" contype="1" conaffinity="2"/></default>
    <asset>{assets}</asset>
    <worldbody>
      {geom.replace("/>", ' contype="2" conaffinity="1"/>')}
      <body mocap="true"><body pos="0 0 {-h / 2}">{root}
        <geom type="capsule" size="{r}" fromto="0 0 {h / 2} 0 0 {h}" contype="0" conaffinity="0"/><site name="clamp" pos="0 0 {h / 2}"/>
        {bodies}{"</body>" * segments}
      </body></body>
    </worldbody>
    <sensor><force site="clamp"/><torque site="clamp"/></sensor></mujoco>"""


def settled(model: mujoco.MjModel, positions: np.ndarray, rest: float) -> Settled:
    """Step to rest at each clamp position (n, 3)."""
    data = mujoco.MjData(model)
    wrench, point, steps = (
        np.zeros((len(positions), 6)),
        np.full((len(positions), 3), np.nan),
        np.zeros(len(positions), dtype=int),
    )
    begin = perf_counter()
    for row, position in enumerate(positions):
        data.mocap_pos[0] = position
        while steps[row] < MOST_STEPS:
            mujoco.mj_step(model, data, _AT_ONCE)
            steps[row] += _AT_ONCE
            if max(np.abs(data.qvel).max(), np.abs(data.qacc).max()) < rest:
                break
        wrench[row] = data.sensordata
        load = data.efc_force[data.contact.efc_address] if data.nefc else np.zeros(0)
        if load.sum() > 0:
            point[row] = load @ data.contact.pos / load.sum()
    return Settled(
        wrench[:, :3], wrench[:, 3:], point, steps, 1e6 * (perf_counter() - begin) / len(positions)
    )


def compared(scan: vb.Scan, found: Settled) -> dict[str, np.ndarray]:
    """Differences in each row that is in contact in both: force and moment relative to their
    largest, the contact point in millimetres.
    """
    both = scan.in_contact & np.isfinite(found.point[:, 0])
    force, moment = scan.reactions.force / ROD.force_scale, scan.reactions.moment / ROD.moment_scale
    return {
        "force": np.linalg.norm((found.force - force)[both], axis=1)
        / np.linalg.norm(force, axis=1).max(),
        "moment": np.linalg.norm((found.moment - moment)[both], axis=1)
        / np.linalg.norm(moment, axis=1).max(),
        "point": 1e3 * np.linalg.norm(found.point[both] * ROD.length - scan.point[both], axis=1),
    }


def main(segments: list[int]) -> dict[tuple[str, int], tuple[Settled, dict[str, np.ndarray]]]:
    """Print the table and return its rows by joint and number of segments."""
    sphere = vb.surfaces.Sphere(center=CENTER, radius=RADIUS)
    scan = vb.scan(ROD, sphere, TRAIL, finite_radius=True)
    own = best_of(50, lambda: vb.scan(ROD, sphere, TRAIL, finite_radius=True), TRAIL.count)
    many = vb.Trail.stack([TRAIL] * 200)
    batch = best_of(5, lambda: vb.scan(ROD, sphere, many, finite_radius=True), many.count * 200)
    print(
        f"MuJoCo {mujoco.__version__}, {TRAIL.count} positions, {scan.in_contact.sum()} in contact; errors are differences from vb.scan, median and largest\n"
    )
    print(
        f"{'':<22}{'steps':>7}{'µs/position':>13}{'ratio':>9}{'force':>18}{'moment':>18}{'point, mm':>18}"
    )
    print(f"{'vb.scan, one trail':<29}{own:>13.1f}\n{'vb.scan, 200 trails':<29}{batch:>13.1f}")
    table = {}
    for joint, most in ((hinges, max(segments)), (ball, 40), (cable, 40)):
        for count in (count for count in segments if count <= most):
            found = settled(
                mujoco.MjModel.from_xml_string(chain(count, joint, ball_geom())),
                TRAIL.position / ROD.length,
                REST / count,
            )
            errors = compared(scan, found)
            if abs(len(errors["point"]) - scan.in_contact.sum()) > 1:
                raise AssertionError(
                    f"contact in {len(errors['point'])} rows of {scan.in_contact.sum()}"
                )
            table[joint.__name__, count] = found, errors
            figures = "".join(
                f"{np.median(error):>9.1e}{error.max():>9.1e}" for error in errors.values()
            )
            name = f"{count} segments, {joint.__name__}"
            print(
                f"{name:<22}{found.steps.mean():>7.0f}{found.microseconds:>13,.0f}{found.microseconds / own:>8,.0f}x{figures}",
                flush=True,
            )
    return table


if __name__ == "__main__":
    main([int(count) for count in sys.argv[1:]] or list(SEGMENTS))
