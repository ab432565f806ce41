"""Packing in a process that gets no more memory."""

from __future__ import annotations

import re
import subprocess
import sys

PROGRAM = """
import resource
import msgpack
from failstop.messages.packing import Note
note = Note("disk", "x" * 200, {"process": "telemetry", "reason": "y" * 100})
with open("/proc/self/statm") as file:
    pages = int(file.read().split()[0])
resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize(),) * 2)
#
print(len(note.pack()))
"""


def last_line(program: str) -> str:
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=20, check=False)
    return (done.stdout + done.stderr).strip().splitlines()[-1]


def test_a_remark_needs_no_memory_that_is_not_there() -> None:
    assert 300 < int(last_line(PROGRAM)) < 500
    by_packb = PROGRAM.replace("#\n", "msgpack.packb('x')\n")
    # Python 3.14 may lack the memory even to say it.
    assert re.match("MemoryError|lost sys.stderr$", last_line(by_packb)), "what is avoided"
