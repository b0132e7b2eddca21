"""Numerics that know no physics. Importing it switches JAX to 64-bit floats, which every equation
here needs, and sets up how it compiles and where it keeps what it has compiled.
"""

import jax

from vibrissa.numerics.compiled import set_up_cache, set_up_loops

jax.config.update("jax_enable_x64", True)  # type: ignore[no-untyped-call]  # noqa: FBT003
set_up_loops()
set_up_cache()
