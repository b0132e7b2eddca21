"""A rod that swings freely after it was released is no contact, and a contact is no ringing."""

import numpy as np
import pytest

import vibrissa as vb
from vibrissa.inverse.ringing import ringing

WIRE = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
NOISE = np.repeat([2e-3, 4e-5], 3)
RELEASE = 400


def released(frequency: float, share: float = 1.0, count: int = 1200) -> vb.Reactions:
    """A tip that is pushed aside ever further, let go, and swings with 0.2 s of decay: 1 kHz."""
    time = np.arange(count) / 1000
    push = np.clip((time - 0.1) / 0.3, 0, 1)
    since = np.maximum(time - 1e-3 * RELEASE, 0)
    swing = share * np.exp(-since / 0.2) * np.cos(2 * np.pi * frequency * since)
    load = np.where(np.arange(count) < RELEASE, push, swing)[:, None]
    axial = np.where(np.arange(count) < RELEASE, push, 0)[:, None]
    force = 0.4 * load * [0.8, 0.6, 0] + 0.1 * axial * [0, 0, 1]
    moment = 0.4 * 0.048 * load * [-0.6, 0.8, 0]
    noise = np.random.default_rng(3).normal(0, NOISE, (count, 6))
    trail = vb.Trail.line(start=(0.04, 0, 0), stop=(0.03, 0, 0), count=count)
    return vb.Reactions(
        trail, force + noise[:, :3], moment + noise[:, 3:], time=time, covariance=np.diag(NOISE**2)
    )


@pytest.mark.filterwarnings(
    "ignore::vibrissa.contacts.RecordingWarning"
)  # the clamp's way is none that such loads come from
@pytest.mark.parametrize("frequency", [20.0, 60.0, 142.0, 200.0])
@pytest.mark.parametrize("share", [1.0, 0.3])
def test_contacts_end_with_the_release(frequency: float, share: float) -> None:
    found = vb.reconstruct(WIRE, released(frequency, share))
    last = np.flatnonzero(found.in_contact & (found.status != vb.Status.NOT_SINGLE_CONTACT))
    assert np.all(found.in_contact[150:RELEASE])
    # Up to a quarter of a period the load is that of a contact still.
    assert np.count_nonzero(last >= RELEASE) <= 250 / frequency
    rows = found.status == vb.Status.RINGING
    assert np.count_nonzero(rows[RELEASE:]) > 100
    assert not rows[:RELEASE].any()
    assert np.all(found.kind[rows] == vb.ContactKind.NONE)
    assert np.isnan(found.point[rows]).all()
    assert np.isnan(found.covariance[rows]).all()


def test_a_load_that_changes_its_side_once_is_a_contact() -> None:
    count = 800
    side = np.linspace(-1, 1, count)[:, None]
    noise = np.random.default_rng(4).normal(0, NOISE, (count, 6))
    trail = vb.Trail.line(start=(0.04, 0, 0), stop=(-0.04, 0, 0), count=count)
    force, moment = side * [0.3, 0, 0] + noise[:, :3], side * [0, 0.012, 0] + noise[:, 3:]
    given = vb.Reactions(
        trail, force, moment, time=np.arange(count) / 250, covariance=np.diag(NOISE**2)
    )
    assert not ringing(given).any()


def test_without_stated_noise_a_swing_is_told_by_its_size() -> None:
    given = released(142.0)
    exact = vb.Reactions(given.trail, given.force, given.moment, time=given.time)
    rows = ringing(exact)
    assert np.all(rows[RELEASE + 10 : RELEASE + 300])
    assert not rows[150:RELEASE].any()


@pytest.mark.filterwarnings("ignore::vibrissa.contacts.RecordingWarning")
def test_smoothing_ends_contacts_with_the_release() -> None:
    found = vb.smooth(vb.reconstruct(WIRE, released(60.0)))
    assert found.smoothing is not None
    assert max(touch.last for touch in found.smoothing[0].touches) <= RELEASE + 250 / 60
    assert np.count_nonzero(found.status[RELEASE:] == vb.Status.RINGING) > 100
