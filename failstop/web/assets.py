"""Assets: the page's files. The first response contains all that the browser needs to show the page and to stop the
robot, because a second request takes half a second on a slow phone."""

from __future__ import annotations

import base64
import gzip
import hashlib
from pathlib import Path

FOLDER = Path(__file__).parent / "page"
TYPES = {".html": "text/html; charset=utf-8", ".js": "text/javascript; charset=utf-8", ".svg": "image/svg+xml"}
WITHIN = {"stop.css": "style-src", "stop.js": "script-src 'self'", "page.css": "style-src"}
"""The files whose text is put into page.html, in place of a comment with the file's name. The value is the directive of
the Content-Security-Policy that allows this text."""
INDEX = "/"


def load() -> dict[str, tuple[bytes, bytes, str, str]]:
    """Return the files by path, each as (content, gzip-compressed content, content type, additions to the
    Content-Security-Policy). The additions allow the styles and scripts inside the page, by their hashes."""
    page, allowed = _text("page.html"), dict[str, str]()
    for name, directive in WITHIN.items():
        text = _text(name)
        page = page.replace(f"/*{name}*/", text)
        allowed[directive] = f"{allowed.get(directive, directive)} {_hash(text)}"
    found = {INDEX: (page.encode(), _small(page.encode()), TYPES[".html"], "; ".join(allowed.values()))}
    for path in sorted(FOLDER.iterdir()):
        if path.suffix in TYPES and path.name not in ("page.html", *WITHIN):
            content = path.read_bytes()
            found[f"/{path.name}"] = content, _small(content), TYPES[path.suffix], ""
    return found


def policy(given: str, more: str) -> str:
    """Combine two Content-Security-Policies. A directive in `more` replaces the directive with the same name."""
    rows = dict(row.strip().partition(" ")[::2] for row in given.split(";"))
    rows |= dict(row.strip().partition(" ")[::2] for row in more.split(";") if row)
    return "; ".join(f"{name} {value}" for name, value in rows.items())


def _small(content: bytes) -> bytes:
    return gzip.compress(content, mtime=0)


def _text(name: str) -> str:
    return (FOLDER / name).read_text("utf-8")


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
