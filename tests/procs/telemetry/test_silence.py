"""How long a board may pause before it counts as silent: by its description, or by what was seen of it."""

from __future__ import annotations

import pytest

from failstop.board.interface import HEARD_BATTERY, HEARD_IMU, HEARD_KEY
from failstop.board.kinds import board_of
from failstop.procs.telemetry.silence import LEAST_PAUSE_NS, NOISE_NS, Silence

MS = 1_000_000
S = 1_000 * MS


def of(kind: str) -> Silence:
    return Silence(board_of(kind, 0.08, 0.0))


def stream(silence: Silence, kind: int, period_ns: int, seconds: float, from_ns: int = S) -> int:
    count = round(seconds * S / period_ns)
    for number in range(count):
        silence.heard([kind], from_ns + number * period_ns)
    return from_ns + (count - 1) * period_ns


@pytest.mark.parametrize(
    ("kind", "patience_ns"), [("hoverboard", LEAST_PAUSE_NS), ("ugv", LEAST_PAUSE_NS), ("arduino", 0)]
)
def test_a_description_says_how_long(kind: str, patience_ns: int) -> None:
    assert of(kind).patience_ns == patience_ns


def test_without_a_description_it_is_seen() -> None:
    silence = of("rrc")
    assert stream(silence, HEARD_IMU, 9 * MS, 0.9) == silence.said_ns
    assert silence.patience_ns == 0, "too little was seen"
    stream(silence, HEARD_IMU, 9 * MS, 1.0, silence.said_ns + 9 * MS)
    assert silence.patience_ns == LEAST_PAUSE_NS


def test_reports_that_come_seldom_are_given_their_time() -> None:
    silence = of("rrc")
    stream(silence, HEARD_BATTERY, S, 30)
    assert silence.patience_ns == 12 * S


def test_a_machine_that_was_held_up_learns_better() -> None:
    silence = of("rrc")
    held_ns = stream(silence, HEARD_IMU, 10 * MS, 0.5) + 600 * MS
    held_ns = stream(silence, HEARD_IMU, 10 * MS, 0.2, held_ns)
    assert silence.patience_ns == 1_200 * MS
    stream(silence, HEARD_IMU, 10 * MS, 1.5, held_ns + 10 * MS)
    assert silence.patience_ns == LEAST_PAUSE_NS


def test_keys_say_that_it_lives_and_not_how_often_it_reports() -> None:
    silence = of("rrc")
    last_ns = stream(silence, HEARD_KEY, 10 * MS, 10)
    assert (silence.said_ns, silence.patience_ns) == (last_ns, 0)


def test_bytes_that_can_t_be_read_count_for_a_while() -> None:
    silence = of("hoverboard")
    silence.heard([], S)
    assert silence.said_ns == 0
    silence.heard([HEARD_BATTERY], S)
    silence.heard([], S + NOISE_NS - 1)
    assert silence.said_ns == S + NOISE_NS - 1
    silence.heard([], S + NOISE_NS)
    assert silence.said_ns == S + NOISE_NS - 1


def test_another_port_is_another_board() -> None:
    silence = of("hoverboard")
    silence.heard([HEARD_BATTERY], S)
    silence.forget()
    silence.heard([], 2 * S)
    assert silence.said_ns == 0
