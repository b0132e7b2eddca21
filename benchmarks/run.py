"""Benchmarks on one core: `python benchmarks/run.py`. The README explains the rows."""

import platform

from cold import cold, memory
from timing import Row, pin_to_one_core


def main() -> list[Row]:
    """Print the table; return its warm rows."""
    core = pin_to_one_core()
    print(f"one core (number {core}), Python {platform.python_version()}, {platform.machine()}\n")
    for title, unit, measured in (
        ("cold, a fresh process", "s", cold()),
        ("peak resident memory", "MiB", memory()),
    ):
        print(f"{title:<58}{unit:>14}")
        for name, value in measured.items():
            print(f"{name:<58}{value:>14,.3f}")
        print()

    # Imported only now, so that NumPy and JAX start on that core and do not add to the memory that
    # the fresh processes inherit.
    from warm import forward, inverse  # noqa: PLC0415

    rows = []
    for title, measure in (("forward, a position", forward), ("inverse, a sample", inverse)):
        print(f"{title:<58}{'µs':>14}{'ratio':>12}")
        for row in measure():
            rows.append(row)
            print(row)
        print()
    return rows


if __name__ == "__main__":
    main()
