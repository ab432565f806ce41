"""Guard: decides which HTTP requests are accepted, by a table of checks. The first check that fails decides the answer.
Pure.

The checks protect against pages of other sites, which can make a browser send requests to the robot. Such a page can
make its own host name point to the robot (DNS rebinding), or send requests to the robot's name (cross-site requests). A
request is not trusted just because it comes from the robot's network.
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
"""A header that only the page's own scripts can set. A form or a link on another site can't."""
READS = frozenset(("GET", "HEAD"))
METHODS = READS | {"POST"}
SAME = frozenset(("", "same-origin", "none"))
"""The accepted values of the header Sec-Fetch-Site. "same-origin": the request comes from this page. "none": the person
has opened the address directly. Empty: the browser has not sent the header."""

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
"""The headers of every response."""


@dataclasses.dataclass(frozen=True)
class PageRequest:
    """The parts of a request that the checks look at. A part that was not sent is empty."""

    method: str
    scheme: str
    """The scheme with which this process has received the request, http or https. Behind a proxy, the browser may have
    used the other scheme."""
    host: str
    """The header Host, including the port."""
    origin: str = ""
    header: str = ""
    """The value of HEADER."""
    site: str = ""
    """The value of Sec-Fetch-Site."""
    path: str = ""
    """The path, without the query."""
    mode: str = ""
    """The value of Sec-Fetch-Mode."""
    dest: str = ""
    """The value of Sec-Fetch-Dest."""
    upgrade: bool = False
    """True if the request asks for a websocket."""


def origin_of(setting: str) -> str:
    """Check and normalize the setting web.origin, which is the page's origin behind a proxy. Returns "" if the setting
    is empty. Raises FailstopError."""
    found = setting.lower().rstrip("/")
    scheme, _, host = found.partition("://")
    if found and not (scheme in ("http", "https") and host_of(host) and host.isascii() and " " not in host):
        raise FailstopError(f"web.origin = {setting!r} is not the address of a page, such as https://robot.example")
    return found


def names(hostname: str, more: str, origin: str = "") -> frozenset[str]:
    """Return all host names of the robot: its own host name, the same name with .local, localhost, the names in the
    setting `more` (separated by blanks), and the name in `origin`."""
    own = hostname.lower().partition(".")[0]
    proxied = host_of(origin.partition("://")[2])
    return frozenset(("localhost", hostname.lower(), own, f"{own}.local", *more.lower().split(), proxied)) - {""}


def host_of(header: str) -> str:
    """Return the host in a Host header, without port and brackets. Empty if the header is malformed."""
    try:
        found = urlsplit(f"//{header}")
        _ = found.port
    except ValueError:
        return ""
    if found.username is not None or found.path or found.query or found.fragment:
        return ""
    return (found.hostname or "").rstrip(".")


def is_address(host: str) -> bool:
    """Return True if the host is an address, not a name. Another site can make only names point to the robot, so
    addresses are safe from DNS rebinding."""
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def only_here(address: str) -> bool:
    """Return True if only this computer can reach the address."""
    return address == "localhost" or (is_address(address) and ipaddress.ip_address(address).is_loopback)


def _own_host(request: PageRequest, known: frozenset[str], proxied: str) -> bool:
    host = host_of(request.host)
    return is_address(host) or host in known


def _own_site(request: PageRequest, known: frozenset[str], proxied: str) -> bool:
    """Return True also if a person has followed a link of another site to the page itself. The other site can't read
    the answer, and the page does nothing before a person touches it."""
    opens = (request.method, request.path, request.mode, request.dest) == ("GET", "/", "navigate", "document")
    return request.site in SAME or (opens and not request.upgrade)


def _own_origin(request: PageRequest, known: frozenset[str], proxied: str) -> bool:
    if request.origin:
        # Without a proxy `proxied` is empty. It can't match then, because request.origin is not empty here.
        return request.origin.lower() in (f"{request.scheme}://{request.host.lower()}", proxied)
    # A browser always sends the origin when it asks for a websocket. Without one, only plain requests are accepted.
    return not request.upgrade


ROWS: tuple[tuple[str, int, Callable[[PageRequest, frozenset[str], str], bool], str], ...] = (
    ("method", 405, lambda request, known, proxied: request.method in METHODS, "only GET, HEAD and POST are answered"),
    ("host", 421, _own_host, "this robot does not answer to that host name: add it to the setting web.hosts"),
    ("site", 403, _own_site, "a page of another site may not call this one"),
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
"""The checks in their order. Each row has a name, the HTTP status of a refusal, a function that returns True for an
accepted request, and the reason for a refusal."""


def refusal(request: PageRequest, known: frozenset[str], proxied: str = "") -> tuple[int, str] | None:
    """Check a request. Returns the HTTP status and the reason of a refusal, or None. `known`: the robot's host names.
    `proxied`: the page's origin behind a proxy, or ""."""
    for _, status, holds, why in ROWS:
        if not holds(request, known, proxied):
            return status, why
    return None
