"""Assets: the page's files. The first answer holds all that it needs to be painted and to stop: on a slow phone a
second request takes half a second."""

from __future__ import annotations

import base64
import gzip
import hashlib
from pathlib import Path

FOLDER = Path(__file__).parent / "page"
TYPES = {".html": "text/html; charset=utf-8", ".js": "text/javascript; charset=utf-8", ".svg": "image/svg+xml"}
STYLE = "/*style*/"
SCRIPT = "/*script*/"
INDEX = "/"


def load() -> dict[str, tuple[bytes, bytes, str, str]]:
    """(content, the same compressed, type, what its Content-Security-Policy adds) by path; the style and the first
    script stand in the page itself, and the policy names them by their hashes."""
    style, script = (_text(name) for name in ("page.css", "stop.js"))
    page = _text("page.html").replace(STYLE, style).replace(SCRIPT, script)
    more = f"style-src {_hash(style)}; script-src 'self' {_hash(script)}"
    found = {INDEX: (page.encode(), _small(page.encode()), TYPES[".html"], more)}
    for path in sorted(FOLDER.iterdir()):
        if path.suffix in TYPES and path.name not in ("page.html", "stop.js"):
            content = path.read_bytes()
            found[f"/{path.name}"] = content, _small(content), TYPES[path.suffix], ""
    return found


def policy(given: str, more: str) -> str:
    """A Content-Security-Policy with some of its directives changed."""
    rows = dict(row.strip().partition(" ")[::2] for row in given.split(";"))
    rows |= dict(row.strip().partition(" ")[::2] for row in more.split(";") if row)
    return "; ".join(f"{name} {value}" for name, value in rows.items())


def _small(content: bytes) -> bytes:
    return gzip.compress(content, mtime=0)


def _text(name: str) -> str:
    return (FOLDER / name).read_text("utf-8")


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
