"""How the rod is held."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vibrissa as vb

WIRE = vb.Rod.cylinder(length=0.05, radius=2e-4, youngs_modulus=2e11)


def test_a_pivot_turns_by_the_moment_over_its_stiffness() -> None:
    compliance = np.asarray(vb.Support.pivot((0.5, 2.0, 4.0)).compliance)
    np.testing.assert_allclose(compliance @ [1, 2, 3, 1, 1, 1], [0, 0, 0, 2, 0.5, 0.25])
    slope = jax.jacobian(lambda k: vb.Support.pivot(k).compliance[4, 4])(jnp.array([1.0, 2.0, 4.0]))
    np.testing.assert_allclose(slope, [0, -0.25, 0])


def test_compliance_is_the_inverse_of_stiffness() -> None:
    half = np.random.default_rng(1).normal(size=(6, 6))
    scale = np.array([1e4] * 3 + [1.0] * 3)  # N/m beside N m/rad
    stiffness = (half @ half.T + np.eye(6)) * np.sqrt(np.outer(scale, scale))
    support = vb.Support.compliant(stiffness)
    np.testing.assert_allclose(support.compliance @ stiffness, np.eye(6), atol=1e-9)
    assert hash(WIRE.on(support)) == hash(WIRE.on(vb.Support.compliant(stiffness)))
    assert not WIRE.on(support).plain


def test_a_rigid_support_is_none() -> None:
    np.testing.assert_array_equal(vb.Support.rigid().compliance, np.zeros((6, 6)))
    assert WIRE.on(vb.Support.rigid()) == WIRE
    assert WIRE.plain


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: vb.Support.pivot((1, 0, 1)), r"stiffness\[1\] = 0"),
        (lambda: vb.Support.pivot((1, 1)), "stiffness has shape"),
        (lambda: vb.Support.compliant(np.eye(5)), r"stiffness has shape \(5, 5\); .* \(6, 6\)"),
        (lambda: vb.Support(kind="soft"), "kind = 'soft'; allowed is 'rigid', 'pivot' or"),
        (lambda: vb.Support(kind="pivot"), r"stiffness has shape \(\); allowed is \(3,\)"),
        (lambda: vb.Support("pivot", np.zeros(3)), r"stiffness\[0\] = 0"),
        (lambda: vb.Support("compliant", np.eye(3)), r"stiffness has shape \(3, 3\)"),
        (lambda: vb.Support("rigid", np.ones(3)), "allowed is None if kind = 'rigid'"),
        (lambda: vb.Support.compliant(np.eye(6) + np.eye(6, k=1)), "allowed is symmetric"),
        (lambda: vb.Support.compliant(np.diag([1, 1, 1, 1, 1, -1])), "positive definite"),
        (lambda: vb.Support.compliant(np.ones((6, 6))), "positive definite"),
    ],
)
def test_impossible_supports_are_named(make: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()  # type: ignore[operator]
