"""The paper's own route: integrate its initial value problem from the clamp, and stop at the first
zero of the curvature.

Slow, and independent of the closed form in `mechanics`: it exists so that tests can hold the two
against each other.
"""

import numpy as np
from jaxtyping import Float
from scipy.integrate import solve_ivp

from vibrissa.reactions import Reactions
from vibrissa.rod import Rod

_LONGEST = 3.0


def reconstruct_by_integration(
    rod: Rod, reactions: Reactions, *, tolerance: float = 1e-12
) -> tuple[
    Float[np.ndarray, "*trail n 3"], Float[np.ndarray, "*trail n 3"], Float[np.ndarray, "*trail n"]
]:
    """Contact point (…, 3), direction of the contact force (…, 3) and arc length (…) by integrating
    the paper's eqs. (10) and (16).

    Parameters
    ----------
    rod, reactions
        As for `reconstruct`; covariances are not used.
    tolerance
        Relative and absolute tolerance of the integrator (DOP853).

    Returns
    -------
    tuple
        In units of the rod; NaN without a force, and where the curvature has no zero within three
        rod lengths.

    Notes
    -----
    Eq. (16) is taken with κ(0) = +m0·eψ, as eqs. (7) and (14) imply (mechanics.md, "Signs").
    """
    shape = reactions.trail.shape
    point, direction, arc_length = (
        np.full((*shape, 3), np.nan),
        np.full((*shape, 3), np.nan),
        np.full(shape, np.nan),
    )
    axes = reactions.trail.axis
    for index in np.ndindex(*shape):
        f0, m0 = (
            reactions.force[index] / rod.force_scale,
            reactions.moment[index] / rod.moment_scale,
        )
        if not np.all(np.isfinite([f0, m0])) or not np.any(f0):
            continue
        reach, s1 = _integrated(f0, m0, axes[index], tolerance)
        point[index] = reactions.trail.position[index] + rod.length * reach
        direction[index] = -f0 / np.linalg.norm(f0)
        arc_length[index] = rod.length * s1
    return point, direction, arc_length


def _integrated(
    f0: Float[np.ndarray, "3"],
    m0: Float[np.ndarray, "3"],
    t0: Float[np.ndarray, "3"],
    tolerance: float,
) -> tuple[Float[np.ndarray, "3"], float]:
    """Reach r [L] and s₁ [L] in the plane of t0 and b = t0 × m0/‖m0‖, the side to which the rod
    bends.
    """
    curvature = float(np.linalg.norm(np.cross(t0, m0)))
    b = np.cross(t0, m0) / curvature
    along, across = -f0 @ t0, -f0 @ b

    def rod(_: float, y: Float[np.ndarray, "4"]) -> list[float]:
        angle, bend = y[2], y[3]
        # κ' = −F × t: the shear that the force leaves in the section.
        return [np.cos(angle), np.sin(angle), bend, along * np.sin(angle) - across * np.cos(angle)]

    def straightens(_: float, y: Float[np.ndarray, "4"]) -> float:
        return float(y[3])

    straightens.terminal = True  # type: ignore[attr-defined]
    straightens.direction = -1  # type: ignore[attr-defined]
    path = solve_ivp(
        rod,
        (0, _LONGEST),
        np.array([0.0, 0.0, 0.0, curvature]),
        method="DOP853",
        events=straightens,
        rtol=tolerance,
        atol=tolerance,
    )
    if not path.t_events[0].size:
        return np.full(3, np.nan), np.nan
    u, v = path.y_events[0][0][:2]
    return u * t0 + v * b, float(path.t_events[0][0])
