"""For which whiskers do force and moment at the base determine the contact? `python
docs/make_uniqueness.py` draws the figure of docs/real_rods.md and prints its numbers.

The question of L. A. Huet, J. W. Rudnicki, M. J. Z. Hartmann, Soft Robotics 4 (2017) 88-102. Force
and moment at the clamp fix the shape of the rod up to any contact. So all contacts that explain
them lie on one curve: that of the rod under the force, continued beyond the contact; wherever this
curve crosses the force's line of action, no moment is left. Here rods of length 1, arcs at rest,
are pushed across, and the curve is integrated from the contact both ways, without the library.
"""

from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

mpl.use("Agg")

import vibrissa as vb
from vibrissa.plot import journal, save_as
from vibrissa.plot.style import PAGE

FIGURE = Path(__file__).parent / "images" / "uniqueness.png"
POISSON, STEPS = 0.3, 400
"""Steps of the classical Runge-Kutta method, shorter where the rod is thinner."""
TURNS = (0, 30, 60, 90, 120, 150, 180, 210, 240)
"""Angles [°] between the rod's tangents at clamp and tip at rest."""
TAPERS = {"uniform": 0.0, "tip of a half": 0.5, "tip of a fifth": 0.8}
PAINTS = ("#1d5fa8", "#009e73", "#c1121f")
COUNT, MANY, BENDS, PLACES = 1000, 4000, (5.0, 90.0), (0.2, 0.99)
"""Contacts in the plane and from all sides, angles [°] by which they turn the rod there in linear
theory, and arc lengths [L].
"""
FIRST = 0.05
"""Arc length [L] from which on others are sought: no object is at the clamp."""
EXACT, GOOD = 1e-6, 1e-3
"""Distances [L] at which a line of action crosses the rod, up to the error of the integration, and
at which a good sensor cannot tell that it does not.
"""
GAPS, NEAR_TURNS = np.geomspace(1e-3, 1e-1, 9), {60.0: ":", 180.0: "-"}
FRICTION = 0.75
NODES = 80
"""Of the rod whose stability is decided."""


class Pushed(NamedTuple):
    """Contacts (n,): arc lengths, unit forces (n, 3) and their sizes, and the curves through them
    from clamp to tip (k, n, …), seen from the contact.
    """

    place: np.ndarray
    along: np.ndarray
    force: np.ndarray
    s: np.ndarray
    r: np.ndarray
    t: np.ndarray
    axes: np.ndarray
    """Of the clamp (n, 3, 3)."""


class Others(NamedTuple):
    """Further places where a curve comes closest to the line of action: contact, arc length,
    distance, and cosine between rod and force.
    """

    of: np.ndarray
    s: np.ndarray
    gap: np.ndarray
    lean: np.ndarray


def _softness(place: np.ndarray, taper: float) -> np.ndarray:
    """Angle by which a unit force turns a straight rod of linear theory where it acts."""
    points, weights = np.polynomial.legendre.leggauss(24)
    s = (points + 1) / 2 * place[:, None]
    return ((place[:, None] - s) / (1 - taper * s) ** 4 * weights * place[:, None] / 2).sum(1)


def _half(
    place: np.ndarray, force: np.ndarray, end: float, turn: float, taper: float
) -> tuple[np.ndarray, ...]:
    """Arc lengths, places, and axes of the rod from contacts to one end, seen from the contact."""
    thin = np.log1p(-taper)
    first, last = (np.log1p(-taper * x) / thin if taper else x for x in (place, end))
    share = first + (last - first) * np.linspace(0, 1, STEPS + 1)[:, None]
    s = -np.expm1(share * thin) / taper if taper else share

    def slope(s: np.ndarray, r: np.ndarray, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        moment = np.einsum("nji,nj->ni", axes, np.cross(-r, force))
        bend = moment * [1, 1, 1 + POISSON] / ((1 - taper * s) ** 4)[:, None]
        bend[:, 1] += np.radians(turn)
        return axes[:, :, 2], np.cross(axes, bend[:, None, :])

    r, axes = np.zeros_like(force), np.tile(np.eye(3), (len(place), 1, 1))
    rows = [(r, axes)]
    for start, stop in pairwise(s):
        h, slopes = stop - start, []
        for part, before in ((0, None), (0.5, 0), (0.5, 1), (1, 2)):
            ahead, turned = (0.0, 0.0) if before is None else slopes[before]
            moved = r + (part * h)[:, None] * ahead, axes + (part * h)[:, None, None] * turned
            slopes.append(slope(start + part * h, *moved))
        r, axes = (
            at + (h / 6).reshape(-1, *(1,) * (at.ndim - 1)) * (a + 2 * b + 2 * c + d)
            for at, a, b, c, d in zip((r, axes), *slopes, strict=True)
        )
        rows.append((r, axes))
    return s, *(np.array(part) for part in zip(*rows, strict=True))


def pushed(
    place: np.ndarray, side: np.ndarray, size: np.ndarray, turn: float, taper: float
) -> Pushed:
    """Contacts with forces across the rod; `side` [rad] is the angle of the force from the plane of
    the arc, 0 where it straightens the rod.
    """
    along = np.column_stack([-np.cos(side), np.sin(side), 0 * side])
    back, ahead = (_half(place, size[:, None] * along, end, turn, taper) for end in (0.0, 1.0))
    s, r, axes = (np.concatenate([b[::-1], a[1:]]) for b, a in zip(back, ahead, strict=True))
    return Pushed(place, along, size, s, r, axes[..., 2], back[2][-1])


def others(given: Pushed) -> Others:
    """Where else the curves come closest to the lines of action, by cubics between nodes."""
    off, rate = np.cross(given.r, given.along), np.cross(given.t, given.along)
    fall = np.sum(off * rate, axis=-1)
    near = (fall[:-1] < 0) & (fall[1:] >= 0)
    near[STEPS - 1 : STEPS + 1] = False
    near &= given.s[:-1] > FIRST
    i, of = np.nonzero(near)
    h = (given.s[i + 1, of] - given.s[i, of])[:, None]
    p, q, u, v = off[i, of], off[i + 1, of], h * rate[i, of], h * rate[i + 1, of]
    low, high = np.zeros_like(h), np.ones_like(h)
    for _ in range(50):
        x = (low + high) / 2
        at = p + x * (u + x * (3 * (q - p) - 2 * u - v + x * (2 * (p - q) + u + v)))
        slope = u + x * (2 * (3 * (q - p) - 2 * u - v) + 3 * x * (2 * (p - q) + u + v))
        past = np.sum(at * slope, axis=1, keepdims=True) > 0
        low, high = np.where(past, low, x), np.where(past, x, high)
    t = (1 - x) * given.t[i, of] + x * given.t[i + 1, of]
    lean = np.sum(t * given.along[of], axis=1) / np.linalg.norm(t, axis=1)
    return Others(of, given.s[i, of] + (x * h)[:, 0], np.linalg.norm(at, axis=1), lean)


def slides_off(given: Pushed, of: int, stop: float, turn: float, taper: float) -> bool:
    """Whether a rod in the plane, without friction on a thin peg at an arc length, is unstable: the
    second variation of its energy, less the force times the distance from the peg, has a negative
    direction among those that stay on the peg.
    """
    s = np.linspace(0, stop, NODES + 1)
    t = np.stack([np.interp(s, given.s[:, of], given.t[:, of, k]) for k in (0, 2)], 1)
    f, h = given.along[of, [0, 2]], s[1]
    # Turned by η, the tangent moves by η n; n is on the side to which the force pushes.
    n = np.stack([t[:, 1], -t[:, 0]], 1)
    sign = np.sign(n[-1] @ f)
    n, width = sign * n, np.full(NODES + 1, h)
    width[[0, -1]] /= 2
    stiff = (1 - taper * (s[:-1] + h / 2)) ** 4 / h
    form = np.diag(given.force[of] * (t @ f) * width)
    form += np.diag(np.r_[stiff, 0] + np.r_[0, stiff]) - np.diag(stiff, 1) - np.diag(stiff, -1)
    slid, left, last = width * (n @ t[-1]), width * (n @ n[-1]), np.eye(NODES + 1)[-1]
    form += given.force[of] * (np.outer(last, slid) + np.outer(slid, last))
    form -= given.force[of] * sign * np.radians(turn) * np.outer(slid, slid)
    allowed = np.linalg.svd(left[None, 1:])[2][1:]
    return bool(np.linalg.eigvalsh(allowed @ form[1:, 1:] @ allowed.T)[0] < 0)


def sampled(turn: float, taper: float, *, plane: bool) -> Pushed:
    """Contacts drawn at random, in the plane of the arc or from all sides."""
    draw = np.random.default_rng(0)
    place, bend, side = (
        draw.uniform(*span, COUNT if plane else MANY)
        for span in (PLACES, np.radians(BENDS), (0, 2 * np.pi))
    )
    side = np.where(side < np.pi, 0, np.pi) if plane else side
    return pushed(place, side, bend / _softness(place, taper), turn, taper)


def share(of: np.ndarray, count: int = COUNT) -> float:
    """Share [%] of contacts that are named once or more."""
    return 100 * len(np.unique(of)) / count


def in_plane(turn: float, taper: float) -> dict[str, float]:
    """Shares [%] of contacts whose reactions another explains exactly, and by how much the cosine
    between rod and force is greater at the one farther out: least and most.
    """
    given = sampled(turn, taper, plane=True)
    other = others(given)
    crossed = other.gap < EXACT
    steeper = (other.lean * np.sign(other.s - given.place[other.of]))[crossed]
    explains = crossed & (abs(other.lean) < np.sin(np.arctan(FRICTION)))
    smooth = np.flatnonzero(explains & (abs(other.lean) < GOOD))
    stays = [i for i in smooth if not slides_off(given, other.of[i], other.s[i], turn, taper)]
    return {
        "friction": share(other.of[explains]),
        "none": share(other.of[smooth]),
        "stable": share(other.of[stays]),
        "least": min(steeper, default=np.nan),
        "most": max(steeper, default=np.nan),
    }


def all_round(turn: float, taper: float) -> list[float]:
    """Shares [%] of contacts from all sides that another explains within the distances `GAPS`."""
    other = others(sampled(turn, taper, plane=False))
    leans = abs(other.lean) < np.sin(np.arctan(FRICTION))
    return [share(other.of[leans & (other.gap < gap)], MANY) for gap in GAPS]


def swept(start: float, stop: float) -> dict[str, int]:
    """A uniform half circle in its plane past a peg near its stem: contacts, how many of them the
    library finds not unique, and how many are wrong if each is the one nearest to the last.
    """
    rod = vb.Rod(length=1.0, bending_stiffness=1.0).curved(vb.RestShape.arc(1 / np.pi))
    peg = vb.surfaces.Cylinder((0, 0, 0), (0, 1, 0), radius=0.05, length=2.0)
    trail = vb.Trail.line(start=(-start, 0, -0.15), stop=(-stop, 0, -0.15), count=121)
    scan = vb.scan(rod, peg, trail)
    rows = np.flatnonzero(scan.in_contact & (scan.status == vb.Status.OK))
    found = vb.reconstruct(rod, scan.reactions)
    listed = {one.row[0]: one.contacts.arc_length for one in found.candidates}
    last, wrong = scan.arc_length[rows[0]], 0
    for row in rows:
        ways = listed.get(row, found.arc_length[[row]])
        last = ways[np.argmin(abs(ways - last))]
        wrong += int(abs(last - scan.arc_length[row]) > EXACT)
    several = [row in listed for row in rows]
    return {
        "contacts": len(rows),
        "not unique": sum(several),
        "the first is": several[0],
        "wrong": wrong,
    }


def _draw_pair(axes: Axes) -> None:
    """Two contacts of a hook with the same reactions, and the rods that they bend."""
    turn, place = 210.0, 0.95
    given = pushed(*(np.array([value]) for value in (place, np.pi, 2.2)), turn, 0.0)
    clamp = given.axes[0]
    r, t, f = (given.r[:, 0] - given.r[0, 0]) @ clamp, given.t[:, 0] @ clamp, given.along[0] @ clamp
    s = given.s[:, 0]
    for name, stop, paint in (("A", others(given).s[0], PAINTS[2]), ("B", place, PAINTS[0])):
        i = int(np.argmin(abs(s - stop)))
        ahead = np.linspace(0, 1 - s[i], 100)
        heading = np.arctan2(t[i, 0], t[i, 2]) + np.radians(turn) * ahead[:-1]
        free = np.cumsum(np.column_stack([np.sin(heading), np.cos(heading)]), axis=0) * ahead[1]
        bent = r[: i + 1, [0, 2]]
        axes.plot(*np.vstack([bent, bent[-1] + free]).T, color=paint)
        axes.plot(*bent[-1], "o", color=paint, markersize=4)
        axes.annotate(name, bent[-1], (-11, -4), textcoords="offset points", color=paint)
    axes.plot(*(bent[-1] + np.outer([-0.2, 0.75], f[[0, 2]])).T, "--", color="0.5", linewidth=0.8)
    axes.plot(0, 0, "ks", markersize=4)
    axes.set_aspect("equal")
    axes.set_xlabel("$x/L$")
    axes.set_ylabel("$z/L$")


def _draw(
    found: dict[str, list[dict[str, float]]], near: dict[tuple[str, float], list[float]]
) -> None:
    figure, (pair, plane, around) = plt.subplots(
        1, 3, figsize=(PAGE, 2.7), width_ratios=(1, 1.1, 1.1), layout="constrained"
    )
    _draw_pair(pair)
    for (name, rows), paint in zip(found.items(), PAINTS, strict=True):
        shares = [row["friction"] for row in rows]
        plane.plot(TURNS, shares, "o-", color=paint, markersize=3, label=name)
        for turn, line in NEAR_TURNS.items():
            around.loglog(GAPS, near[name, turn], line, color=paint)
    stable = [row["stable"] for row in found["uniform"]]
    plane.plot(TURNS, stable, "s--", color=PAINTS[0], markersize=3, markerfacecolor="white",
               label="uniform, stable without friction")  # fmt: skip
    plane.set_xlabel("turn of the rod at rest [°]")
    plane.set_xticks(range(0, 241, 60))
    for turn, line in NEAR_TURNS.items():
        around.plot([], [], line, color="0.3", label=f"turn {turn:g}°")
    around.set_xlabel("least gap noticed [$L$]")
    around.set_ylim(0.02, 30)
    around.legend(loc="upper left")
    for axes, title in ((pair, "one wrench"), (plane, "in the plane"), (around, "from all sides")):
        axes.set_title(title)
    for axes in (plane, around):
        axes.set_ylabel("contacts not unique [%]")
    figure.legend(*plane.get_legend_handles_labels(), loc="outside upper center", ncols=4,
                  columnspacing=1.2, handlelength=1.6)  # fmt: skip
    save_as([pair, plane, around], FIGURE)


def main() -> None:
    """Draw the figure and print its numbers."""
    found = {name: [in_plane(turn, taper) for turn in TURNS] for name, taper in TAPERS.items()}
    near = {
        (name, turn): all_round(turn, taper)
        for name, taper in TAPERS.items()
        for turn in NEAR_TURNS
    }
    with journal():
        mpl.rcParams["savefig.dpi"] = 200
        _draw(found, near)
    for name, rows in found.items():
        for turn, row in zip(TURNS, rows, strict=True):
            print(name, turn, {key: round(float(value), 4) for key, value in row.items()})  # noqa: T201
    for (name, turn), shares in near.items():
        print(name, turn, "from all sides", np.round(shares, 2))  # noqa: T201
    for way in ((-0.2, 0.25), (1 / np.pi, -0.2)):
        print("peg", np.round(way, 2), swept(*way))  # noqa: T201


if __name__ == "__main__":
    main()
