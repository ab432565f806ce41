"""The page docs/reference/c.md: the C API, from the comments of failstop.h."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
C_HEADER = ROOT / "clients" / "c" / "include" / "failstop.h"
PAGE_HEAD = """# C: reference

Generated from the comments of `failstop.h` (`make docs`). The guide is [c.md](../c.md).
"""
_COMMENT = re.compile(r"/\*\*(?P<words>.*?)\*/|/\* -- (?P<title>[^-]*) -+ \*/|/\*\n(?P<note>.*?)\*/", re.DOTALL)
_FUNCTION = re.compile(r"(?m:^)FS_API (?:FS_MUST_LOOK )?(?P<declared>[^;]*);")
_ENUM = re.compile(r"typedef (?P<kind>enum|struct) (?P<name>\w+) \{(?P<inside>.*?)\n\}", re.DOTALL)
_MEMBER = re.compile(r"(?:/\*\*(?P<words>.*?)\*/\s*)?(?P<declared>[^/;,{}]+)[;,]?", re.DOTALL)


def page() -> str:
    """The page."""
    source = C_HEADER.read_text("utf-8")
    general = _words(_COMMENT.search(source)["words"])  # type: ignore[index]
    return "\n".join((PAGE_HEAD, general, "", *_functions(source), "## Types\n", *_types(source)))


def functions() -> Iterator[str]:
    """The name and the types of each function, without the names of its arguments."""
    for found in _FUNCTION.finditer(C_HEADER.read_text("utf-8")):
        declared = _flat(found["declared"])
        yield re.sub(r"(\w[\w ]*[ *]+)\w+(?=[,)])", lambda part: part[1].strip(), declared)


def members() -> Iterator[str]:
    """Each number of an enum with its value, and each field of a struct with its place and type."""
    for found in _ENUM.finditer(C_HEADER.read_text("utf-8")):
        fields = [_flat(member["declared"]) for member in _MEMBER.finditer(found["inside"])]
        for at, declared in enumerate(filter(None, fields)):
            yield f"{found['name']} {declared}" if found["kind"] == "enum" else f"{found['name']} {at:02} {declared}"


def _functions(source: str) -> Iterator[str]:
    words, titled = "", False
    for found in re.finditer(f"{_COMMENT.pattern}|{_FUNCTION.pattern}", source, re.DOTALL):
        if found["title"]:
            yield f"## {found['title'].strip()}\n"
            titled = True
        elif found["note"] and titled:
            yield f"{_words(found['note'])}\n"
        elif found["words"]:
            words = _words(found["words"])
        elif found["declared"] and titled:
            yield f"### {_name(found['declared'])}\n\n```c\n{_flat(found['declared'])};\n```\n\n{words}\n"


def _types(source: str) -> Iterator[str]:
    for found in _ENUM.finditer(source):
        above = source[: found.start()].rstrip()
        comment = above[above.rindex("/**") + 3 : -2] if above.endswith("*/") else ""
        yield f"### {found['name']}\n\n{_words(comment)}\n\n| | |\n|---|---|"
        for member in _MEMBER.finditer(found["inside"]):
            declared = _flat(member["declared"])
            if declared and not declared.endswith("_"):
                yield f"| `{declared}` | {_words(member['words'] or '').replace(chr(10), ' ')} |"
        yield ""


def _name(declared: str) -> str:
    name: str = re.findall(r"(\w+)\(", declared)[0]
    return name


def _flat(text: str) -> str:
    return " ".join(text.split())


def _words(comment: str) -> str:
    """Its paragraphs, each on one line."""
    lines = [line.strip().removeprefix("*").strip() for line in comment.strip().splitlines()]
    return "\n\n".join(_flat(part) for part in "\n".join(lines).split("\n\n"))
