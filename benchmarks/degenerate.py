"""Scans of scenes in which something is exactly level, coplanar, parallel, grazing or centred:
`python benchmarks/degenerate.py [NAME ...]`.

A steel wire of 50 mm × 0.5 mm touches with its skin. For each scene: positions, how many are OK,
how many have a status that names the degeneracy (HEAD_ON, PENETRATING, LATERALLY_UNSTABLE,
CLAMP_INSIDE), how many are left as NOT_CONVERGED or NO_EQUILIBRIUM, snaps, and any exception. Boxes
of twelve triangles are compared with the box itself: positions that differ in kind or status, and
the largest difference in contacts [µm] and forces [EI/L²] at the others. Names select scenes by
their beginning.
"""

import sys
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa import surfaces

LENGTH, RADIUS = 0.05, 0.25e-3
ROD = vb.Rod.cylinder(length=LENGTH, radius=RADIUS, youngs_modulus=206e9)
HALF = np.array([0.010, 0.008, 0.010])
BALL = 0.012
UP, ASIDE = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)
UNNAMED = (vb.Status.NOT_CONVERGED, vb.Status.NO_EQUILIBRIUM)
COUNT = 121


class Scene(NamedTuple):
    """An object and a trail under it."""

    name: str
    surface: surfaces.Surface
    trail: vb.Trail


def line(
    start: tuple[float, ...],
    stop: tuple[float, ...],
    turned: Rotation | None = None,
    count: int = COUNT,
) -> vb.Trail:
    """A straight trail, in millimetres, with the rod along z before it is turned."""
    share = np.linspace(0, 1, count)[:, None]
    position = (np.array(start) * (1 - share) + np.array(stop) * share) / 1000
    turn = Rotation.identity() if turned is None else turned
    return vb.Trail(position, np.repeat(turn.as_quat()[None], count, axis=0))


def joined(*trails: vb.Trail) -> vb.Trail:
    """Concatenate trails."""
    return vb.Trail(
        np.concatenate([part.position for part in trails]),
        np.concatenate([part.orientation for part in trails]),
    )


def around(start: tuple[float, ...], axis: str, angles: tuple[float, float]) -> vb.Trail:
    """A turn on the spot [degrees]."""
    turns = Rotation.from_euler(axis, np.linspace(*angles, COUNT)[:, None], degrees=True)
    return vb.Trail(np.repeat(np.array([start]) / 1000, COUNT, axis=0), turns.as_quat())


def tipped(angle: float, azimuth: float = 0.0) -> Rotation:
    """The rod tilted from z [degrees]."""
    return Rotation.from_euler("zy", [azimuth, angle], degrees=True)


WAYS = {
    "along x": line((20, 1, 0), (-20, 1, 0)),
    "along x, centred": line((20, 0, 0), (-20, 0, 0)),
    "along y": line((2, 20, 0), (2, -20, 0)),
    "oblique": line((20, 13, 0), (-20, -11, 0)),
    "over the corners": line((20, 16, 0), (-20, -16, 0)),
    "at 45 degrees to a corner": line((20, 18, 0), (-8, -10, 0)),
    "side level with the rod": line((20, 8, 0), (-20, 8, 0)),
    "skin along the side": line((20, 8.25, 0), (-20, 8.25, 0)),
    "begun in contact": line((9, 1, 0), (-20, 1, 0)),
    "begun in contact, centred": line((0, 0, 0), (-20, 0, 0)),
    "begun touching": line((10.25, 1, 0), (-20, 1, 0)),
    "to and fro": joined(line((20, 1, 0), (0, 1, 0)), line((0, 1, 0), (20, 1, 0))),
    "round a corner": joined(line((20, 1, 0), (2, 1, 0)), line((2, 1, 0), (2, 20, 0))),
    "from below": line((1, 1, -10), (1, 1, 2)),
}
LEVELS = {
    "level": 0.0,
    "skin level": RADIUS,
    "level less a radius": -RADIUS,
    "a nanometre in": -1e-9,
    "half way": -0.01,
    "deep": -0.018,
}


def boxes(kind: str) -> Iterator[Scene]:
    """A box whose lower face is level with the tip, or nearly so, and the same with a tilted or
    turning rod against its edges.
    """
    for level, height in LEVELS.items():
        center = np.array([0, 0, LENGTH + HALF[2] + height])
        surface = box(kind, center)
        for way, trail in WAYS.items():
            if not (way == "from below" and height <= -0.01):
                yield Scene(f"{kind}, {level}, {way}", surface, trail)
    surface = box(kind, np.array([0, 0, LENGTH]))
    for angle in (45.0, 90.0):
        for azimuth in (0.0, 90.0, 45.0):
            turn = tipped(angle, azimuth)
            at = 1000 * (np.array([0, 0, LENGTH]) - 0.055 * turn.apply([0, 0, 1]))
            for sideways, way in (
                (turn.apply(UP), "on"),
                (turn.apply(ASIDE), "across"),
                (np.array(UP), "up"),
            ):
                yield Scene(
                    f"{kind}, rod at {angle:g}/{azimuth:g}, {way}",
                    surface,
                    line(at - 14 * sideways, at + 14 * sideways, turn),
                )
    yield Scene(f"{kind}, turning about x", surface, around((0, -20, 10), "x", (-60, 10)))
    yield Scene(f"{kind}, turning about z", surface, around((0, 0, -9), "z", (0, 90)))


def box(kind: str, center: np.ndarray) -> surfaces.Surface:
    """The box as a solid, or as twelve triangles."""
    if kind == "box":
        return surfaces.Box(center, HALF)
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    faces = [
        (0, 1, 3),
        (0, 3, 2),
        (4, 6, 7),
        (4, 7, 5),
        (0, 4, 5),
        (0, 5, 1),
        (2, 3, 7),
        (2, 7, 6),
        (0, 2, 6),
        (0, 6, 4),
        (1, 5, 7),
        (1, 7, 3),
    ]
    return surfaces.Mesh(center + HALF * corners, np.array(faces))


def round_objects() -> Iterator[Scene]:
    """Balls, cylinders, cones, capsules and rings, touched where they are level with the tip,
    parallel to the rod, or symmetric.
    """
    below = {
        "touching": LENGTH,
        "skin touching": LENGTH + RADIUS,
        "pressed": LENGTH - RADIUS,
        "deep": LENGTH - 0.01,
    }
    ways = {
        "along x": line((20, 0, 0), (-20, 0, 0)),
        "along y": line((0, 20, 0), (0, -20, 0)),
        "aside": line((20, 5, 0), (-20, 5, 0)),
        "grazing": line((20, 12, 0), (-20, 12, 0)),
        "skin grazing": line((20, 12.25, 0), (-20, 12.25, 0)),
        "begun centred": line((0, 0, 0), (-20, 0, 0)),
        "begun in contact": line((4, 0, 0), (-20, 0, 0)),
        "from below": line((0, 0, -15), (0, 0, -0.1)),
    }
    for level, z in below.items():
        objects = {
            "ball": surfaces.Sphere((0, 0, z + BALL), BALL),
            "lying cylinder": surfaces.Cylinder((0, 0, z + BALL), ASIDE, BALL, 0.03),
            "cylinder's end": surfaces.Cylinder((0, 0, z + 0.01), UP, BALL, 0.02),
            "cone's base": surfaces.Cone((0, 0, z), UP, BALL, 0.02),
            "cone's tip": surfaces.Cone((0, 0, z + 0.02), (0, 0, -1.0), BALL, 0.02),
            "lying capsule": surfaces.Capsule((0, 0, z + BALL), ASIDE, BALL, 0.02),
            "upright capsule": surfaces.Capsule((0, 0, z + 0.01 + BALL), UP, BALL, 0.02),
            "upright ring": surfaces.Torus((0, 0, z + 0.016), ASIDE, 0.012, 0.004),
            "lying ring": surfaces.Torus((0, 0, z + 0.004), UP, 0.012, 0.004),
            "superquadric": surfaces.Superquadric((0, 0, z + BALL), (BALL, BALL, BALL), (0.3, 0.3)),
        }
        for name, surface in objects.items():
            for way, trail in ways.items():
                yield Scene(f"{name}, {level}, {way}", surface, trail)


def scanned(scene: Scene) -> tuple[vb.Scan | None, str]:
    """The scan, None if it raised; and its line of the table."""
    try:
        scan = vb.scan(ROD, scene.surface, scene.trail, finite_radius=True)
    except Exception as error:
        return None, f"{scene.name:48s} raised {type(error).__name__}: {error}"
    fine, left = int(np.sum(scan.status == vb.Status.OK)), int(np.isin(scan.status, UNNAMED).sum())
    snaps = sum(event.kind == vb.EventKind.SNAP for event in scan.events)
    lost = sum(
        not np.isfinite([event.parameter, *event.clamp, *event.point]).all()
        for event in scan.events
    )
    said = " ".join(vb.Status(status).name for status in np.unique(scan.status) if status)
    wrong = f", {lost} events not finite" if lost else ""
    return (
        scan,
        f"{scene.name:48s} {scan.status.size:4d} {fine:4d} {scan.status.size - fine - left:4d} {left:4d} {snaps:4d}  {said}{wrong}",
    )


def compared(ours: vb.Scan, theirs: vb.Scan) -> str:
    """Where a mesh differs from the solid."""
    same = (ours.kind == theirs.kind) & (ours.status == theirs.status)
    both = same & ours.in_contact & np.isfinite(ours.energy) & np.isfinite(theirs.energy)
    away = 1e6 * np.linalg.norm(ours.point - theirs.point, axis=-1)[both].max(initial=0)
    force = (
        np.linalg.norm(ours.reactions.force - theirs.reactions.force, axis=-1)[both].max(initial=0)
        / ROD.force_scale
    )
    return f"   mesh: {int((~same).sum()):4d} differ, {away:.1e} µm, {force:.1e}"


def main() -> None:
    """Print one line per scene, then the totals."""
    names = sys.argv[1:]
    exact: dict[str, vb.Scan | None] = {}
    print(f"{'scene':48s} {'rows':>4s} {'OK':>4s} {'said':>4s} {'left':>4s} {'snap':>4s}")
    sums = np.zeros(5, dtype=int)
    scenes = [*boxes("box"), *round_objects()]
    if not names or any("mesh" in name for name in names):
        scenes += boxes("mesh")
    for scene in scenes:
        if names and not any(
            scene.name.startswith(name) or (name == "mesh" and scene.name.startswith("box"))
            for name in names
        ):
            continue
        scan, text = scanned(scene)
        kind, _, rest = scene.name.partition(", ")
        other = exact.get(rest) if kind == "mesh" else None
        if kind == "box":
            exact[rest] = scan
        print(
            text + (compared(scan, other) if scan is not None and other is not None else ""),
            flush=True,
        )
        sums += [
            1,
            scan is None,
            *(
                np.array(text[48:].split()[1:5], dtype=int)[[0, 1, 2]]
                if scan is not None
                else (0, 0, 0)
            ),
        ]
    print(f"{sums[0]} scenes, {sums[1]} raised; rows: {sums[2]} OK, {sums[3]} said, {sums[4]} left")


if __name__ == "__main__":
    main()
