"""The paper's own route: integrate its initial value problem from the clamp, here in vectors, and stop
at the first zero of the curvature.

Slow, and independent of the closed form in `mechanics`: it exists so that tests can hold the two
against each other.
"""

import numpy as np
import scipy
from jaxtyping import Float

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
    trail = reactions.trail
    force, moment = reactions.force / rod.force_scale, reactions.moment / rod.moment_scale
    found = np.full((*trail.shape, 7), np.nan)
    for index in np.ndindex(*trail.shape):
        f0, m0 = force[index], moment[index]
        if np.all(np.isfinite([f0, m0])) and np.any(f0):
            reach, s1 = _integrated(f0, m0, trail.axis[index], tolerance)
            point = trail.position[index] + rod.length * reach
            found[index] = *point, *(-f0 / np.linalg.norm(f0)), rod.length * s1
    return found[..., :3], found[..., 3:6], found[..., 6]


def _integrated(
    f0: Float[np.ndarray, "3"],
    m0: Float[np.ndarray, "3"],
    t0: Float[np.ndarray, "3"],
    tolerance: float,
) -> tuple[Float[np.ndarray, "3"], float]:
    """Reach r [L] and s₁ [L], by r' = t, t' = m × t, m' = t × f0 with m = −m0 at the clamp."""
    bend = (m0 @ t0) * t0 - m0

    def rod(_: float, y: Float[np.ndarray, "9"]) -> Float[np.ndarray, "9"]:
        tangent, moment = y[3:6], y[6:]
        return np.concatenate([tangent, np.cross(moment, tangent), np.cross(tangent, f0)])

    def straightens(_: float, y: Float[np.ndarray, "9"]) -> float:
        return float(y[6:] @ bend)

    straightens.terminal, straightens.direction = True, -1  # type: ignore[attr-defined]
    path = scipy.integrate.solve_ivp(
        rod,
        (0, _LONGEST),
        np.concatenate([np.zeros(3), t0, bend]),
        method="DOP853",
        events=straightens,
        rtol=tolerance,
        atol=tolerance,
    )
    if not path.t_events[0].size:
        return np.full(3, np.nan), np.nan
    return path.y_events[0][0][:3], float(path.t_events[0][0])
