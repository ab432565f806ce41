"""`failstop fleet`: shows the robots on a broker, stops all of them, or publishes the state of this robot."""

from __future__ import annotations

import contextlib
import errno
import getpass
import json
import os
import secrets
import signal
import socket
import sys
import time
from argparse import SUPPRESS, ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Callable
from contextlib import closing

from failstop.api import words
from failstop.cli import standard, style
from failstop.cli.commands import add_name
from failstop.cli.screen.terminal import Terminal
from failstop.files import instance
from failstop.fleet import FleetError, levels, message, publisher, report, settings, signed, topics, view
from failstop.fleet.broker import CONNECT_S, Broker
from failstop.fleet.roster import Robot, Roster
from failstop.fleet.sender import BY_HAND, Sender
from failstop.fleet.settings import FleetSettings
from failstop.notify import Notify

EXAMPLES = """\
failstop fleet                       # every robot, live
failstop fleet stop smoke in hall 2  # stop all of them
failstop fleet key                   # make the key that all robots share
failstop fleet publish               # run this on each robot
"""


WATCH_S = 0.25
"""The time between two updates of the screen, in seconds."""
LIST_S = 1.5
"""How many seconds to wait until the broker has sent everything that it has stored."""
PROGRESS_S = 0.25
"""The time between two updates of the progress line, in seconds."""
INTERRUPTED = 130
"""The exit code after Ctrl-C."""


class Interrupted(FleetError):
    """Ctrl-C ended the command before it had done anything."""

    exit_code = INTERRUPTED
    """Exit code of a command that fails with this error."""


def add_arguments(parser: ArgumentParser) -> None:
    """Add the options of `failstop fleet` to its parser."""
    below = parser.add_subparsers(dest="action", metavar="ACTION")
    actions = {name: below.add_parser(name, help=what) for name, (_, what) in ACTIONS.items()}
    stop = actions["stop"].add_argument
    stop("reason", nargs="*", help="why you stop the robots; each robot shows it")
    stop("--by", metavar="NAME", help="who stops the robots (default: USER@HOST)")
    wait = "for how many seconds to keep trying (default: 5, or more if the broker has just restarted)"
    stop("--wait", type=_seconds, metavar="S", help=wait)
    for name in ("list", "stop"):
        actions[name].add_argument("--json", action="store_true", help="print JSON instead of text")
    actions["forget"].add_argument("robot", help="the robot's name in the fleet")
    add_name(actions["publish"])
    del actions["config"]
    for name, action in {"": parser, **actions}.items():
        default = SUPPRESS if name else None
        action.add_argument("--config", metavar="FILE", default=default, help="TOML file with the fleet's settings")
        if name != "key":
            action.add_argument("--broker", metavar="HOST[:PORT]", default=default, help="address of the MQTT broker")


def main(arguments: Namespace) -> int:
    """Carry out the action that the user has named, for example `stop`. Raises FleetError or SettingError."""
    return ACTIONS[arguments.action or "watch"][0](arguments)


def _seconds(text: str) -> float:
    """Convert the value of --wait to seconds. Raises ArgumentTypeError if the value is not allowed."""
    try:
        found = float(text)
    except ValueError:
        found = 0.0
    if not 0.0 < found <= levels.LONGEST_S:
        raise ArgumentTypeError(f"{text!r}: it must be more than 0 s, and at most {levels.LONGEST_S:.0f} s")
    return found


def _settings(arguments: Namespace) -> FleetSettings:
    changed: dict[str, object] = {}
    if broker := getattr(arguments, "broker", None):
        host, colon, port = broker.rpartition(":")
        # An IPv6 address contains colons, so a port can follow it only if the address is in brackets.
        if colon and port.isascii() and port.isdigit() and (":" not in host or host.endswith("]")):
            number = settings.port_number(port)
            changed = {"broker.host": host.strip("[]"), "broker.port": port if number is None else number}
        else:
            changed = {"broker.host": broker.strip("[]")}
    return settings.load(arguments.config, changed)


def _publish(arguments: Namespace) -> int:
    found = _settings(arguments)
    instance.check_name(arguments.name)
    service = publisher.Service(arguments.name)
    robot = found.robot_id(arguments.name)
    publishing = publisher.Publisher(found, arguments.name, service, robot, publisher.store(arguments.name))
    manager = Notify.from_environment(os.environ, os.getpid())
    ended: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda by, _: ended.append(by))
    standard.say(f"publishing {arguments.name!r} as {robot} at {publishing.broker.where}")
    said = None
    while not ended:
        publishing.turn()
        # If the manager's queue is full, try again in the next turn.
        if (status := _status(publishing.deaf(), publishing.doubled())) != said and manager.say(status):
            said = status
    publishing.close()
    return 0


def _status(deaf: str, doubled: str) -> str:
    """Return the status of this robot's publisher in systemd's format. `systemctl status` and `failstop doctor` show
    it. `deaf`: why the robot would obey no fleet stop. `doubled`: a warning if another publisher uses the robot's name.
    Either may be empty."""
    if deaf:
        return f"STATUS=obeys no fleet stop: {words.printable(deaf)}\nERRNO={errno.ENOTCONN}"
    if doubled:
        return f"STATUS=obeys a fleet stop, but {words.printable(doubled)}\nERRNO={errno.ENOTUNIQ}"
    return "STATUS=obeys a fleet stop\nERRNO=0"


def _key(arguments: Namespace) -> int:
    path = _settings(arguments).text("stop.key_file")
    signed.make_key(path)
    standard.print_line(f"{path} is the fleet's key: copy it to every robot, and to the computers that may stop them")
    return 0


def _config(_: Namespace) -> int:
    print(settings.example(), end="")
    return 0


def _seen(found: FleetSettings) -> tuple[Roster, Broker]:
    """Return an empty roster, and the broker connection that fills it with robots."""
    roster = Roster()

    def hear(topic: str, payload: bytes, retained: bool) -> None:
        roster.hear(topic, payload, time.monotonic(), retained=retained)

    fleet = found.text("robot.fleet")
    wanted = [topics.of_robot(fleet, topics.ANY, last) for last in (topics.CONNECTION, topics.STATE)]
    return roster, Broker(found, f"failstop-view-{secrets.token_hex(6)}", wanted, hear)


def _listen(broker: Broker, seconds: float, enough: Callable[[], bool] = lambda: False) -> None:
    until_s = time.monotonic() + seconds
    while not enough() and (left_s := until_s - time.monotonic()) > 0:
        broker.turn(min(0.1, left_s))


def _watch(arguments: Namespace) -> int:
    roster, broker = _seen(_settings(arguments))
    with closing(broker), Terminal() as terminal:
        while not terminal.ended:
            if b"q" in terminal.wait(0.0).lower():
                break
            _listen(broker, WATCH_S)
            now = time.monotonic(), time.time()
            size = terminal.columns, terminal.rows
            terminal.draw(view.lines(roster.sorted(), broker.where, broker.problem, *now, *size, _blind(broker)))
    return 128 + terminal.ended if terminal.ended else 0


def _list(arguments: Namespace) -> int:
    roster, broker = _seen(_settings(arguments))
    with closing(broker):
        _listen(broker, CONNECT_S, lambda: broker.listening)
        _listen(broker, LIST_S if broker.listening else 0.0)
    if broker.problem and not roster.robots:
        raise FleetError(broker.problem)
    if problem := broker.problem or _blind(broker):
        standard.say(f"{problem}: this list may lack robots")
    robots, now_s, unix_s = roster.sorted(), time.monotonic(), time.time()
    if arguments.json:
        rows = [
            {**vars(robot), "word": view.word(robot, now_s, unix_s), "age_s": robot.age_s(now_s, unix_s)}
            for robot in robots
        ]
        for row in rows:
            for key in ("heard_s", "sign_s", "first_s"):  # these times are of this process's own clock
                row[key] = None
        print(json.dumps(rows, indent=2))
    elif not robots:
        standard.print_line(
            f"the broker at {broker.where} shows no robot: either it knows none, or its access list hides them"
        )
    else:
        style.show([view.counts(robots, now_s, unix_s), *view.table(robots, now_s, unix_s)])
    return 1 if problem else 0


def _blind(broker: Broker) -> str:
    """Return a warning if the broker does not let this client read some topics, because then robots may be missing.
    Otherwise empty."""
    denied = " and ".join(broker.denied)
    return f"the broker does not let you read {denied}: see its access list" if denied else ""


def _user() -> str:
    """Return the user's name, or the number if no account has it, as in a container that was started with --user."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # OSError from Python 3.13 on
        return f"uid {os.getuid()}"


def _stop(arguments: Namespace) -> int:
    by = arguments.by or f"{_user()}@{socket.gethostname()}"
    stopping = Sender(_settings(arguments), " ".join(arguments.reason), by)
    progress = Progress(stopping)
    try:
        code = 0 if stopping.run(arguments.wait, progress.show) else 1
    except KeyboardInterrupt:
        code = INTERRUPTED
    finally:
        progress.clear()
    if code == INTERRUPTED:
        if stopping.sent_s is None:
            raise Interrupted(f"NO ROBOT WAS STOPPED: interrupted before a broker took the stop; {BY_HAND}")
        standard.say("interrupted, so no robot is asked again; this was confirmed until now")
    if arguments.json:
        found = report.as_dict(stopping.tally, stopping.doubts)
        print(json.dumps({**found, "interrupted": code == INTERRUPTED}, indent=2))
    else:
        style.show(report.lines(stopping.tally, stopping.doubts, listed=stopping.listed))
    return code


class Progress:
    """A line on stderr that shows how many robots have confirmed a stop. Shows nothing if stderr is not a terminal."""

    def __init__(self, stopping: Sender) -> None:
        self._stopping = stopping
        self._shows = style.lives(os.environ, terminal=sys.stderr.isatty())
        self._began_s = self._next_s = time.monotonic()

    def show(self) -> None:
        """Update the line, unless it was updated less than PROGRESS_S ago."""
        now_s = time.monotonic()
        if not self._shows or now_s < self._next_s:
            return
        self._next_s = now_s + PROGRESS_S
        tally, problem = self._stopping.tally, self._stopping.broker.problem
        self._write(report.progress(tally, problem, now_s - self._began_s))

    def clear(self) -> None:
        """Remove the line."""
        if self._shows:
            self._write("")

    def _write(self, text: str) -> None:
        with contextlib.suppress(OSError, ValueError):
            columns = os.get_terminal_size(2).columns or style.NO_TERMINAL_COLUMNS
            sys.stderr.write(f"\r\x1b[K{style.cut(text, columns - 1)}")
            sys.stderr.flush()


def _check_gone(robot: Robot, broker: Broker) -> None:
    """Raise FleetError if the robot is still alive, or if the connection to the broker is lost. If the broker reports
    the robot as connected, wait for a message of the robot itself. The broker's report proves nothing, because it stays
    forever if the robot is switched off while the broker is down."""

    def over() -> bool:
        gone = robot.connection in (message.OFFLINE, message.LOST)
        return gone or robot.sign_s is not None or bool(broker.problem)

    limit_s = 0.0
    if not over():
        limit_s = robot.silent_after_s()
        standard.say(f"the broker reports {robot.id} as connected; waiting up to {limit_s:.0f} s for a sign of life")
    _listen(broker, limit_s, over)
    if broker.problem:
        raise FleetError(broker.problem)
    if robot.connection not in (message.OFFLINE, message.LOST) and robot.sign_s is not None:
        raise FleetError(
            f"{robot.id} is connected: end its publisher first, or the robot reappears with its next message"
        )


def _forget(arguments: Namespace) -> int:
    found, name = _settings(arguments), arguments.robot
    roster, broker = _seen(found)
    with closing(broker):
        _listen(broker, CONNECT_S, lambda: broker.listening)
        # Wait for its connection too, because its state may arrive first.
        _listen(broker, LIST_S, lambda: any(each.id == name and each.connection for each in roster.robots.values()))
        if broker.problem:
            raise FleetError(broker.problem)
        known = {robot.id: in_topic for in_topic, robot in roster.robots.items()}
        if (in_topic := known.get(name)) is None:
            raise FleetError(f"the broker at {broker.where} knows no robot {name!r}")
        _check_gone(roster.robots[in_topic], broker)
        fleet = found.text("robot.fleet")
        for last in (topics.CONNECTION, topics.STATE, topics.EVENT):
            broker.say(topics.of_robot(fleet, in_topic, last), b"", retain=True)
        _listen(broker, LIST_S, lambda: in_topic not in roster.robots)
        if in_topic in roster.robots:  # a broker may drop a message without telling its sender
            where = topics.of_robot(fleet, name, "#")
            raise FleetError(
                broker.problem or f"the broker still knows {name}: its access list must let you read and write {where}"
            )
    if _listed(found, name):
        standard.print_line(
            f"{name} is forgotten by the broker, but a fleet stop still waits for it: remove it from "
            f"stop.robots_file {found.text('stop.robots_file')} too"
        )
    else:
        standard.print_line(f"{name} is forgotten: a fleet stop no longer waits for it")
    return 0


def _listed(found: FleetSettings, name: str) -> bool:
    """Return True if stop.robots_file lists the robot. False if that file can't be read: then a fleet stop doesn't use
    it either."""
    with contextlib.suppress(FleetError):
        return name in (settings.robots(found) or ())
    return False


ACTIONS: dict[str, tuple[Callable[[Namespace], int], str]] = {
    "watch": (_watch, "show every robot, live; the same as `failstop fleet`"),
    "list": (_list, "list every robot, once"),
    "stop": (_stop, "stop all robots, and show which of them have not confirmed the stop"),
    "publish": (_publish, "publish this robot's state, and obey fleet stops; run it on each robot"),
    "key": (_key, "make the fleet's key; do this once, then copy the key to every robot"),
    "forget": (_forget, "make the broker forget a robot that is gone for good"),
    "config": (_config, "print a file with every setting of the fleet at its default"),
}
