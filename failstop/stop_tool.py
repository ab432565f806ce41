"""The stop tool: stops the robot when no service is running. It opens the port and writes the stop burst itself. When
the service ends, it first kills the processes that are left of it.

systemd runs this tool (ExecStopPost) at `systemctl stop`, at a restart, and when its watchdog fires. Workers that are
still alive hold the port (TIOCEXCL), and could write to it after the stop. The tool finds these workers in /proc by
their control group. The control group's own files are not used, because their place differs between machines.
"""

from __future__ import annotations

# The C module under `signal`, because importing `signal` would also import enum.
import _signal
import contextlib
import os
import select
import time

from failstop.board.interface import SUPERVISOR_ROW
from failstop.board.port import PortError, close_port, has_lines, is_read, open_port
from failstop.board.stop_port import StopPort

RETRY_S = 0.02
WARN_S = 1.0
OLDER_S = 0.05
"""An answer that comes within this time, in seconds, answers an earlier question, so it is ignored."""
_SIGKILL = 9

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from failstop.board.interface import Board


def stop(
    write_once: Callable[[], bool],
    wait: Callable[[PortError], float],
    say: Callable[[str], None],
    otherwise: Callable[[PortError], bool] = lambda _: False,
) -> tuple[float, bool]:
    """Call `write_once`, which writes the stop burst by write(), and try again until it works or the time is over.
    Returns (how many seconds that took, what write() returned; False if it was `otherwise` that worked). Raises the
    last PortError.

    `wait` returns for how many seconds to try, and is called only after the first failure, because it may have to read
    a file. `otherwise` is called after each failure, and returns True if a stop was sent in another way. Then nothing
    more is written. `say` prints a text.
    """
    start_s = time.monotonic()
    wait_s = -1.0
    warned = False
    while True:
        waited_s = time.monotonic() - start_s
        try:
            held = write_once()
        except PortError as error:
            if otherwise(error):
                return waited_s, False
            wait_s = wait(error) if wait_s < 0 else wait_s
            if waited_s >= wait_s:
                raise
            if waited_s >= WARN_S and not warned:
                warned = True
                say(f"{error}; trying for {wait_s:g} s")
            time.sleep(RETRY_S)
        else:
            return waited_s, held


def write(path: str, board: Board, servos: tuple[int, ...] = (), *, named_by: int = 0) -> bool:
    """Write the whole stop burst to the port, and then the frames that stop an arm with these servos. Waits until the
    bytes have left the kernel. The port is not opened exclusively. Returns True if a service has the port. It has not
    heard of the stop, so it may write motion again. `named_by`: as for open_port(). Raises PortError."""
    stop_port = StopPort(open_port(path, exclusive=False, line=board.port, named_by=named_by), board, servos)
    try:
        stop_port.burst()
        stop_port.repeat(board.repeats_ns[SUPERVISOR_ROW])
        if not stop_port.drain():
            gone = f"went away while writing ({os.strerror(stop_port.errno)})"
            why = gone if stop_port.lost else "takes no bytes: use the POWER SWITCH"
            raise PortError("io", f"{path} {why}", stop_port.errno)
        return is_read(stop_port.fd)
    finally:
        stop_port.close()


def answered(path: str, board: Board, *, patient: bool, named_by: int = 0) -> bool | None:
    """After a stop, find out if the board still answers. Returns None if this kind of board never answers, or if a
    service reads the port. `patient`: ask a silent board again after a wait, because opening the port resets some
    boards. `named_by`: as for open_port(). Never raises."""
    if not (board.pings or board.echo_ns):
        return None
    # Imported only here, because the stop itself needs neither.
    from failstop.board import asking
    from failstop.board.tap import Tap

    try:
        fd = open_port(path, exclusive=False, line=board.port, named_by=named_by)
    except PortError:
        return False
    try:
        if is_read(fd):
            return None
        tap = Tap(fd, board)
        time.sleep(OLDER_S)
        tap.read()
        if asking.ask(tap, board, stop=False) is not None:
            return True
        if not (patient and board.port.deaf_ns and has_lines(fd)):
            return False
        time.sleep(board.port.deaf_ns / 1e9)
        tap.lost()
        return asking.ask(tap, board, stop=True) is not None
    except OSError:
        return False
    finally:
        close_port(fd)


def of_a_service(proc: str = "/proc") -> bool:
    """True if this process is in the control group of a systemd service. It is False, for example, in a login session.
    Raises OSError."""
    return any(line.endswith(b".service") for line in _group(proc, "self"))


def kill_rest(timeout_s: float, proc: str = "/proc") -> tuple[int, int]:
    """Kill (SIGKILL) all other processes of this process's control group, until none is left or `timeout_s` is over.
    Returns how many processes were found, and how many have not ended. A process of another user may not be killable.
    `proc`: the folder that lists the processes. Raises OSError if this process's own control group can't be read."""
    group = _group(proc, "self")
    until_s = time.monotonic() + timeout_s
    killed: set[int] = set()
    left = 0
    # Repeat it, because one of the processes may just have started another.
    while not left and (found := _others(proc, group)):
        try:
            for fd in found.values():
                # Another user's process can't be killed. It will not end, so the result reports it.
                with contextlib.suppress(OSError):
                    _signal.pidfd_send_signal(fd, _SIGKILL)
            killed.update(found)
            left = _wait(found.values(), until_s)
        finally:
            for fd in found.values():
                os.close(fd)
    return len(killed), left


def _others(proc: str, group: list[bytes]) -> dict[int, int]:
    """A pidfd for each other living process of the control group, by pid."""
    found: dict[int, int] = {}
    for word in os.listdir(proc):
        if not word.isdecimal() or int(word) == os.getpid():
            continue
        pid = int(word)
        try:
            if _group(proc, word) != group:
                continue
            fd = os.pidfd_open(pid)
        except OSError:
            continue  # the process has just ended
        # Check again with the pidfd open, because the pid may have belonged to another process before.
        try:
            same = _group(proc, word) == group and bool(_wait([fd], 0.0))
        except OSError:
            same = False
        if same:
            found[pid] = fd
        else:
            os.close(fd)
    return found


def _group(proc: str, pid: str) -> list[bytes]:
    """The control group of a process, as lines of its `cgroup` file. Only the hierarchies in which systemd separates
    services count, because people may have moved processes in the others. Raises OSError."""
    with open(f"{proc}/{pid}/cgroup", "rb") as file:
        return [line for line in file.read().splitlines() if line.split(b":", 2)[1] in (b"", b"name=systemd")]


def _wait(fds: Collection[int], until_s: float) -> int:
    """Wait until all of these processes have ended, but not after `until_s` (time.monotonic()). Returns how many are
    left."""
    poll = select.poll()
    for fd in fds:
        poll.register(fd, select.POLLIN)
    left = len(fds)
    while left:
        ready = poll.poll(max(0.0, until_s - time.monotonic()) * 1000)
        if not ready:
            break
        for fd, _ in ready:
            poll.unregister(fd)
        left -= len(ready)
    return left
