"""supervisord as a peer: it starts the driver, and tells a resident event listener when that has exited.

Its loop (4.3.0) looks for events to pass on before it reaps, and then waits up to 1 s for something to read: it is the
output of its other programs that decides how late the listener hears of a death. With 100 lines a second it is some
7 ms, unless the wait is long all the same; with the 10 of BusySupervisord some 70 ms.
"""

from __future__ import annotations

import importlib.metadata
import os
import subprocess
import sys
import tempfile

from bench.peer import ROOT, PeerMissing
from failstop_lab.trial import wait_for

CONFIG = """
[supervisord]
nodaemon = true
logfile = {dir}/supervisord.log
pidfile = {dir}/supervisord.pid
childlogdir = {dir}
[unix_http_server]
file = {dir}/socket
[rpcinterface:supervisor]
supervisor.rpcinterface_factory = supervisor.rpcinterface:make_main_rpcinterface
[supervisorctl]
serverurl = unix://{dir}/socket
[program:driver]
command = {python} -m bench.peer_driver {link}
directory = {root}
autostart = false
autorestart = false
startsecs = 0
[eventlistener:stopper]
command = {python} -m bench.peer_listener {link} {dir}/ready
directory = {root}
events = PROCESS_STATE_EXITED
"""
LOGGER = """
[program:logger]
command = {python} -u -c "import time; [(print('line'), time.sleep(0.1)) for _ in iter(int, 1)]"
startsecs = 0
stdout_logfile = NONE
"""
"""Another program that logs 10 lines a second."""
END_S = 15.0
"""supervisord gives its children 10 s."""


class Supervisord:
    """A supervisord of its own, in a directory of its own. Raises PeerMissing when it is not installed."""

    label = "supervisord, a resident listener writes the stop (the most favourable listener)"
    config = CONFIG

    def __init__(self, link: str) -> None:
        try:
            # Not by its import name: in a checkout that is this project's own folder.
            importlib.metadata.version("supervisor")
        except importlib.metadata.PackageNotFoundError:
            raise PeerMissing("supervisor is not installed: pip install supervisor") from None
        self._directory = tempfile.TemporaryDirectory(prefix="failstop-peer-")
        self._config = os.path.join(self._directory.name, "supervisord.conf")
        with open(self._config, "w", encoding="utf-8") as file:
            file.write(self.config.format(root=ROOT, dir=self._directory.name, python=sys.executable, link=link))
        self._process = subprocess.Popen(
            [sys.executable, "-m", "supervisor.supervisord", "-c", self._config],
            cwd=self._directory.name,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            ready = os.path.join(self._directory.name, "ready")
            wait_for("supervisord's listener to have the port open", lambda: os.path.exists(ready))
        except BaseException:
            self.close()
            raise

    def _control(self, *words: str) -> str:
        command = [sys.executable, "-m", "supervisor.supervisorctl", "-c", self._config, *words]
        found = subprocess.run(
            command, cwd=self._directory.name, check=True, capture_output=True, text=True, timeout=END_S
        )
        return found.stdout

    def start(self) -> int:
        """Have the driver started; returns its pid."""
        self._control("start", "driver")
        return int(self._control("pid", "driver"))

    def settle(self) -> None:
        """Nothing is left to wait for: the listener is ready again."""

    def close(self) -> None:
        """End supervisord, and the driver and the listener with it."""
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(END_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._directory.cleanup()


class BusySupervisord(Supervisord):
    """Its times beside a program that logs."""

    label = Supervisord.label + ", beside a program that logs 10 lines a second"
    config = CONFIG + LOGGER
