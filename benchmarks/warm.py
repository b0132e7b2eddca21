"""Warm timings: the package and its peers on the same positions and samples, in one run, with the
same answers.
"""

from functools import partial

import numpy as np

import vibrissa as vb
from cases import (
    OBJECT,
    POSITIONS,
    ROD,
    SAMPLES,
    TRAILS,
    assert_close,
    batch,
    one_trail,
    samples_of,
)
from peers import bvp_along, inverse_by_integration, shooting_along
from timing import Row, best_of

_PEER_SAMPLES = 211


def forward() -> list[Row]:
    """Microseconds per position. The peers' trail is one of the batch: y0 = 0.2, positions 0.01
    apart, in contact throughout.
    """
    stack, single, trail = batch(), one_trail(0.2), one_trail(0.2, 1.05, POSITIONS)
    found = vb.scan(ROD, OBJECT, trail)
    if not found.in_contact.all():
        raise AssertionError("the peers' trail is not in contact throughout")
    positions = trail.position[:, :2]

    own = best_of(5, lambda: vb.scan(ROD, OBJECT, stack), TRAILS * POSITIONS)
    alone = best_of(20, lambda: vb.scan(ROD, OBJECT, single), single.count)
    rows = [
        Row(f"vb.scan, {TRAILS} trails x {POSITIONS} positions", own),
        Row("vb.scan, one trail of 241 positions", alone),
    ]
    for peer, tolerance, name in (
        (
            partial(bvp_along, exact_jacobians=False),
            1e-5,
            "SciPy solve_bvp, tol 1e-6, warm-started",
        ),
        (bvp_along, 1e-5, "the same, with exact Jacobians of ours"),
        (shooting_along, 1e-8, "SciPy shooting, solve_ivp + root, warm-started"),
    ):
        assert_close(np.array(list(peer(positions))), found.point, tolerance, name)
        time = best_of(3, lambda peer=peer: list(peer(positions)), len(positions))
        rows.append(Row(name, time, time / own, f"{time / alone:,.0f} x one trail"))
    return rows


def inverse() -> list[Row]:
    """Microseconds per sample."""
    found = vb.scan(ROD, OBJECT, batch(64))
    many, one = samples_of(found, SAMPLES), samples_of(found, 1)
    few = samples_of(vb.scan(ROD, OBJECT, one_trail(0.2, 1.05, POSITIONS)), _PEER_SAMPLES)

    def integrate() -> np.ndarray:
        rows = zip(few.trail.position, few.trail.axis, few.force, few.moment, strict=True)
        return np.array([inverse_by_integration(*row) for row in rows])

    assert_close(
        vb.reconstruct(ROD, many).point,
        np.resize(found.point[found.in_contact], (SAMPLES, 3)),
        1e-9,
        "scan",
    )
    assert_close(integrate(), vb.reconstruct(ROD, few).point, 1e-8, "solve_ivp")
    own = best_of(5, lambda: vb.reconstruct(ROD, many), SAMPLES)
    alone = best_of(200, lambda: vb.reconstruct(ROD, one), 1)
    peer = best_of(3, integrate, few.trail.count)
    return [
        Row(f"vb.reconstruct, {SAMPLES} samples in one call", own),
        Row("vb.reconstruct, one sample in one call", alone),
        Row(
            "SciPy solve_ivp, DOP853, rtol 1e-9, event κ = 0",
            peer,
            peer / own,
            f"{peer / alone:,.1f} x one sample",
        ),
    ]
