"""The paper's case, in the sizes measured."""

import numpy as np

import vibrissa as vb
from peers import A, B, H

ROD = vb.Rod.unit()
OBJECT = vb.surfaces.EllipticParaboloid(a=A, b=B, h=H)
TRAILS, POSITIONS, SAMPLES = 1000, 211, 10**6


def batch(trails: int = TRAILS) -> vb.Trail:
    """Trails at y0 = 0.05 to 0.5, each of 211 positions from x = 1.05 to −1.05."""
    position = np.zeros((trails, POSITIONS, 3))
    position[..., 0], position[..., 1] = (
        np.linspace(1.05, -1.05, POSITIONS),
        np.linspace(0.05, 0.5, trails)[:, None],
    )
    return vb.Trail(position)


def one_trail(y0: float, x_from: float = 1.2, count: int = 241) -> vb.Trail:
    """Positions from x = x_from to its mirror image."""
    return vb.Trail(np.linspace([x_from, y0, 0.0], [-x_from, y0, 0.0], count))


def samples_of(scan: vb.Scan, count: int) -> vb.Reactions:
    """Reactions of the scan's contacts, repeated up to `count`."""
    rows = np.resize(np.flatnonzero(scan.in_contact), count)
    position, orientation = (
        scan.trail.position.reshape(-1, 3)[rows],
        scan.trail.orientation.reshape(-1, 4)[rows],
    )
    force, moment = (
        scan.reactions.force.reshape(-1, 3)[rows],
        scan.reactions.moment.reshape(-1, 3)[rows],
    )
    return vb.Reactions(vb.Trail(position, orientation), force, moment)


def assert_close(found: np.ndarray, expected: np.ndarray, tolerance: float, who: str) -> None:
    """Raise AssertionError unless two methods give the same contact points."""
    largest = float(np.abs(found - expected).max())
    if not largest <= tolerance:
        raise AssertionError(f"{who}: contact points differ by {largest}; allowed is {tolerance}")
