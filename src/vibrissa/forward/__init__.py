"""The forward problem: rod, object and clamp path in, support reactions out."""

from vibrissa.forward.equilibria import Equilibrium, equilibria
from vibrissa.forward.events import Event, EventKind
from vibrissa.forward.result import Scan
from vibrissa.forward.scan import scan
from vibrissa.forward.slip import Slip
from vibrissa.forward.validity import QuasiStatic

__all__ = ["Equilibrium", "Event", "EventKind", "QuasiStatic", "Scan", "Slip", "equilibria", "scan"]
