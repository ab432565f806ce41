"""Finish: the last steps of the setup, from the test of the board's own watchdog to the commands that you type next."""

from __future__ import annotations

import contextlib
import difflib
import errno
import itertools
import json
import os
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from types import FrameType
from typing import Any

from failstop import config, helpers
from failstop.api.errors import Refused
from failstop.board.driver import language_of
from failstop.board.kinds import watchdog_of
from failstop.cli import style
from failstop.cli.commands.doctor import screen
from failstop.cli.main import here
from failstop.doctor import table
from failstop.doctor.look import FAIL, WARN, Look
from failstop.files import durable
from failstop.files.instance import DEFAULT_NAME, option
from failstop.files.root import state_directory
from failstop.instances import unit_of
from failstop.policy.proofs import WATCHDOGS
from failstop.policy.settings import Settings
from failstop.setup.halt import WAITS_S, Halt
from failstop.setup.rig import toml
from failstop.setup.talk import NO, YES, Left, NotAnAnswer, Talk, yes_or_no

CONSENT = "spin\n"
"""The word that `failstop prove` wants to read before it turns the wheels."""
FROZEN = "frozen"
GIVES_UP = 3
"""How many signals it takes to kill a hanging command. The first Ctrl-C ends the stand test. If the board is unplugged,
the test then waits until the board is plugged in again, and the second Ctrl-C ends this waiting. So only the third
signal kills the command."""
REPLACE = "replace"
NOT_YET = "service"
"""The doctor's check whose result setup does not show, because this check needs a running service, and the service is
started only after the setup."""
NO_SECOND_NAME = (errno.EPERM, errno.EACCES, errno.EOPNOTSUPP, errno.EMLINK, errno.EXDEV)
"""The errors of os.link if the file system or the kernel (fs.protected_hardlinks) allows no second name."""
RESULT = "result.json"
FAILED = "FAIL"
"""The verdict of a stand test in which the wheels did not do what they should."""
NO_RESULT = "no result"
"""The verdict of a stand test that did not begin, or could not save its result."""


def watchdog(talk: Talk, kind: str) -> None:
    """Tell the person what the board's own watchdog does, or that the board has none. This is the fifth step of the
    setup."""
    talk.step(5, "The board's own watchdog")
    seconds, does = watchdog_of(kind)
    if not seconds:
        talk.say(
            "This board has none. If this computer freezes or the cable is pulled, it keeps its last speed forever."
        )
        talk.warn("Only the power switch helps then.", "keep it within reach")
        return
    talk.say(f"It acts {seconds:g} s after the last frame: {WATCHDOGS[does]}. failstop arms it at each start.")
    talk.say("The next step tests it: it freezes the whole service and watches the wheels.")


def proof(talk: Talk, values: Mapping[str, object], device: str, name: str, halt: Halt) -> dict[str, Any]:
    """Run the short stand test with these settings, as the sixth step of the setup. Returns the evidence of the test,
    or an empty dict if the person skips the test. After each test, `halt` stops the wheels once more, because the test
    turned them in another process. Raises Left if nobody can be asked, or if a wheel may still be turning. Raises
    KeyboardInterrupt if a signal such as Ctrl-C has ended the test."""
    talk.step(6, "The proof")
    if not here("prove"):
        talk.warn(
            "The stand test is not installed here, so nothing is proved yet.", fix="sudo apt install failstop-lab"
        )
        talk.say("Then run the stand test with the command shown at the end.")
        return {}
    agreed = talk.ask("prove", "", "", yes_or_no, keep=False) if "prove" in talk.given else ""
    if agreed == NO:
        talk.warn("You skipped the stand test, so nothing is proved yet.", "the command for it is shown at the end")
        return {}
    if talk.silent and not agreed:
        raise Left("there is no terminal to ask you at: give --prove yes, or --prove no")
    talk.say("failstop tests each of the main stop paths once on the robot, which must still be on its stand.")
    folder = os.path.join(state_directory(name, os.environ), "prove")
    before = _runs(folder)
    with tempfile.TemporaryDirectory(prefix="failstop-setup-") as place:
        path = os.path.join(place, "settings.toml")
        with open(path, "w", encoding="utf-8") as file:
            file.write(toml(values))
        words = ["prove", "--quick", "--config", path, "--device", device, "--out", folder, "--name", name]
        sys.stdout.flush()
        whole = helpers.python("failstop", *words)
        code = -signal.SIGKILL
        try:
            code, interrupted = _run(whole, CONSENT if agreed else None)
        finally:
            # If the port is unplugged, the test has already waited for it, so don't wait again.
            known = halt.now(0.0 if code >= 0 else WAITS_S)
    if interrupted or code >= 128 or code < 0:
        raise KeyboardInterrupt
    if not known.safe:
        raise Left(known.sentence())
    for run in sorted(_runs(folder) - before):
        # A disk that is full or broken may have left no result, or half of one.
        with contextlib.suppress(OSError, ValueError):
            with open(os.path.join(folder, run, RESULT), encoding="utf-8") as file:
                found: dict[str, Any] = json.load(file)
            return found
    if code == Refused.exit_code and not agreed:
        return {}
    return {"passed": False, "verdict": NO_RESULT}


def _run(words: list[str], said: str | None) -> tuple[int, bool]:
    """Run a command, write `said` to its input, and wait until it exits. Returns the command's exit code, and True if a
    signal has arrived. After a signal, the caller must exit too.

    Ctrl-C reaches the command directly from the terminal. Every other signal is passed on as SIGTERM. The command stops
    the wheels before it exits, so it is killed only after GIVES_UP signals.
    """
    process = subprocess.Popen(words, stdin=None if said is None else subprocess.PIPE, text=True)

    signals = 0

    def pass_on(number: int, _frame: FrameType | None) -> None:
        nonlocal signals
        signals += 1
        if signals >= GIVES_UP:
            process.kill()
        elif number != signal.SIGINT:
            process.send_signal(signal.SIGTERM)

    before = {number: signal.signal(number, pass_on) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        process.communicate(said)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return process.returncode, signals > 0


def _runs(folder: str) -> set[str]:
    try:
        return {name for name in os.listdir(folder) if os.path.exists(os.path.join(folder, name, RESULT))}
    except OSError:
        return set()


def text(values: Mapping[str, object], robot: str, evidence: Mapping[str, Any]) -> str:
    """Return the text of the settings file. Its head names the robot and the result of the stand test."""
    day = time.strftime("%Y-%m-%d")
    proved = f"stand test: {evidence['verdict']}" if evidence else "not proved yet: run failstop prove"
    head = f"# {robot}.\n# Written by `failstop setup` on {day}.\n# {proved[0].upper()}{proved[1:]}.\n"
    head += "# Every setting: failstop config --example\n\n"
    return head + toml(values)


def write(talk: Talk, made: str, name: str) -> str:
    """Show the settings, ask for a path, and write the settings there. Returns the path. Raises Left."""
    style.show([[], [("The settings", style.STRONG)]])
    style.show([[(f"   {line}", style.PLAIN)] for line in made.splitlines()])
    style.show([[]])
    installed = config.installed(name)
    default = installed if os.access(os.path.dirname(installed), os.W_OK) else os.path.abspath(f"{name}.toml")

    def check(answer: str) -> str:
        if answer.lower() in ("n", NO):
            return NO
        if answer.lower() in ("y", YES) or not answer.isprintable():
            raise NotAnAnswer(f"type a path, or {NO}")
        path = os.path.abspath(os.path.expanduser(answer))
        if not os.access(os.path.dirname(path), os.W_OK):
            raise NotAnAnswer(f"you may not write to {os.path.dirname(path)}: type another path, or {NO}")
        if os.path.lexists(path) and not os.path.isfile(path):
            raise NotAnAnswer(f"{path} is not a file: type another path, or {NO}")
        if os.path.exists(path) and not os.access(path, os.R_OK):
            raise NotAnAnswer(f"you may not read {path}, which would be replaced: type another path, or {NO}")
        return path

    path = talk.ask(
        "file", f"Which file should they be written to? ({NO}: don't write them)", default, check, keep=False
    )
    if path == NO:
        raise Left("you chose not to write the settings")
    if os.path.exists(path):
        _differ(talk, path, made)
        question = f"{path} exists. Replace it with these settings? ({REPLACE}, {NO})"
        if talk.ask("replace", question, "", _replace, keep=False) != REPLACE:
            raise Left(f"{path} was left unchanged")
    try:
        # The service runs as another user, who must be able to read the file.
        durable.write_draft(f"{path}.new", made.encode(), path)
        if os.path.exists(path):
            talk.say(f"The previous settings are in {_keep(path)}.")
        durable.publish(f"{path}.new", path)
    except OSError as error:
        with contextlib.suppress(OSError):
            os.unlink(f"{path}.new")
        raise Left(f"{path} could not be written: {error.strerror}; write to another path") from None
    talk.say(f"Written to {path}.", style.OK)
    return path


def _replace(answer: str) -> str:
    """Check the answer to the question whether a file may be replaced. Only the whole word "replace" allows it, because
    "yes" is typed too easily. Raises NotAnAnswer."""
    if answer.strip() not in (REPLACE, NO):
        raise NotAnAnswer(f"type the whole word {REPLACE}, or {NO}")
    return answer.strip()


def _keep(path: str) -> str:
    """Give a file a second name, so that its content is kept when the first name gets a new file. Copy it if the system
    allows no second name, for example for a file of another user. The second name is FILE.old, or the first FILE.old.N
    that is free. Returns the second name. Raises OSError."""
    for number in itertools.count(1):
        kept = f"{path}.old" if number == 1 else f"{path}.old.{number}"
        with contextlib.suppress(FileExistsError):
            try:
                os.link(path, kept)
            except OSError as error:
                if error.errno not in NO_SECOND_NAME:
                    raise
                with open(path, "rb") as file:
                    durable.write_new(kept, file.read(), path)
            return kept
    raise AssertionError


def _differ(talk: Talk, path: str, made: str) -> None:
    """Show the lines in which the file differs from the new settings. Raises Left."""
    try:
        with open(path, encoding="utf-8", errors="replace") as file:
            before = file.read().splitlines()
    except OSError as error:
        raise Left(f"{path} could not be read: {error.strerror}; write to another path") from None
    for line in list(difflib.unified_diff(before, made.splitlines(), "there", "new", lineterm="", n=0))[2:]:
        if line[:1] in "+-":
            style.show([[(f"   {line}", style.PLAIN)]])


def doctor(talk: Talk, path: str, device: str, name: str) -> None:
    """Run the doctor's quick checks, and show only the problems that they find on this computer."""
    style.show([[], [("This computer, checked by `failstop doctor --quick`", style.STRONG)]])
    looked = table.examine(Look(name, path, device, True))
    found = [row for row in looked if row[1].level in (FAIL, WARN) and row[0] != NOT_YET]
    style.show(screen(found, min(80, style.width())) if found else [[("   nothing to fix", style.OK)]])


def closing(
    talk: Talk, path: str, name: str, evidence: Mapping[str, Any], settings: Mapping[str, object] | None = None
) -> None:
    """Print the summary: what is proved, what is not, and the commands to type next. With `settings`, also show how to
    use the guard port, if failstop has one for this board."""
    style.show([[], [("What is proved", style.STRONG)]])
    rows = evidence.get("rows", [])
    if not rows:
        talk.warn("Nothing yet.", fix=_prove(path, name))
    else:
        passed = sum(row["verdict"] == "PASS" for row in rows)
        talk.say(
            f"{passed} of the {len(rows)} tests of the main stop paths, on this robot with its wheels off the ground.",
            style.OK,
        )
        if any(row["path"] == FROZEN and row["verdict"] == "PASS" for row in rows):
            talk.say("The board's own watchdog stopped the wheels while the whole service was frozen.", style.OK)
    # The evidence names the skipped ones as not proved, with the reason.
    failed = {row["path"]: row["verdict"] for row in rows if row["verdict"] not in ("PASS", "SKIP")}
    for path_, verdict in failed.items():
        talk.say(f"not proved: {path_} (the stand test ended with {verdict})", style.WARN)
    for reason in (*evidence.get("unproved", ()), "stops on the ground, where wheels take longer to stop"):
        talk.say(f"not proved: {reason}", style.DIM)
    style.show([[], [("Next", style.STRONG)]])
    # Don't wrap these lines, because people copy them.
    style.show([[(f"   {command}", style.STRONG)] for command in commands(path, name)])
    if settings is not None:
        _guard(talk, Settings(dict(settings)), path, name)


def _guard(talk: Talk, settings: Settings, path: str, name: str) -> None:
    """Show how to use the guard port, if failstop has one for this board."""
    if language_of(settings.text("board.kind"), settings.flat()) is None:
        return
    style.show([[], [("Your own driver", style.STRONG)]])
    talk.say(
        f"If you have a driver for the bare board, keep it. Let it open the guard port instead of "
        f"{settings.text('device.path') or 'its port'}, and the wheels stop when it crashes or hangs:"
    )
    in_systemd = name == DEFAULT_NAME and path == config.installed(name) and os.path.isdir("/run/systemd/system")
    start = "sudo systemctl enable --now failstop-guard@$USER" if in_systemd else f"failstop guard{option(name)}"
    style.show([[(f"   {start}", style.STRONG)]])
    if settings.on("scan.gate"):
        talk.say(
            'Such a driver does not report an obstacle sensor, so it can move nothing while scan.gate is "on". Set it '
            'to "off", or let a program call Robot.sensed().',
            style.WARN,
        )


def _prove(path: str, name: str) -> str:
    """Return the command that tests this robot on its stand. The command names the settings file `path`, unless this is
    the installed file."""
    config_ = "" if path == config.installed(name) else f" --config {shlex.quote(path)}"
    return f"failstop prove --quick{config_}{option(name)}"


def commands(path: str, name: str) -> list[str]:
    """Return the commands to type after the setup: start the service, enable motion, and drive the robot."""
    installed = config.installed(name)
    where = option(name)
    start = f"sudo systemctl enable --now {unit_of(name).removesuffix('.service')}"
    if path == installed and os.path.isdir("/run/systemd/system"):
        begin = [start]
    elif path != installed and name == DEFAULT_NAME and os.path.isdir(os.path.dirname(installed)):
        begin = [f"sudo install -m 644 {shlex.quote(path)} {installed}", start]
    else:
        begin = [f"failstop run --config {shlex.quote(path)}{where} &"]
    return [*begin, f"failstop enable{where}", f"failstop teleop{where}      # drive with the keyboard; space stops"]
