"""The supervisor's entry point. The supervisor replaces `failstop run` in the same process, and by then the stop is
written, the port is open and the name is locked."""

from __future__ import annotations

import contextlib
import os
import signal

from failstop.board import kept
from failstop.board.kinds import board_of
from failstop.files.instance import InstanceError
from failstop.messages.segments import AttachError
from failstop.notify import Notify, Outbox
from failstop.policy import scale
from failstop.policy.settings import SETTINGS_VARIABLE, Settings
from failstop.procs import rights
from failstop.supervisor.events import JOURNAL, Events, is_journal
from failstop.supervisor.main import Supervisor
from failstop.supervisor.port_handover import OwnPort
from failstop.supervisor.run import Run


def start(words: dict[str, str]) -> int:
    """Run the service; returns the exit code."""
    rights.name_process("fs:supervisor")
    # A parent may have left signals ignored or blocked, and exec passes that on. Without SIGCHLD no child can be
    # reaped, and a blocked signal can't end the service. SIGHUP stays ignored if it is, because a user of nohup wants
    # that. SIGCONT is blocked and polled (main.py), because a handler might run too late; it continues the process
    # even so.
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_SETMASK, (signal.SIGCONT,))
    settings = Settings.from_lines(os.environ[SETTINGS_VARIABLE])
    fd = _keep_descriptors(int(words["lock"]), int(words["port"]))
    board = board_of(*settings.board(), tried=True)
    settings = scale.capped(settings, assumed=board.scale_assumed)
    port = OwnPort(fd, board, settings.servos())
    notify = Notify.from_environment(os.environ, os.getpid())
    journal = Outbox(JOURNAL) if is_journal(os.environ.pop("JOURNAL_STREAM", "")) else None
    try:
        run = Run(settings, words["name"], words["dir"], journal, words["again"])
        supervisor = _found(run, port, notify)
    except (AttachError, InstanceError, OSError) as error:
        events = Events(words["name"], journal=journal)
        events.log("not_started", str(error), {"reason": str(error)})
        events.flush()
        port.drain()
        port.close()
        return 1
    # Skipped if the service fails: then every moment counts, and the next run saves the rings that are left.
    code = _serve(supervisor)
    run.remove()
    port.close()  # an exit would wait for a port that does not drain
    return code


def _found(run: Run, port: OwnPort, notify: Notify) -> Supervisor:
    """Create the supervisor of a run, then publish the run's name. The heartbeat and the process table come first,
    because a client reads them as soon as it finds the name. Raises whatever Run raises, and leaves nothing behind."""
    try:
        supervisor = Supervisor(run, port, notify)
        run.publish(kept.pack_stop(port.board))
    except BaseException:
        run.remove()
        raise
    return supervisor


def _serve(supervisor: Supervisor) -> int:
    """Serve until SIGTERM or SIGINT, or until it can't go on; returns the exit code."""
    supervisor.handover.opener.begin()
    signal.signal(signal.SIGTERM, supervisor.end)
    signal.signal(signal.SIGINT, supervisor.end)
    for child in supervisor.children:
        supervisor.processes.start(child)
    supervisor.blackbox.begin()
    rights.settle(rights.SUPERVISOR_LOOP_US)
    ready: dict[int, int] = {}
    while not supervisor.ending:
        supervisor.turn(ready)
        ready = supervisor.rest()
    well = supervisor.finish()
    return int(supervisor.broken or not well)


def _keep_descriptors(lock: int, port: int) -> int:
    """Close all other inherited descriptors, and move these two to small numbers, because select() can't use numbers
    from 1024 on. Children inherit neither of them. The lock stays open for the life of this process; returns the new
    number of the port."""
    with contextlib.suppress(OSError):  # without /proc they stay open
        for fd in set(map(int, os.listdir("/proc/self/fd"))) - {0, 1, 2, lock, port}:
            with contextlib.suppress(OSError):  # the descriptor of the listing itself
                os.close(fd)
    for fd in (lock, port):
        found = os.dup(fd)
        os.close(fd)
    return found
