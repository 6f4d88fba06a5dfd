"""Who may use the server: those with the token, from names and sites that are known."""

from __future__ import annotations

import hmac
import ipaddress
import math
import re
import secrets
import socket
import time
from collections.abc import Iterable
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from clvol.base.errors import OptionError

if TYPE_CHECKING:
    from aiohttp import web

__all__ = ["INVALID", "SECRET", "Access", "Refused", "from_another_site", "is_any", "is_loopback"]

_LOOPBACK = ("127.0.0.1", "::1", "localhost")
SECRET = "X-Clvol-Secret"
INVALID = "this address is not, or no longer, valid: open the one that was printed where clvol was started"
_TICKET = 60.0  # seconds that a browser has to start


class Refused(Exception):
    """A request that is not answered, and its HTTP status."""

    def __init__(self, status: int, why: str) -> None:
        super().__init__(why)
        self.status = status


class Access:
    """Checks requests: `Host` and `Origin` whatever token they bring, then the token or the secret that it was exchanged for.

    So neither another site in the same browser nor a name that was made to point here gets in.

    The server listens at `host`; `names` are further ones, with or without a port.
    """

    def __init__(self, host: str, names: Iterable[str]) -> None:
        self._host, self._names = host, frozenset(map(_as_name, names))
        self._tickets: dict[str, float] = {}  # until when each is valid
        self.token = secrets.token_urlsafe(32)
        self.secret = secrets.token_urlsafe(32)
        """What pages keep: the address does not reveal it."""

    def ticket(self) -> str:
        """A token that is valid once, for a minute."""
        ticket = secrets.token_urlsafe(32)
        self._tickets[ticket] = time.monotonic() + _TICKET
        return ticket

    def _asked_host(self, request: web.BaseRequest) -> str:
        """The name that was asked for, if it is one of ours: another could be made to point here."""
        values = request.headers.getall("Host", [])
        asked = values[0].lower() if len(values) == 1 else ""
        name = _without_port(asked)
        public = not is_loopback(self._host)
        if name and (name in _names_of(self._host) or asked in self._names or name in self._names or (public and _is_ip(name))):
            return asked
        raise Refused(403, f"this server does not answer to the name {asked[:80]!r}; allow it with --allow-host")

    def check(self, request: web.BaseRequest) -> None:
        """Refuse requests to names that are not known, and what a page of another site asks for; other programs send no origin."""
        host = self._asked_host(request)
        origins = request.headers.getall("Origin", [])
        for origin in origins:
            try:
                parts = urlsplit(origin.lower() if origin.isascii() else "")
            except ValueError:  # brackets that hold no address
                parts = urlsplit("")
            known = parts.scheme in ("http", "https") and (
                parts.netloc == host or parts.netloc in self._names or _without_port(parts.netloc) in self._names
            )
            if not known:
                raise Refused(403, f"requests from {origin[:80]!r} are not allowed; allow a proxy's name with --allow-host")
        navigates = request.headers.get("Sec-Fetch-Mode") == "navigate"
        if from_another_site(request) and not navigates and not origins:
            raise Refused(403, "requests from other sites are not allowed")

    def admits(self, hello: object) -> bool:
        """Whether the first message of a websocket has a token or the secret; tickets are spent."""
        if not isinstance(hello, dict) or hello.get("type") != "hello":
            return False
        token, secret = (given if isinstance(given := hello.get(name), str) else "" for name in ("token", "secret"))
        now, until = time.monotonic(), self._tickets.pop(token, -math.inf)
        self._tickets = {ticket: end for ticket, end in self._tickets.items() if end > now}
        return _equal(token, self.token) or now < until or _equal(secret, self.secret)

    def check_secret(self, request: web.BaseRequest) -> None:
        """Refuse a request without the secret, which pages send in a header of their own: no proxy has a use for it."""
        if not _equal(request.headers.get(SECRET, ""), self.secret):
            raise Refused(403, INVALID)


def from_another_site(request: web.BaseRequest) -> bool:
    """Whether a browser says so."""
    return request.headers.get("Sec-Fetch-Site", "none") in ("cross-site", "same-site")


def _equal(given: str, expected: str) -> bool:
    """Whether two secrets are equal, in a time that does not depend on how much of them is."""
    return hmac.compare_digest(given.encode("utf-8", "replace"), expected.encode())


def _as_name(given: str) -> str:
    name = given.lower().removeprefix("http://").removeprefix("https://").rstrip("/")
    if not name or any(c in name for c in "/@?#* \t\r\n") or not name.isascii():
        raise OptionError(f"names must be hosts such as hub.example.org or hub.example.org:8000; got {given!r}")
    return name


_NETLOC = re.compile(r"(?:\[([0-9a-f:.]+)\]|([a-z0-9._-]+))(?::\d{1,5})?")


def _without_port(netloc: str) -> str:
    """The name in ``name:port``, without the brackets of IPv6; "" if it is no such text."""
    found = _NETLOC.fullmatch(netloc)
    return (found[1] or found[2]) if found else ""


def is_any(host: str) -> bool:
    """Whether it stands for all addresses of this machine."""
    return host == "" or (_is_ip(host) and ipaddress.ip_address(host).is_unspecified)


def _is_ip(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches it."""
    return host.lower() == "localhost" or (_is_ip(host) and ipaddress.ip_address(host).is_loopback)


def _names_of(host: str) -> frozenset[str]:
    """The names by which a server at `host` is reached."""
    if is_loopback(host):
        return frozenset((*_LOOPBACK, host.lower()))
    here = socket.gethostname().lower()
    return frozenset((*_LOOPBACK, host.lower(), here))
