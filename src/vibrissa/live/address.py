"""Source addresses (`netft://HOST:PORT`, `tcp://HOST:PORT`, `serial:DEVICE`, `replay:FILE`, options
after a question mark), and sockets whose errors name the address.
"""

import re
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

from vibrissa.files import InputError
from vibrissa.live.rdt import PORT

FORMS = (
    "netft://HOST[:PORT], tcp://HOST:PORT, serial:DEVICE[?baud=115200] and replay:FILE[?speed=1]"
)
_WITH_A_HOST = re.compile(r"(\w+)://(?:\[([^]]+)\]|([^]:/?#@[]+))(?::([0-9]{1,5}))?/?")
_WITH_A_PATH = re.compile(r"(serial|replay):(.+?)(?:\?(\w+)=([^?]*))?")
_FASTEST_BAUD = 20_000_000  # beyond any serial port


@dataclass(frozen=True)
class Address:
    """Where samples come from.

    Attributes
    ----------
    kind
        Kind of source: netft, tcp, serial or replay.
    path
        Host, device or file.
    port
        Port of the host; 0 if there is none.
    speed
        Speed of a replay; infinity for as fast as possible.
    baud
        Baud rate of a serial line.

    Raises
    ------
    ValueError
        If the speed is not greater than 0, or the baud rate is out of range.
    """

    kind: str
    path: str
    port: int = 0
    speed: float = 1.0
    baud: int = 115200

    def __post_init__(self) -> None:
        if not (self.speed > 0 and 0 < self.baud <= _FASTEST_BAUD):
            raise ValueError(f"speed = {self.speed}, baud = {self.baud}")


def parse_address(text: str) -> Address:
    """Parse the address of a source.

    Raises
    ------
    InputError
        If the text has none of the forms named above.
    """
    kind = text.partition(":")[0]
    if kind in ("netft", "tcp"):
        return Address(kind, *host_and_port(text, PORT if kind == "netft" else 0))
    found = _WITH_A_PATH.fullmatch(text)
    with suppress(ValueError):
        match found and found.groups():
            case kind, path, None, None:
                return Address(kind, path)
            case "serial", path, "baud", value:
                return Address("serial", path, baud=int(value))
            case "replay", path, "speed", value:
                return Address("replay", path, speed=float("inf" if value == "max" else value))
    raise InputError(
        f"source {text!r}; allowed are {FORMS}, with a baud rate from 1 to {_FASTEST_BAUD} and a "
        "speed greater than 0, or max"
    )


def host_and_port(text: str, default: int = 0) -> tuple[str, int]:
    """Host and port of `SCHEME://HOST:PORT`; IPv6 addresses go in brackets.

    Raises
    ------
    InputError
        If there is no host, anything besides host and port, or the port is missing or not from 1 to
        65535.
    """
    found = _WITH_A_HOST.fullmatch(text)
    port = int(found[4] or default) if found else 0
    if found is None or not 1 <= port <= 65535:
        raise InputError(
            f"address {text!r}; allowed is SCHEME://HOST:PORT with a port from 1 to 65535"
        )
    return found[2] or found[3], port


@contextmanager
def naming(address: str) -> Iterator[None]:
    """Make an OSError raised within name the address."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), address) from error


def listening(host: str, port: int) -> socket.socket:
    """A UDP socket bound to this address.

    Raises
    ------
    OSError
        If the port is taken, or the address is not this machine's; the error names both.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    opened = socket.socket(family, socket.SOCK_DGRAM)
    try:
        with naming(f"udp://{host}:{port}"):
            opened.bind((host, port))
    except OSError:
        opened.close()
        raise
    return opened
