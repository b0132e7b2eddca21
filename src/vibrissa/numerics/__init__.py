"""Numerics that know no physics. Importing it switches JAX to 64-bit floats, which every equation
here needs, and sets up its cache of compiled kernels.
"""

import jax

from vibrissa.numerics.compiled import set_up_cache

jax.config.update("jax_enable_x64", True)  # type: ignore[no-untyped-call]  # noqa: FBT003
set_up_cache()
