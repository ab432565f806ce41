"""Ports: finds the board's port, and shows what keeps this user from using it, with the remedies."""

from __future__ import annotations

import glob
import os
import time
from collections.abc import Callable, Collection

from failstop.board import asking, port
from failstop.board.finder import look_alikes, of_number
from failstop.board.kinds import board_of
from failstop.doctor.look import FAIL, OK, SKIP, Finding, Look, fail
from failstop.doctor.port import LINK, NO_DESCRIPTION, accessible, grabbers, held, taken, talkers
from failstop.doctor.system import System
from failstop.policy.layouts import BOARDS
from failstop.setup.rig import RIG
from failstop.setup.talk import Left, NotAnAnswer, Talk

UNPLUG = "unplug"
OTHER_PATH = "or the path of another port"
NODES = ("/dev/ttyACM*", "/dev/ttyUSB*", "/dev/ttyAMA*", "/dev/ttyTHS*", "/dev/ttyS[0-9]", "/dev/serial0")
BY = "/dev/serial"
"""The folder of udev's names for serial ports. It has two folders. The names in by-id are made from what a device
reports about itself. The names in by-path are made from the USB socket into which the device is plugged."""
COMES_S = 10.0
"""How long to wait for the port of a board that was just plugged in, s."""
LOOK_S = 0.1
ENDS_S = 5.0
RASPBERRY = "Raspberry Pi"


def listed(system: System) -> dict[str, str]:
    """Return the ports to which the board may be connected: for each path, a description for people."""
    own = {usb for kind in BOARDS for usb in board_of(kind, 1.0, 0.0).usb}
    found = {}
    for path, what in system.ports(own):
        if what != NO_DESCRIPTION or not path.startswith("/dev/ttyS"):
            chip = next((f", a {name}" for usb, name in asking.ADAPTERS.items() if usb in what), "")
            found[path] = f"{'on serial pins' if what == NO_DESCRIPTION else what}{chip}"
    for link in ("/dev/serial0",):
        if os.path.exists(link) and os.path.realpath(link) not in map(os.path.realpath, found):
            found[link] = "on serial pins"
    return found


def nodes() -> set[str]:
    """Return the paths of all serial devices that exist at this moment."""
    return {path for pattern in NODES for path in glob.glob(pattern)}


def stable(path: str, folder: str = BY, sysfs: str = "/sys") -> str:
    """Return a path for the port that stays the same when the board is plugged in again, or `path` itself if there is
    none.

    This is failstop's udev link, else a link in by-id, else a link in by-path. The udev link is not used if another
    port has the same vendor and product. A link in by-id is not used if such a port also has the same serial number, or
    if both have none.
    """
    try:
        others, twins = look_alikes(of_number(os.stat(path).st_rdev, sysfs), sysfs)
    except OSError:
        return path
    links = [] if others else [LINK]
    for kind in ("by-path",) if twins else ("by-id", "by-path"):
        links += sorted(glob.glob(f"{glob.escape(folder)}/{kind}/*"))
    return next((link for link in links if os.path.realpath(link) == os.path.realpath(path)), path)


def went(talk: Talk, look: Callable[[], Collection[str]] = nodes, comes_s: float = COMES_S) -> str:
    """Find the board's port by letting a person unplug the board and plug it in again. Returns the port that comes
    back. Raises Left if not exactly one port disappears, or if none comes back."""
    before = set(look())
    talk.ask("unplugged", "Pull the board's USB cable now, then press Enter.", "done", keep=False)
    gone = before - set(look())
    if len(gone) != 1:
        what = f"{', '.join(sorted(gone))} disappeared" if gone else "no port disappeared"
        raise Left(f"{what} when the cable was pulled: is the board connected to this computer by a data cable?")
    talk.say(f"{min(gone)} disappeared.")
    without = set(look())
    talk.ask("plugged", "Plug it in again, then press Enter.", "done", keep=False)
    until_s = time.monotonic() + comes_s
    while not (came := set(look()) - without):
        if time.monotonic() > until_s:
            raise Left("no port came back: check the cable, and look at `sudo dmesg | tail`")
        time.sleep(LOOK_S)
    return min(came)


def is_serial(path: str) -> bool:
    """Return True if the kernel lists the device as a serial port. Also True for a pseudo-terminal, which sysfs does
    not list."""
    number = os.stat(path).st_rdev
    subsystem = f"/sys/dev/char/{os.major(number)}:{os.minor(number)}/subsystem"
    return not os.path.exists(subsystem) or os.path.basename(os.path.realpath(subsystem)) == "tty"


def choose(talk: Talk, system: System) -> str:
    """Ask the person which port the board is connected to, and return its path. Raises Left."""
    found = {} if talk.known("port") else listed(system)
    for number, (path, what) in enumerate(found.items(), 1):
        talk.say(f"{number}  {path}   {what}")
    if not found and not talk.known("port"):
        talk.warn(
            "This computer has no serial port.",
            "plug the board in; `sudo dmesg | tail` shows whether the computer sees it",
        )
        for row in (*taken(system), *pins(system)):
            _say(talk, row)

    def check(answer: str) -> str:
        if answer == UNPLUG:
            return answer
        if answer.isdecimal() and 1 <= int(answer) <= len(found):
            return list(found)[int(answer) - 1]
        path = os.path.expanduser(answer)
        if not path.startswith("/"):
            numbers = f"a number from 1 to {len(found)}, " if found else ""
            raise NotAnAnswer(f"type {numbers}a path such as /dev/ttyACM0, or {UNPLUG}")
        if not os.path.exists(path):
            raise NotAnAnswer(f"{path} does not exist: plug the board in, or type another path")
        if system.node(path) is None or not is_serial(path):
            raise NotAnAnswer(f"{path} is not a serial port")
        return path

    numbers = f"its number, {OTHER_PATH}" if found else "type its path"
    default = next(iter(found)) if len(found) == 1 else ""
    question = f"Which port is the board at? ({numbers}; {UNPLUG}: find it by unplugging it)"
    while (path := talk.ask("port", question, default, check, passing=(UNPLUG,))) == UNPLUG:
        talk.draft.forget("port")  # an earlier answer must not be used if no port is found now
        try:
            path = went(talk)
        except Left as error:
            if talk.silent:
                raise
            talk.warn(f"{str(error)[0].upper()}{str(error)[1:]}.", f"type another answer, or {UNPLUG} to try again")
            continue
        talk.draft.keep("port", path)
        talk.say(f"The board is at {path}.")
        break
    return path


def pins(system: System) -> list[Finding]:
    """Return why the serial pins of a Raspberry Pi can't be used as a port, with the remedies. Empty if they can be
    used, or on another computer."""
    raspberry = RASPBERRY in (system.read("/proc/device-tree/model") or "")
    if raspberry and not os.path.exists(system.path("/dev/serial0")):
        advice = "then restart; on a Pi 5, set dtparam=uart0 in config.txt instead"
        return fail("the serial pins are switched off", "sudo raspi-config nonint do_serial_hw 0", advice)
    return []


def hindrances(path: str, system: System) -> list[Finding]:
    """Return why failstop can't open this port, or must share it with another program. Empty if failstop can use the
    port alone."""
    look = Look(device_path=path, system=system)
    found = [row for check in (accessible, held, grabbers) for row in check(look)]
    if service := next((holder for holder in look.holders[0] if holder.instance), None):
        return fail(f"{service} has {path} open", service.end())
    return [*talkers(system, path), *(row for row in found if row.level not in (OK, SKIP))]


def _say(talk: Talk, row: Finding) -> None:
    talk.warn(f"{row.text[0].upper()}{row.text[1:]}.", row.advice, row.fix)


def _let_end(path: str, system: System) -> None:
    """Wait up to ENDS_S for the service of a killed setup, which may still be stopping the wheels at this port."""
    until_s = time.monotonic() + ENDS_S
    real = os.path.realpath(path)
    while any(holder.instance.startswith(RIG) for holder in system.holders(real)[0]) and time.monotonic() < until_s:
        time.sleep(LOOK_S)


def step(talk: Talk, system: System) -> str:
    """Find the board's port, as the first step of the setup. Returns its path. Raises Left."""
    talk.step(1, "The port")
    path = choose(talk, system)
    try:
        serious = False
        _let_end(path, system)
        for row in hindrances(path, system):
            _say(talk, row)
            serious = serious or row.level == FAIL
        if serious:
            raise Left(f"{path} can't be used yet: follow the steps above, then run setup again")
    except port.PortError as error:
        raise Left(str(error)) from None
    return path
