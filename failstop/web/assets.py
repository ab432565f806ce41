"""Assets: the page's files. The first answer holds everything that the page needs to be shown and to stop the robot,
because on a slow phone a second request takes half a second."""

from __future__ import annotations

import base64
import gzip
import hashlib
from pathlib import Path

FOLDER = Path(__file__).parent / "page"
TYPES = {".html": "text/html; charset=utf-8", ".js": "text/javascript; charset=utf-8", ".svg": "image/svg+xml"}
WITHIN = {"stop.css": "style-src", "stop.js": "script-src 'self'", "page.css": "style-src"}
"""Files that are put into the page itself, in place of comments with their names, each with the directive of the
Content-Security-Policy that allows it."""
INDEX = "/"


def load() -> dict[str, tuple[bytes, bytes, str, str]]:
    """Every file by its path: (content, the same compressed, type, what its Content-Security-Policy adds). The policy
    names the parts within the page by their hashes."""
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
    """A Content-Security-Policy in which some directives are replaced."""
    rows = dict(row.strip().partition(" ")[::2] for row in given.split(";"))
    rows |= dict(row.strip().partition(" ")[::2] for row in more.split(";") if row)
    return "; ".join(f"{name} {value}" for name, value in rows.items())


def _small(content: bytes) -> bytes:
    return gzip.compress(content, mtime=0)


def _text(name: str) -> str:
    return (FOLDER / name).read_text("utf-8")


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
