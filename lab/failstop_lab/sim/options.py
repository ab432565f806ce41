"""Options of a simulated board at its start, and the command line for it."""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass

from failstop.board.kinds import is_own, wire_of
from failstop.policy.layouts import BOARDS
from failstop.policy.settings import BY_KEY
from failstop_lab.boards.line import model_of
from failstop_lab.sim.usb.port import VHCI

IMU_HZ = 110.0
BATTERY_MV = 12_000
LINK = "/tmp/board"


@dataclass(frozen=True)
class Options:
    """Settings of one board. `link` is where clients find the port; the control socket is beside it."""

    link: str
    record: str | None = None
    imu_hz: float = IMU_HZ
    battery_mv: int = BATTERY_MV
    seed: int = 0
    first_invalid_func: int = 12
    mode: int | None = None
    cooked: bool = False
    board: str = BOARDS[0]
    """Its kind, as the setting board.kind."""
    usb: str = ""
    """Where the plug goes in: `vhci`, or a usbredir host; empty: the port is a pty."""
    verbose: bool = False
    until_eof: bool = False
    per_rps: float = 0.0
    """One turn a second of its wheels in its own unit; 0: as such boards usually have it."""
    motors: int = 0
    """How many motors it has, where boards of its kind differ; 0: as usual."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `failstop sim`."""
    add = parser.add_argument
    add(
        "--device",
        metavar="LINK",
        default=LINK,
        help="the path at which programs open the simulated port (default: %(default)s)",
    )
    add_board(parser)
    add(
        "--per-rps",
        type=_positive,
        default=0.0,
        metavar="N",
        help="how many of the board's speed units make one wheel turn per second, whatever board.per_rps says; on an "
        "Arduino: the encoder counts of one wheel turn, divided by 30 (default: the usual value of such boards)",
    )
    add(
        "--motors",
        type=int,
        choices=(2, 3, 4),
        default=0,
        help="with --board damiao: how many motors the board has (default: 2)",
    )
    add("--record", metavar="FILE", help="write every chunk, frame and fault to FILE, one JSON object per line")
    add(
        "--imu-hz",
        type=_rate_hz,
        default=IMU_HZ,
        metavar="N",
        help="IMU frames per second; 0: none (default: %(default)g)",
    )
    add(
        "--battery-mv",
        type=_millivolts,
        default=BATTERY_MV,
        metavar="N",
        help="battery voltage, mV (default: %(default)s)",
    )
    add("--seed", type=int, default=0, metavar="N", help="seed of the noise and the faults (default: %(default)s)")
    add(
        "--first-invalid-func",
        type=int,
        choices=(10, 11, 12),
        default=12,
        help="with --board rrc: the lowest function number that the firmware rejects, which depends on its version "
        "(default: %(default)s)",
    )
    add(
        "--mode", type=_octal, metavar="OCTAL", help="permissions of the port, for example 0660 (default: the system's)"
    )
    add(
        "--cooked",
        action="store_true",
        help="begin in the terminal mode that the kernel gives a real port: with echo and line editing",
    )
    add(
        "--usb",
        nargs="?",
        const=VHCI,
        default="",
        metavar="PLACE",
        help="simulate a USB device instead of a pty, so that the kernel's own driver makes the port. Without PLACE "
        "the device is plugged into this machine (vhci_hcd; needs root). PLACE is where usb-redir of a virtual machine "
        "listens: HOST:PORT, or the path of a socket",
    )
    add(
        "--verbose",
        action="store_true",
        help="print what the wheels do and each stop burst, and every 10 s how many other frames came",
    )
    add("--until-eof", action="store_true", help="exit when standard input is closed")


def add_board(
    parser: argparse.ArgumentParser, default: str | None = BOARDS[0], words: str = "{} (default: %(default)s)"
) -> None:
    """Add the option that says which board. `words`: its help, around the kinds there are."""
    kinds = f"{', '.join(BOARDS)}, or the path of your own board's folder"
    parser.add_argument("--board", type=_kind, metavar="KIND", default=default, help=words.format(kinds))


def from_arguments(args: argparse.Namespace) -> Options:
    """The options that a parser with add_arguments() has read."""
    names = set(Options.__dataclass_fields__) - {"link"}
    return Options(link=args.device, **{name: getattr(args, name) for name in names})


def _kind(text: str) -> str:
    try:
        kind = str(BY_KEY["board.kind"].check(os.path.abspath(text) if os.sep in text else text))
        if is_own(kind):
            wire_of(kind)
            model_of(kind)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return kind


def _positive(text: str) -> float:
    value = float(text)
    if not 0 < value <= 10_000:
        raise argparse.ArgumentTypeError(f"{text}, must be above 0 and at most 10000")
    return value


def _rate_hz(text: str) -> float:
    value = float(text)
    if value != 0 and not 0.1 <= value <= 1000.0:
        raise argparse.ArgumentTypeError(f"{text} Hz, must be 0 (no IMU) or 0.1 to 1000")
    return value


def _millivolts(text: str) -> int:
    value = int(text)
    if not 0 <= value <= 65_535:
        raise argparse.ArgumentTypeError(f"{text} mV, must be 0 to 65535")
    return value


def _octal(text: str) -> int:
    value = int(text, 8)
    if not 0 <= value <= 0o777:
        raise argparse.ArgumentTypeError(f"{text}, must be 000 to 777")
    return value
