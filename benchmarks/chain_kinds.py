"""The package against MuJoCo stepped to rest, by kind of object, on one core: `python
benchmarks/chain_kinds.py [NAME ...]`.

Rod, trail and the way the chain comes to rest are as in `chains.py`, with 40 segments. The kinds
are those that the engine has too, with the wire's radius in both. Rows where the chain is not at
rest after 3000 steps count as restless; hard events are snaps and changes of stability, which
`vb.scan` follows one by one: if there are any, they take nearly all of its time.
"""

import sys
from typing import NamedTuple

from timing import best_of, pin_to_one_core

if __name__ == "__main__":
    pin_to_one_core()

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation
from trimesh.creation import icosphere

import chains
import vibrissa as vb
from kinds import HARD

ROD, TRAIL, L = chains.ROD, chains.TRAIL, chains.ROD.length
SEGMENTS = 40
_SKEW = Rotation.align_vectors([(0.3, 1, 0.2)], [(0, 0, 1)])[0]
_TURN = Rotation.from_quat((0.25, -0.1, 0.3, 1.0))


class Peer(NamedTuple):
    """An object in both worlds; the engine's in units of the rod's length."""

    surface: vb.surfaces.Surface
    geom: str
    assets: str = ""


def objects() -> dict[str, Peer]:
    """The objects, by name."""
    s = vb.surfaces
    center, axis = chains.CENTER, _SKEW.as_matrix()[:, 2]
    ball = icosphere(subdivisions=6, radius=chains.RADIUS)
    return {
        "Sphere": Peer(s.Sphere(center, chains.RADIUS), chains.ball_geom()),
        "Plane": Peer(
            s.Plane((-0.01, 0, 0.05), (1, 0.2, -1)),
            f'<geom type="plane" size="9 9 9" pos="{_text((-0.01, 0, 0.05))}" zaxis="1 0.2 -1"/>',
        ),
        "Ellipsoid": Peer(
            s.Ellipsoid(center, (0.035, 0.025, 0.03)),
            _geom("ellipsoid", (0.035, 0.025, 0.03), center),
        ),
        "Capsule": Peer(
            s.Capsule(center, axis, 0.02, 0.03), _geom("capsule", (0.02, 0.015), center, _SKEW)
        ),
        "Cylinder": Peer(
            s.Cylinder(center, axis, 0.02, 0.05), _geom("cylinder", (0.02, 0.025), center, _SKEW)
        ),
        "Box": Peer(
            s.Box((0, 0, 0), (0.022, 0.018, 0.015)).placed(_TURN, center),
            _geom("box", (0.022, 0.018, 0.015), center, _TURN),
        ),
        "Mesh, 81920 faces": Peer(
            s.Mesh(ball.vertices + center, ball.faces),
            f'<geom type="mesh" mesh="ball" pos="{_text(center)}"/>',
            f'<mesh name="ball" vertex="{_text(ball.vertices.ravel())}"/>',
        ),
    }


def _text(lengths: object) -> str:
    return " ".join(f"{value:.17g}" for value in np.asarray(lengths) / L)


def _geom(
    kind: str, size: tuple[float, ...], center: np.ndarray, turn: Rotation | None = None
) -> str:
    quaternion = np.array((0, 0, 0, 1.0)) if turn is None else turn.as_quat()
    return f'<geom type="{kind}" size="{_text(size)}" pos="{_text(center)}" quat="{" ".join(map(str, np.roll(quaternion, 1)))}"/>'


def main(names: list[str]) -> dict[str, float]:
    """Print the table; return the ratios."""
    print(
        f"MuJoCo {mujoco.__version__}, {SEGMENTS} segments, {TRAIL.count} positions; µs a position; differences are medians\n"
    )
    print(
        f"{'object':<20}{'in contact':>11}{'in both':>9}{'hard':>6}{'vb.scan':>9}{'engine':>10}{'ratio':>8}"
        f"{'steps':>7}{'restless':>10}{'force':>9}{'moment':>9}{'point, mm':>11}"
    )
    ratios = {}
    for name, peer in objects().items():
        if names and not any(name.startswith(chosen) for chosen in names):
            continue
        scan = vb.scan(ROD, peer.surface, TRAIL, finite_radius=True)
        own = best_of(
            20,
            lambda surface=peer.surface: vb.scan(ROD, surface, TRAIL, finite_radius=True),
            TRAIL.count,
        )
        model = mujoco.MjModel.from_xml_string(
            chains.chain(SEGMENTS, chains.hinges, peer.geom, peer.assets)
        )
        found = chains.settled(model, TRAIL.position / L, chains.REST / SEGMENTS)
        errors = chains.compared(scan, found)
        ratios[name] = found.microseconds / own
        hard = sum(event.kind in HARD for event in scan.events)
        restless = np.count_nonzero(found.steps >= chains.MOST_STEPS)
        print(
            f"{name:<20}{scan.in_contact.sum():>11}{len(errors['point']):>9}{hard:>6}{own:>9.1f}{found.microseconds:>10,.0f}{ratios[name]:>7,.0f}x"
            f"{found.steps.mean():>7.0f}{restless:>10}"
            + "".join(
                f"{np.median(error):>{width}.1e}"
                for error, width in zip(errors.values(), (9, 9, 11), strict=True)
            ),
            flush=True,
        )
    return ratios


if __name__ == "__main__":
    main(sys.argv[1:])
