"""Contacts smoothed as they come."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.inverse import CausalSmoother, Reconstruction
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.trail import Trail


class SmoothingStage:
    """A `vibrissa.live.Stage` that estimates each row's contact from all samples up to it
    (`vibrissa.CausalSmoother`).

    Parameters
    ----------
    rod
        The rod of the contacts.
    friction
        Coulomb friction coefficient between rod and object: 0 for none, None if unknown.
    """

    def __init__(self, rod: Rod, *, friction: float | None = None) -> None:
        self._rod, self._friction = rod, friction
        self._smoother: CausalSmoother | None = None
        self._last = -np.inf
        # Compile before samples come: the numbers do not matter, but a soft rod has a shape in some
        # of these poses only.
        smoother, still = CausalSmoother(rod, np.eye(6)), np.zeros((1, 3))
        for turn in Rotation.create_group("O").as_quat():
            with suppress(ValueError):
                one = Reactions(Trail(still, turn[None]), still, still, time=np.zeros(1))
                smoother.update_all(one)
                break

    def push(self, found: Reconstruction) -> Reconstruction:
        """Return the batch with kind, point, normal, arc length and their covariances from the
        filter, which restarts where time runs backwards.

        Raises
        ------
        ValueError
            If the noise of the wrench is unknown.
        """
        reactions = found.reactions
        assert reactions.time is not None
        if self._smoother is None:
            self._smoother = CausalSmoother(
                self._rod,
                _first_covariance(reactions),
                position_covariance=reactions.position_covariance,
                friction=self._friction,
                setup_errors=reactions.setup_errors,
            )
        if reactions.time[0] <= self._last:
            self._smoother.reset()
        self._last = float(reactions.time[-1])
        rows = self._smoother.update_all(reactions)
        filtered = {name: value for name, value in vars(rows).items() if name in vars(found)}
        bad = found.status * ~np.isfinite(reactions.force).all(axis=-1)
        filtered["status"] = np.maximum(bad, rows.status)
        return replace(found, **filtered, arc_length_deviation=None)

    def reset(self) -> None:
        """Restart, after the sensor was tared again."""
        if self._smoother is not None:
            self._smoother.reset()


def _first_covariance(reactions: Reactions) -> np.ndarray:
    """Covariance (6, 6) of the first row's wrench, in clamp axes."""
    if reactions.covariance is None:
        raise ValueError(
            "force_noise = None: smoothing needs the noise of the wrench; allowed is a [sensor] "
            "with force_noise and torque_noise"
        )
    both = np.kron(np.eye(2), rotation_matrices(reactions.trail.orientation[0]))
    return both.T @ reactions.covariance.reshape(-1, 6, 6)[0] @ both
