"""Sweeps by an independent engine: a chain of capsules with bending springs, stepped to rest by
MuJoCo under rigid objects.

As in `chains.py`, in units with L = EI = 1, but closer to a real bench: wires that taper, are bent
at rest or have weight; friction; clamps that turn; objects that are rounded or concave.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from chains import MOST_STEPS, REST

SEGMENTS = 36
SKIN = 10e-6
"""Half the thickness of wires and contacts [m]: 0.02 % of 50 mm, so that contact is on the centre
line.
"""
GRAVITY = 9.80665

_STEP, _AT_ONCE = 0.3, 5
_MASS = 1e-3
_RUBBING = 20
"""Factor on the limit of rest with friction: the engine's friction creeps where the rod should
stick.
"""
_ONE_CONTACT = 0.98
"""Share of the load that one body of the object carries at least if the wire touches it alone."""


@dataclass(frozen=True)
class Wire:
    """A round wire; SI units.

    Attributes
    ----------
    length, radius, youngs_modulus
        As for `vibrissa.Rod.cylinder`; the radius is that at the clamp.
    tip
        Radius at the tip over that at the clamp; the taper is linear.
    sagitta
        Sagitta of its shape at rest, a parabola, towards clamp x and y.
    density
        Density; 0 for no weight.
    down
        Direction of its weight (3,), world axes.
    poisson_ratio
        As for `vibrissa.Rod`, for its stiffness in torsion; None if it cannot twist.
    """

    length: float = 0.05
    radius: float = 0.25e-3
    youngs_modulus: float = 206e9
    tip: float = 1.0
    sagitta: tuple[float, float] = (0.0, 0.0)
    density: float = 0.0
    down: tuple[float, float, float] = (0.0, 0.0, -1.0)
    poisson_ratio: float | None = None

    @property
    def stiffness(self) -> float:
        """EI at the clamp [N m²]."""
        return self.youngs_modulus * np.pi / 4 * self.radius**4

    @property
    def weight(self) -> float:
        """Weight of the whole wire over EI/L², if it did not taper."""
        return (
            self.density
            * np.pi
            * self.radius**2
            * self.length
            * GRAVITY
            / (self.stiffness / self.length**2)
        )


@dataclass(frozen=True)
class Body:
    """A part of an object: MuJoCo's kind and sizes [m], place (3,) [m] and turn. `rounding` [m] is
    added all around it; all parts of an object have the same rounding.
    """

    kind: str
    size: tuple[float, ...]
    place: tuple[float, float, float]
    turn: Rotation | None = None
    rounding: float = 0.0


@dataclass(frozen=True)
class Run:
    """Equilibria along a path of the clamp; SI units.

    Attributes
    ----------
    position, orientation
        Pose of the clamp (n, 3), (n, 4), world axes.
    force, moment
        What the clamp exerts on the rod (n, 3), clamp axes.
    point
        Contact point (n, 3), world axes; NaN without contact.
    twice
        Whether the wire touches at two places (n,).
    rests
        Whether the chain came to rest (n,).
    """

    position: np.ndarray
    orientation: np.ndarray
    force: np.ndarray
    moment: np.ndarray
    point: np.ndarray
    twice: np.ndarray
    rests: np.ndarray


def swept(
    wire: Wire,
    bodies: list[Body],
    position: np.ndarray,
    orientation: np.ndarray,
    friction: float = 0.0,
    segments: int = SEGMENTS,
) -> Run:
    """Step to rest at each pose of the clamp (n, 3), (n, 4)."""
    model = mujoco.MjModel.from_xml_string(_model(wire, bodies, friction, segments))
    data = mujoco.MjData(model)
    thickness = (SKIN + bodies[0].rounding) / wire.length
    rows = len(position)
    wrench, point, twice, rests = (
        np.zeros((rows, 6)),
        np.full((rows, 3), np.nan),
        np.zeros(rows, dtype=bool),
        np.zeros(rows, dtype=bool),
    )
    for row in range(rows):
        data.mocap_pos[0], data.mocap_quat[0] = (
            position[row] / wire.length,
            np.roll(orientation[row], 1),
        )
        rests[row] = _rests(model, data, (_RUBBING if friction else 1) * REST / segments)
        wrench[row] = data.sensordata
        point[row], twice[row] = _touch(model, data, thickness)
    force, moment = (
        wrench[:, :3] * wire.stiffness / wire.length**2,
        wrench[:, 3:] * wire.stiffness / wire.length,
    )
    return Run(position, orientation, force, moment, point * wire.length, twice, rests)


def remembered(path: Path, make: Callable[[], Run]) -> Run:
    """The run kept at `path`, made if it is missing."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(path, **vars(make()))
    with np.load(path) as kept:
        return Run(**{name: kept[name] for name in kept.files})


def _rests(model: mujoco.MjModel, data: mujoco.MjData, rest: float) -> bool:
    for _ in range(0, MOST_STEPS, _AT_ONCE):
        mujoco.mj_step(model, data, _AT_ONCE)
        if max(np.abs(data.qvel).max(), np.abs(data.qacc).max()) < rest:
            return True
    return False


def _touch(model: mujoco.MjModel, data: mujoco.MjData, thickness: float) -> tuple[np.ndarray, bool]:
    """Where the load acts on the centre line, and whether it is on two bodies of the object."""
    contacts = [contact for contact in data.contact if contact.efc_address >= 0]
    load = np.array([data.efc_force[contact.efc_address] for contact in contacts])
    if not load.sum() > 0:
        return np.full(3, np.nan), False
    on_line, touched = [], []
    for contact in contacts:
        first_is_object = model.geom_bodyid[contact.geom[0]] == 0
        to_wire = contact.frame[:3] if first_is_object else -contact.frame[:3]
        on_line.append(contact.pos + (thickness + contact.dist / 2) * to_wire)
        touched.append(contact.geom[0] if first_is_object else contact.geom[1])
    shares = np.bincount(touched, load) / load.sum()
    return load @ np.array(on_line) / load.sum(), bool(shares.max() < _ONE_CONTACT)


def _text(lengths: object) -> str:
    return " ".join(f"{value:.17g}" for value in np.ravel(lengths))


def _model(wire: Wire, bodies: list[Body], friction: float, segments: int) -> str:
    """MJCF: the object, the clamp as a mocap body, a half segment fixed to it, then the joints:
    hinges with the stiffness and the bend of a length h.
    """
    h, r, unit = 1 / segments, (SKIN + bodies[0].rounding) / wire.length, wire.length
    # A parabola of sagitta b over L has the curvature 8 b/L²; bending towards +x is a turn about
    # +y, towards +y one about -x.
    bend = 8 * np.array(wire.sagitta) / wire.length * h
    hinges = [("1 0 0", 1.0, -bend[1]), ("0 1 0", 1.0, bend[0])]
    if wire.poisson_ratio is not None:
        hinges.append(("0 0 1", 1 / (1 + wire.poisson_ratio), 0.0))
    links = ""
    for i in range(segments):
        length = h / 2 if i == segments - 1 else h
        k = (1 - (1 - wire.tip) * (i + 0.5) * h) ** 4 / h
        middle = (i + 0.5) * h + length / 2
        weighs = f'mass="{_MASS * length * (1 - (1 - wire.tip) * middle) ** 2}"'
        joints = [
            f'<joint type="hinge" axis="{axis}" stiffness="{part * k}" armature="{part * k}" damping="{part * k}" springref="{at}"/>'
            for axis, part, at in hinges
        ]
        # Hinges turn one after another: in alternating order, what that does cancels but for h².
        links += f'<body pos="0 0 {h}">{"".join(joints[:: (-1) ** i])}<geom type="capsule" size="{r}" fromto="0 0 0 0 0 {length}" {weighs}/>'
    objects = "".join(
        f'<geom type="{body.kind}" size="{_text(np.array(body.size) / unit)}" pos="{_text(np.array(body.place) / unit)}" '
        f'quat="{_text(np.roll((body.turn or Rotation.identity()).as_quat(), 1))}" contype="2" conaffinity="1"/>'
        for body in bodies
    )
    law = f'condim="{3 if friction else 1}" friction="{friction or 1} 0.005 0.0001"'
    return f"""<mujoco><compiler angle="radian"/>
    <option timestep="{_STEP}" integrator="implicitfast" gravity="{_text(np.array(wire.down) * wire.weight / _MASS)}" solver="Newton" tolerance="1e-14" iterations="100"
      ls_iterations="100" cone="elliptic" impratio="{100 if friction else 1}"/>
    <default><geom {law} solref="{2 * _STEP} 1" solimp="0.9999 0.9999 0.001" contype="1" conaffinity="2"/></default>
    <worldbody>{objects}
      <body mocap="true"><body pos="0 0 {-h / 2}">
        <geom type="capsule" size="{r}" fromto="0 0 {h / 2} 0 0 {h}" contype="0" conaffinity="0" mass="{_MASS * h / 2}"/>
        <site name="clamp" pos="0 0 {h / 2}"/>{links}{"</body>" * segments}
      </body></body>
    </worldbody>
    <sensor><force site="clamp"/><torque site="clamp"/></sensor></mujoco>"""
