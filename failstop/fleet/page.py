"""Page: the tables of docs/fleet.md that are made from the code. `python -m failstop.fleet.page docs/fleet.md` renews
them.
"""

from __future__ import annotations

import sys
from pathlib import Path

from failstop.fleet import metrics, settings


def tables() -> dict[str, list[str]]:
    """By the name in the page's marks."""
    return {"metrics": metrics.markdown(), "settings": settings.markdown()}


def renewed(page: str) -> str:
    """The page with its tables as they are now. Raises ValueError for a page without their marks."""
    for name, lines in tables().items():
        begin, end = f"<!-- {name}: generated -->\n", f"<!-- end of {name} -->\n"
        head, found, rest = page.partition(begin)
        _, also, tail = rest.partition(end)
        if not (found and also):
            raise ValueError(f"no marks of the table {name!r}")
        page = head + begin + "\n".join(lines) + "\n" + end + tail
    return page


if __name__ == "__main__":
    path = Path(sys.argv[1])
    path.write_text(renewed(path.read_text("utf-8")), "utf-8")
