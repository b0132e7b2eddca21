"""Support reactions: the single-contact condition, and what is refused."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import vibrissa as vb

TRAIL = vb.Trail.line(start=(0, 0, 0), stop=(1, 0, 0), count=4)
ZERO = np.zeros((4, 3))


def test_one_contact_force_leaves_no_residual_and_a_couple_does() -> None:
    rng = np.random.default_rng(2)
    force, arm = rng.normal(size=(2, 4, 3))
    single = vb.Reactions(TRAIL, -force, -np.cross(arm, force))
    np.testing.assert_allclose(single.single_contact_residual, 0, atol=1e-15)
    twisted = vb.Reactions(TRAIL, -force, -np.cross(arm, force) + force)
    f2, lever = np.sum(force**2, axis=1), np.sum(np.cross(arm, force) ** 2, axis=1)
    # m0·f0 = −f², over ‖f0‖ ‖m0‖.
    np.testing.assert_allclose(
        twisted.single_contact_residual, -f2 / np.sqrt(f2 * (lever + f2)), rtol=1e-13
    )


def test_without_a_force_there_is_no_residual() -> None:
    assert np.all(np.isnan(vb.Reactions(TRAIL, ZERO, ZERO).single_contact_residual))


def test_a_row_without_a_value_may_stand() -> None:
    force = np.full((4, 3), np.nan)
    assert np.all(np.isnan(vb.Reactions(TRAIL, force, force).force))


def test_a_covariance_turned_into_world_axes_is_taken() -> None:
    """R C Rᵀ is symmetric only to rounding, also where an entry should vanish."""
    rotation = np.kron(np.eye(2), Rotation.from_rotvec([0.3, 0.5, -0.2]).as_matrix())
    spread = np.diag([4e-6, 4e-6, 4e-6, 1e-9, 1e-9, 2e-9])
    reactions = vb.Reactions(TRAIL, ZERO, ZERO, covariance=rotation @ spread @ rotation.T)
    assert reactions.covariance is not None
    np.testing.assert_allclose(np.linalg.eigvalsh(reactions.covariance)[-3:], 4e-6, rtol=1e-9)


BAD = {
    "force": (
        lambda: vb.Reactions(TRAIL, np.zeros((3, 3)), ZERO),
        "force has shape (3, 3); allowed is (4, 3)",
    ),
    "moment": (
        lambda: vb.Reactions(TRAIL, ZERO, np.zeros((4, 2))),
        "moment has shape (4, 2); allowed is (4, 3)",
    ),
    "short time": (
        lambda: vb.Reactions(TRAIL, ZERO, ZERO, time=np.arange(3.0)),
        "time has shape (3,); allowed is (4,)",
    ),
    "time backwards": (
        lambda: vb.Reactions(TRAIL, ZERO, ZERO, time=np.array([0, 2.0, 1.0, 3.0])),
        "time[1] = 2.0 is not before the next; allowed are increasing times",
    ),
    "time twice": (
        lambda: vb.Reactions(TRAIL, ZERO, ZERO, time=np.array([0, 1.0, 1.0, 3.0])),
        "time[1] = 1.0 is not before the next",
    ),
    "time missing": (
        lambda: vb.Reactions(TRAIL, ZERO, ZERO, time=np.array([0, 1.0, np.nan, 3.0])),
        "time[2] = nan; allowed are finite numbers",
    ),
    "covariance shape": (
        lambda: vb.Reactions(TRAIL, ZERO, ZERO, covariance=np.zeros((3, 6, 6))),
        "covariance has shape (3, 6, 6); allowed is (6, 6) or (4, 6, 6)",
    ),
    "not symmetric": (
        lambda: vb.Reactions(TRAIL, ZERO, ZERO, covariance=np.eye(6) + np.eye(6, k=1)),
        "covariance",
    ),
    "negative": (
        lambda: vb.Reactions(TRAIL, ZERO, ZERO, covariance=np.diag([1.0, 1, 1, 1, 1, -0.1])),
        "covariance has the least eigenvalue -0.1; allowed is symmetric and positive definite",
    ),
    "position covariance": (
        lambda: vb.Reactions(TRAIL, ZERO, ZERO, position_covariance=np.diag([1.0, -1, 1])),
        "position_covariance has the least eigenvalue -1; allowed is symmetric and positive semidefinite",
    ),
    "rotation covariance": (
        lambda: vb.Reactions(
            TRAIL, ZERO, ZERO, rotation_covariance=np.diag([1.0, -1, 1]), rotation_center=ZERO
        ),
        "rotation_covariance has the least eigenvalue -1; allowed is symmetric and positive semidefinite",
    ),
    "rotation without centre": (
        lambda: vb.Reactions(TRAIL, ZERO, ZERO, rotation_covariance=np.eye(3)),
        "rotation_covariance and rotation_center: one is given without the other; allowed are both or none",
    ),
    "singular": (
        lambda: vb.Reactions(TRAIL, ZERO, ZERO, covariance=np.diag([1.0, 1, 1, 1, 1, 0])),
        "covariance has the least eigenvalue 0; allowed is symmetric and positive definite",
    ),
    "infinite": (
        lambda: vb.Reactions(TRAIL, ZERO, ZERO, covariance=np.diag([np.inf] * 6)),
        "covariance[0, 0] = inf; allowed are finite numbers",
    ),
}


@pytest.mark.parametrize("what", BAD)
def test_what_is_wrong_is_named(what: str) -> None:
    build, message = BAD[what]
    with pytest.raises(ValueError, match=re.escape(message)):
        build()
