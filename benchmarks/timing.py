"""One core, timing, and the table."""

import os
from collections.abc import Callable
from time import perf_counter
from typing import NamedTuple


def pin_to_one_core() -> int:
    """Keep this process and its libraries on one core; call before NumPy or JAX is imported.
    Returns the core.
    """
    core = max(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {core})
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    flags = os.environ.get("XLA_FLAGS", "")
    os.environ["XLA_FLAGS"] = f"--xla_cpu_multi_thread_eigen=false {flags}".strip()
    os.environ["JAX_PLATFORMS"] = "cpu"
    return core


class Row(NamedTuple):
    """One line of the table; a ratio compares with the package's figure for the same task."""

    task: str
    microseconds: float
    ratio: float | None = None
    note: str = ""

    def __str__(self) -> str:
        """Task, figure, ratio, note."""
        ratio = "" if self.ratio is None else f"{self.ratio:,.0f} x"
        return f"{self.task:<58}{self.microseconds:>14,.2f}{ratio:>12}  {self.note}".rstrip()


def best_of(repeats: int, task: Callable[[], object], items: int) -> float:
    """Microseconds per item in the fastest of several runs, after a warm-up run that does not
    count.
    """
    task()
    elapsed = []
    for _ in range(repeats):
        start = perf_counter()
        task()
        elapsed.append(perf_counter() - start)
    return 1e6 * min(elapsed) / items
