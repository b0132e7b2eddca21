"""Sockets that say which address they are of."""

import socket
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def naming(address: str) -> Iterator[None]:
    """What the system refuses names the address."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), address) from error


def listening(host: str, port: int) -> socket.socket:
    """A socket for datagrams to this address; raise OSError, which names address and port, where
    another program has it or it is none of this machine's.
    """
    with naming(f"udp://{host}:{port}"):
        opened = socket.socket(
            socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_DGRAM
        )
        try:
            opened.bind((host, port))
        except OSError:
            opened.close()
            raise
    return opened
