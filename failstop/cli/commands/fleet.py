"""`failstop fleet`: the robots of a broker - see them, stop all of them, publish this one."""

from __future__ import annotations

import signal
import time
from argparse import SUPPRESS

from failstop.cli.commands import add_name

TYPE_CHECKING = False
if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace
    from types import FrameType

    from failstop.fleet.settings import FleetSettings

EXAMPLES = """\
failstop fleet                       # every robot, live
failstop fleet stop smoke in hall 2  # all; says who has not confirmed
failstop fleet key                   # once: then copy it to all of them
failstop fleet publish               # on the robot
"""


WATCH_S = 0.25
"""Between two pictures."""
LIST_S = 1.5
"""How long the broker may take to say what it knows."""


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop fleet`."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION")
    watch = actions.add_parser("watch", help="every robot, live; the same as `failstop fleet`")
    listing = actions.add_parser("list", help="every robot, once")
    listing.add_argument("--json", action="store_true", help="for programs")
    stop = actions.add_parser("stop", help="stop all of them, and say who has not confirmed")
    stop.add_argument("reason", nargs="*", help="why; each robot shows it")
    stop.add_argument("--by", metavar="NAME", help="who stops them (default: USER@HOST)")
    stop.add_argument("--wait", type=float, default=5.0, metavar="S", help="how long to try (default: 5)")
    stop.add_argument("--json", action="store_true", help="for programs")
    publish = actions.add_parser("publish", help="publish this robot, and obey a stop of the fleet")
    add_name(publish)
    key = actions.add_parser("key", help="make the fleet's key, once")
    forget = actions.add_parser("forget", help="take a robot that is gone for good off the broker")
    forget.add_argument("robot", help="its name in the fleet")
    config = actions.add_parser("config", help="a file of settings, every value its default")
    for action in (parser, watch, listing, stop, publish, key, forget):
        default = None if action is parser else SUPPRESS
        action.add_argument("--config", metavar="FILE", default=default, help="settings of the fleet, as TOML")
        if action is not key:
            action.add_argument("--broker", metavar="HOST[:PORT]", default=default, help="where the broker is")
    del config


def main(arguments: Namespace) -> int:
    """Carry out one action. Raises FleetError, SettingError."""
    return {
        None: _watch,
        "watch": _watch,
        "list": _list,
        "stop": _stop,
        "publish": _publish,
        "key": _key,
        "forget": _forget,
        "config": _config,
    }[arguments.action](arguments)


def _settings(arguments: Namespace) -> FleetSettings:
    from failstop.fleet import settings

    changed: dict[str, object] = {}
    if broker := getattr(arguments, "broker", None):
        host, colon, port = broker.rpartition(":")
        if colon and port.isdigit():
            changed["broker.port"] = int(port)
            changed["broker.host"] = host.strip("[]")
        else:
            changed["broker.host"] = broker
    return settings.load(arguments.config, changed)


def _publish(arguments: Namespace) -> int:
    from failstop.cli import standard
    from failstop.fleet import publisher
    from failstop.shm import instance

    found = _settings(arguments)
    instance.check_name(arguments.name)
    service = publisher.Service(arguments.name)
    robot = found.robot_id(arguments.name)
    publishing = publisher.Publisher(found, arguments.name, service, robot, publisher.store(arguments.name))
    ended = _Ended()
    standard.say(f"publishing {arguments.name!r} as {robot} at {publishing.broker.where}")
    while not ended.by:
        publishing.turn()
    publishing.close()
    return 0


class _Ended:
    """The signal that asked to end; 0: none has."""

    def __init__(self) -> None:
        self.by = 0
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._note)

    def _note(self, number: int, _frame: FrameType | None) -> None:
        self.by = number


def _key(arguments: Namespace) -> int:
    from failstop.cli import standard
    from failstop.fleet import signed

    path = _settings(arguments).text("stop.key_file")
    signed.make_key(path)
    standard.tell(f"{path} is the fleet's key: copy it to every robot, and to who may stop them")
    return 0


def _config(_: Namespace) -> int:
    from failstop.fleet import settings

    print(settings.example(), end="")
    return 0


class _Seen:
    """A connection that fills a roster."""

    def __init__(self, found: FleetSettings) -> None:
        import secrets

        from failstop.fleet import topics
        from failstop.fleet.broker import Broker
        from failstop.fleet.roster import Roster

        manufacturer = found.text("robot.manufacturer")
        wanted = tuple(topics.of_robot(manufacturer, topics.ANY, last) for last in (topics.CONNECTION, topics.STATE))
        self.roster = Roster()
        self.broker = Broker(found, f"failstop-view-{secrets.token_hex(6)}", wanted, self._hear)

    def _hear(self, topic: str, payload: bytes, retained: bool) -> None:
        self.roster.hear(topic, payload, time.monotonic(), retained=retained)


def _watch(arguments: Namespace) -> int:
    from failstop.cli.screen.terminal import Terminal
    from failstop.fleet import view

    seen = _Seen(_settings(arguments))
    with Terminal() as terminal:
        while not terminal.ended:
            if b"q" in terminal.wait(0.0).lower():
                break
            if terminal.stopped:
                terminal.suspend()
            until_s = time.monotonic() + WATCH_S
            while (now_s := time.monotonic()) < until_s:
                seen.broker.turn(until_s - now_s)
            robots = seen.roster.sorted()
            broker = seen.broker
            shown = view.lines(
                robots, broker.where, broker.problem, now_s, time.time(), terminal.columns, terminal.rows
            )
            terminal.draw(shown)
    seen.broker.close()
    return 128 + terminal.ended if terminal.ended else 0


def _list(arguments: Namespace) -> int:
    import json

    from failstop.cli import style
    from failstop.fleet import FleetError, view

    seen = _Seen(_settings(arguments))
    until_s = time.monotonic() + LIST_S
    while (now_s := time.monotonic()) < until_s:
        seen.broker.turn(min(0.1, until_s - now_s))
    seen.broker.close()
    if seen.broker.problem and not seen.roster.robots:
        raise FleetError(seen.broker.problem)
    robots, unix_s = seen.roster.sorted(), time.time()
    if arguments.json:
        rows = [
            {**vars(robot), "word": view.word(robot), "age_s": robot.age_s(now_s, unix_s), "heard_s": None}
            for robot in robots
        ]
        print(json.dumps(rows, indent=2))
    else:
        style.show([view.counts(robots), *(view.table(robots, now_s, unix_s) if robots else [])])
    return 0


def _stop(arguments: Namespace) -> int:
    import getpass
    import json
    import socket

    from failstop.cli import style
    from failstop.fleet import report
    from failstop.fleet.sender import Sender

    by = arguments.by or f"{getpass.getuser()}@{socket.gethostname()}"
    sender = Sender(_settings(arguments), " ".join(arguments.reason), by)
    done = sender.run(arguments.wait)
    if arguments.json:
        print(json.dumps(report.as_dict(sender.tally), indent=2))
    else:
        style.show(report.lines(sender.tally))
    return 0 if done else 1


def _forget(arguments: Namespace) -> int:
    from failstop.cli import standard
    from failstop.fleet import FleetError, topics

    found = _settings(arguments)
    seen = _Seen(found)
    until_s = time.monotonic() + LIST_S
    while arguments.robot not in seen.roster.robots and time.monotonic() < until_s:
        seen.broker.turn(0.1)
    if seen.broker.problem:
        raise FleetError(seen.broker.problem)
    robot = seen.roster.robots.get(arguments.robot)
    if robot is None:
        raise FleetError(f"no robot {arguments.robot!r} is known to the broker at {seen.broker.where}")
    if not robot.lost():
        raise FleetError(f"{arguments.robot} is connected: end its publisher first, or it is back at its next message")
    for last in (topics.CONNECTION, topics.STATE, topics.EVENT):
        seen.broker.say(topics.of_robot(found.text("robot.manufacturer"), arguments.robot, last), b"", retain=True)
    until_s = time.monotonic() + LIST_S
    while arguments.robot in seen.roster.robots and time.monotonic() < until_s:
        seen.broker.turn(0.1)
    seen.broker.close()
    standard.tell(f"{arguments.robot} is forgotten: a fleet stop does not miss it any more")
    return 0
