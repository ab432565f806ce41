"""Opens the board's serial port: raw, at the board's baud rate, and with the modem lines set as the board needs them.

pyserial is not used, because it is slow to import: 1.9 ms and 8 modules, compared with 0.5 ms and 3 modules for this
file (Python 3.11 on x86-64). The supervisor opens the port in its first 150 ms, and the stop tool must be fast too.
pyserial's Serial also opens five descriptors instead of one. Its `exclusive` is an flock, which only keeps out programs
that ask for it. Only doctor uses pyserial, to list the ports.
"""

from __future__ import annotations

# The C module behind `signal`, because importing `signal` also imports enum.
import _signal
import contextlib
import errno
import fcntl
import os
import stat
import struct
import termios

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any, Literal

    from failstop.board.wire import Port

    Kind = Literal["absent", "permission", "not-a-tty", "busy", "io"]

_INT = struct.Struct("i")
_ZERO = _INT.pack(0)

READ_BYTES = 4096
CLOSE_S = 0.02
"""How long a close may wait for bytes to leave the kernel, in s."""

_OPEN_FLAGS = os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC
_OTHER_SPEED = termios.B500000
"""A baud rate that no board uses."""
_TIOCGEXCL = 0x80045440
"""Asks if TIOCEXCL is set. Python's termios has no name for it."""
_CFLAG = termios.CS8 | termios.CREAD | termios.CLOCAL
_CFLAG_MASK = _CFLAG | termios.CSIZE | termios.CSTOPB | termios.PARENB | termios.HUPCL | termios.CRTSCTS

_FILE_KINDS = {
    stat.S_IFIFO: "a FIFO",
    stat.S_IFREG: "a regular file",
    stat.S_IFDIR: "a directory",
    stat.S_IFBLK: "a block device",
    stat.S_IFSOCK: "a socket",
}


class PortError(Exception):
    """Raised if the port can't be used. The message is one line that names the path and says what to do.

    `kind` is "absent" (there is no such device, or it is certainly not the board), "permission", "not-a-tty" (something
    else is at that path), "busy" (another process holds it exclusively) or "io" (the device or the system failed).
    `errno` is the system's error number, or 0.
    """

    def __init__(self, kind: Kind, message: str, number: int = 0) -> None:
        super().__init__(message)
        self.kind = kind
        self.errno = number


def open_port(path: str, *, exclusive: bool, line: Port, named_by: int = 0) -> int:
    """Open the board's port and return its descriptor: non-blocking, close-on-exec, raw, 8N1, and with the rate and
    modem lines of `line`. Opens only a character device, and writes nothing. Raises PortError.

    A read raises BlockingIOError if nothing has come, and returns no bytes after a hang-up. With `exclusive`, other
    opens by unprivileged processes fail until every duplicate of the descriptor is closed or release_exclusive() is
    called. `named_by` is the id of another user whose file names this path, or 0. Root opens such a path with no more
    than that user's rights.

    The board's USB chip forgets the baud rate when the USB bus is reset, for example when the computer sleeps, and the
    kernel's driver does not notice. So this function makes the driver send the rate again, unless a service has the
    port. If a service has the port at another rate than that of `line`, the rate stays as it is, and nothing else is
    set up either: what is written then leaves at the service's rate.
    """
    descriptor = -1
    try:
        descriptor = _opened(path, named_by)
        _prepare(path, descriptor, exclusive, line)
    except BaseException as error:
        if descriptor >= 0:
            os.close(descriptor)
        if isinstance(error, (OSError, termios.error)):
            raise _explain(path, OSError(*error.args)) from None
        raise
    return descriptor


def _opened(path: str, named_by: int) -> int:
    if named_by and not os.geteuid():
        from failstop.board import named

        return named.open_named(path, named_by, _OPEN_FLAGS)
    mode = os.stat(path).st_mode
    if not stat.S_ISCHR(mode):
        what = _FILE_KINDS.get(stat.S_IFMT(mode), "something else")
        raise PortError("not-a-tty", f"{path} is {what}, not a serial port: name the board's device with --device")
    return os.open(path, _OPEN_FLAGS)


def open_if_there(path: str, line: Port) -> int:
    """Open a port exclusively, as open_port() does. Returns -1 if that fails. Never raises. It never looks up users to
    explain a failure, because that may take long."""
    # A device exists before udev has given it to its group. Then the open would be refused. To explain a refusal,
    # open_port() looks up users, which may take long, and here nobody reads the explanation.
    if not os.access(path, os.R_OK | os.W_OK):
        return -1
    try:
        return open_port(path, exclusive=True, line=line)
    except PortError:
        return -1


def waiting_bytes(descriptor: int) -> bytes | None:
    """Return bytes that the board has sent, up to READ_BYTES. Empty if none are waiting, and None if the device is
    gone."""
    try:
        return os.read(descriptor, READ_BYTES) or None
    except BlockingIOError:
        return b""
    except OSError:
        return None


def unsent_bytes(descriptor: int) -> int:
    """Return how much written data the kernel has not sent yet (TIOCOUTQ). The unit depends on the driver: cdc_acm
    counts 1280 for each write under way, a pty always has 0, and other drivers count bytes. Raises OSError."""
    return int(_INT.unpack(fcntl.ioctl(descriptor, termios.TIOCOUTQ, _ZERO))[0])


def is_read(descriptor: int) -> bool:
    """True while a service has the port and reads the board's bytes. Then don't read from the port, because the service
    would miss these bytes."""
    if not _lock(descriptor):
        return True
    fcntl.flock(descriptor, fcntl.LOCK_UN)
    return False


def has_lines(descriptor: int) -> bool:
    """True if the port has modem lines. A pty has none. The kernel raises the lines at every open, which may reset the
    board, and no program can prevent it."""
    try:
        fcntl.ioctl(descriptor, termios.TIOCMGET, _ZERO)
    except OSError:
        return False
    return True


def set_speed(descriptor: int, line: Port) -> None:
    """Switch the port to the baud rate of `line`. The modem lines stay as they are, because changing them may reset the
    board. Raises OSError."""
    try:
        _set_raw(descriptor, termios.tcgetattr(descriptor), getattr(termios, f"B{line.baud}"))
    except termios.error as error:
        raise OSError(*error.args) from None


def close_port(descriptor: int, within_s: float = CLOSE_S) -> None:
    """Close the port's descriptor. Never raises. In the main thread this takes `within_s` at most, even if the port
    sends nothing.

    The last close of a terminal waits until its bytes are sent. On cdc_acm this takes up to 30 s, and until then nobody
    can open the port again. A timer's signals end this wait. Close the port with this function before the process
    exits: an exiting process gets no more signals, so it would wait for the whole time.
    """
    try:
        before = _signal.signal(_signal.SIGALRM, _interrupt)
    except ValueError:  # not the main thread
        _close(descriptor)
        return
    # Repeated, because the first signal may come before the close has begun to wait.
    timer = _signal.setitimer(_signal.ITIMER_REAL, within_s, within_s)
    try:
        _close(descriptor)
    finally:
        _signal.setitimer(_signal.ITIMER_REAL, *timer)
        _signal.signal(_signal.SIGALRM, before)


def _interrupt(_number: int, _frame: object) -> None:
    """Do nothing. The signal only has to interrupt the call."""


def _close(descriptor: int) -> None:
    with contextlib.suppress(OSError):
        os.close(descriptor)


def release_exclusive(descriptor: int) -> None:
    """Let other processes open the port again: undo TIOCEXCL, and release the lock. Raises OSError."""
    fcntl.ioctl(descriptor, termios.TIOCNXCL)
    fcntl.flock(descriptor, fcntl.LOCK_UN)


def _prepare(path: str, descriptor: int, exclusive: bool, line: Port) -> None:
    # The file that stat() saw may have been replaced before open(); only a terminal answers this.
    before = termios.tcgetattr(descriptor)
    # TIOCEXCL does not keep root out. But another service that runs as root asks for this lock too. All duplicates of
    # the descriptor share the lock. It is taken before TIOCEXCL is set, because TIOCEXCL would outlast a refusal: it
    # stays until the last descriptor of the terminal is closed.
    alone = _lock(descriptor)
    if exclusive and not alone:
        raise PortError("busy", f"{path} is held by another process (flock): stop it first", errno.EBUSY)
    if exclusive:
        # Before all other changes, so that nobody else gets in while the port is set up.
        fcntl.ioctl(descriptor, termios.TIOCEXCL)
    elif alone:
        fcntl.flock(descriptor, fcntl.LOCK_UN)
    speed = getattr(termios, f"B{line.baud}")
    # A service drives its board at this rate. At another one, neither its motion nor its stops would arrive.
    theirs = not alone and before[4:6] != [speed, speed] and _is_exclusive(descriptor)
    if alone:
        # cdc_acm sends the line coding only if it differs from the one that it sent last.
        _set_raw(descriptor, before, _OTHER_SPEED)
    if not theirs:
        _set_raw(descriptor, before, speed)
        _check_raw(path, descriptor, line.baud, speed)
    # A port that was stopped would hold back every byte. TCOOFF stops a port, and so does a ^S that came while it was
    # still a terminal. This call costs 0.5 us on a pty, and waits for nothing.
    termios.tcflow(descriptor, termios.TCOON)
    if theirs:
        return
    # Opening has raised both lines. Set the lines that must be on first, because DTR off while RTS is on resets some
    # boards' processors. Then clear the others in one call, for the same reason.
    lines = ((termios.TIOCM_DTR, line.dtr), (termios.TIOCM_RTS, line.rts))
    for request, wanted in ((termios.TIOCMBIS, True), (termios.TIOCMBIC, False)):
        if bits := sum(bit for bit, on in lines if on == wanted):
            _set_line(descriptor, request, _INT.pack(bits))


def _lock(descriptor: int) -> bool:
    """Try to lock the port. Returns False if another process has locked it: a service, or a program that uses
    pyserial's `exclusive`."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _is_exclusive(descriptor: int) -> bool:
    """True if TIOCEXCL is set. On a port that is also locked, this shows that a service has it, because pyserial only
    locks a port. Also True if the kernel can't tell: a rate that a service needs must stay."""
    try:
        return fcntl.ioctl(descriptor, _TIOCGEXCL, _ZERO) != _ZERO
    except OSError:
        return True


def _set_raw(descriptor: int, before: list[Any], speed: int) -> None:
    cc = list(before[6])
    # VMIN 1: with 0, a read would return no bytes both when there is nothing to read and after a hang-up.
    cc[termios.VMIN], cc[termios.VTIME] = 1, 0
    cflag = before[2] & ~_CFLAG_MASK | _CFLAG
    # Not TCSADRAIN or TCSAFLUSH: both wait for output to drain, which hangs on CDC-ACM.
    termios.tcsetattr(descriptor, termios.TCSANOW, [0, 0, cflag, 0, speed, speed, cc])


def _check_raw(path: str, descriptor: int, baud: int, speed: int) -> None:
    """Raise PortError unless the port has taken all settings. tcsetattr succeeds even if the port has taken only
    one."""
    after = termios.tcgetattr(descriptor)
    took = after[:2] == [0, 0] and after[2] & _CFLAG_MASK == _CFLAG and after[3:6] == [0, speed, speed]
    if not took or after[6][termios.VMIN] != 1:
        raise PortError("io", f"{path} does not take raw mode at {baud} baud: is it the board? see --device")


def _set_line(descriptor: int, request: int, bits: bytes) -> None:
    try:
        fcntl.ioctl(descriptor, request, bits)
    except OSError as error:
        # A pty has no modem lines.
        if error.errno not in (errno.ENOTTY, errno.EINVAL):
            raise


def _explain(path: str, error: OSError) -> PortError:
    number = error.errno or 0
    text = os.strerror(number)
    if number in (errno.ENOENT, errno.ENXIO, errno.ENODEV, errno.ENOTDIR):
        return PortError("absent", f"no device {path}: plug the board in, or name another with --device", number)
    if number in (errno.EACCES, errno.EPERM):
        return PortError("permission", _explain_permission(path), number)
    if number == errno.EBUSY:
        return PortError("busy", f"{path} is held exclusively by another process (TIOCEXCL): stop it first", number)
    if number == errno.ENOTTY:
        return PortError("not-a-tty", f"{path} is not a serial port: name the board's device with --device", number)
    if number in (errno.EMFILE, errno.ENFILE, errno.ENOMEM):
        return PortError("io", f"cannot open {path}: {text}: the system is out of resources, not the board", number)
    return PortError("io", f"cannot open {path}: {text}: unplug the board and plug it in again", number)


def _explain_permission(path: str) -> str:
    try:
        node = os.stat(path)
    except OSError:
        return f"no permission to look at {path}: run as the service's user, or open its directory to yours"
    # Imported here because only a failure needs them.
    import grp
    import pwd

    owner, group = str(node.st_uid), str(node.st_gid)
    with contextlib.suppress(KeyError):
        owner = pwd.getpwuid(node.st_uid).pw_name
    with contextlib.suppress(KeyError):
        group = grp.getgrgid(node.st_gid).gr_name
    whose = f"{path} belongs to {owner}:{group}, mode {stat.S_IMODE(node.st_mode):04o}"
    if node.st_gid != 0 and node.st_mode & 0o060 == 0o060:
        return f"no permission to open {path}: {whose}: usermod -aG {group} USER, or run as the service's user"
    return f"no permission to open {path}: {whose}: run as the service's user, or install the udev rule"
