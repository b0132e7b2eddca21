"""Compilation: XLA options, and a cache on disk.

Environment variables: `VIBRISSA_CACHE` names the cache's folder, or switches it off (`off`).
"""

import hashlib
import os
import platform
from collections.abc import Callable
from contextlib import suppress
from functools import cache, lru_cache, wraps
from pathlib import Path
from typing import ParamSpec, TypeVar

import jax
from platformdirs import user_cache_path

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

_MOST_KERNELS = 10_000
"""In the cache, some 500 MB; of more, the older half goes."""
_LARGEST_LOOP = 2**30
"""[bytes] up to which XLA compiles a loop into one function: enough for all of ours. With the
default of 1024 it calls a function for each operation of each iteration, which takes longer than
the operation itself on a few numbers.
"""


def set_up_loops() -> None:
    """Have XLA compile each loop in one piece, if JAX has not started and no other such options are
    set; the environment is the only way to say so.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if "xla_backend_extra_options" not in flags:
        ours = f"xla_cpu_small_while_loop_byte_threshold={_LARGEST_LOOP}"
        # First: a word that is no flag ends what XLA reads.
        os.environ["XLA_FLAGS"] = f"--xla_backend_extra_options={ours} {flags}".strip()


def set_up_cache() -> None:
    """Keep compiled kernels in the user's cache folder, unless JAX has been given a cache already.

    Entries hold machine code, so each kind of processor has a folder of its own. Any number of
    processes may share it. JAX could limit its size itself, but then reads all entries under a lock
    before it adds one: half a second with six thousand of them.
    """
    wanted = os.environ.get("VIBRISSA_CACHE", "")
    if wanted.lower() == "off" or jax.config.values["jax_compilation_cache_dir"]:
        return
    folder = (Path(wanted) if wanted else user_cache_path("vibrissa")) / "kernels" / _processor()
    _shrink(folder)
    for name, value in {
        "jax_compilation_cache_dir": str(folder),
        "jax_persistent_cache_min_compile_time_secs": 0.0,
        "jax_persistent_cache_min_entry_size_bytes": -1,
    }.items():
        jax.config.update(name, value)  # type: ignore[no-untyped-call]


def is_marked(name: str) -> bool:
    """Whether any process has marked a name in the cache."""
    marked = _mark(name)
    return marked is not None and marked.exists()


def mark(name: str) -> None:
    """Mark a name in the cache, if there is one."""
    marked = _mark(name)
    if marked is not None:
        with suppress(OSError):
            marked.touch()


def _mark(name: str) -> Path | None:
    folder = jax.config.values["jax_compilation_cache_dir"]
    return None if folder is None else Path(folder) / f"{name}-mark"


def _shrink(folder: Path) -> None:
    """Drop the older half of a folder that has become too large."""
    # The folder may be missing, and another process may drop entries at the same time.
    with suppress(OSError):
        entries = list(folder.iterdir())
        if len(entries) > _MOST_KERNELS:
            entries.sort(key=lambda entry: entry.stat().st_mtime)
            for entry in entries[: len(entries) // 2]:
                entry.unlink()


def _processor() -> str:
    """Short name of the kind of processor."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
        told = sorted(
            {line for line in text.splitlines() if line.startswith(("flags", "Features"))}
        )
    except OSError:
        told = [platform.processor()]
    return f"{platform.machine()}-{hashlib.sha256(repr(told).encode()).hexdigest()[:12]}"


@cache
def _options(*, quick: bool) -> dict[str, bool | int | str]:
    """XLA's older loop emitter keeps Newton's method in one vectorised loop: twice as fast here
    (measured), and quicker to compile. Code in one piece takes less work to compile than in many,
    and LLVM's expensive passes add a quarter to the compilation without making the code faster.
    Sums and products of arrays as small as ours take longer in the library that XLA would leave
    them to: checks of spatial rods take a third less time without it.

    Without optimisation scalar code takes half the time to compile and three times as long to run;
    of a block of 64 lanes jaxlib 0.10.2 then turns some into NaN. With few, marches of spatial rods
    take a quarter longer to run, and a tenth less to compile.
    """
    options: dict[str, bool | int | str] = {
        "xla_cpu_use_fusion_emitters": False,
        "xla_cpu_parallel_codegen_split_count": 1,
        "xla_llvm_disable_expensive_passes": True,
        "xla_cpu_experimental_ynn_fusion_type": "",
    }
    if quick:
        options["xla_backend_optimization_level"] = 0
    try:
        jax.jit(lambda x: x + 1, compiler_options=options)(0.0)
    except Exception:  # a release of XLA without the options, whatever it raises
        return {}
    return options


def compiled(
    function: Callable[Parameters, Result], *, quick: bool = False
) -> Callable[Parameters, Result]:
    """`jax.jit` with the options above, set up at the first call so that importing a module does
    not start a backend; `quick` says of scalar code that it matters more how soon it is at hand
    than how fast it is.
    """

    @lru_cache(maxsize=1)
    def build() -> Callable[Parameters, Result]:
        return jax.jit(function, compiler_options=_options(quick=quick))

    @wraps(function)
    def call(*arguments: Parameters.args, **named: Parameters.kwargs) -> Result:
        return build()(*arguments, **named)

    return call
