"""Noise, lines of the mains, drifts and poses other than stated: said, and in the error bars."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import RATE, ROD, changed, logged, only, pushed, sensor

from vibrissa.sensor import Inspection, RawRecording, inspect_raw

OF = sensor()
GOOD = logged(OF, pushed(turning=0.5), seed=1)


def warned(raw: RawRecording) -> tuple[Inspection, list[tuple[str, tuple[str, ...]]]]:
    found = inspect_raw(raw, OF, ROD)
    return found, [
        (str(fault.kind), fault.channels) for fault in found.faults if fault.text in found.warnings
    ]


def test_nothing_is_said_of_a_good_recording() -> None:
    found, said = warned(GOOD)
    assert said == []
    assert found.sensor is OF


def test_larger_noise_is_used_and_smaller_is_no_warning() -> None:
    found, said = warned(logged(sensor(force_noise=6e-3), pushed(), seed=2))
    assert said == [("noise", (name,)) for name in ("fx", "fy", "fz")]
    assert "the error bars use it" in found.warnings[0]
    deviation = np.sqrt(found.sensor.reading_variance)
    np.testing.assert_allclose(deviation[:3], found.noise[:3], rtol=1e-9)
    np.testing.assert_allclose(deviation[3:], np.sqrt(OF.reading_variance)[3:], rtol=1e-9)
    assert found.tare is not None
    there, stated = (
        of.reactions(raw).covariance for of, raw in ((found.sensor, found.cleaned), (OF, GOOD))
    )
    assert there is not None
    assert stated is not None
    forces = [np.trace(part.reshape(-1, 6, 6)[0, :3, :3]) for part in (there, stated)]
    assert forces[0] / forces[1] == pytest.approx((6e-3 / 2.05e-3) ** 2, rel=0.2)
    quiet, said = warned(logged(sensor(force_noise=1e-3, force_resolution=0.0), pushed(), seed=2))
    assert said == []
    assert quiet.sensor is OF


@pytest.mark.parametrize(
    ("frequency", "words"),
    [(50.0, "as from 50 Hz"), (180.0, "as from 180 Hz at 250 samples a second"), (33.0, "at 33")],
)
def test_hum_is_named_with_its_frequency_and_size(frequency: float, words: str) -> None:
    """180 Hz at 250 samples a second is seen at 70 Hz."""
    line = 5e-3 * np.sin(2 * np.pi * frequency * GOOD.time)
    found, said = warned(changed(GOOD, slice(None), 1, GOOD.force[:, 1] + line))
    assert ("hum", ("fy",)) in said
    text = next(fault.text for fault in found.faults if str(fault.kind) == "hum")
    assert words in text
    assert float(text.split("a line of ")[1].split(" ")[0]) == pytest.approx(5e-3, rel=0.15)
    assert ("mains hum" in text) == (frequency != 33.0)
    assert found.sensor.reading_variance[1] == pytest.approx(
        OF.reading_variance[1] + 5e-3**2 / 2, rel=0.2
    )


def test_a_drift_is_taken_off_between_two_rests_and_named_with_one() -> None:
    ramp = 4e-3 * (GOOD.time - GOOD.time[0])
    drifting = changed(GOOD, slice(None), 0, GOOD.force[:, 0] + ramp)
    found, said = warned(drifting)
    assert ("drift", ("fx",)) in said
    assert "a line from rest to rest is subtracted" in " ".join(found.warnings)
    assert found.tare is not None
    assert found.tare.drift[0] == pytest.approx(4e-3, rel=0.05)
    one, said = warned(only(drifting, np.arange(len(GOOD.time) - 300)))
    assert ("drift", ("fx",)) in said
    assert "estimate_drift = true" in " ".join(one.warnings)


def test_poses_that_scatter_or_come_in_steps_widen_the_error_bars() -> None:
    scatter = np.random.default_rng(5).normal(0, 6e-5, GOOD.position.shape)
    found, said = warned(replace(GOOD, position=GOOD.position + scatter))
    assert said == [("pose noise", ("position",))]
    assert found.sensor.position_noise == pytest.approx(6.1e-5, rel=0.15)
    smooth = logged(sensor(position_noise=0.0), pushed(), seed=1)
    found, said = warned(replace(smooth, position=np.round(smooth.position / 4e-4) * 4e-4))
    assert ("pose noise", ("position",)) in said
    assert found.sensor.position_noise == pytest.approx(4e-4 / np.sqrt(12), rel=0.1)


def test_jumps_of_a_pose_are_one_finding() -> None:
    steps = np.floor(np.arange(len(GOOD.time)) / 50) * 3e-4
    found, _ = warned(replace(GOOD, position=GOOD.position + steps[:, None]))
    jumps = [fault for fault in found.faults if str(fault.kind) == "pose jump"]
    assert len(jumps) == 1
    assert jumps[0].count == int(len(GOOD.time) / 50) - 1
    assert jumps[0].stop - jumps[0].start == pytest.approx((len(GOOD.time) - 100) / RATE, abs=0.02)
