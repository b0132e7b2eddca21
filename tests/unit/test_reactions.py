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


def many(*shape: int) -> vb.Reactions:
    """Reactions of any numbers, with all fields by row."""
    rng = np.random.default_rng(7)
    trail = vb.Trail(rng.normal(size=(*shape, 3)), rng.normal(size=(*shape, 4)))
    root = rng.normal(size=(*shape, 6, 6))
    return vb.Reactions(
        trail,
        *rng.normal(size=(2, *shape, 3)),
        time=np.sort(rng.uniform(size=shape), axis=-1),
        covariance=root @ np.swapaxes(root, -1, -2) + np.eye(6),
        position_covariance=1e-10 * np.eye(3),
        rotation_covariance=1e-6 * np.eye(3),
        rotation_center=rng.normal(size=(*shape, 3)),
        velocity=rng.normal(size=(*shape, 6)),
        misread=("upside down",),
    )


BY_ROW = ("force", "moment", "time", "covariance", "rotation_center", "velocity")
INDICES = [slice(2, 5), slice(None, None, 2), [0, 3], np.array([1, 4]), np.arange(6) > 2, -1, 0]


@pytest.mark.parametrize("index", INDICES, ids=repr)
@pytest.mark.parametrize("shape", [(6,), (6, 3)], ids=["one trail", "several"])
def test_rows_come_with_all_that_belongs_to_them(shape: tuple[int, ...], index: object) -> None:
    whole = many(*shape)
    part = whole[index]
    rows = [index] if isinstance(index, int) and len(shape) == 1 else index
    for name in BY_ROW:
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[rows])
    np.testing.assert_array_equal(part.trail.position, whole.trail.position[rows])
    np.testing.assert_allclose(part.trail.orientation, whole.trail.orientation[rows], rtol=1e-15)
    np.testing.assert_array_equal(whole.trail[index].position, part.trail.position)
    np.testing.assert_array_equal(part.position_covariance, whole.position_covariance)
    np.testing.assert_array_equal(part.rotation_covariance, whole.rotation_covariance)
    assert part.misread == whole.misread
    assert part.trail.shape == part.force.shape[:-1]


def test_one_row_is_reactions_of_one_position_and_one_trail_one_of_its_own() -> None:
    assert many(6)[2].trail.shape == (1,)
    assert many(6, 3)[2].trail.shape == (3,)
    assert many(6, 3)[2:3].trail.shape == (1, 3)
    assert vb.Trail(np.zeros((4, 2, 3)))[1].shape == (2,)


def test_what_all_rows_share_stays_and_what_is_not_there_is_not_made_up() -> None:
    plain = vb.Reactions(TRAIL, ZERO, ZERO, covariance=np.eye(6))[1:3]
    assert plain.covariance is not None
    assert plain.covariance.shape == (6, 6)
    assert (plain.time, plain.rotation_center, plain.velocity) == (None, None, None)


def test_a_row_keeps_the_velocity_that_its_neighbours_tell() -> None:
    moving = vb.Reactions(TRAIL, ZERO, ZERO, time=np.arange(4.0))
    np.testing.assert_allclose(moving[2].clamp_velocity(), moving.clamp_velocity()[2:3])
    np.testing.assert_allclose(moving[2].clamp_velocity()[0, 0], 1 / 3)


@pytest.mark.parametrize(
    ("index", "error", "words"),
    [
        (4, IndexError, "out of bounds"),
        ((1, 2), IndexError, "index = (1, 2); allowed is a number, a slice, a mask (n,)"),
        (np.zeros((2, 2), dtype=int), IndexError, "allowed is a number, a slice"),
        (slice(2, 2), ValueError, "an empty trail; allowed is at least one position"),
        ([2, 1], ValueError, "time[0] = 2.0 is not before the next; allowed are increasing times"),
    ],
    ids=["beyond", "tuple", "two axes", "nothing", "backwards"],
)
def test_rows_that_are_not_there_are_refused(
    index: object, error: type[Exception], words: str
) -> None:
    moving = vb.Reactions(TRAIL, ZERO, ZERO, time=np.arange(4.0))
    with pytest.raises(error, match=re.escape(words)):
        moving[index]


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
