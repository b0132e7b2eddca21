"""The names of the public face."""

import importlib
import inspect
from types import ModuleType

import pytest

import vibrissa as vb


def test_every_public_name_is_there() -> None:
    assert [name for name in vb.__all__ if not hasattr(vb, name)] == []
    assert set(dir(vb)) == set(vb.__all__)


def test_functions_keep_their_names_when_their_rooms_are_imported() -> None:
    for room in ("forward", "inverse", "sensor", "rod", "trail"):
        importlib.import_module(f"vibrissa.{room}")
    assert callable(vb.scan)
    assert callable(vb.reconstruct)
    assert isinstance(vb.Rod.unit(), vb.Rod)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="whisker"):
        _ = vb.whisker


@pytest.mark.parametrize("room", [vb, vb.surfaces], ids=["vibrissa", "surfaces"])
def test_signatures_read_as_they_are_written(room: ModuleType) -> None:
    for name in dir(room):
        public = getattr(room, name)
        if callable(public) and not name.endswith(("Error", "Warning")):
            signature = str(inspect.signature(public))
            for spelt_out in ("Annotated", "_array_like", "functools", " at 0x"):
                assert spelt_out not in signature, name
            assert max(map(len, signature.split(", "))) < 160, name
