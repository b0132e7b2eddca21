from .page import Viewer
from .stream import ViewerSink
from .view import view

__all__ = ["Viewer", "ViewerSink", "view"]
