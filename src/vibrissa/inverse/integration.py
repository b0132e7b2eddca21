"""The paper's own route: integrate its initial value problem from the clamp, here in vectors, and
stop at the first zero of the curvature.

Slow, and independent of the closed form in `mechanics`: it lets tests check one against the other.
"""

from typing import Any

import numpy as np
import scipy
from jaxtyping import Float

from vibrissa.inverse.arrays import Scalars, Vector, Vectors
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod

_LONGEST = 3.0
State = Float[np.ndarray, "9"]


def reconstruct_by_integration(
    rod: Rod, reactions: Reactions, *, tolerance: float = 1e-12
) -> tuple[Vectors, Vectors, Scalars]:
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
    Eq. (16) is taken with κ(0) = +m0·eψ, as eqs. (7) and (14) imply (mechanics.md,
    "Two sign errors in the printed paper").
    """
    trail = reactions.trail
    force, moment = reactions.force / rod.force_scale, reactions.moment / rod.moment_scale
    found = np.full((*trail.shape, 7), np.nan)
    for index in np.ndindex(*trail.shape):
        f0, m0 = force[index], moment[index]
        if np.all(np.isfinite([f0, m0])) and np.any(f0):
            path = _integrated(f0, m0, trail.axis[index], tolerance)
            for end, s1 in zip(path.y_events[0], path.t_events[0], strict=True):
                point = trail.position[index] + rod.length * end[:3]
                found[index] = *point, *(-f0 / np.linalg.norm(f0)), rod.length * s1
    return found[..., :3], found[..., 3:6], found[..., 6]


def _integrated(f0: Vector, m0: Vector, t0: Vector, tolerance: float) -> Any:
    """Integrate r' = t, t' = m × t, m' = t × f0 with m = −m0 at the clamp, in model units: SciPy's
    solution, which ends where the curvature vanishes.
    """
    bend = (m0 @ t0) * t0 - m0

    def rod(_: float, y: State) -> State:
        tangent, moment = y.reshape(3, 3)[1:]
        return np.concatenate([tangent, np.cross(moment, tangent), np.cross(tangent, f0)])

    def straightens(_: float, y: State) -> float:
        return float(y[6:] @ bend)

    straightens.terminal, straightens.direction = True, -1  # type: ignore[attr-defined]
    start, options = np.concatenate([np.zeros(3), t0, bend]), {"rtol": tolerance, "atol": tolerance}
    return scipy.integrate.solve_ivp(
        rod, (0, _LONGEST), start, "DOP853", events=straightens, **options
    )
