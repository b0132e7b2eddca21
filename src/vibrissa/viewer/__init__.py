"""The 3-D scene in the browser. The only room that imports viser."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
