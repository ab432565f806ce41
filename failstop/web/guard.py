"""Guard: decides which requests are let in, by a table. The first row that fails decides. Pure.

A page of another site can make a browser send requests here: it can let a name of its own point to the robot
(rebinding), or send requests to the robot's name from elsewhere (cross-site). Nobody is trusted only because the
request comes from the robot's network.
"""

from __future__ import annotations

import dataclasses
import ipaddress
from urllib.parse import urlsplit

from failstop.api.errors import FailstopError

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

HEADER = "X-Failstop"
"""A header that the page's own scripts set. A form or a link of another site can't set it."""
READS = frozenset(("GET", "HEAD"))
METHODS = READS | {"POST"}
SAME = frozenset(("", "same-origin", "none"))
"""The values of Sec-Fetch-Site that are allowed: the request comes from this page, or from something that the person
did."""

HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
        "manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=(), payment=(), usb=()",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Cache-Control": "no-store",
}
"""The headers of every answer."""


@dataclasses.dataclass(frozen=True)
class PageRequest:
    """The parts of a request that decide. A part that was not sent is empty."""

    method: str
    scheme: str
    """http or https, as the request arrived."""
    host: str
    """The header Host, with the port."""
    origin: str = ""
    header: str = ""
    """The value of HEADER."""
    site: str = ""
    """The value of Sec-Fetch-Site."""
    upgrade: bool = False
    """True if the request asks for a websocket."""


def origin_of(setting: str) -> str:
    """The origin that browsers see if there is a proxy in between; empty if there is none. Raises FailstopError."""
    found = setting.lower().rstrip("/")
    scheme, _, host = found.partition("://")
    if found and not (scheme in ("http", "https") and host_of(host) and host.isascii() and " " not in host):
        raise FailstopError(f"web.origin = {setting!r} is not the address of a page, such as https://robot.example")
    return found


def names(hostname: str, more: str, origin: str = "") -> frozenset[str]:
    """Every name that the robot answers to, in addition to its addresses: its host name, the same with .local,
    localhost, the names in a setting (separated by blanks), and the name in the origin that browsers see."""
    own = hostname.lower().partition(".")[0]
    proxied = host_of(origin.partition("://")[2])
    return frozenset(("localhost", hostname.lower(), own, f"{own}.local", *more.lower().split(), proxied)) - {""}


def host_of(header: str) -> str:
    """The host in a Host header, without port and brackets; empty if it is not one."""
    try:
        found = urlsplit(f"//{header}")
        _ = found.port
    except ValueError:
        return ""
    if found.username is not None or found.path or found.query or found.fragment:
        return ""
    return (found.hostname or "").rstrip(".")


def is_address(host: str) -> bool:
    """True if the host is an address and not a name. Another site can't let an address point to the robot, so a page
    that was opened at an address came from the robot."""
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def only_here(address: str) -> bool:
    """True if only this computer can reach that address."""
    return address == "localhost" or (is_address(address) and ipaddress.ip_address(address).is_loopback)


def _own_host(request: PageRequest, known: frozenset[str], proxied: str) -> bool:
    host = host_of(request.host)
    return is_address(host) or host in known


def _own_origin(request: PageRequest, known: frozenset[str], proxied: str) -> bool:
    if request.origin:
        # An origin that was sent is never empty, as one that is not set is.
        return request.origin.lower() in (f"{request.scheme}://{request.host.lower()}", proxied)
    # A browser names the origin of each of these; a program has none.
    return not request.upgrade


ROWS: tuple[tuple[str, int, Callable[[PageRequest, frozenset[str], str], bool], str], ...] = (
    ("method", 405, lambda request, known, proxied: request.method in METHODS, "only GET, HEAD and POST are answered"),
    ("host", 421, _own_host, "this robot does not answer to that host name: add it to the setting web.hosts"),
    ("site", 403, lambda request, known, proxied: request.site in SAME, "a page of another site may not call this one"),
    (
        "origin",
        403,
        _own_origin,
        "a page of another site may not call this one; behind a proxy that handles HTTPS, set web.origin",
    ),
    (
        "header",
        403,
        lambda request, known, proxied: request.method in READS or request.header == "1",
        f"a request that changes something must have the header {HEADER}: 1",
    ),
)
"""Name, status, what must hold, what is said otherwise."""


def refusal(request: PageRequest, known: frozenset[str], proxied: str = "") -> tuple[int, str] | None:
    """The status and the reason for a request that is not let in; None if it is let in. `proxied`: the origin that
    browsers see if there is a proxy in between."""
    for _, status, holds, why in ROWS:
        if not holds(request, known, proxied):
            return status, why
    return None
