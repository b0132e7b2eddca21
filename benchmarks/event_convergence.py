"""Positions of events as steps are halved, and their order of convergence: `python
benchmarks/event_convergence.py`.

Without friction an event does not depend on the trail's step: it is located on the branch itself.
With friction a state depends on its history, and the implicit step of Coulomb's law makes events
converge with the step.
"""

import numpy as np

import vibrissa as vb

COUNTS = (61, 121, 241, 481, 961, 1921)
BOWL = vb.surfaces.EllipticParaboloid(a=0.5, b=1.0, h=0.4)


def trail(y0: float, count: int, *, back: bool) -> vb.Trail:
    """From x = 1.2 to −1.4, or from 1.1 to −0.8 with two reversals on the way."""
    share = np.linspace(0, 1, count)
    x = np.interp(share, [0, 0.4, 0.6, 1], [1.1, 0, 0.5, -0.8]) if back else 1.2 - 2.6 * share
    return vb.Trail(np.stack([x, np.full(count, y0), np.zeros(count)], axis=1))


def table(title: str, y0: float, friction: float, *, back: bool) -> None:
    """One line per event: its parameter on the finest trail, the errors of the coarser ones, and
    the order of the last halving.
    """
    scans = [
        vb.scan(vb.Rod.unit(), BOWL, trail(y0, count, back=back), friction=friction)
        for count in COUNTS
    ]
    print(f"\n{title}\nsteps {', '.join(str(count - 1) for count in COUNTS)}")
    kinds = [[event.kind for event in scan.events] for scan in scans]
    shared = [scan for scan, kind in zip(scans, kinds, strict=True) if kind == kinds[-1]]
    if len(shared) < len(scans):
        print(f"  the {len(scans) - len(shared)} coarsest show other events")
    finest = shared[-1].events
    for index, event in enumerate(finest):
        values = np.array([scan.events[index].parameter for scan in shared])
        errors = np.abs(values[:-1] - values[-1])
        changes = np.abs(np.diff(values))
        order = (
            np.log2(changes[-2] / changes[-1])
            if len(changes) > 1 and changes[-1] > 1e-12
            else np.nan
        )
        shown = " ".join(f"{error:.1e}" for error in errors)
        print(
            f"  {event.kind.name:20s} {event.parameter:.12f}  {shown}  {'exact' if np.isnan(order) else f'order {order:.1f}'}"
        )


if __name__ == "__main__":
    table("no friction, y0 = 0.2", 0.2, 0.0, back=False)
    table("no friction, y0 = 0: the plane branch and its snap", 0.0, 0.0, back=False)
    table("no friction, y0 = 0.2, with reversals", 0.2, 0.0, back=True)
    table("friction 0.25, y0 = 0.2", 0.2, 0.25, back=False)
    table("friction 0.25, y0 = 0.2, with reversals", 0.2, 0.25, back=True)
