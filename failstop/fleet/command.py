"""`failstop fleet`: the robots of a broker - see them, stop all of them, publish this one."""

from __future__ import annotations

import errno
import getpass
import json
import os
import secrets
import signal
import socket
import time
from argparse import SUPPRESS, ArgumentParser, Namespace
from collections.abc import Callable
from contextlib import closing

from failstop.api import words
from failstop.cli import standard, style
from failstop.cli.commands import add_name
from failstop.cli.screen.terminal import Terminal
from failstop.files import instance
from failstop.fleet import FleetError, publisher, report, settings, signed, topics, view
from failstop.fleet.broker import Broker
from failstop.fleet.roster import Roster
from failstop.fleet.sender import Sender
from failstop.fleet.settings import FleetSettings
from failstop.notify import Notify

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
    below = parser.add_subparsers(dest="action", metavar="ACTION")
    actions = {name: below.add_parser(name, help=what) for name, (_, what) in ACTIONS.items()}
    stop = actions["stop"].add_argument
    stop("reason", nargs="*", help="why; each robot shows it")
    stop("--by", metavar="NAME", help="who stops them (default: USER@HOST)")
    stop("--wait", type=float, default=5.0, metavar="S", help="how long to try (default: 5)")
    for name in ("list", "stop"):
        actions[name].add_argument("--json", action="store_true", help="for programs")
    actions["forget"].add_argument("robot", help="its name in the fleet")
    add_name(actions["publish"])
    del actions["config"]
    for name, action in {"": parser, **actions}.items():
        default = SUPPRESS if name else None
        action.add_argument("--config", metavar="FILE", default=default, help="settings of the fleet, as TOML")
        if name != "key":
            action.add_argument("--broker", metavar="HOST[:PORT]", default=default, help="where the broker is")


def main(arguments: Namespace) -> int:
    """Carry out one action. Raises FleetError, SettingError."""
    return ACTIONS[arguments.action or "watch"][0](arguments)


def _settings(arguments: Namespace) -> FleetSettings:
    changed: dict[str, object] = {}
    if broker := getattr(arguments, "broker", None):
        host, colon, port = broker.rpartition(":")
        if colon and port.isdigit():
            changed = {"broker.host": host.strip("[]"), "broker.port": int(port)}
        else:
            changed = {"broker.host": broker}
    return settings.load(arguments.config, changed)


def _publish(arguments: Namespace) -> int:
    found = _settings(arguments)
    instance.check_name(arguments.name)
    service = publisher.Service(arguments.name)
    robot = found.robot_id(arguments.name)
    publishing = publisher.Publisher(found, arguments.name, service, robot, publisher.store(arguments.name))
    manager = Notify.taken_from(os.environ, os.getpid())
    ended: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda by, _: ended.append(by))
    standard.say(f"publishing {arguments.name!r} as {robot} at {publishing.broker.where}")
    said = None
    while not ended:
        publishing.turn()
        if (deaf := publishing.deaf()) != said:
            said = deaf
            manager.say(_status(deaf))
    publishing.close()
    return 0


def _status(deaf: str) -> str:
    """The status that `systemctl status` shows and `failstop doctor` reads."""
    text = f"obeys no fleet stop: {words.printable(deaf)}" if deaf else "obeys a fleet stop"
    return f"STATUS={text}\nERRNO={errno.ENOTCONN if deaf else 0}"


def _key(arguments: Namespace) -> int:
    path = _settings(arguments).text("stop.key_file")
    signed.make_key(path)
    standard.tell(f"{path} is the fleet's key: copy it to every robot, and to who may stop them")
    return 0


def _config(_: Namespace) -> int:
    print(settings.example(), end="")
    return 0


def _seen(found: FleetSettings) -> tuple[Roster, Broker]:
    """A roster, and the connection that fills it."""
    roster = Roster()

    def hear(topic: str, payload: bytes, retained: bool) -> None:
        roster.hear(topic, payload, time.monotonic(), retained=retained)

    manufacturer = found.text("robot.manufacturer")
    wanted = [topics.of_robot(manufacturer, topics.ANY, last) for last in (topics.CONNECTION, topics.STATE)]
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
            terminal.draw(view.lines(roster.sorted(), broker.where, broker.problem, *now, *size))
    return 128 + terminal.ended if terminal.ended else 0


def _list(arguments: Namespace) -> int:
    roster, broker = _seen(_settings(arguments))
    with closing(broker):
        _listen(broker, LIST_S)
    if broker.problem and not roster.robots:
        raise FleetError(broker.problem)
    robots, now_s, unix_s = roster.sorted(), time.monotonic(), time.time()
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
    by = arguments.by or f"{getpass.getuser()}@{socket.gethostname()}"
    sender = Sender(_settings(arguments), " ".join(arguments.reason), by)
    done = sender.run(arguments.wait)
    if sender.broker.denied:
        standard.say(f"the broker does not let you read {' and '.join(sender.broker.denied)}: see its access list")
    if arguments.json:
        print(json.dumps(report.as_dict(sender.tally), indent=2))
    else:
        style.show(report.lines(sender.tally))
    return 0 if done else 1


def _forget(arguments: Namespace) -> int:
    found, name = _settings(arguments), arguments.robot
    roster, broker = _seen(found)
    with closing(broker):
        _listen(broker, LIST_S, lambda: name in (robot.id for robot in roster.robots.values()))
        if broker.problem:
            raise FleetError(broker.problem)
        known = {robot.id: in_topic for in_topic, robot in roster.robots.items()}
        if (in_topic := known.get(name)) is None:
            raise FleetError(f"no robot {name!r} is known to the broker at {broker.where}")
        if not roster.robots[in_topic].lost():
            raise FleetError(f"{name} is connected: end its publisher first, or it is back at its next message")
        for last in (topics.CONNECTION, topics.STATE, topics.EVENT):
            broker.say(topics.of_robot(found.text("robot.manufacturer"), in_topic, last), b"", retain=True)
        _listen(broker, LIST_S, lambda: in_topic not in roster.robots)
    standard.tell(f"{name} is forgotten: a fleet stop does not miss it any more")
    return 0


ACTIONS: dict[str, tuple[Callable[[Namespace], int], str]] = {
    "watch": (_watch, "every robot, live; the same as `failstop fleet`"),
    "list": (_list, "every robot, once"),
    "stop": (_stop, "stop all of them, and say who has not confirmed"),
    "publish": (_publish, "publish this robot, and obey a stop of the fleet"),
    "key": (_key, "make the fleet's key, once"),
    "forget": (_forget, "take a robot that is gone for good off the broker"),
    "config": (_config, "a file of settings, every value its default"),
}
