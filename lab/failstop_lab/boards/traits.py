"""Traits: the facts of a board of any kind that a trial of the whole service depends on.

They come from the board's description, so a board in a folder of the user's own has them too.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

from failstop import config
from failstop.board.driver import language_of
from failstop.board.interface import BY_IMU, HEARD_BATTERY, Board
from failstop.board.kinds import board_of, is_described, wire_of
from failstop.policy.layouts import BOARDS
from failstop.policy.scale import PER_RPS, PER_RPS_CONFIRMED
from failstop_lab.boards.line import BAR_NS, CROWD_BAR_NS, ReceiverModel, arrivals, model_of, play
from failstop_lab.boards.live import DIAMETER_M

HAS_ARM, HAS_GAMEPAD, HAS_KEYS, HAS_PINGS, HAS_IMU = "an arm", "a gamepad", "keys", "pings", "an IMU"
HAS_CHECK = "a check in its frames"
"""A stop of which one bit was changed on the way turns no wheel."""
HAS_BATTERY = "a battery that it reports"
HAS_REPORTS = "reports of its wheels or its IMU that nobody asks for"
HAS_WHEEL_REPORTS = "reports of its wheels"
"""So often that a wheel which runs away shows in them."""
SHOWS_DEAF = "pings, or an echo of its command"
HAS_ARM_BESIDE = "an arm that moves beside the wheels"
HAS_DRIVERS = "a language for drivers at the guard port"
HAS_MOTORS = "a controller for each motor, of which one may hear nothing"
PARTS = (
    *(HAS_ARM, HAS_ARM_BESIDE, HAS_GAMEPAD, HAS_KEYS, HAS_PINGS, HAS_IMU, HAS_CHECK, HAS_BATTERY, HAS_REPORTS),
    *(HAS_WHEEL_REPORTS, SHOWS_DEAF, HAS_DRIVERS, HAS_MOTORS),
)
RARELY_NS = 1_000_000_000
CARRIED_OUT_NS = 100_000_000
"""So long after its first byte every stop has been carried out."""


@dataclass(frozen=True)
class Traits:
    """One kind of board. `language` is the board as failstop speaks it, for wheels of DIAMETER_M."""

    kind: str
    language: Board
    parts: frozenset[str]
    """Those of PARTS that it has, or failstop uses."""
    own_ns: int
    """The board's own line and loop: this comes on top of each of the first board's bars."""
    late_ns: int
    """Added to a bar that must never be passed: some more of its stops may be lost."""
    deaf_ns: int
    """How long it is taken to hear nothing after its port was opened."""
    resets: bool
    """Opening its port resets it."""
    watchdog_ns: int
    """The board's own watchdog lets the wheels turn for so long after the last frame, as failstop leaves it; 0: it has
    none."""

    @property
    def settings(self) -> dict[str, object]:
        """The settings that a service for it needs: of a simulated board the scale of its wheels is known."""
        if self.kind == BOARDS[0]:
            return {}
        known = (
            dict.fromkeys((PER_RPS, PER_RPS_CONFIRMED), self.language.per_rps) if self.language.scale_assumed else {}
        )
        return {"board.kind": self.kind, **known}


@functools.cache
def traits_of(kind: str) -> Traits:
    """The traits of one of the setting's BOARDS, or of a folder of the user's own. Raises ValueError."""
    language = board_of(kind, DIAMETER_M, 0.0)
    has = {
        HAS_ARM: bool(language.arm and not language.arm.beside_wheels),
        HAS_ARM_BESIDE: bool(language.arm and language.arm.beside_wheels),
        HAS_PINGS: bool(language.pings),
        HAS_REPORTS: language.silent_ns > 0 and not language.ping_ns,
        HAS_IMU: language.observed_by == BY_IMU,
        HAS_WHEEL_REPORTS: 0 < language.reports.every_ns < RARELY_NS,
        SHOWS_DEAF: bool(language.pings) or language.echo_ns > 0,
        HAS_MOTORS: is_described(kind) and hasattr(model_of(kind).live(), "disconnect_motor"),
        HAS_DRIVERS: language_of(kind, config.load(None).flat()) is not None,
        # A Wire has no word for these.
        HAS_GAMEPAD: not is_described(kind),
        HAS_KEYS: not is_described(kind),
        HAS_CHECK: not is_described(kind) or _checks(model_of(kind), language.burst, language.port.byte_ns),
        HAS_BATTERY: not is_described(kind) or _reports_battery(model_of(kind), language),
    }
    parts = frozenset(part for part, there in has.items() if there)
    port, own_ns, late_ns, watchdog_ns = language.port, 0, 0, 0
    if is_described(kind):
        own_ns, late_ns, watchdog_ns = BAR_NS, CROWD_BAR_NS, wire_of(kind).watchdog.acts_ns
    resets = port.dtr and port.deaf_ns > 0
    return Traits(kind, language, parts, own_ns, late_ns, port.deaf_ns, resets, watchdog_ns)


def _reports_battery(model: ReceiverModel, language: Board) -> bool:
    """Whether its receiver tells of it unasked."""
    receiver = model.live()
    for at_ns in range(0, 5 * CARRIED_OUT_NS, BAR_NS):
        receiver.until(at_ns)
    said = language.hearing().feed(b"".join(data for _, data in receiver.said))
    return any(kind == HEARD_BATTERY for kind, _ in said)


def _checks(model: ReceiverModel, stop: bytes, byte_ns: int) -> bool:
    """Whether its receiver, by its own word, takes no stop with a changed bit for motion."""
    for bit in range(8 * len(stop)):
        garbled = (int.from_bytes(stop, "big") ^ 1 << bit).to_bytes(len(stop), "big")
        receiver = model.live()
        play(receiver, arrivals([(0, garbled)], byte_ns), CARRIED_OUT_NS)
        if any(any(speeds) for _, speeds in receiver.commands):
            return False
    return True
