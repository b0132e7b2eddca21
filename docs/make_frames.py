"""Draw the frames and signs of a bench: `python docs/make_frames.py` writes docs/images/frames-*.

Nothing is drawn from memory: the wire is a scan's elastic line, poses and readings are what
`vibrissa.sensor.Sensor` makes of that scan, and `bench` checks them.
"""

from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl

mpl.use("Agg")

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Rectangle
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa.plot import journal
from vibrissa.sensor import Sensor

IMAGES = Path(__file__).parent / "images"
MM = 1e3
WIRE = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
BAR = (0.07, 0.0, 0.115)
"""Axis of the bar, which runs along y: all forces lie in the plane y = 0."""
CLAMP = np.array([0.0, 0.0, 0.025])
"""In sensor axes."""
_X, _Z, _FORCE, _WIRE, _INK, _PALE = "#c1121f", "#1d5fa8", "#d97706", "black", "0.25", "0.93"
_AXIS, _NEWTON = 11.0, 42.0


class Bench(NamedTuple):
    """One position of a sweep: in world axes but for the readings; SI units.

    `point`, `normal`: of the contact. `force`, `moment`: support reaction on the rod at the clamp.
    `readings`: of a sensor whose wrench is "on_sensor" and of one whose wrench is "on_rod".
    """

    line: np.ndarray
    clamp: np.ndarray
    sensor: np.ndarray
    point: np.ndarray
    normal: np.ndarray
    force: np.ndarray
    moment: np.ndarray
    readings: dict[str, np.ndarray]


def bench() -> Bench:
    """Sweep the wire under the bar and look at one position."""
    bar = vb.surfaces.Cylinder(center=BAR, axis=(0, 1, 0), radius=0.015, length=0.2)
    trail = vb.Trail.line(start=(0.09, 0, 0.065), stop=(0.062, 0, 0.065), count=29)
    scan = vb.scan(WIRE, bar, trail)
    reactions = scan.reactions[-1:]
    readings = {}
    for sign in ("on_sensor", "on_rod"):
        sensor = Sensor(CLAMP, (0, 0, 0, 1), sign)
        pose = sensor.frame(reactions.trail)
        readings[sign] = sensor.to_readings(pose.orientation)[0] @ reactions.wrench[0]
    found = Bench(
        scan.elastic_line(-1),
        trail.position[-1],
        pose.position[0],
        scan.point[-1],
        scan.normal[-1],
        reactions.force[0],
        reactions.moment[0],
        readings,
    )
    # The wire is pushed along the normal out of the object; "on_sensor" reads that force.
    np.testing.assert_allclose(
        found.readings["on_sensor"][:3], found.normal * np.linalg.norm(found.force), atol=1e-9
    )
    np.testing.assert_allclose(found.readings["on_rod"], -found.readings["on_sensor"])
    return found


def torque_about(found: Bench, point: np.ndarray) -> np.ndarray:
    """Torque that the contact exerts about a point given in sensor axes, as a sensor whose
    wrench_point is there reads it.
    """
    sensor = Sensor(CLAMP, (0, 0, 0, 1), "on_sensor", wrench_point=point)
    wrench = sensor.to_readings(np.array([[0.0, 0.0, 0.0, 1.0]]))[0] @ [*found.force, *found.moment]
    push = found.readings["on_sensor"][:3]
    np.testing.assert_allclose(wrench[3:], np.cross(found.point - found.sensor - point, push))
    return wrench[3:]


def _arrow(axes: Axes, start: Any, by: Any, colour: str, width: float = 1.2) -> None:
    """An arrow in the plane x, z [mm]."""
    tip = (start[0] + by[0], start[1] + by[1])
    style = {"arrowstyle": "-|>", "color": colour, "lw": width, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", tip, tuple(start), arrowprops=style | {"mutation_scale": 7 + 2 * width})


def _frame(
    axes: Axes, origin: Any, name: str, turn: Rotation | None = None, at: Any = (-2, -2)
) -> None:
    """A frame's x and z axes with their letters, and its name."""
    turn = turn or Rotation.identity()
    for letter, colour, axis in (("x", _X, (1, 0, 0)), ("z", _Z, (0, 0, 1))):
        along = turn.apply(axis)[[0, 2]]
        _arrow(axes, origin, _AXIS * along, colour)
        axes.text(*(origin + (_AXIS + 2.2) * along), letter, color=colour, ha="center", va="center")
    axes.plot(*origin, "o", color=_INK, markersize=2.5)
    side = "right" if at[0] < 0 else "left"
    axes.text(origin[0] + at[0], origin[1] + at[1], name, ha=side, va="center", color=_INK)


def _stage(size: tuple[float, float], panels: int = 1) -> tuple[Any, list[Axes]]:
    figure, axes = plt.subplots(1, panels, figsize=size, squeeze=False, layout="constrained")
    figure.get_layout_engine().set(w_pad=0.1, h_pad=0.1)
    for one in axes[0]:
        one.set_aspect("equal")
        one.axis("off")
    return figure, list(axes[0])


def _rig(axes: Axes, found: Bench, *, object_name: str = "object") -> None:
    """Flange, sensor, clamp, wire and bar, seen along +y."""
    x, z = found.sensor[[0, 2]] * MM
    parts = ((-34, 12, "robot's flange", "0.86"), (-22, 38, "sensor", _PALE))
    for (below, height, name, grey), half in zip(parts, (9, 8), strict=True):
        box = Rectangle((x - half, z + below), 2 * half, height, facecolor=grey, edgecolor=_INK)
        axes.add_patch(box)
        axes.text(x + half + 3, z + below + height / 3, name, ha="left", va="center", color="0.4")
    clamp = found.clamp[[0, 2]] * MM
    axes.add_patch(Rectangle((clamp[0] - 2, clamp[1] - 9), 4, 9, facecolor="0.6", edgecolor=_INK))
    axes.add_patch(Circle((BAR[0] * MM, BAR[2] * MM), 15, facecolor=_PALE, edgecolor=_INK))
    axes.text(BAR[0] * MM, BAR[2] * MM + 3, object_name, ha="center", va="center", color="0.4")
    axes.plot(*(found.line[:, [0, 2]].T * MM), color=_WIRE, lw=1.4)


def draw_frames(found: Bench) -> Any:
    """World, flange, sensor and clamp, and the numbers that relate them."""
    figure, (axes,) = _stage((4.4, 5.2))
    _rig(axes, found)
    sensor, clamp = (part[[0, 2]] * MM for part in (found.sensor, found.clamp))
    _frame(axes, np.zeros(2), "world: the robot's base", at=(2, -5))
    _arrow(axes, (0, 0), sensor, "0.45", 0.9)
    axes.text(19, 17, "pose in the log:\nposition, orientation", ha="right", color="0.35")
    _frame(axes, sensor, "sensor frame", at=(-13, 2))
    _frame(axes, sensor + [0, -22], "flange frame", at=(-13, -7))
    _frame(axes, clamp, "clamp frame", at=(-4, 2))
    axes.annotate(
        "clamp_position\n= [0, 0, 0.025]",
        (sensor[0] - 5, (sensor[1] + clamp[1]) / 2),
        (sensor[0] - 42, (sensor[1] + clamp[1]) / 2 + 2),
        color=_INK,
        va="center",
        arrowprops={"arrowstyle": "-", "color": "0.6", "lw": 0.7},
    )
    _arrow(axes, (sensor[0] - 5, sensor[1]), (0, clamp[1] - sensor[1]), _INK, 0.9)
    axes.set(xlim=(-18, 100), ylim=(-9, 133))
    return figure


def draw_clamp(_: Bench) -> Any:
    """How clamp_orientation turns the wire."""
    figure, panels = _stage((6.6, 2.4), 3)
    half = np.sqrt(0.5)
    for axes, turn, text in zip(
        panels,
        ((0, 0, 0, 1), (0, half, 0, half), (1, 0, 0, 0)),
        ("[0, 0, 0, 1]", "[0, 0.7071, 0, 0.7071]", "[1, 0, 0, 0]"),
        strict=True,
    ):
        rotation = Rotation.from_quat(turn)
        out = rotation.apply((0, 0, 1))[[0, 2]]
        axes.add_patch(Rectangle((-9, -6), 18, 12, facecolor=_PALE, edgecolor=_INK))
        start = out * (9 if abs(out[0]) > 0.5 else 6)
        axes.plot(*np.transpose([start, start + 26 * out]), color=_WIRE, lw=1.4)
        _frame(axes, np.array([-24.0, -14.0]), "", None)
        axes.text(-24, -20, "sensor", ha="center", va="center", color=_INK)
        axes.set_title(f"clamp_orientation =\n{text}", fontsize="medium")
        axes.set(xlim=(-34, 38), ylim=(-34, 34))
    return figure


def draw_signs(found: Bench) -> Any:
    """What a sensor reads while the object pushes the wire, for both signs."""
    figure, panels = _stage((7.2, 4.7), 2)
    titles = {
        "on_sensor": 'wrench = "on_sensor"\nwhat the wire does to the sensor',
        "on_rod": 'wrench = "on_rod"\nwhat holds the wire',
    }
    point, clamp = found.point[[0, 2]] * MM, found.clamp[[0, 2]] * MM
    for axes, (sign, title) in zip(panels, titles.items(), strict=True):
        _rig(axes, found, object_name="")
        push = _NEWTON * found.readings["on_sensor"][[0, 2]]
        _arrow(axes, point, push, "0.45", 1.2)
        axes.text(*(point + push + [2, 0]), "push of the\nobject", color="0.35", va="center")
        read = found.readings[sign]
        shown = _NEWTON * read[[0, 2]]
        _arrow(axes, clamp, shown, _FORCE, 1.8)
        axes.text(
            found.sensor[0] * MM - 12,
            found.sensor[2] * MM - 2,
            f"fx = {read[0]:+.2f} N\nfz = {read[2]:+.2f} N".replace("-", "−"),
            color=_FORCE,
            ha="right",
            va="center",
        )
        _frame(axes, np.array([17.0, 62.0]), "", None)
        axes.text(17, 55, "sensor axes", ha="center", color=_INK)
        axes.set_title(title, fontsize="medium", pad=8)
        axes.set(xlim=(5, 112), ylim=(3, 133))
    return figure


def draw_wrench_point(found: Bench) -> Any:
    """The same push, read about three points."""
    figure, (axes,) = _stage((5.6, 5.0))
    _rig(axes, found, object_name="")
    point = found.point[[0, 2]] * MM
    push = _NEWTON * found.readings["on_sensor"][[0, 2]]
    _arrow(axes, point, push, "0.45", 1.2)
    axes.text(*(point + push + [2, 0]), "push of the object", color="0.35", va="center")
    names = {
        "wrench_point = [0, 0, 0]\nthe sensor's origin": np.zeros(3),
        "wrench_point = [0, 0, 0.016]\nits upper face": np.array([0, 0, 0.016]),
        "the clamp: what vibrissa\ncomputes with": CLAMP,
    }
    for (name, place), height in zip(names.items(), (-2, 26, 54), strict=True):
        at = (found.sensor + place)[[0, 2]] * MM
        torque = torque_about(found, place)[1] * 1e3
        axes.plot(*at, "o", color=_Z, markersize=4, zorder=5)
        axes.annotate(
            f"{name}\nty = {torque:+.1f} N mm",
            at,
            (found.sensor[0] * MM - 26, found.sensor[2] * MM + height - 8),
            ha="right",
            va="center",
            color=_INK,
            arrowprops={"arrowstyle": "-", "color": "0.6", "lw": 0.7},
        )
    axes.set(xlim=(-28, 118), ylim=(3, 133))
    return figure


DIAGRAMS = {
    "bench": draw_frames,
    "clamp": draw_clamp,
    "signs": draw_signs,
    "wrench-point": draw_wrench_point,
}


def main(folder: Path = IMAGES) -> None:
    """Write all diagrams."""
    found = bench()
    with journal(), mpl.rc_context({"svg.hashsalt": "vibrissa", "font.size": 10}):
        for name, draw in DIAGRAMS.items():
            figure = draw(found)
            figure.savefig(folder / f"frames-{name}.svg", metadata={"Date": None})
            plt.close(figure)


if __name__ == "__main__":
    main()
