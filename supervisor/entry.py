"""Where the supervisor starts, after `failstop run` has become it: the stop is on the wire, the port open, the name
locked."""

from __future__ import annotations

import os

from failstop.procs import rights
from failstop.procs.child import SETTINGS_VARIABLE
from failstop.shm.segment import SUPERVISOR_COMM, AttachError
from failstop.supervisor import main
from failstop.supervisor.events import say
from failstop.supervisor.port import OwnPort
from failstop.supervisor.resources import Resources
from failstop.supervisor.settings import Settings


def start(words: dict[str, str]) -> int:
    """Run the service; returns the exit code."""
    rights.name_process(SUPERVISOR_COMM)
    lock, port = int(words["lock"]), int(words["port"])
    for fd in (lock, port):
        os.set_inheritable(fd, False)
    settings = Settings.from_lines(os.environ[SETTINGS_VARIABLE])
    try:
        resources = Resources(words["name"], words["dir"])
    except (AttachError, OSError) as error:
        say(str(error))
        return 1
    try:
        return main.run(resources, OwnPort(port), settings)
    finally:
        resources.remove()
