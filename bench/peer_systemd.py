"""systemd as a peer: a service whose ExecStopPost runs the stop tool, under a systemd of its own."""

from __future__ import annotations

import contextlib
import os
import tempfile
from pathlib import Path

from bench import installed
from bench.container import Bind, Container, ContainerMissing
from bench.peer import PeerMissing
from failstop_lab.trial import wait_for

UNIT = "driver.service"
PORT = "/board"
SERVICE = """
[Unit]
StartLimitIntervalSec=0
[Service]
Type=exec
WorkingDirectory={prefix}/src
ExecStart={prefix}/bin/python3 -m bench.peer_driver {link}
ExecStopPost={prefix}/bin/failstop stop --device {link}
"""
END_S = 10.0


class Systemd:
    """A systemd of its own. Raises PeerMissing when there can be none here."""

    label = "systemd, ExecStopPost runs `failstop stop`"

    def __init__(self, link: str) -> None:
        where, name = os.path.split(link)
        service = SERVICE.format(prefix=installed.PREFIX, link=f"{PORT}/{name}")
        with contextlib.ExitStack() as stack:
            directory = stack.enter_context(tempfile.TemporaryDirectory(prefix="failstop-peer-"))
            binds = [*installed.lay_out(Path(directory)), Bind(where, PORT)]
            try:
                self._box = stack.enter_context(Container({UNIT: service}, binds))
            except ContainerMissing as missing:
                raise PeerMissing(str(missing)) from None
            self._stack = stack.pop_all()

    def start(self) -> int:
        """Have the driver's service started; returns its pid out here."""
        self._box.ctl("start", UNIT)
        return self._box.pids(UNIT)[0]

    def settle(self) -> None:
        """Wait for the stop tool to be through."""
        wait_for("the driver's service to end", lambda: not self._box.pids(UNIT), END_S)

    def close(self) -> None:
        """Kill the container."""
        self._stack.close()
