"""`failstop probe`: does your robot stop? Any base, measured without adopting failstop, and a card of it."""

from __future__ import annotations

import dataclasses
import json
import os
import sys
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping

from failstop import config
from failstop.api.errors import FailstopError, Refused
from failstop.board.driver import language_of
from failstop.board.interface import Board
from failstop.board.kinds import board_of
from failstop.board.port import PortError
from failstop.cli import style
from failstop.policy.halted import OF_CTRL_C, Halted
from failstop.policy.layouts import BOARDS
from failstop.policy.settings import BAUDS
from failstop.ros2.command import find_rclpy
from failstop.setup.ending import interruptible
from failstop_lab.probe import judge, ros2, serial
from failstop_lab.probe.card import Card, Row
from failstop_lab.probe.guard_port import GuardProbe
from failstop_lab.prove.session import check_free
from failstop_lab.sim.options import add_board

EXAMPLES = """\
failstop probe serial --board ugv --port /dev/ttyAMA0
failstop probe serial --board ugv --port /dev/ttyAMA0 --key
failstop probe serial --board arduino --port /dev/ttyUSB0 --frame 'm 50 50\\r'
failstop probe serial --board arduino --port /dev/ttyUSB0 --guard
failstop probe ros2 --cmd-vel /cmd_vel --odom /odom
"""
WORD = "spin"
DIAMETER_M = 0.08
WARNING = """\
THIS TURNS THE WHEELS slowly, {count} times, for up to {seconds:.0f} s each{longer}, and makes the program \
that drives them fail. The wheels may keep turning until the probe stops them.

  1. The robot is on a stand: every wheel is OFF THE GROUND and free to turn.
  2. No person, hair, clothing, cable or tool is near the wheels.
  3. The POWER SWITCH is at hand.

Ctrl-C stops the wheels.{others}
Type "{word}" to begin, or anything else to quit:"""
DRIVES_ON = " `failstop stop` does not: the driver under test writes its speed again."
LONGER = " (longer when you pull the plug: they may turn until you plug it in again)"
ENDED_BY_PERSON = "interrupted"
NEVER_TURNED = "no wheel was turned"


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop probe`."""
    ways = parser.add_subparsers(dest="way", required=True, metavar="serial|ros2")
    by_port = ways.add_parser("serial", help="measure a motor board on a serial port")
    by_ros = ways.add_parser("ros2", help="measure a robot that obeys cmd_vel")
    add_board(by_port, None, "the kind of board: {}")
    add = by_port.add_argument
    add("--port", required=True, metavar="PATH", help="the board's port")
    add(
        "--baud", type=int, default=0, metavar="RATE", help="the firmware's baud rate (default: the board's usual rate)"
    )
    add(
        "--frame",
        metavar="TEXT",
        help=r"the bytes that your driver sends, as text with \n or as hexadecimal digits after 0x (default: the "
        "board's own frame for slow wheels)",
    )
    add(
        "--guard",
        action="store_true",
        help="then measure again through failstop's guard port, and show that in a second column",
    )
    add = by_ros.add_argument
    add(
        "--cmd-vel",
        default="/cmd_vel",
        metavar="TOPIC",
        help="the topic that the robot takes velocity commands from (default: %(default)s)",
    )
    add("--odom", default="/odom", metavar="TOPIC", help="the topic with the robot's odometry (default: %(default)s)")
    add(
        "--imu",
        metavar="TOPIC",
        help="the topic of an IMU that judges instead of the odometry, because some odometry only repeats the commands",
    )
    add("--stamped", action="store_true", help="publish TwistStamped instead of Twist")
    add(
        "--driver-pid",
        type=int,
        metavar="PID",
        help="the pid of the robot's driver; the row `driver` needs it, because there the probe kills the driver",
    )
    for way, rows in ((by_port, serial.ROWS), (by_ros, ros2.ROWS)):
        add = way.add_argument
        add("--rows", metavar="ROW,...", help=f"measure only these failures: {', '.join(rows)}")
        add("--key", action="store_true", help="judge by eye: you press a key when the wheels have stopped")
        add("--robot", default="", metavar="TEXT", help="the robot's name, for the result card")
        add("--firmware", default="", metavar="TEXT", help="the firmware and its version, for the result card")
        add("--driver", default="", metavar="TEXT", help="the driver and its version, for the result card")
        add(
            "--out",
            metavar="BASE",
            help="write the result card to BASE.txt, BASE.json and BASE.svg (default: card-DATE)",
        )
        add("--json", action="store_true", help="print the result card as JSON")
        add("--yes", action="store_true", help="don't ask for consent, because the wheels are off the ground")


def main(arguments: Namespace) -> int:
    """Probe, and print the card; exit code 1 when a row never stopped or was not measured, 2 without consent. With
    --guard the guard port decides."""
    if arguments.key and not judge.somebody():
        raise FailstopError("--key needs a terminal, because your key is read there: start the probe in one")
    card, code = _serial(arguments) if arguments.way == "serial" else _ros2(arguments)
    print(json.dumps(card.as_dict(), indent=1) if arguments.json else f"\n{card.text()}", end="\n" * arguments.json)
    base = arguments.out or f"card-{time.strftime('%Y%m%d-%H%M%S')}"
    try:
        for path in card.save(base):
            print(f"card: {os.path.relpath(path)}", file=sys.stderr)
    except OSError as error:
        print(f"failstop: the card could not be saved: {error}", file=sys.stderr)
    shown = [row.guarded or row for row in card.rows]
    return code or int(bool(card.ended) or any(row.never or row.unjudged for row in shown))


def _ended(card: Card, known: Halted | None, error: BaseException | None) -> int:
    """Say on the card why it ended early, if it did, and what is known of the wheels. Returns the exit code of that, or
    0."""
    if isinstance(error, KeyboardInterrupt):
        card.ended = f"{ENDED_BY_PERSON}; {known.sentence() if known else NEVER_TURNED}"
        return known.interrupted() if known else OF_CTRL_C
    if error or (known and not known.safe):
        card.ended = "; ".join([*([str(error)] if error else []), *([known.sentence()] if known else [])])
        return 1
    return 0


def _say(text: str) -> None:
    style_line = style.wrap([(text, style.PLAIN)], min(80, style.width()), 2)
    print("\n".join(map(style.plain, style_line)), file=sys.stderr, flush=True)


def _consent(arguments: Namespace, count: int, longer: str = "", others: str = "") -> None:
    if arguments.yes:
        return
    style.warn(WARNING.format(seconds=15, count=count, longer=longer, others=others, word=WORD), end=" ")
    if sys.stdin.readline().strip() != WORD:
        raise Refused("no consent: nothing was moved")


def _rows(given: str | None, known: Mapping[str, str]) -> list[str]:
    """The names of --rows. Raises FailstopError."""
    names = given.split(",") if given else list(known)
    for name in names:
        if name not in known:
            raise FailstopError(f"no row {name!r}: the rows are {', '.join(known)}")
    return names


def _frame(text: str) -> bytes:
    """The bytes of --frame. Raises FailstopError."""
    try:
        return (
            bytes.fromhex(text[2:])
            if text.startswith("0x")
            else text.encode().decode("unicode_escape").encode("latin1")
        )
    except (ValueError, UnicodeError):
        raise FailstopError(rf"--frame {text}: write hexadecimal digits after 0x, or text with \n") from None


def _serial(arguments: Namespace) -> tuple[Card, int]:
    if not arguments.board:
        raise FailstopError(
            f"which board is it? Give --board with {', '.join(BOARDS)}, or the path of your own board's folder"
        )
    if arguments.baud not in BAUDS:
        raise FailstopError(f"--baud {arguments.baud}: it must be one of {', '.join(map(str, BAUDS[1:]))}")
    board = board_of(arguments.board, DIAMETER_M, 0.0, baud=arguments.baud)
    sent = _frame(arguments.frame) if arguments.frame else serial.frame_of(board)
    names = _rows(arguments.rows, serial.ROWS)
    if arguments.guard and arguments.key:
        raise FailstopError(
            "--guard and --key: leave one of them out, because only the board's reports can judge the guard port"
        )
    if arguments.guard and language_of(arguments.board, config.load(None).flat()) is None:
        raise FailstopError(f"--guard: {arguments.board} does not say what a driver may write to it (docs/guard.md)")
    if not os.path.exists(arguments.port):
        raise FailstopError(f"no port {arguments.port}: plug the board in; `failstop doctor --quick` lists ports")
    check_free(arguments.port)
    if doubt := serial.check_kind(arguments.port, arguments.board, arguments.baud):
        _say(f"This may not be {arguments.board}: {doubt}.")
    longer = LONGER if "plug" in names and sys.stdin.isatty() else ""
    _consent(arguments, len(names) * (2 if arguments.guard else 1) + 1, longer, DRIVES_ON)
    driver = arguments.driver or f"a throw-away process, one frame every {serial.PERIOD_S:g} s"
    card = Card(arguments.robot, arguments.board, arguments.firmware, driver)
    probe = serial.SerialProbe(arguments.port, arguments.board, board, sent, by_key=arguments.key, say=_say)
    try:
        with interruptible(), probe:
            _say("first, what the board reports while its wheels are still and while they turn ...")
            probe.character()
            for name in names:
                if name == "plug" and not sys.stdin.isatty():
                    card.rows.append(Row(name, serial.ROWS[name], skipped="nobody to pull it"))
                    continue
                _say(f"{serial.ROWS[name]} ...")
                card.rows.append(row := probe.run_row(name))
                _say(f"   {row.found}")
    except (KeyboardInterrupt, FailstopError, PortError, OSError) as error:
        return card, _ended(card, probe.outcome, error)
    code = _ended(card, probe.outcome, None)
    return card, code or (_guarded(arguments, board, sent, probe, card) if arguments.guard else 0)


def _guarded(arguments: Namespace, board: Board, sent: bytes, probe: serial.SerialProbe, card: Card) -> int:
    """The second column; the exit code of its end, or 0."""
    if probe.by == judge.PERSON or probe.unjudged:
        card.ended = "the guard port was not measured, because the board's reports don't show whether its wheels turn"
        return 1
    _say("now the same through the guard port; a service starts ...")
    column = GuardProbe(arguments.port, arguments.board, arguments.baud, board, sent, probe.shaking, _say)
    try:
        with interruptible(), column:
            for at, row in enumerate(card.rows):
                _say(f"{row.words} ...")
                found = column.run_row(row.name)
                card.rows[at] = dataclasses.replace(row, guarded=found)
                _say(f"   {found.found}")
    except KeyboardInterrupt as error:
        return _ended(card, column.outcome or probe.outcome, error)
    except (FailstopError, OSError) as error:
        return _ended(card, column.outcome or probe.outcome, FailstopError(f"at the guard port: {error}"))
    return _ended(card, column.outcome, None)


def _ros2(arguments: Namespace) -> tuple[Card, int]:
    names = _rows(arguments.rows, ros2.ROWS)
    # A number below 1 would mean more than one process.
    if (pid := arguments.driver_pid) is not None and (pid < 1 or not os.path.exists(f"/proc/{pid}")):
        raise FailstopError(f"no process has the pid {pid}; `ps -ef` lists all processes")
    find_rclpy()
    _consent(arguments, len(names))
    card = Card(arguments.robot, f"behind {arguments.cmd_vel}", arguments.firmware, arguments.driver or "a ROS 2 node")
    probe = ros2.RosProbe(arguments, _say)
    try:
        with interruptible(), probe:
            for row in probe.rows(names):
                card.rows.append(row)
                _say(f"   {row.found}")
    except (KeyboardInterrupt, FailstopError, OSError) as error:
        return card, _ended(card, probe.outcome, error)
    return card, _ended(card, probe.outcome, None)
