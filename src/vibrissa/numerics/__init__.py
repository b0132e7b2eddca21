"""Numerics without physics. Importing this package switches JAX to 64-bit floats, which every
equation here needs, and sets up compilation and the cache of compiled code.
"""

import jax

from vibrissa.numerics.compiled import set_up_cache, set_up_loops

jax.config.update("jax_enable_x64", True)  # type: ignore[no-untyped-call]  # noqa: FBT003
set_up_loops()
set_up_cache()
