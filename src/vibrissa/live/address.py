"""Addresses of sources: `netft://HOST:PORT`, `tcp://HOST:PORT`, `serial:DEVICE`, `replay:FILE`,
with options after a question mark.
"""

from dataclasses import dataclass, field
from typing import Literal
from urllib.parse import parse_qsl, urlsplit

from vibrissa.files import InputError
from vibrissa.live.rdt import PORT

Kind = Literal["netft", "tcp", "serial", "replay"]
FORMS = (
    "netft://HOST[:PORT], tcp://HOST:PORT, serial:DEVICE[?baud=115200] and replay:FILE[?speed=1]"
)
_OPTIONS: dict[str, tuple[str, ...]] = {
    "netft": (),
    "tcp": (),
    "serial": ("baud",),
    "replay": ("speed",),
}
_FASTEST_BAUD = 20_000_000


@dataclass(frozen=True)
class Address:
    """Where samples come from.

    Attributes
    ----------
    kind
        Of the source.
    path
        Host, device or file.
    port
        Of the host; 0 where there is none.
    speed
        Of a replay, infinity for as fast as possible.
    baud
        Of a serial line.
    """

    kind: Kind
    path: str
    port: int = 0
    speed: float = 1.0
    baud: int = field(default=115200)


def parse_address(text: str) -> Address:
    """Address of a source.

    Raises
    ------
    InputError
        If the text has none of the forms named above.
    """
    kind, _, rest = text.partition(":")
    match kind:
        case "netft" | "tcp":
            _check_options(text, kind, text.partition("?")[2])
            host, port = host_and_port(text.partition("?")[0], PORT if kind == "netft" else None)
            return Address(kind, host, port)
        case "serial" | "replay":
            path, _, query = (
                rest.rpartition("?")
                if "?" in rest and "=" in rest.rpartition("?")[2]
                else (rest, "", "")
            )
            options = _check_options(text, kind, query)
            if not path:
                raise InputError(
                    f"source {text!r}: no {'device' if kind == 'serial' else 'file'}; allowed are {FORMS}"
                )
            return Address(kind, path, speed=_speed(text, options), baud=_baud(text, options))
    raise InputError(f"source {text!r}; allowed are {FORMS}")


def host_and_port(text: str, default: int | None = None) -> tuple[str, int]:
    """Parts of `SCHEME://HOST:PORT`; a host of version 6 of the protocol stands in brackets.

    Raises
    ------
    InputError
        If there is no host, more than these, or the port is missing or not from 1 to 65535.
    """
    try:
        parts = urlsplit(text)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise InputError(
            f"address {text!r}: {error}; allowed is {text.partition(':')[0]}://HOST:PORT"
        ) from error
    port = default if port is None else port
    if (
        not host
        or not port
        or parts.path.strip("/")
        or parts.username is not None
        or parts.query
        or parts.fragment
    ):
        raise InputError(
            f"address {text!r}; allowed is {parts.scheme}://HOST:PORT with a port from 1 to 65535"
        )
    return host, port


def _check_options(text: str, kind: str, query: str) -> dict[str, str]:
    options = dict(parse_qsl(query, keep_blank_values=True))
    unknown = [name for name in options if name not in _OPTIONS[kind]]
    if unknown:
        allowed = ", ".join(_OPTIONS[kind]) or "none"
        raise InputError(f"source {text!r}: unknown option {unknown[0]!r}; allowed are {allowed}")
    return options


def _speed(text: str, options: dict[str, str]) -> float:
    value = options.get("speed", "1")
    try:
        speed = float("inf") if value == "max" else float(value)
    except ValueError:
        speed = float("nan")
    if not speed > 0:
        raise InputError(
            f"source {text!r}: speed = {value!r}; allowed is a number greater than 0, or max"
        )
    return speed


def _baud(text: str, options: dict[str, str]) -> int:
    value = options.get("baud", "115200")
    if not value.isascii() or not value.isdigit() or not 0 < int(value[:10]) <= _FASTEST_BAUD:
        raise InputError(
            f"source {text!r}: baud = {value!r}; allowed is a whole number from 1 to {_FASTEST_BAUD}"
        )
    return int(value)
