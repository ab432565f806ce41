"""Where the supervisor starts, after `failstop run` has become it: the stop is on the wire, the port open, the name
locked."""

from __future__ import annotations

import os

from failstop.procs import rights
from failstop.procs.child import SETTINGS_VARIABLE
from failstop.shm.segment import SUPERVISOR_COMM, AttachError
from failstop.supervisor import main
from failstop.supervisor.events import Events
from failstop.supervisor.journal import Journal, is_stderr
from failstop.supervisor.notify import Notify
from failstop.supervisor.port import OwnPort
from failstop.supervisor.resources import Resources
from failstop.supervisor.settings import Settings


def start(words: dict[str, str]) -> int:
    """Run the service; returns the exit code."""
    rights.name_process(SUPERVISOR_COMM)
    lock, port = int(words["lock"]), int(words["port"])
    for fd in (lock, port):
        os.set_inheritable(fd, False)
    notify = Notify.taken_from(os.environ, os.getpid())
    journal = Journal() if is_stderr(os.environ.pop("JOURNAL_STREAM", "")) else None
    settings = Settings.from_lines(os.environ[SETTINGS_VARIABLE])
    try:
        resources = Resources(words["name"], words["dir"])
    except (AttachError, OSError) as error:
        events = Events(words["name"], journal=journal)
        events.tell("not_started", str(error), {"reason": str(error)})
        events.flush()
        return 1
    try:
        return main.run(resources, OwnPort(port), settings, notify, journal)
    finally:
        resources.remove()
