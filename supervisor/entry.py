"""The supervisor's entry point. `failstop run` first opens the port, writes the first stop and locks the instance's
name. Then it becomes the supervisor by exec, in the same process."""

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
    """Run the service until it ends. Returns the exit code."""
    rights.name_process("fs:supervisor")
    # A parent may have left signals ignored or blocked, and exec passes that on. Without SIGCHLD no child can be
    # reaped, and a blocked signal can't end the service. SIGHUP stays ignored if the parent ignores it, because nohup
    # depends on that. SIGCONT is blocked and polled (main.py), because a handler might run too late. A blocked SIGCONT
    # still continues a suspended process.
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
    # Skipped if the service fails. Then every moment counts, and the next run saves the black box's rings.
    code = _serve(supervisor)
    run.remove()
    port.close()  # an exit would wait for a port that does not drain
    return code


def _found(run: Run, port: OwnPort, notify: Notify) -> Supervisor:
    """Create the supervisor of a run, and then publish the run's name. The order matters: clients read the supervisor's
    heartbeat and process table as soon as they find the name. After any error, removes the run and raises the error
    again."""
    try:
        supervisor = Supervisor(run, port, notify)
        run.publish(kept.pack_stop(port.board), supervisor.handover.opener.finder.usb)
    except BaseException:
        run.remove()
        raise
    return supervisor


def _serve(supervisor: Supervisor) -> int:
    """Run the supervisor's loop until SIGTERM or SIGINT comes, or until the service can't go on. Returns the exit
    code."""
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
    """Close all inherited descriptors except stdin, stdout, stderr, the lock and the port. Give the lock and the port
    small numbers, because select() can't use a number above 1023. The supervisor's children don't inherit the lock, and
    inherit the port only if the supervisor passes it on. The lock stays open until this process ends. Returns the
    port's new number."""
    with contextlib.suppress(OSError):  # without /proc they stay open
        for fd in set(map(int, os.listdir("/proc/self/fd"))) - {0, 1, 2, lock, port}:
            with contextlib.suppress(OSError):  # the descriptor of the listing itself
                os.close(fd)
    for fd in (lock, port):
        found = os.dup(fd)
        os.close(fd)
    return found
