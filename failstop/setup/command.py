"""`failstop setup`: asks about the robot, turns its wheels, tests its stops, and writes the settings file."""

from __future__ import annotations

import contextlib
import os
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping
from typing import Any

from failstop.board.kinds import board_of
from failstop.cli import style
from failstop.cli.commands import add_name
from failstop.doctor.system import System
from failstop.files import instance
from failstop.policy.layouts import BOARDS, NUMBERS, drivable, speeds_of
from failstop.policy.setting import SettingError
from failstop.policy.settings import Settings
from failstop.setup import boards, finish, ports, robots, sizes
from failstop.setup.draft import Draft
from failstop.setup.ending import interruptible
from failstop.setup.halt import Halt
from failstop.setup.talk import NO, YES, Left, Talk, one_of, option, word_of, yes_or_no
from failstop.setup.wheels import Trial
from failstop.supervisor.fit import checked_board

EXAMPLES = """\
failstop setup                         # takes about ten minutes
failstop setup --port /dev/ttyUSB0     # asks everything except for the port
failstop setup --afresh                # forgets earlier answers
"""
QUESTIONS = {
    "port": "the board's port",
    "board": f"the kind of board: {', '.join(BOARDS)}, or your own board's folder",
    "can_id": "the CAN id of the second VESC, or none if the robot has one motor",
    "robot": "the robot, by its number or name in the list that setup prints, or other if it is not in the list",
    "layout": f"the kind of base, if failstop does not know the robot: {', '.join(sizes.OF_LAYOUT)}",
    "stand": "yes: the wheels are off the ground and can turn freely",
    "per_rps": "how many of the board's speed units make one wheel turn per second (on an Arduino: the encoder counts "
    "of one wheel turn, divided by 30), or unknown. With a number you need not turn a wheel by hand, but the speed "
    "stays capped, because nobody has confirmed it",
    **{
        f"wheel_{number - 1}": f"which wheel the motor with id {number - 1} turned, and which way: fl+ means front "
        "left, forward (left+ on a robot with two wheels)"
        for number in NUMBERS
    },
    "forward": "yes: every wheel turned forward when all wheels turned together",
    "turn": "yes: the wheels turned as they must for a turn to the left",
    **sizes.OPTIONS,
    "prove": "yes: do the stand test without asking; no: skip it",
    "unproved": "yes: write the settings even if the stand test did not pass",
    "file": "where to write the settings",
    "replace": "replace: overwrite the file if it exists (a copy of the old file is kept)",
}
"""The keys of the setup's questions, each with the help text of the command-line option that answers the question."""
ROWS_SAY = "see the rows above; usual reasons are a loose plug or a wrong size"
REMEDIES = {
    "INVALID": "this computer was too busy to judge: end other programs, then run it again",
    finish.NO_RESULT: "its last message says why, and what to do",
}
"""What to do after a stand test that did not pass, by the test's verdict. ROWS_SAY is shown for a verdict that is not
in this table."""
UNMOVED = "no wheel was turned"
NOTHING = "no settings were written"


def add_arguments(parser: ArgumentParser) -> None:
    """Add the options of `failstop setup` to its parser."""
    for key, what in QUESTIONS.items():
        parser.add_argument(option(key), dest=key, metavar="ANSWER", help=what.replace("%", "%%"))
    parser.add_argument(
        "--afresh",
        action="store_true",
        help="start from the beginning, and forget the answers of a setup that you left early",
    )
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Hold the whole conversation. Returns the exit code. Raises Left with a text that says what is wrong and what to
    do next."""
    draft = Draft(instance.check_name(arguments.name), os.environ)
    if arguments.afresh:
        draft.forget()
    given = {key: value for key in QUESTIONS if (value := getattr(arguments, key)) is not None}
    talk = Talk(given, draft, silent=not sys.stdin.isatty())
    halts: list[Halt] = []
    again = f"run `failstop setup{instance.option(arguments.name)}` again to go on from here"
    try:
        with interruptible():
            _converse(talk, arguments.name, halts)
    except KeyboardInterrupt:
        with contextlib.suppress(OSError):
            print()
        kept = "" if draft.unwritten else f"; {again}"
        known = next((halt.last for halt in halts), None)
        raise Left(f"{known.sentence() if known else UNMOVED}; {NOTHING}{kept}") from None
    except (Left, SettingError) as error:
        kept = f"; your answers could not be kept ({draft.unwritten})" if draft.unwritten else f"; {again}"
        raise Left(f"{error}; {NOTHING}{kept}") from None
    return 0


def _converse(talk: Talk, name: str, halts: list[Halt]) -> None:
    """Go through the six steps. The board's Halt is appended to `halts` once the board is known, so that the caller can
    report how the newest stop went."""
    style.show([[("failstop setup", style.STRONG), (": set up a robot and test its stops, in six steps", style.PLAIN)]])
    talk.say("Ctrl-C stops the wheels and quits, and keeps your answers. You see the settings before they are written.")
    _resume(talk)
    device = ports.step(talk, System())
    kind, found = boards.step(talk, device)
    robot, values, known = _robot(talk, kind)
    values = {**values, **found}
    board = board_of(*Settings(dict(values)).board())
    halt = Halt(device, board, lambda text: talk.say(text, style.FAIL))
    halts.append(halt)
    wheels = Trial(talk, device, values, halt).step()
    chosen = sizes.step(talk, {**values, **wheels}, known=known)
    settings = {"device.path": ports.stable(device), **values, **wheels, **chosen}
    checked_board(Settings(dict(settings)), None)  # as the service does when it starts
    finish.watchdog(talk, kind)
    evidence = _prove(talk, settings, device, name, halt)
    path = finish.write(talk, finish.text(settings, robot, evidence), name)
    talk.draft.forget()
    finish.doctor(talk, path, device, name)
    finish.closing(talk, path, name, evidence, settings)


def _prove(talk: Talk, settings: Mapping[str, object], device: str, name: str, halt: Halt) -> Mapping[str, Any]:
    """Run the stand test, and again if it did not pass and the person wants to. Returns its evidence, which is empty if
    the person skips the test. Raises Left if the test did not pass and the settings must not be written."""
    evidence = finish.proof(talk, settings, device, name, halt)
    while evidence and not evidence["passed"]:
        talk.warn(f"The stand test ended with {evidence['verdict']}.", REMEDIES.get(evidence["verdict"], ROWS_SAY))
        if talk.silent or not talk.agreed("repeat", "Run it again? (yes, no)", YES):
            if talk.agreed("unproved", "Write the settings anyway? (yes, no)", NO):
                break
            if evidence["verdict"] == finish.FAILED:
                talk.draft.forget_tested()
                talk.say(
                    "The next setup asks about the wheels, sizes and limits again, because one of these answers may be "
                    "wrong."
                )
            wheels = f"; {halt.last.sentence()}" if halt.last else ""
            raise Left(f"the robot did not pass the stand test{wheels}")
        evidence = finish.proof(talk, settings, device, name, halt) or evidence
    return evidence


def _resume(talk: Talk) -> None:
    """Show the answers of a setup that was left early, and ask whether to continue with them. After a no, delete the
    answers. Without a terminal, keep them."""
    answers = talk.draft.answers
    if not answers:
        return
    said = ", ".join(f"{key.replace('_', ' ')} {answer}" for key, answer in answers.items())
    talk.say(f"You left a setup early, with these answers: {said}.")
    if (
        not talk.silent
        and talk.ask("take_up", "Go on with it? (yes; no: start from the beginning)", YES, yes_or_no, keep=False) != YES
    ):
        talk.draft.forget()


def layouts_of(kind: str) -> list[str]:
    """Return the kinds of base that a board of this kind can drive."""
    return drivable(kind, speeds_of(kind) or board_of(kind, 1.0, 0.0).wheels)


def _robot(talk: Talk, kind: str) -> tuple[str, dict[str, object], bool]:
    """Ask which robot this is. If setup does not know the robot, ask what kind of base it has. `kind`: the kind of the
    robot's board. Returns the robot's name, its known settings, and True if its sizes are known."""
    known = robots.of_kind(kind)
    choices = {**{key: robot.name for key, robot in known.items()}, robots.OTHER: "another one"}
    chosen = robots.OTHER
    if known:
        sizes_known = not any(robot.measure for robot in known.values())
        talk.say("Which robot is it? For these, failstop knows the sizes." if sizes_known else "Which robot is it?")
        for number, (key, what) in enumerate(choices.items(), 1):
            talk.say(f"{number}  {key:<16} {what}")
        chosen = talk.ask("robot", "Which number is your robot?", "", one_of(choices))
    if chosen in known:
        for remark in filter(None, (known[chosen].remark, known[chosen].measure)):
            talk.say(remark, style.WARN)
        return known[chosen].name, known[chosen].settings, not known[chosen].measure
    layouts = layouts_of(kind)
    if len(layouts) == 1:
        return f"A robot with the board {kind}", {"board.kind": kind, "wheels.layout": layouts[0]}, False
    layout = talk.ask("layout", f"What kind of drive does it have? ({', '.join(layouts)})", "", word_of(layouts))
    return f"A robot with the board {kind}", {"board.kind": kind, "wheels.layout": layout}, False
