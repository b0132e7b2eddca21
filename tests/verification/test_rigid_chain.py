"""An independent engine: a tapered rod that is curved at rest, as a chain of rigid links with springs
between them, relaxed by MuJoCo against a ball. With more links it approaches the scan's equilibrium as the square
of their length. The tip touches: elsewhere it would matter where on its link the contact lies, an
error of the order of the length itself.
"""

from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import vibrissa as vb

mujoco = pytest.importorskip("mujoco")

TAPER, POISSON, ROLL = 0.6, 0.3, 0.7
CURVATURE = (0.9, -0.4)
CENTER, RADIUS = np.array([0.0, 0.0, 1.15]), 0.35
START, STOP = np.array([-0.25, -0.15, -0.2]), np.array([-0.25, -0.15, 0.02])
SKIN = 1e-4
"""Half the thickness of the links [L]; the engine's ball is smaller by as much."""
STEP, AT_ONCE, MOST, REST = 0.3, 5, 400_000, 1e-11
"""Time step, steps between looks, most steps, and speed at rest, all in the engine's units."""
APPROACH = 9


class State(NamedTuple):
    """What the clamp exerts on the rod, world axes, the contact, and how deep the links are in the
    ball.
    """

    force: np.ndarray
    moment: np.ndarray
    point: np.ndarray
    depth: float

    @property
    def numbers(self) -> np.ndarray:
        """All but the depth (9,)."""
        return np.concatenate([self.force, self.moment, self.point])


def chain(count: int) -> str:
    """MJCF in units L = EI = 1: half a link fixed to the clamp, then joints in the middle of each
    length h with the stiffness B/h there and the bend of h at rest, twist included.
    """
    h, links = 1 / count, ""
    for i in range(count):
        s, length = (i + 0.5) * h, h / 2 if i == count - 1 else h
        bend = (CURVATURE[0] + CURVATURE[1] * s) * h * np.array([-np.sin(ROLL), np.cos(ROLL), 0])
        x, y, z, w = Rotation.from_rotvec(bend / 2).as_quat()
        k = (1 - TAPER * s) ** 4 / h
        joints = [
            f'<joint type="hinge" axis="{axis}" stiffness="{b}" armature="{b}" damping="{b}"/>'
            for axis, b in (("1 0 0", k), ("0 1 0", k), ("0 0 1", k / (1 + POISSON)))
        ]
        # Hinges turn one after another: in alternating order, what that does cancels but for h².
        links += f"""<body pos="0 0 {h}" quat="{w} {x} {y} {z}">{"".join(joints[:: (-1) ** i])}
            <body quat="{w} {x} {y} {z}">
            <geom type="capsule" size="{SKIN}" fromto="0 0 0 0 0 {length}" mass="{1e-3 * length}"/>"""
    return f"""<mujoco><compiler angle="radian"/>
    <option timestep="{STEP}" integrator="implicitfast" gravity="0 0 0" solver="Newton"
      tolerance="1e-15" iterations="100" ls_iterations="100"/>
    <default><geom condim="1" solref="{2 * STEP} 1" solimp="0.9999 0.9999 0.001" contype="1"
      conaffinity="2"/></default>
    <worldbody>
      <geom type="sphere" size="{RADIUS - SKIN}" pos="{" ".join(map(str, CENTER))}" contype="2"
        conaffinity="1"/>
      <body mocap="true"><body pos="0 0 {-h / 2}">
        <geom type="capsule" size="{SKIN}" fromto="0 0 {h / 2} 0 0 {h}" contype="0" conaffinity="0"
          mass="{1e-3 * h}"/>
        <site name="clamp" pos="0 0 {h / 2}"/>{links}{"</body>" * 2 * count}
      </body></body>
    </worldbody>
    <sensor><force site="clamp"/><torque site="clamp"/></sensor></mujoco>"""


def relaxed(count: int) -> State:
    """The chain at rest where the clamp stops."""
    model = mujoco.MjModel.from_xml_string(chain(count))
    data = mujoco.MjData(model)
    for place in np.linspace(START, STOP, APPROACH):
        data.mocap_pos[0] = place
        for _ in range(0, MOST, AT_ONCE):
            mujoco.mj_step(model, data, AT_ONCE)
            if max(np.abs(data.qvel).max(), np.abs(data.qacc).max()) < REST:
                break
        else:
            raise ArithmeticError(f"{count} links: speed {np.abs(data.qvel).max():g}")
    touching = [contact for contact in data.contact if contact.efc_address >= 0]
    load = np.array([data.efc_force[contact.efc_address] for contact in touching])
    points = np.array([contact.pos for contact in touching])
    outward = points - CENTER
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    depth = -min(contact.dist for contact in touching)
    point = load @ (CENTER + (RADIUS - depth) * outward) / load.sum()
    return State(data.sensordata[:3].copy(), data.sensordata[3:].copy(), point, depth)


def test_a_chain_of_links_approaches_the_scan() -> None:
    """Forces, moments and the contact point: the error falls by four when links are halved, and the
    chain's limit by Richardson's extrapolation is the scan's. Measured: 1.5e-3 for 8 links, 3.7e-4 for
    16, 9.2e-5 for 32, and 1e-6 for their limit.
    """
    states = [relaxed(count) for count in (8, 16, 32)]
    rod = vb.Rod.tapered(
        length=1.0,
        base_radius=0.01,
        tip_radius=0.01 * (1 - TAPER),
        # For EI = 1 at the clamp.
        youngs_modulus=4 / np.pi * 1e8,
        poisson_ratio=POISSON,
    ).curved(vb.RestShape.polynomial(CURVATURE, ROLL))
    # The engine's contact yields: by 3.1e-6.
    ball = vb.surfaces.Sphere(center=CENTER, radius=RADIUS - states[-1].depth)
    scan = vb.scan(rod, ball, vb.Trail.line(start=START, stop=STOP, count=41))
    assert scan.kind[-1] == vb.ContactKind.TIP and scan.status[-1] == vb.Status.OK
    exact = State(scan.reactions.force[-1], scan.reactions.moment[-1], scan.point[-1], 0.0).numbers
    errors = [np.linalg.norm(state.numbers - exact) for state in states]
    assert np.all(np.array(errors) < [2e-3, 5e-4, 1.2e-4])
    np.testing.assert_allclose([errors[0] / errors[1], errors[1] / errors[2]], 4, rtol=0.1)
    limit = states[2].numbers + (states[2].numbers - states[1].numbers) / 3
    np.testing.assert_allclose(limit, exact, atol=errors[2] / 50)
