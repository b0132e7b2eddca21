"""Sweeps that calibrations are tested with, by the shooting method of `tests/verification`: nothing
of the package's own contact solver or closed forms.

    python tests/unit/calibration_sweeps.py

solves them anew, in a minute or two, and writes `calibration_sweeps.npz` beside this file: of each
sweep the clamp's positions (n, 3) [m], and force [N] and moment [N m] about the clamp on the rod
(n, 3). The clamp looks along +z.
"""

import sys
from bisect import bisect
from pathlib import Path

import numpy as np

LENGTH, RADIUS, MODULUS = 0.05, 0.25e-3, 206e9
CENTER, BALL_RADIUS = (0.0, 0.0, 0.0575), 0.03
PLANE = (0.0, 0.0, 0.045), (0.3, 0.2, -1.0)
EGG = (0.033, 0.027, 0.03)
"""Semi-axes of an ellipsoid in the ball's place."""
COUNT = 260
PATHS = {
    "ball +0.005": ((0.04, 0.005, 0.0), (-0.04, 0.005, 0.0)),
    "ball -0.010": ((0.04, -0.01, 0.0), (-0.04, -0.01, 0.0)),
    "plane +0.005": ((0.06, 0.005, 0.0), (-0.04, 0.005, 0.0)),
    "plane -0.010": ((0.06, -0.01, 0.0), (-0.04, -0.03, 0.0)),
    "egg +0.005": ((0.045, 0.005, 0.0), (-0.04, 0.005, 0.0)),
    "egg -0.010": ((0.045, -0.01, 0.0), (-0.04, 0.0, 0.0)),
}
"""Start and stop of the clamp's way."""
_FILE = Path(__file__).with_suffix(".npz")


def loaded(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, forces and moments of a sweep."""
    with np.load(_FILE) as data:
        position, force, moment = data[name]
    return position, force, moment


def _solved(name: str) -> np.ndarray:
    sys.path.insert(0, str(Path(__file__).parents[1] / "verification"))
    from shooting import Equilibrium, Level, follow, quadric

    normal = np.array(PLANE[1]) / np.linalg.norm(PLANE[1])
    solid = {
        "ball": quadric(CENTER, np.full(3, BALL_RADIUS)),
        "plane": Level(lambda p: float((p - PLANE[0]) @ normal), lambda _p: normal),
        "egg": quadric(CENTER, EGG),
    }[name.split(maxsplit=1)[0]].scaled(LENGTH)
    clamps = np.linspace(*PATHS[name], COUNT)
    tangents = np.tile([0.0, 0.0, 1.0], (COUNT, 1))
    stiffness = MODULUS * np.pi / 4 * RADIUS**4

    def states(count: int) -> list[Equilibrium | None] | None:
        try:
            return follow(solid, clamps[:count] / LENGTH, tangents[:count])
        except ArithmeticError:
            return None

    # Where the branch ends the rod snaps off, and is free for the rest of the way.
    end = bisect(range(1, COUNT + 1), 0, key=lambda count: states(count) is None)
    found = np.zeros((3, COUNT, 3))
    found[0] = clamps
    for index, state in enumerate(states(end) or []):
        if state is not None:
            found[1, index] = -state.force * state.normal * stiffness / LENGTH**2
            found[2, index] = -state.base_moment * stiffness / LENGTH
    return found


if __name__ == "__main__":
    np.savez_compressed(_FILE, **{name: _solved(name) for name in PATHS})
