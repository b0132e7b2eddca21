"""Whisker-like tactile sensing: large-deflection contact mechanics of a swept elastic rod, forward
and inverse.

Names are loaded when first used (`__init__.pyi` lists them), so that `import vibrissa` and the
command line's help stay quick.
"""

import lazy_loader

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
