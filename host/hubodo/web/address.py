"""Where a server listens, and which names of it a browser may use."""

from __future__ import annotations

import ipaddress
import socket
from dataclasses import dataclass

from hubodo.errors import InputError
from hubodo.listening.listener import BoundedListener

LOOPBACK = "127.0.0.1"


@dataclass(frozen=True)
class Address:
    """host: a name or an IP number without brackets."""

    host: str
    port: int

    @property
    def loopback(self) -> bool:
        """Whether nobody but this computer reaches it."""
        number = _number(self.host)
        return self.host.lower() == "localhost" if number is None else number.is_loopback

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"

    def listen(self) -> BoundedListener:
        """Return a socket that listens there. Raises InputError where that is not possible."""
        try:
            return BoundedListener.listen_on(self.host, self.port)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"{self}: cannot listen there: {reason}; name another HOST:PORT") from None


def parse_address(text: str, port: int) -> Address:
    """`HOST:PORT`, `HOST`, `:PORT` or `PORT`; what is missing is loopback and `port`. Raises InputError."""
    if text.isdigit():
        text = ":" + text
    host, colon, number = text.rpartition(":")
    if not colon or text.endswith("]"):
        host, number = text, str(port)
    host = host.removeprefix("[").removesuffix("]")
    if not number.isascii() or not number.isdigit() or int(number) > 65535 or set(host) & set("/=@ "):
        raise InputError(
            f"{text!r} is no HOST:PORT; write such as {LOOPBACK}:{port}, and ports of nodes before it"
        )
    return Address(host or LOOPBACK, int(number))


def split_host(text: str) -> str:
    """The name in a Host header or in the authority of a URL, lower case, without port and brackets."""
    if text.startswith("["):
        return text[1:].partition("]")[0].lower()
    return text.partition(":")[0].lower().removesuffix(".")


def host_allowed(name: str, address: Address, more: frozenset[str]) -> bool:
    """Whether a browser that used this name for the server was not sent by somebody else's name service.

    A page of another site can make a name of its own point to this computer, but neither an IP number nor the
    computer's own name.
    """
    if _number(name) is not None:
        return True
    own = {"localhost", address.host.lower(), *more}
    if not address.loopback:
        machine = socket.gethostname().lower()
        own |= {machine, f"{machine.partition('.')[0]}.local"}
    return name in own


def _number(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return None
