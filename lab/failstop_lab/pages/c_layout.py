"""The C library's view of shared memory and its table of causes (clients/c/src/layout.h), made from the declarations
that the service itself runs by."""

from __future__ import annotations

import json
import re
import struct

from failstop.files import instance
from failstop.messages import box, layout, packing, records, segments
from failstop.messages.records import Shape
from failstop.policy import causes, kinematics, layouts, proofs
from failstop.policy.settings import FIRST_SOURCE
from failstop.shm import cell
from failstop.shm.segment import HEADER_BYTES
from failstop.shm.words import LINE_BYTES

C_FIELDS: dict[str, tuple[Shape, tuple[str, ...]]] = {
    "LATCH": (records.LATCH, ("epoch", "noticed_ns", "raised_ns")),
    "PORT": (records.PORT, ("number", "since_ns", "state")),
    "REPLY": (records.REPLY, ("session", "number", "done", "refused_for")),
    "IMU": (records.IMU, ("acceleration", "", "", "rate", "", "")),
    "WHEELS": (
        records.WHEELS_SEEN,
        ("does", "by", "unexpected", "count", "since_ns", "read_ns", "rps", "", "", "", "turns", "", "", ""),
    ),
    "BATTERY": (records.BATTERY, ("mv", "plugged")),
    "ODOMETRY": (records.ODOMETRY, ("pose", "", "", "twist", "", "", "std", "", "source", *("",) * 6)),
    "HELLO": (records.HELLO, ("session", "pid", "namespace")),
    "COMMAND": (records.COMMAND, ("session", "vx", "vy", "wz", "flags")),
    "ASSERTED": (records.ASSERTED, ("session",)),
    "REQUEST": (records.REQUEST, ("session", "number", "verb")),
    "SEEN": (records.SEEN, ("session", "epoch")),
    "SAID": (records.SAID, ("session",)),
}
"""The names of each shape's numbers, in order; the empty ones are reached from the one before."""
C_NUMBERS: dict[str, int] = {
    "HEADER_BYTES": HEADER_BYTES,
    "CELL_HEADER_BYTES": cell.CELL_HEADER_BYTES,
    "LINE_BYTES": LINE_BYTES,
    "CLIENT_SLOTS": layout.CLIENT_SLOTS,
    "RUN_DIGITS": instance.RUN_DIGITS,
    "ASKED_BYTES": records.ASKED_BYTES,
    "WHO_BYTES": records.WHO_BYTES,
    "BY_HAND": records.BY_HAND,
    "SOURCE_BYTES": records.SOURCE_BYTES,
    "HELD_BYTES": records.HELD_BYTES,
    "SAID_BYTES": records.SAID_BYTES,
    "GOODBYES": records.GOODBYES,
    "MOST_WHEELS": records.MOST_WHEELS,
    "MOST_SPEEDS": box.MOST_SPEEDS,
    "VERB_ENABLE": records.ENABLE,
    "VERB_DISABLE": records.DISABLE,
    "VERB_RESET": records.RESET,
    "REPLY_REFUSED": records.REFUSED,
    "REPLY_DONE": records.DONE,
    "REPLY_UNDER_WAY": records.UNDER_WAY,
    "FOR_THE_LATCH": records.FOR_THE_LATCH,
    "PORT_OPEN": records.PORT_OPEN,
    "WHEELS_STILL": records.WHEELS_DO.index("still"),
    "WHEELS_TURNING": records.WHEELS_DO.index("turning"),
    "BY_ROLLING": records.BY_ROLLING,
    "CAUSE_NUMBER_BYTES": causes.NUMBER_BYTES,
    "CAUSE_DIED": causes.DIED.number,
    "CAUSE_SILENT": causes.SILENT.number,
    "CAUSE_UNKNOWN": causes.UNKNOWN.number,
    "ANSWER_WITHIN_NS": records.ANSWER_WITHIN_NS,
    "OLD_READING_NS": records.OLD_READING_NS,
}
C_TEXTS: dict[str, str] = {
    "MAGIC": segments.MAGIC.decode(),
    "SHM": segments.SHM,
    "SUPERVISOR": layout.SUPERVISOR,
    "PORT_OWNER": layout.PORT_OWNER,
    "GATE": layout.GATE,
    "TELEMETRY": layout.TELEMETRY,
    "DEFAULT_NAME": instance.DEFAULT_NAME,
    "FIRST_SOURCE": FIRST_SOURCE,
    "LEFT_OUT": records.LEFT_OUT.decode(),
    "CAUSE_MARK": records.CAUSE,
    "BETWEEN": causes.BETWEEN,
    "NEXT_STEP": packing.NEXT_STEP,
    "BLOCK_LATCHED": box.LATCHED,
    "BLOCK_DISABLED": box.DISABLED,
    "BLOCK_HELD": box.HELD,
    "BLOCK_NO_COMMAND": box.NO_COMMAND,
    "BLOCK_NO_SCAN": box.NO_SCAN,
    "ACKERMANN": layouts.ACKERMANN,
}
LINKS = (
    proofs.LINK_UNPROVEN,
    proofs.LINK_ALIVE,
    proofs.LINK_DEAF,
    proofs.LINK_UNHEARD,
    proofs.LINK_UNASKED,
    proofs.LINK_SILENT,
)
"""In the order of `fs_link` in failstop.h, whose numbers never change."""


def _fields(form: str, names: tuple[str, ...]) -> dict[str, int]:
    """Where each named number is. Raises ValueError if they are not as many as the form has."""
    codes = [code for count, code in re.findall(r"(\d*)([A-Za-z?])", form) for _ in range(int(count or 1))]
    if len(codes) != len(names):
        raise ValueError(f"{form}: {len(codes)} numbers and {len(names)} names")
    return {name: struct.calcsize("<" + "".join(codes[:at])) for at, name in enumerate(names) if name}


def _quoted(text: str) -> str:
    """A C string of plain ASCII. Raises ValueError for a text that is not."""
    if not text.isascii():
        raise ValueError(f"not ASCII: {text!r}")
    return json.dumps(text).replace("\\u001f", "\\037")


def _define(name: str, value: object) -> str:
    return f"#define {name} {value}"


def _records() -> list[str]:
    lines = []
    for name, used in layout.OF_LIBRARY.items():
        spec, short = layout.SEGMENT_BY_NAME[name], name.partition(".")[0].upper()
        for record in used:
            declared = spec.records[record]
            if record.startswith("reply.") and record != "reply.0":
                continue
            of = f"{short}_{record.partition('.')[0].upper()}"
            lines.append(_define(f"AT_{of}", spec.offsets[record]))
            if declared.kind == "latest":
                lines.append(_define(f"CAP_{of}", declared.capacity))
                lines.append(_define(f"NAME_{of}", _quoted(f"{name}.{record}")))
    gate = layout.SEGMENT_BY_NAME[layout.GATE]
    lines.append(_define("REPLY_STRIDE", gate.offsets["reply.1"] - gate.offsets["reply.0"]))
    for name, (shape, names) in C_FIELDS.items():
        lines += [_define(f"F_{name}_{field.upper()}", at) for field, at in _fields(shape.form, names).items()]
        lines.append(_define(f"N_{name}", struct.calcsize(shape.form)))
    header = ("magic", "layout", "size", "incarnation", "name", "client", "version")
    form = segments.SEGMENT_HEADER.format
    at = 0
    for field, code in zip(header, re.findall(r"\d*[A-Za-z]", form), strict=True):
        lines.append(_define(f"F_HEADER_{field.upper()}", at))
        at += struct.calcsize(f"<{code}")
    lines.append(_define("N_HEADER", at))
    return lines


def _remedy(kind: causes.Kind) -> str:
    """What to do first, without the names of a case, which only Python works out."""
    return kind.first().format_map(dict.fromkeys(causes.ADVISED, "all but one of them"))


def _causes() -> list[str]:
    rows = (
        f"    {{{kind.number}, {_quoted(kind.name)},\n     {_quoted(kind.template)},\n     {_quoted(_remedy(kind))}}},"
        for kind in sorted(causes.BY_NUMBER.values(), key=lambda kind: kind.number)
    )
    return ["#define CAUSES \\", *(f"{line} \\" for row in rows for line in row.split("\n")), ""]


def _wheels() -> list[str]:
    """Names of the wheels for each number of them, and the axes that each layout can follow."""
    names = (
        f"    {{{count}, {{{', '.join(_quoted(name.replace(' ', '_')) for name in names)}}}}}, \\"
        for count, names in layouts.WHEEL_NAMES.items()
    )
    axes = (
        f"    {{{_quoted(name)}, {{{', '.join(map(repr, factors))}}}}}, \\" for name, factors in kinematics.AXES.items()
    )
    return ["#define WHEEL_NAMES \\", *names, "", "#define AXES \\", *axes, ""]


def text() -> str:
    """The whole file."""
    lines = [
        "/* Made from the service's own declarations by `make docs` (lab/failstop_lab/pages/c_layout.py). */",
        "#ifndef FS_LAYOUT_H",
        "#define FS_LAYOUT_H",
        "",
        _define("CLIENT_HASH", f"UINT64_C({layout.CLIENT_HASH:#018x})"),
        *(_define(name, value) for name, value in C_NUMBERS.items()),
        *(_define(f"TEXT_{name}", _quoted(value)) for name, value in C_TEXTS.items()),
        _define("LINKS", ", ".join(map(_quoted, LINKS))),
        "",
        "/* AT_: where a record begins in its segment; CAP_: the most bytes of its payload; NAME_: what seeds its CRC.",
        " * F_: where a number is in a payload; N_: the bytes of all its numbers. */",
        *_records(),
        "",
        *_wheels(),
        "/* Number, name, text, what to do first. In a text, braces hold an argument, and what is in brackets is left",
        " * out when its arguments are empty. */",
        *_causes(),
        "#endif",
    ]
    return "\n".join(lines) + "\n"
