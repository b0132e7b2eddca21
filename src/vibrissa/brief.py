"""Short texts of results, for consoles and notebooks."""

from collections.abc import Mapping
from dataclasses import fields
from enum import IntEnum
from typing import Any

import numpy as np

_FEW = 6
"""Numbers up to which an array is written out, and entries up to which a list is."""


def brief(result: Any) -> str:
    """Name and fields of a dataclass on one line, arrays by their shapes."""
    parts = (f"{field.name}={_text(getattr(result, field.name))}" for field in fields(result))
    return f"{type(result).__name__}({', '.join(parts)})"


def counts(codes: Any, words: type[IntEnum]) -> str:
    """How often each of these words occurs among codes of any shape."""
    pairs = zip(*np.unique(codes, return_counts=True), strict=True)
    return ", ".join(f"{count} {words(int(code)).name}" for code, count in pairs)


def point(numbers: Any) -> str:
    """Coordinates, to four digits."""
    return f"({', '.join(f'{number:.4g}' for number in numbers)})"


def _text(value: Any) -> str:
    match value:
        case np.ndarray() if value.size > _FEW:
            return f"<array {value.shape}>"
        case Mapping():
            return "{" + ", ".join(f"{name}: {_text(part)}" for name, part in value.items()) + "}"
        case list() | tuple() if len(value) > _FEW:
            return f"<{len(value)} × {type(value[0]).__name__}>"
    text = repr(value)
    return text if "\n" not in text else f"<{type(value).__name__}>"
