"""Numerics that know no physics. Importing it switches JAX to 64-bit floats, which every equation
here needs.
"""

import jax

jax.config.update("jax_enable_x64", True)  # type: ignore[no-untyped-call]  # noqa: FBT003
