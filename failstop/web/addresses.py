"""Addresses: where a phone finds the page, as text and as a QR code. The QR code also contains the pairing code."""

from __future__ import annotations

import io
import socket
from typing import Any

HERE = ("127.", "::1", "fe80")
EVERYWHERE = ("0.0.0.0", "::", "")
QUIET = 1
"""The margin around a QR code, in squares of the code. A small margin is enough, because a terminal has a margin
too."""


def own_addresses() -> list[str]:
    """Return the network addresses of this computer, IPv4 first, without loopback and link-local IPv6."""
    import psutil

    rows = [row for each in psutil.net_if_addrs().values() for row in each]
    found = [row.address for row in rows if row.family in (socket.AF_INET, socket.AF_INET6)]
    return sorted(
        (address for address in found if not address.startswith(HERE)),
        key=lambda address: (":" in address, address),
    )


def urls(found: dict[str, Any]) -> list[str]:
    """Return the addresses at which a phone finds the page, the best one first. Behind a proxy, this is only the
    proxy's address. `found`: the result of Page.addresses()."""
    return [f"{found['origin']}/"] if found["origin"] else listening(found)


def listening(found: dict[str, Any]) -> list[str]:
    """Return the addresses at which the page itself listens, for phones or for a proxy. `found` is the result of
    Page.addresses()."""
    hosts = [found["address"]]
    if found["address"] in EVERYWHERE:
        own = socket.gethostname().partition(".")[0]
        hosts = [*own_addresses(), f"{own}.local"]
    return [f"{found['scheme']}://{f'[{host}]' if ':' in host else host}:{found['port']}/" for host in hosts]


def link(url: str, code: str) -> str:
    """Return the text of the QR code: the page's address, then # and the pairing code. A browser never sends the part
    after # over the network."""
    return f"{url}#{code}"


def terminal_text(found: dict[str, Any]) -> str:
    """Return the text that `failstop web pair` prints: the QR code, the pairing code, and the page's addresses. With
    HTTPS, it also has the certificate's fingerprint."""
    places = urls(found)
    parts = []
    if picture := qr(link(places[0], found["code"])):
        parts.append(picture)
    parts.append(f"code  {found['code']}   (once, for two minutes)")
    parts += [f"page  {place}" for place in places]
    if found["fingerprint"]:
        parts.append(
            "The browser warns about the certificate, because the robot made it itself. Go on only if it shows "
            "this SHA-256:"
        )
        half = len(found["fingerprint"]) // 2 + 1
        parts += [f"  {found['fingerprint'][:half]}", f"  {found['fingerprint'][half:]}"]
    return "\n".join(parts)


def qr(text: str) -> str:
    """Return the QR code as block characters for a terminal. Empty if segno is not installed."""
    try:
        import segno
    except ImportError:
        return ""
    out = io.StringIO()
    segno.make(text, error="m", micro=False).terminal(out, compact=True, border=QUIET)
    return out.getvalue().rstrip("\n")
