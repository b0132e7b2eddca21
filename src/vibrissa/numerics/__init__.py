"""Numerics without physics. Importing this package switches JAX to 64-bit floats, which every
equation here needs, and sets up compilation and the cache of compiled code.
"""

import jax

from vibrissa.numerics.compiled import set_up_cache, set_up_loops

jax.config.update("jax_enable_x64", True)  # type: ignore[no-untyped-call]  # noqa: FBT003
# Threads of ours share out the work: a kernel runs in the one that calls it.
jax.config.update("jax_cpu_enable_async_dispatch", False)  # type: ignore[no-untyped-call]  # noqa: FBT003
set_up_loops()
set_up_cache()
