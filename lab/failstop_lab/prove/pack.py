"""Evidence pack: one page that opens without a network, with the record of a stand test inside it and beside it.

The page is made from the record alone, so the same record is the same page to the byte, and a page that somebody has
changed is no longer that of its record. With a key, OpenSSH signs it (`ssh-keygen -Y sign`).
"""

from __future__ import annotations

import hashlib
import html
import json
import os
import re
import subprocess
from pathlib import Path
from typing import Any

from failstop.api.errors import FailstopError
from failstop.api.words import printable
from failstop.files import durable
from failstop_lab.case.assumptions import ASSUMPTIONS
from failstop_lab.prove import saving

NAMESPACE = "failstop"
"""The purpose that a signature is bound to."""
SIGN = ("-Y", "sign", "-n", NAMESPACE)
SIGNS_S = 60.0
"""How long ssh-keygen may take. It may ask a person for a passphrase."""
LONGEST_PACK = 64_000_000
"""Bytes. The page of no stand test is as long."""
RECORD = re.compile(r'<script type="application/json" id="record">(.*?)</script>', re.DOTALL)
COLUMNS = (
    ("path", "stop path"),
    ("velocity", "velocity"),
    ("verdict", "result"),
    ("written_ms", "written, ms"),
    ("written_bar_ms", "bar, ms"),
    ("acknowledged_ms", "acknowledged, ms"),
    ("rest_s", "at rest, s"),
    ("rest_bar_s", "bar, s"),
    ("latched", "latched"),
)
STYLE = """\
body{font:16px/1.45 system-ui,sans-serif;max-width:62rem;margin:2rem auto;padding:0 1rem;color:#1a1a1a;background:#fff}
h1{font-size:1.6rem;margin:0}h2{font-size:1.1rem;margin:2rem 0 .4rem}
.verdict{display:inline-block;padding:.3rem .8rem;border-radius:.3rem;color:#fff;font-weight:700;background:#b00020}
.PASS .verdict{background:#1b6e3c}.PASS.part .verdict{background:#7a5200}
table{border-collapse:collapse;width:100%;font-size:.88rem}
th,td{text-align:left;padding:.3rem .5rem;border-bottom:1px solid #ddd;vertical-align:top}
td.n{text-align:right;font-variant-numeric:tabular-nums}code{overflow-wrap:anywhere;font-size:.85rem}
.wide{overflow-x:auto}@media print{body{margin:0}}
"""


def code_digest() -> str:
    """SHA-256 of the source of failstop and its laboratory, as they ran, by the names of their modules."""
    import failstop
    import failstop_lab

    digest = hashlib.sha256()
    roots = [Path(package.__file__ or "").resolve().parent for package in (failstop, failstop_lab)]
    found = {
        os.path.relpath(os.path.join(folder, name), root.parent): os.path.join(folder, name)
        for root in roots
        for folder, _, names in os.walk(root, followlinks=True)
        for name in names
        if name.endswith(".py")
    }
    for name, path in sorted(found.items()):
        digest.update(f"{name}\0{len(data := Path(path).read_bytes())}\0".encode() + data)
    return digest.hexdigest()


def canonical(record: dict[str, Any]) -> str:
    """The record as JSON that is the same for the same values."""
    return json.dumps(record, sort_keys=True, separators=(",", ":"))


def page(record: dict[str, Any]) -> str:
    """The whole page of a record."""
    data = canonical(record)
    digest = hashlib.sha256(data.encode()).hexdigest()
    verdict = html.escape(str(record["verdict"]))
    headline = html.escape(_headline(record))
    question = "Does a SIMULATED robot stop?" if record["simulated"] else "Does this robot stop?"
    machine = f"{record['machine']}, {record['cores']} cores, kernel {record['kernel']}, Python {record['python']}"
    facts = [
        ("when", record["begun"]), ("failstop", record["version"]), ("code", record["code_sha256"]),
        ("settings", record["settings_sha256"]), ("machine", machine),
        ("board", f"{record['board']} at {record['device']}{' (SIMULATED)' if record['simulated'] else ''}"),
        ("real-time rights", "yes" if record["realtime"] else "no: the bars are longer"), ("this record", digest),
    ]  # fmt: skip
    parts = [
        '<!doctype html><html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width">',
        f"<title>failstop prove: {headline}</title><style>{STYLE}</style></head>",
        f'<body class="{verdict}{"" if record["complete"] else " part"}"><h1>{question}</h1>',
        f'<p class="verdict">{headline}</p>',
        _paragraphs([record["ended"]] if record["ended"] else []),
        "<table>", *(f"<tr><th>{name}</th><td>{_code(value)}</td></tr>" for name, value in facts), "</table>",
        "<h2>Stopping distance</h2>", _paragraphs(record["distances"]),
        "<h2>Every run</h2><div class=wide><table><tr>", *(f"<th>{head}</th>" for _, head in COLUMNS),
        "<th>why</th></tr>",
        *(_row(row) for row in record["rows"]), "</table></div>",
        "<h2>Not proved here</h2>", _paragraphs([*record["unproved"], record["can_not"]]),
        "<h2>Assumptions</h2><table>",
        *(f"<tr><th>{row.name}</th><td>{html.escape(row.says)}<br>If it is wrong: {html.escape(row.wrong)}</td></tr>"
          for row in ASSUMPTIONS), "</table>",
        "<h2>Settings</h2><table>",
        *(f"<tr><th>{html.escape(key)}</th><td>{html.escape(str(value))}</td></tr>"
          for key, value in sorted(record["settings"].items())), "</table>",
        # A `<` in a text of the record must not end the script.
        '<script type="application/json" id="record">', data.replace("<", "\\u003c"), "</script></body></html>\n",
    ]  # fmt: skip
    return "".join(parts)


def _headline(record: dict[str, Any]) -> str:
    """The verdict, never without what it is about."""
    return ": ".join(filter(None, (str(record["verdict"]), str(record["covers"]))))


def _paragraphs(lines: list[str]) -> str:
    return "".join(f"<p>{html.escape(line)}</p>" for line in lines)


def _code(value: str) -> str:
    text = html.escape(str(value))
    return f"<code>{text}</code>" if re.fullmatch("[0-9a-f]{64}", text) else text


def _row(row: dict[str, Any]) -> str:
    cells = []
    for key, _ in COLUMNS:
        value = row[key]
        text = "-" if value is None else f"{value:.2f}" if isinstance(value, float) else str(value)
        cells.append(f"<td{' class=n' if isinstance(value, float) else ''}>{html.escape(text)}</td>")
    reasons = [row["starved"], *row["wrong"]] if row["verdict"] == "INVALID" else row["wrong"] or [row["skipped"]]
    return f"<tr>{''.join(cells)}<td>{html.escape('; '.join(reasons))}</td></tr>"


def check_place(path: str, key: str | None = None, waits_s: float = SIGNS_S) -> None:
    """Before anything moves: a pack can be written to this path, and signed with this OpenSSH key. Whether it can is
    tried out, which may ask a person for the key's passphrase. Raises FailstopError."""
    folder = os.path.dirname(path) or "."
    if not os.path.isdir(folder):
        raise FailstopError(f"--pack {path}: there is no folder {folder}")
    if why := saving.unwritable(folder):
        raise FailstopError(f"--pack {path}: {why}")
    for file in _files(path):
        try:
            durable.check_replaceable(file)
        except OSError as error:
            raise FailstopError(f"--pack {path}: {file}: {error.strerror}") from None
    if key:
        _openssh([*SIGN, "-f", key], f"--key {key}: nothing can be signed with it", b"failstop", waits_s)


def save(record: dict[str, Any], path: str, key: str | None = None) -> list[str]:
    """Write the page and, beside it, the record; sign the page with an OpenSSH key. Returns the paths. Raises OSError,
    and FailstopError where it can't be signed."""
    page_path, beside, signature = _files(path)
    durable.replace(page_path, page(record).encode())
    durable.replace(beside, f"{canonical(record)}\n".encode())
    if not key:
        return [path, beside]
    Path(signature).unlink(missing_ok=True)
    _openssh([*SIGN, "-f", key, path], f"{path} is written, but can't be signed with {key}")
    return [path, beside, signature]


def _files(path: str) -> tuple[str, str, str]:
    """The page, its record and its signature."""
    return path, f"{os.path.splitext(path)[0]}.json", f"{path}.sig"


def verified(path: str) -> str:
    """Say whether a pack is whole, and whose signature it has. Raises FailstopError for a pack that was changed, or a
    path that is none."""
    data = _read(path)
    found = RECORD.search(data.decode("utf-8", "replace"))
    if not found:
        raise FailstopError(f"{path} is not an evidence pack: it has no record")
    try:
        record = json.loads(found[1])
        # As bytes, because decoding replaces whatever is no UTF-8.
        same = page(record).encode() == data
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise FailstopError(f"{path}: its record can't be read ({printable(str(error))})") from None
    if not same:
        raise FailstopError(
            f"{path} was changed, or was made by another version of failstop: the page does not match its record"
        )
    digest = hashlib.sha256(canonical(record).encode()).hexdigest()
    told = printable(f"{_headline(record)}; {record['begun']}, failstop {record['version']}")
    words = f"{told}\nrecord {digest}: unchanged"
    if not os.path.exists(f"{path}.sig"):
        return f"{words}\nno signature, so anyone may have made this file"
    arguments = ["-Y", "check-novalidate", "-n", NAMESPACE, "-s", f"{path}.sig"]
    return f"{words}\n{_openssh(arguments, f'{path}.sig does not belong to this file', data)}"


def _read(path: str) -> bytes:
    """A pack's bytes. Raises FailstopError for a path that can't be read, is no regular file, or is too long."""
    try:
        with open(durable.open_regular(path), "rb") as file:
            data = file.read(LONGEST_PACK + 1)
    except OSError as error:
        raise FailstopError(f"{path} can't be read: {error.strerror}") from None
    if len(data) > LONGEST_PACK:
        raise FailstopError(f"{path} is not an evidence pack: it has more than {LONGEST_PACK} bytes")
    return data


def _openssh(arguments: list[str], failed: str, data: bytes | None = None, waits_s: float = SIGNS_S) -> str:
    try:
        done = subprocess.run(
            ["ssh-keygen", *arguments], input=data, stdin=None if data else subprocess.DEVNULL, capture_output=True,
            check=False, timeout=waits_s,
        )  # fmt: skip
    except FileNotFoundError:
        raise FailstopError(f"{failed}: ssh-keygen is not installed (package openssh-client)") from None
    except subprocess.TimeoutExpired:
        raise FailstopError(
            f"{failed}: ssh-keygen did not end within {waits_s:g} s; if it asks for a passphrase, answer it in time"
        ) from None
    if done.returncode:
        raise FailstopError(f"{failed}: {_printable(done.stderr or done.stdout)}")
    return _printable(done.stdout)


def _printable(said: bytes) -> str:
    return "\n".join(printable(line) for line in said.decode("utf-8", "replace").strip().splitlines())
