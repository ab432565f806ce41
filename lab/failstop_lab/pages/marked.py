"""Marked: a page of which a part is made from the code, between two marks."""

from __future__ import annotations


def renewed(page: str, name: str, text: str) -> str:
    """The page with this text between the marks of that name. Raises ValueError for a page without them."""
    begin, end = f"<!-- {name}: generated -->\n", f"<!-- end of {name} -->\n"
    head, found, rest = page.partition(begin)
    _, also, tail = rest.partition(end)
    if not (found and also):
        raise ValueError(f"no marks of the part {name!r}")
    return f"{head}{begin}{text}\n{end}{tail}"
