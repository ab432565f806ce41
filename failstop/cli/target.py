"""Target: the port to which `failstop stop` writes a stop, the board there, and how long to try."""

from __future__ import annotations

import contextlib
import os
from argparse import Namespace
from functools import cached_property
from math import inf

from failstop import config, instances, stop_tool
from failstop.api.errors import FailstopError
from failstop.board import kept
from failstop.board.kinds import board_of, is_own
from failstop.board.port import PortError
from failstop.board.servos import HIGHEST_ID
from failstop.cli import standard
from failstop.files import durable, instance, place
from failstop.policy.halted import MAY_TURN
from failstop.policy.setting import SettingError
from failstop.policy.settings import BY_KEY, MOST_OF_A_FAMILY

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Collection
    from typing import Any

    from failstop.board.interface import Board
    from failstop.doctor.system import Holder

DEVICE = "device.path"
WAIT = "stop.wait_s"
KIND = "board.kind"
BAUD, CAN_ID = "board.baud", "board.can_id"
DEFAULTS = {key: BY_KEY[key].default for key in (DEVICE, WAIT, KIND, BAUD, CAN_ID)}

STALLED_S = 1.0
"""With --end-service, how long to try a port that exists but accepts no bytes, in seconds. After that, the systemd unit
failstop-late@ keeps trying to write the stop."""
NO_USE = {
    "absent": "does not exist",
    "not-a-tty": "is not a serial port",
    "permission": "may not be opened by the user who made that run",
}
"""For each kind of PortError, why the port of the last run was not used, as the end of a sentence."""


class Target:
    """Chooses the port for the stop, and how long to try. The port comes from the first of these that names one: the
    option --device, the file given with --config, a running service, the last run, the installed settings file, and the
    default. A running service that was started with the file comes before it, because the board may have come back at
    another port. The last run does not count if the device at its port is certainly another one. With `last_first`, the
    last run comes before the file, as long as its board is still at its port: somebody may have edited the file since
    the service started, or the board may have come back at another port.

    The settings file is read only if it is needed. Only its settings about the stop are checked, so that a mistake in
    another setting can't prevent the stop."""

    def __init__(self, arguments: Namespace, *, last_first: bool = False) -> None:
        """Check the options. Raises SettingError."""
        self._last_first = last_first
        options = {DEVICE: ("--device", arguments.device), WAIT: ("--wait", arguments.wait)}
        self._given = {
            key: BY_KEY[key].check(value, name) for key, (name, value) in options.items() if value is not None
        }
        self._name = arguments.name
        self._config = arguments.config
        self._problems: list[str] = []
        """Mistakes in the settings file that have not been printed yet."""
        self._file_owner = 0
        self._unknown = False
        """True if the settings file may name a port that this program could not read from it. Either the file can't be
        read, or its device.path is not a valid port, or device.path is below the wrong [table]."""
        self._known = ("", 0)
        """The port that a running service reports, and the uid of the user who runs that service."""
        self._known_of_file = False
        """True if that service was started with the file given with --config."""
        self.asked: list[str] = []
        """The services that were asked to stop the robot, but have not confirmed it."""
        self.confirmed: list[str] = []
        """The services that were asked to stop their robots, and have confirmed it."""
        self.unproved = False
        """True if a service has taken a stop request, but the wheels may still turn."""
        self._at = ("", 0)
        """The port to which the stop was written, and the uid of the user whose file names it. ("", 0) before that.
        What follows, such as the stop of the arm, goes to the same port, even if devices come and go meanwhile."""
        self._looked = False
        """True once this try has looked at the device at the last run's port. All parts of a try then see the same one,
        and the kernel, which may be slow to answer while the device is being reset, is asked once."""
        self._at_last: bool | None = None
        """What that look has found: see _is_at_last_port()."""
        self._instead_of = ""
        """Why the port of the last run could not be used, as the end of a sentence. Empty if the stop was not written
        to another port because of that."""
        self._held = False
        """True if a service had the port when the stop was written to it."""
        self._stopped = False
        """True once a stop was written. From then on, board() may run the user's own Python code for the board. Asking
        the board for an answer needs that code."""

    def wanted(self) -> str:
        """Return the port that the user has named, with --device or in the file given with --config. Empty if there is
        none."""
        return str(self._given.get(DEVICE) or (self._file.get(DEVICE) if self._config else None) or "")

    def only_file_names_port(self) -> bool:
        """Return True if the user has named a port, but only in the file given with --config. False for systemd: its
        commands must not stop a service that has just been started again."""
        return bool(self.wanted()) and DEVICE not in self._given and not self._last_first

    def is_file_of(self, name: str) -> bool:
        """Return True if the newest service of this name was started with the file given with --config. Then it has the
        board that the file describes, even if the board is at another port by now."""
        if not self._config:
            return False
        import shlex  # imported only here, so that no stop waits for it

        with contextlib.suppress(OSError, ValueError):
            words = shlex.split(instance.last(name).command)
            by_unit = words[:1] == ["sudo"]
            its = config.installed(name) if by_unit else words[words.index("--config") + 1]
            return os.path.samefile(its, self._config)
        return False

    def of_dead_run(self) -> str | None:
        """Return the port of the last run if its board is there, and "" if not. None if the last run does not come
        first, because there was none, or this command is not for systemd, or the user has named a port."""
        if not self._last_first or self._given.get(DEVICE) or not self._last.device:
            return None
        return self._last.device if self._is_at_last_port() else ""

    def learn(self, name: str, device: str, owner: int | None) -> None:
        """Remember the port of the running service `name`. `owner`: the uid of the user who runs that service."""
        if device and owner is not None and not self._known[0]:
            self._known = device, owner
            self._known_of_file = self.only_file_names_port() and self.is_file_of(name)

    def device(self) -> str:
        """Return the port to write to."""
        return self._chosen()[0]

    def _chosen(self) -> tuple[str, int]:
        """Return the port to write to, and the uid of the user whose file names it. The uid is 0 for root's file, an
        option or the default."""
        if self._at[0]:
            return self._at
        if given := self._given.get(DEVICE):
            return str(given), 0
        last = self._last.device, self._last.owner
        at_last = self._is_at_last_port()
        if at_last and self._last_first:
            return last
        # For systemd, the settings' port is where the service starts next, also if that is the default.
        named = self._config and (DEVICE in self._file or (self._last_first and not self._unknown))
        if named and not self._known_of_file:
            return self._guess()
        if self._known[0]:
            return self._known
        return last if last[0] and at_last is not False else self._guess()

    def _is_at_last_port(self) -> bool | None:
        """Return True if the device that the last run had is still at the last run's port, and False if the device
        there is certainly another one. None if there is no device or was no last run, or if nobody can tell."""
        if not self._last.device:
            return None
        if not self._looked:
            self._looked = True
            from failstop.board import finder  # imported only here, because a stop without a last run does not need it

            try:
                now = finder.usb_text(os.stat(self._last.device).st_rdev)
                self._at_last = finder.is_still(now, self._last.usb)
            except OSError:
                self._at_last = None
        return self._at_last

    def board(self) -> Board:
        """Return the board at the port. Its kind comes from the last run if that run used this port, else from the
        settings file, else from the default. Raises FailstopError if the board can't be made.

        If the last run used this port and has saved its stop bytes, these bytes are used until a stop is written,
        because the settings may have changed since the last run. For your own board they are used at any port: the
        user's own Python code for a board must not run before a stop is written. At another port, the settings of any
        other kind of board count, because two boards of one kind may have different motors.
        """
        kind = self._named_kind() or str(DEFAULTS[KIND])
        kept_one = kept.unpack_stop(self._last.stop) if kind == self._last.board else None
        known = kept_one if is_own(kind) or self._is_the_last_s() else None
        if known and is_own(kind) and not self._stopped:
            return known
        baud = known.port.baud if known and self._is_the_last_s() else int(self._file.get(BAUD, DEFAULTS[BAUD]))
        try:
            made = board_of(kind, 1.0, 0.0, baud=baud, can_id=int(self._file.get(CAN_ID, DEFAULTS[CAN_ID])))
        except ValueError as error:
            if kept_one:
                return kept_one
            raise FailstopError(f"{error}; no stop was written: use the POWER SWITCH") from None
        # Use the stop of the last run if it differs, because the settings may name another motor since.
        return known if known and not self._stopped and known.burst != made.burst else made

    def _named_kind(self) -> str:
        """Return the kind of board from the last run if that run used the chosen port, else from the settings file.
        Empty if neither names a kind."""
        if self._is_the_last_s():
            with contextlib.suppress(SettingError):
                return str(BY_KEY[KIND].check(self._last.board))
        return str(self._file.get(KIND, ""))

    def _is_the_last_s(self) -> bool:
        """Return True if the last run used the port that was chosen for the stop, and the device there is not certainly
        another one."""
        return self._last.device == self.device() and self._is_at_last_port() is not False

    def assumes_kind(self) -> bool:
        """Return True if the kind of board is not known, so that the stop of the default kind is written."""
        return not self._named_kind()

    def _is_default(self) -> bool:
        """Return True if nothing names a port or a kind of board, so that both are only the defaults."""
        named = self._given.get(DEVICE) or self._file.get(DEVICE) or self._known[0] or self._is_last()
        return not named and self.assumes_kind()

    def described(self) -> str:
        """Describe the port for people. If it was chosen because the last run used it, the text says so."""
        of = ", the port of the last run" if self._is_last() else ""
        return f"{self.device()}{of}"

    def _is_last(self) -> bool:
        if not self._last.device or self.wanted() or self._known[0]:
            return False
        return self._is_the_last_s()

    def _guess(self) -> tuple[str, int]:
        """Return the port in the settings file and the uid of the file's owner. Without one, return the default port
        and 0."""
        return (str(self._file[DEVICE]), self._file_owner) if DEVICE in self._file else (str(DEFAULTS[DEVICE]), 0)

    @cached_property
    def _last(self) -> instance.Last:
        """How the last run of this service was started."""
        return instance.last(self._name)

    def _servos(self) -> tuple[int, ...]:
        """Return the ids of the arm's servos, from the settings file, and from the last run if it used the chosen port.
        Empty without an arm."""
        joints = [key for key in self._file if key.startswith("joints.") and key.endswith(".servo")]
        found = [value for key in joints if type(value := self._file[key]) is int]
        found += self._last.servos if self._is_the_last_s() else ()
        return tuple(sorted({servo for servo in found if 0 < servo <= HIGHEST_ID})[:MOST_OF_A_FAMILY])

    @cached_property
    def _file(self) -> dict[str, Any]:
        """The settings in the settings file. Settings that the stop needs are checked, and left out if they are wrong.
        Empty if the file does not exist or can't be read."""
        path = self._config or config.installed(self._name)
        table: dict[str, Any] = {}
        try:
            table = config.read(path) if self._config or not durable.missing(path) else {}
            self._file_owner = os.stat(path).st_uid if table else 0
        except SettingError as error:
            self._problems.append(str(error))
            self._unknown = True
        self._unknown |= any(key.endswith(f".{DEVICE}") for key in table)  # the setting is below the wrong [table]
        for key in (key for key in DEFAULTS if key in table):
            try:
                table[key] = BY_KEY[key].check(table[key])
            except SettingError as error:
                self._problems.append(str(error))
                self._unknown |= key == DEVICE
                del table[key]
        return table

    def stop(self, most_s: float = inf, otherwise: Callable[[PortError], bool] = lambda _: False) -> float:
        """Write the stop, trying for at most `most_s` seconds, and then stop the arm. Returns the number of seconds
        until the stop was written. `otherwise` is called after each failed try, and returns True if it has stopped the
        robot in another way. Raises PortError."""
        elsewhere = False

        def write() -> bool:
            # Chosen again for each try, because devices may come and go meanwhile.
            self._looked = False
            device, owner = self._chosen()
            if self._is_default():
                _refuse_stranger(device, self.board())
            held = stop_tool.write(device, self.board(), named_by=owner)
            self._at = device, owner
            return held

        def wait_s(error: PortError) -> float:
            if error.kind == "busy":
                standard.say(self.explained(error))
            elif error.kind == "absent" and (others := self._other_services()):
                standard.say(others)  # at once, because its robot may be the one that drives
            found = {**DEFAULTS, **self._file, **self._given}[WAIT]
            self.complain()
            least_s = STALLED_S if error.kind == "io" and most_s < inf else inf
            return min(float(found), most_s, least_s)

        def another(error: PortError) -> bool:
            nonlocal elsewhere
            elsewhere = otherwise(error)
            return elsewhere

        try:
            after_s, held = stop_tool.stop(write, wait_s, standard.say, another)
            if elsewhere and not self._instead_of:
                return after_s
            self._stopped, self._held = True, held or self._held
            if servos := self._servos():  # after the wheels, the arm
                device, owner = self._chosen()
                stop_tool.write(device, self.board(), servos, named_by=owner)
        except KeyboardInterrupt:
            standard.say(f"ended before a stop was known to be written to {self.device()}: {MAY_TURN}")
            raise
        finally:
            self.complain()
        return after_s

    def wrote_instead(self, error: PortError) -> bool:
        """If the port was chosen only because the last run used it, write the stop to the port in the settings file or
        the default port. The board may have got another port when it was plugged in again. Returns True if a stop was
        written."""
        other = self._guess()
        if not self._is_last() or other[0] == self._last.device:
            return False
        try:
            if DEVICE not in self._file:
                _refuse_stranger(other[0], self.board())
            self._held = stop_tool.write(other[0], self.board(), named_by=other[1])
        except PortError:
            return False
        self._at = other
        self._instead_of = NO_USE[error.kind]
        return True

    def missed(self, most_s: float = inf) -> bool:
        """If the stop was written to the last run's port, but the settings name another one that can't be used, try to
        write the stop there too, for at most `most_s` seconds. Returns True if that did not work.

        The service can't start without that port. So if this command ended at once, systemd would start the service
        again and again, until it gives up. Then nobody would stop a board that comes to that port.
        """
        wrote_to, other = self.device(), self._guess()
        if not (self._last_first and self._config) or self._given.get(DEVICE) or self._unknown:
            return False
        if wrote_to != self._last.device or other[0] == wrote_to:
            return False
        self._at, self._stopped = other, False
        try:
            if self._is_usable():
                return False
            self.stop(most_s)
        except (PortError, FailstopError) as error:
            standard.say(f"{error}; the stop went only to {wrote_to}, where the last run had the board")
            return True
        standard.print_line(f"stop frame sent to {other[0]} too, the port in the settings")
        return False

    def _is_usable(self) -> bool:
        """Return True if the service could open the port. This does not open it, because that resets some boards."""
        try:
            if self._is_default():
                _refuse_stranger(self.device(), self.board())
        except PortError:
            return False
        return os.access(self.device(), os.R_OK | os.W_OK)

    def is_not_theirs(self, error: PortError) -> bool:
        """Return True if this program, as root, has refused to open the port that a user's file names. As root it
        refuses a port that this user may not open, and anything that is not a serial port. Otherwise a user could make
        root write to any device."""
        return bool(self._chosen()[1]) and not os.geteuid() and error.kind in ("permission", "not-a-tty")

    def unheard(self, *, patient: bool) -> bool:
        """Ask the board for an answer, and print the result. Returns True if this kind of board can answer, but was
        silent. `patient`: True to ask a silent board again after a wait, because opening the port resets some
        boards."""
        (device, owner), board = self._chosen(), self.board()
        if isinstance(board, kept.Kept):
            standard.print_line(
                "nobody knows whether the board has heard the stop, because its description can't be used"
            )
            return False
        heard = stop_tool.answered(device, board, patient=patient, named_by=owner)
        if heard:
            how = "answers" if board.pings else "reports zero speed"
            standard.print_line(f"the board at {device} {how}")
        elif heard is None and (board.pings or board.echo_ns):
            standard.print_line(
                f"nobody knows whether the board at {device} answers, because a service reads that port"
            )
        elif heard is None:
            standard.print_line("this board answers no questions, so nothing proves that it has stopped")
        else:
            who = f"nothing at {device} answers as {board.name} does"
            kind = (
                "Without settings failstop takes every board for Hiwonder's: for another board give --config FILE with "
                f"its {KIND}, or run `failstop setup{instance.option(self._name)}` first. "
            )
            standard.say(
                f"{who}, so the wheels may turn: use the POWER SWITCH. {kind if self.assumes_kind() else ''}"
                "If the board is at another port, name that port with --device"
            )
        return heard is False

    def bypassed(self) -> bool:
        """Print a warning and return True if another process has the port open, and was not asked to stop. It does not
        know of the stop, so it writes the next motion frame at its usual time. This can be any driver that has not
        opened the port exclusively, or, for root, whom an exclusive port does not keep out, also a service that another
        user has started. For systemd only services count, because a driver may have begun to use the port since."""
        held = self._held and not self.asked
        if self._last_first and not held:
            return False
        holders = self._holders(writing=True)
        programs = {} if self._last_first else {str(it): it.end() for it in holders if not it.instance}
        if held:
            by, names = _described([it for it in holders if it.instance])
            ways = " or ".join(f"`failstop stop{instance.option(name)}`" for name in names)
            ask = f", or {ways} as the user who started it" if ways else ""
            standard.say(f"{by} was not asked, still has {self.device()} and may drive on: use the POWER SWITCH{ask}")
        if programs:
            ends = ", ".join(f"`{end}`" for end in programs.values())
            also = f"{', '.join(programs)} also has {self.device()} open and may drive on"
            standard.say(f"{also}: use the POWER SWITCH, or end it with {ends}")
        return held or bool(programs)

    def _holders(self, *, writing: bool = False) -> list[Holder]:
        """Return the other processes that have the port open, or, with `writing`, only those that have it open for
        writing. Empty if none can be found."""
        try:
            # imported only here, because it looks at every process of the computer
            from failstop.doctor.system import System

            system, device = System(), self.device()
            return [it for it in system.holders(device)[0] if not writing or system.writes(it.pid, device)]
        except Exception:  # people must learn that the robot may drive on, even if nobody can be named
            return []

    def complain(self) -> None:
        """Print the mistakes in the settings file. Call this after the stop, because printing may be delayed."""
        while self._problems:
            standard.say(f"{self._problems.pop(0)}; stopping without it")

    def doubtful(self) -> bool:
        """Print a warning and return True if the stop was written to a port that was only guessed."""
        if self._instead_of:
            gone = f"{self._last.device}, the port of the last run, {self._instead_of}"
            standard.say(
                f"{gone}, so the stop went to {self.device()}. If that is not the board, name its port with --device"
            )
            return True
        if self._is_last() or self.wanted() or self._known[0]:
            return False
        if not self._last_first and self._is_at_last_port() is False:
            standard.say(
                f"another device is at {self._last.device}, the port of the last run, so the stop went to "
                f"{self.device()}. If that is not the board, name its port with --device"
            )
            return True
        if DEVICE in self._file:
            return False
        if not self._unknown and self._name == instance.DEFAULT_NAME:
            return False
        standard.say(
            f"the stop went to {self.device()}, the default. If that is not the board, name its port with --device"
        )
        return True

    def stopped_by_another(self, name: str) -> bool:
        """Print a warning and return True if the service `name`, which has stopped its robot, may have another port
        than the robot that the user meant. Call this only if the user has named no port, and meant a service that is
        not running."""
        if not self._is_last():
            return self.doubtful()
        standard.say(
            f"no service {self._name!r} runs, and {name!r} has {self.device()} now, the port of its last run. If that "
            "is not the board, name its port with --device"
        )
        return True

    def explained(self, error: PortError) -> str:
        """Return the reason why no stop was written, and what to do. The text names the process that holds the port, if
        that process can be found."""
        device, owner = self._chosen()
        if error.kind == "absent":
            others, either = self._other_services(), ""
            if self._is_last() and (other := self._guess()[0]) != self._last.device:
                neither = f"no stop could be written to {other}" if os.path.exists(other) else f"{other} does not exist"
                either = f" (the last run used it; {neither} either)"
            return f"{error}{either}; {MAY_TURN}{f'; {others}' if others else ''}"
        if self.is_not_theirs(error):
            what = "is not a serial port" if error.kind == "not-a-tty" else "that user may not open it"
            named = f"a file of {place.user(owner)} names {device}, but {what}"
            return f"{named}: name the board's port with --device; {MAY_TURN}"
        if error.kind != "busy":
            return f"{error}; {MAY_TURN}"
        by, names = _described(self._holders())
        asked = f"; asked without success: {', '.join(self.asked)}" if self.asked else ""
        # A service that this user's command can't reach would not be asked by it either.
        ways = [
            f"`failstop stop{instance.option(name)}`"
            for name in names
            if name not in self.asked and instances.listens(name)
        ]
        if os.geteuid():
            ways.append(f"`sudo failstop stop --device {device}{instance.option(self._name)}`, which writes anyway")
        return f"{device} is held exclusively by {by}{asked}: {', or '.join(['use the POWER SWITCH', *ways])}"

    def _other_services(self) -> str:
        """Return a clause with the commands that stop the robots of the running services that were not asked. Empty if
        there are none, if the user has named a port, or for systemd, where nobody types a command."""
        if self._last_first or self.wanted():
            return ""
        names = [name for name in instances.listening() if name not in (*self.asked, *self.confirmed)]
        ways = " or ".join(f"`failstop stop{instance.option(name)}`" for name in names)
        return f"a service with another port is running; to stop its robot: {ways}" if ways else ""


def _described(holders: Collection[Holder]) -> tuple[str, list[str]]:
    """Return (these processes as text; the names of those that are services). The text is "another process" if there
    are none."""
    who = dict.fromkeys(f"the service {it.instance!r}" if it.instance else str(it) for it in holders)
    return ", ".join(who) or "another process", list(dict.fromkeys(it.instance for it in holders if it.instance))


def _refuse_stranger(device: str, board: Board) -> None:
    """Raise PortError if the device is certainly not the board. For a port that nobody has named."""
    from failstop.board import finder  # imported only here, because few stops need it

    finder.refuse_stranger(device, board)
