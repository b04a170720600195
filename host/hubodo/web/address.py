"""Listening addresses, and the host names that a browser may use for them."""

from __future__ import annotations

import ipaddress
import socket
from dataclasses import dataclass

from hubodo.errors import InputError
from hubodo.listening.listener import BoundedListener

LOOPBACK = "127.0.0.1"


@dataclass(frozen=True)
class Address:
    """The address of a server; `host` is a name or an IP number without brackets."""

    host: str
    port: int

    @property
    def is_loopback(self) -> bool:
        """Return True if only this computer can reach the address."""
        number = _number(self.host)
        return self.host.lower() == "localhost" if number is None else number.is_loopback

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"

    def listen(self) -> BoundedListener:
        """Return a listening socket; raise InputError if that is not possible."""
        try:
            return BoundedListener.listen_on(self.host, self.port)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"{self}: cannot listen: {reason}; give another HOST:PORT") from None


def parse_address(text: str, port: int) -> Address:
    """Parse `HOST:PORT`, `HOST`, `:PORT` or `PORT`, by default loopback and `port`; raise InputError."""
    if text.isdigit():
        text = ":" + text
    host, colon, number = text.rpartition(":")
    if not colon or text.endswith("]"):
        host, number = text, str(port)
    host = host.removeprefix("[").removesuffix("]")
    if not number.isascii() or not number.isdigit() or int(number) > 65535 or set(host) & set("/=@ "):
        raise InputError(
            f"{text!r} is no HOST:PORT; write {LOOPBACK}:{port}, for example, after the ports of nodes"
        )
    return Address(host or LOOPBACK, int(number))


def split_host(text: str) -> str:
    """Return the name in a Host header or URL authority, in lower case, without port and brackets."""
    if text.startswith("["):
        return text[1:].partition("]")[0].lower()
    return text.partition(":")[0].lower().removesuffix(".")


def is_host_allowed(name: str, address: Address, extra_names: frozenset[str]) -> bool:
    """Return True if a browser used a name that belongs to this server (protection against DNS rebinding).

    A page of another site can make its own name point to this computer, but neither an IP number nor the
    computer's own name.
    """
    if _number(name) is not None:
        return True
    names = {"localhost", address.host.lower(), *extra_names}
    if not address.is_loopback:
        machine = socket.gethostname().lower()
        names |= {machine, f"{machine.partition('.')[0]}.local"}
    return name in names


def _number(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return None
