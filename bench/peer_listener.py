"""supervisord's event listener: it has the port open all the time and writes the stop burst when the driver exited.

The most favourable form of such a listener: nothing is started, opened or imported between the event and the bytes.
"""

from __future__ import annotations

import os
import sys

from failstop.board.port import open_port
from failstop.board.rrc.board import RRC_PORT
from failstop.board.rrc.burst import BURST


def main(link: str, ready: str) -> int:
    """Serve events until supervisord closes the pipe; the file `ready` is made when the port is open."""
    port = open_port(link, exclusive=False, line=RRC_PORT)
    with open(ready, "w", encoding="ascii"):
        pass
    while True:
        print("READY", flush=True)
        line = sys.stdin.readline()
        if not line:
            return 0
        headers = dict(word.split(":", 1) for word in line.split())
        payload = sys.stdin.read(int(headers["len"]))
        if "processname:driver" in payload.split():
            os.write(port, BURST)
        print("RESULT 2\nOK", end="", flush=True)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
