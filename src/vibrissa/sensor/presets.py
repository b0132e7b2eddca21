"""Specifications of common six-axis sensors, from their manufacturers' data sheets.

Each preset holds ranges, resolution and noise. Where a data sheet states no noise, one step of its
resolution is taken as the standard deviation: the stated resolution is what the manufacturer calls
discernible in the noise, so the noise is at most of that size.

ATI Nano17, calibrations SI-12-0.12, SI-25-0.25 and SI-50-0.5
    ATI Industrial Automation, product page "F/T Sensor: Nano17", tables "Sensing ranges" and
    "Resolution" (typical, with a 16-bit data acquisition system). Noise is not stated.
ATI Mini40, calibration SI-40-2, and ATI Mini45, calibration SI-145-5
    ATI Industrial Automation, product pages "F/T Sensor: Mini40" and "F/T Sensor: Mini45", the same
    tables, as quoted by laboratories that compared their own sensors with them. At rest and
    unfiltered they found noise of 0.7 to 1.6 times these forces and 1.2 to 2.2 times these torques
    (Mini40, 1 kHz), and a third of the lateral forces, 0.8 of the axial force, 0.4 and 0.75 of the
    torques (Mini45, 2 kHz): the resolution is the strain gauges' noise, not the converter's step.
ATI Axia80-M20, calibration SI-500-20
    ATI Industrial Automation, "Manual, F/T Sensor, Ethernet Axia", document 9610-05-Ethernet
    Axia-09, table 4.8: ranges only. Resolution and noise are not in the parts that we have seen,
    and must be given.
Robotiq FT 300-S
    Robotiq, "FT 300-S Force Torque Sensor Instruction Manual": range, data stream at 100 Hz in
    steps of 0.01 N and 0.001 N m. Signal noise from the manufacturer's data sheet: 0.1 N,
    0.005 N m; the figure for tx and ty is used for tz too.
"""

from __future__ import annotations

from typing import Any

from numpy.typing import ArrayLike

from vibrissa.sensor.sensor import Sensor, WrenchSign

_FIGURES = (
    "force_range",
    "torque_range",
    "force_resolution",
    "torque_resolution",
    "force_noise",
    "torque_noise",
)
_SHEETS: dict[str, tuple[Any, ...]] = {
    "ati_nano17_si_12_0_12": ((12.0, 12.0, 17.0), (0.12,) * 3, 1 / 320, 1e-3 / 64),
    "ati_nano17_si_25_0_25": ((25.0, 25.0, 35.0), (0.25,) * 3, 1 / 160, 1e-3 / 32),
    "ati_nano17_si_50_0_5": ((50.0, 50.0, 70.0), (0.5,) * 3, 1 / 80, 1e-3 / 16),
    "ati_mini40_si_40_2": ((40.0, 40.0, 120.0), (2.0,) * 3, (0.01, 0.01, 0.02), 1 / 4000),
    "ati_mini45_si_145_5": (
        (145.0, 145.0, 290.0),
        (5.0,) * 3,
        1 / 16,
        (1 / 752, 1 / 752, 1 / 1504),
    ),
    "ati_axia80_m20_si_500_20": ((500.0, 500.0, 900.0), (20.0,) * 3),
    "robotiq_ft_300_s": ((300.0,) * 3, (30.0,) * 3, 0.01, 0.001, 0.1, 0.005),
}

# Where a data sheet states no noise, it is taken as one step.
PRESETS: dict[str, dict[str, Any]] = {
    name: dict(zip(_FIGURES, (*sheet, *sheet[2:]), strict=False)) for name, sheet in _SHEETS.items()
}
"""Fields of `Sensor` by the name of the sensor and its calibration, SI units."""


def preset(
    name: str,
    *,
    clamp_position: ArrayLike = (0.0, 0.0, 0.0),
    clamp_orientation: ArrayLike = (0.0, 0.0, 0.0, 1.0),
    wrench: WrenchSign = "on_sensor",
) -> Sensor:
    """Return a sensor with a preset's figures; change them by `dataclasses.replace`.

    Parameters
    ----------
    name
        One of `PRESETS`.
    clamp_position, clamp_orientation, wrench
        As for `Sensor`.

    Raises
    ------
    ValueError
        If there is no such preset, or as for `Sensor`.
    """
    if name not in PRESETS:
        raise ValueError(f"preset = {name!r}; allowed are {', '.join(PRESETS)}")
    return Sensor(clamp_position, clamp_orientation, wrench, **PRESETS[name])
