"""Contacts smoothed as they come."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.inverse import CausalSmoother, Reconstruction
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.tolerances import PARAMETERS
from vibrissa.trail import Trail

_UNITS = 1e-6


class SmoothingStage:
    """A `vibrissa.live.Stage` that gives each row what the samples up to it say together
    (`vibrissa.CausalSmoother`).

    Parameters
    ----------
    rod
        As of the contacts.
    friction
        0 where there is known to be none.
    """

    def __init__(self, rod: Rod, *, friction: float | None = None) -> None:
        self._rod, self._friction = rod, friction
        self._smoother: CausalSmoother | None = None
        self._last = -np.inf
        # Compiled before samples come.
        CausalSmoother(rod, _UNITS * np.eye(6)).update_all(_one_sample())

    def push(self, found: Reconstruction) -> Reconstruction:
        """Return the batch with kind, point, normal, arc length and their covariances from the
        filter; where time runs back, it begins anew.

        Raises
        ------
        ValueError
            If the noise of the wrench is not known, or the rows have no time.
        """
        reactions = found.reactions
        if reactions.covariance is None or reactions.time is None:
            raise ValueError(
                "force_noise = None: smoothing needs the noise of the wrench; give force_noise and torque_noise in [sensor]"
            )
        if self._smoother is None:
            self._smoother = CausalSmoother(
                self._rod,
                _in_clamp_axes(found),
                position_covariance=reactions.position_covariance,
                friction=self._friction,
                setup_errors=reactions.setup_errors,
            )
        if len(reactions.time) and reactions.time[0] <= self._last:
            self._smoother.reset()
        rows = self._smoother.update_all(reactions)
        self._last = float(reactions.time[-1]) if len(rows) else self._last
        bad = found.status * ~np.isfinite(reactions.force).all(axis=-1)
        return replace(
            found,
            kind=np.array([int(row.kind) for row in rows], dtype=np.int8),
            point=np.array([row.point for row in rows]).reshape(-1, 3),
            force_direction=np.array([row.normal for row in rows]).reshape(-1, 3),
            arc_length=np.array([row.arc_length for row in rows]),
            modulus=np.array([row.modulus for row in rows]),
            covariance=np.array([row.covariance for row in rows]).reshape(-1, 3, 3),
            normal_covariance=np.array([row.normal_covariance for row in rows]).reshape(-1, 3, 3),
            covariance_noise=np.array([row.covariance_noise for row in rows]).reshape(-1, 3, 3),
            normal_covariance_noise=np.array([row.normal_covariance_noise for row in rows]).reshape(
                -1, 3, 3
            ),
            sensitivity=np.array([row.sensitivity for row in rows]).reshape(-1, 6, len(PARAMETERS)),
            arc_length_deviation=None,
            status=np.maximum(bad, [int(row.status) for row in rows]).astype(np.int8),
        )

    def reset(self) -> None:
        """Begin anew: the sensor's zero was taken anew."""
        if self._smoother is not None:
            self._smoother.reset()


def _one_sample() -> Reactions:
    return Reactions(Trail(np.zeros((1, 3))), np.zeros((1, 3)), np.zeros((1, 3)), time=np.zeros(1))


def _in_clamp_axes(found: Reconstruction) -> Float[np.ndarray, "6 6"]:
    """Covariance of the first row's wrench."""
    assert found.reactions.covariance is not None
    turn = rotation_matrices(found.reactions.trail.orientation[:1])[0]
    both = np.kron(np.eye(2), turn)
    covariance = np.broadcast_to(found.reactions.covariance, (len(found.kind), 6, 6))[0]
    return np.asarray(both.T @ covariance @ both)
