"""Addresses of sources: `netft://HOST:PORT`, `tcp://HOST:PORT`, `serial:DEVICE`, `replay:FILE`,
with options after a question mark.
"""

import re
from dataclasses import dataclass
from typing import Literal
from urllib.parse import urlsplit

from vibrissa.files import InputError
from vibrissa.live.rdt import PORT

FORMS = (
    "netft://HOST[:PORT], tcp://HOST:PORT, serial:DEVICE[?baud=115200] and replay:FILE[?speed=1]"
)
_WITH_A_PATH = re.compile(r"(serial|replay):(.+?)(?:\?(\w+)=([^?]*))?")
_FASTEST_BAUD = 20_000_000  # of any serial port, with room


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

    kind: Literal["netft", "tcp", "serial", "replay"]
    path: str
    port: int = 0
    speed: float = 1.0
    baud: int = 115200


def parse_address(text: str) -> Address:
    """Address of a source.

    Raises
    ------
    InputError
        If the text has none of the forms named above.
    """
    kind = text.partition(":")[0]
    if kind == "netft":
        return Address("netft", *host_and_port(text, PORT))
    if kind == "tcp":
        return Address("tcp", *host_and_port(text))
    found = _WITH_A_PATH.fullmatch(text)
    if found is None:
        raise InputError(f"source {text!r}; allowed are {FORMS}")
    kind, path, option, value = found.groups()
    match kind, option:
        case "serial", None | "baud":
            return Address("serial", path, baud=_baud(text, value or "115200"))
        case "replay", None | "speed":
            return Address("replay", path, speed=_speed(text, value or "1"))
    allowed = {"serial": "baud", "replay": "speed"}[kind]
    raise InputError(f"source {text!r}: unknown option {option!r}; allowed is {allowed}")


def host_and_port(text: str, default: int | None = None) -> tuple[str, int]:
    """Parts of `SCHEME://HOST:PORT`; an IPv6 address stands in brackets.

    Raises
    ------
    InputError
        If there is no host, more than these, or the port is missing or not from 1 to 65535.
    """
    try:
        parts = urlsplit(text)
        host, port = parts.hostname, parts.port or (default if parts.port is None else 0)
    except ValueError as error:
        scheme = text.partition(":")[0]
        raise InputError(f"address {text!r}: {error}; allowed is {scheme}://HOST:PORT") from error
    more = parts.path.strip("/") or parts.query or parts.fragment or parts.username is not None
    if not host or not port or more:
        raise InputError(
            f"address {text!r}; allowed is {parts.scheme}://HOST:PORT with a port from 1 to 65535"
        )
    return host, port


def _speed(text: str, value: str) -> float:
    try:
        speed = float("inf" if value == "max" else value)
    except ValueError:
        speed = 0.0
    if not speed > 0:
        raise InputError(
            f"source {text!r}: speed = {value!r}; allowed is a number greater than 0, or max"
        )
    return speed


def _baud(text: str, value: str) -> int:
    if not re.fullmatch("[0-9]{1,8}", value) or not 0 < int(value) <= _FASTEST_BAUD:
        raise InputError(
            f"source {text!r}: baud = {value!r}; allowed is a whole number from 1 to "
            f"{_FASTEST_BAUD}"
        )
    return int(value)
