"""Benchmarks on one core: `python benchmarks/run.py`. The README says what the rows are."""

import platform

from timing import Row, pin_to_one_core


def main() -> list[Row]:
    """Print the table; return its warm rows."""
    core = pin_to_one_core()
    # Only now, so that NumPy and JAX start on that core.
    from cold import cold, memory  # noqa: PLC0415
    from warm import forward, inverse  # noqa: PLC0415

    print(f"one core (number {core}), Python {platform.python_version()}, {platform.machine()}\n")
    tables = (("forward, µs a position", forward), ("inverse, µs a sample", inverse))
    rows = []
    for title, measure in tables:
        print(f"{title:<58}{'µs':>14}{'ratio':>12}")
        for row in measure():
            rows.append(row)
            print(row)
        print()
    for title, unit, measure in (("cold, a fresh process", "s", cold), ("peak resident memory", "MiB", memory)):
        print(f"{title:<58}{unit:>14}")
        for name, value in measure().items():
            print(f"{name:<58}{value:>14,.3f}")
        print()
    return rows


if __name__ == "__main__":
    main()
