"""Cold costs, each in a fresh process: imports, first calls, memory. This module itself loads
nothing heavy.
"""

import json
import resource
import subprocess
import sys
from pathlib import Path
from time import perf_counter

_MIB = 1024.0


def cold() -> dict[str, float]:
    """Seconds that a process's first use of the package takes, by step."""
    return _in_fresh_process("first_use")


def memory() -> dict[str, float]:
    """Peak resident memory [MiB] of a fresh process, by step."""
    return _in_fresh_process("batch_memory")


def first_use() -> dict[str, float]:
    """Time the steps of first use; the top-level package is imported before anything else."""
    times, clock = {}, _Clock()
    import vibrissa as vb  # noqa: PLC0415

    times["import vibrissa"] = clock.lap()
    _ = vb.scan, vb.reconstruct, vb.surfaces, vb.Trail, vb.Rod
    times["first use of its names (loads JAX)"] = clock.lap()
    from cases import OBJECT, ROD, one_trail, samples_of  # noqa: PLC0415

    clock.lap()
    found = vb.scan(ROD, OBJECT, one_trail(0.2))
    times["first scan of an object's type (compiles)"] = clock.lap()
    vb.scan(ROD, OBJECT, one_trail(0.1))
    times["second scan"] = clock.lap()
    samples = samples_of(found, 1000)
    clock.lap()
    vb.reconstruct(ROD, samples)
    times["first reconstruction (compiles)"] = clock.lap()
    vb.reconstruct(ROD, samples)
    times["second reconstruction"] = clock.lap()
    return times


def batch_memory() -> dict[str, float]:
    """Peak memory after the imports, after one trail with its compilation, and after the batch."""
    import vibrissa as vb  # noqa: PLC0415
    from cases import OBJECT, ROD, batch, one_trail  # noqa: PLC0415

    peaks = {"imports": _peak()}
    vb.scan(ROD, OBJECT, one_trail(0.2))
    peaks["one trail (compiles)"] = _peak()
    vb.scan(ROD, OBJECT, batch())
    peaks["batch of 1000 x 211 (compiles)"] = _peak()
    vb.scan(ROD, OBJECT, batch())
    peaks["the batch again"] = _peak()
    return peaks


class _Clock:
    def __init__(self) -> None:
        self._start = perf_counter()

    def lap(self) -> float:
        """Seconds since the last lap."""
        last, self._start = self._start, perf_counter()
        return self._start - last


def _peak() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _MIB


def _in_fresh_process(name: str) -> dict[str, float]:
    # The child inherits the core, the environment, and, as a floor for its own, the peak memory of
    # this process.
    script = f"import json, cold; print(json.dumps(cold.{name}()))"
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=Path(__file__).parent,
        check=True,
        capture_output=True,
        text=True,
    )
    return json.loads(done.stdout)
