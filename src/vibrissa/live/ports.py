"""Sockets whose errors name the address."""

import socket
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def naming(address: str) -> Iterator[None]:
    """Let an OSError raised within name the address."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), address) from error


def listening(host: str, port: int) -> socket.socket:
    """A socket for datagrams to this address.

    Raises
    ------
    OSError
        If another program has the port, or the address is not one of this machine; it names both.
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
