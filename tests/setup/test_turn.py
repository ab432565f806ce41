"""The scale of the wheels, which only a person can tell where commands and reports share it: by a wheel turned by hand,
by turns counted, or left unknown. The simulated board knows its own encoder, whatever the settings say."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from failstop import config
from failstop.board.arduino.codec import COUNTS, PERIODS
from failstop.board.kinds import board_of
from failstop.policy.setting import SettingError
from failstop.policy.settings import Settings
from failstop.setup import sizes, turn, wheels
from failstop.setup.draft import Draft
from failstop.setup.halt import Halt
from failstop.setup.talk import Left, NotAnAnswer, Talk
from failstop.supervisor.fit import checked_board
from failstop_lab.sim.client import SimBoard
from tests.setup.given import GIVEN, words
from tests.setup.person import Person
from tests.support.amounts import LONG

USUAL = COUNTS / PERIODS
TOO_LARGE = (0.2, 0.5, 2.0, 5.2, 6.0)
"""The usual scale over the robot's own."""
ANSWERED = {key: value for key, value in GIVEN.items() if key != "robot"} | {"board": "arduino"}


def made(place: Path) -> Settings:
    """The settings that were written."""
    return config.load(str(place / "made.toml"))


@pytest.mark.slow
@pytest.mark.parametrize("too_large", TOO_LARGE if LONG else [5.2])
def test_a_wheel_turned_by_hand_tells_the_scale(too_large: float, place: Path) -> None:
    port, true = str(place / "b"), USUAL / too_large
    given = {**ANSWERED, "port": port, "file": str(place / "made.toml")}
    with SimBoard(port, board="arduino", per_rps=true) as board, Person(place, *words(place, given)) as person:
        person.says("How many turns did it make?", "1")
        person.reads("The board counted nothing")
        person.reads("How many turns did it make?")
        for wheel in (0, 1):
            board.turn_by_hand(wheel, 1.0)
        person.types("1")
        person.reads("More than one wheel turned.")
        person.reads("How many turns did it make?")
        board.turn_by_hand(1, -3.0)
        person.types("3")
        person.reads("board.per_rps is")
        person.reads("Written to")
        assert person.ends() == 0
        assert not any(event.is_motor and any(event.speeds) for event in board.events())
    assert made(place)["board.per_rps"] == pytest.approx(true, rel=0.01)
    assert not board_of(*made(place).board()).scale_assumed


@pytest.mark.slow
def test_the_turns_of_a_wheel_that_can_not_be_turned_by_hand_are_counted(place: Path) -> None:
    port, true = str(place / "b"), USUAL / 5.2
    given = {**ANSWERED, "port": port, "file": str(place / "made.toml")}
    with SimBoard(port, board="arduino", per_rps=true) as board, Person(place, *words(place, given)) as person:
        person.says("How many turns did it make?", "no")
        board.wait_wheels(True, 30.0)
        fastest_mps = max(map(abs, board.wheels())) * 3.1416 * 0.08
        person.reads("How many turns did it make?")
        assert fastest_mps <= 5.2 * 0.051, "within the cap, by the scale that is assumed"
        turned = board.turned()[0]
        person.types(f"{turned:.2f}")
        person.reads("Written to")
        assert person.ends() == 0
    assert made(place)["board.per_rps"] == pytest.approx(true, rel=0.05)


def talk(place: Path, **given: str) -> Talk:
    return Talk(given, Draft("failstop", {"STATE_DIRECTORY": str(place)}), silent=True)


VALUES = {"board.kind": "arduino", "wheels.layout": "differential"}


def asked(place: Path, values: dict[str, object], **given: str) -> dict[str, object]:
    return turn.asked(talk(place, **given), "/nowhere", values, None, 2)  # type: ignore[arg-type]


def test_a_number_that_is_given_is_taken_and_an_unknown_one_stays_unset(place: Path) -> None:
    assert asked(place, dict(VALUES), per_rps="22") == {"board.per_rps": 22.0}, "no wheel was turned for it"
    with pytest.raises(Left, match="there is no terminal to ask you at"):
        asked(place, dict(VALUES))
    assert asked(place, dict(VALUES), per_rps="unknown") == {}
    with pytest.raises(Left, match="type a number above 0, up to 100000, or unknown"):
        asked(place, dict(VALUES), per_rps="0")


def test_a_turn_of_before_the_setup_was_left_confirms_its_number_and_no_other(place: Path) -> None:
    conversation = talk(place)
    conversation.draft.keep("per_rps", "22")
    assert asked(place, dict(VALUES)) == {"board.per_rps": 22.0, "board.per_rps_confirmed": 22.0}
    assert asked(place, dict(VALUES), per_rps="33") == {"board.per_rps": 33.0}
    assert asked(place, dict(VALUES), per_rps="22") == {"board.per_rps": 22.0, "board.per_rps_confirmed": 22.0}


def test_without_a_person_the_scale_has_to_be_given(place: Path) -> None:
    with pytest.raises(Left, match="there is no terminal to ask you at: give --per-rps"):
        asked(place, dict(VALUES))


def test_a_board_of_which_no_single_wheel_can_be_turned_needs_the_number(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(turn, "by_hand", lambda *_: None)
    person = Talk({}, Draft("failstop", {"STATE_DIRECTORY": str(place)}), silent=False)
    with pytest.raises(Left, match="can't turn a single wheel of your board: give --per-rps, a number or unknown"):
        turn.asked(person, "/nowhere", dict(VALUES), None, 4, single=False)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "values",
    [
        {"board.kind": "rrc"},
        {"board.kind": "feetech"},
        {"board.kind": "hoverboard"},
        {"board.kind": "ugv"},
        {"board.kind": "arduino", "board.per_rps": 20.0, "board.per_rps_confirmed": 20.0},
    ],
    ids=str,
)
def test_a_scale_that_is_known_is_not_asked_for(values: dict[str, object], place: Path) -> None:
    assert asked(place, values) == {}


@pytest.mark.parametrize(
    ("before", "after", "wraps", "counts"),
    [
        ((0.0, 10.0), (-660.0, 10.0), 2.0**32, [660.0, 0.0]),
        ((32700.0, 0.0), (-32736.0, 0.0), 65536.0, [100.0, 0.0]),
        ((1.5,), (3.0,), 0.0, [1.5]),
    ],
)
def test_counts_are_told_either_way_and_over_a_wrap(
    before: tuple[float, ...], after: tuple[float, ...], wraps: float, counts: list[float]
) -> None:
    assert turn._moved(before, after, wraps) == counts


def test_sizes_of_a_robot_without_a_name_are_asked_for_and_nobody_elses_are_offered(place: Path) -> None:
    with pytest.raises(Left, match="there is no terminal to ask you at"):
        sizes.step(talk(place), VALUES, known=False)
    measured = {"diameter_m": "0.065", "track_m": "0.3", "vx_mps": "0.2", "wz_radps": "1"}
    assert sizes.step(talk(place, **measured), VALUES, known=False)["wheels.track_m"] == 0.3


@pytest.mark.parametrize("check", [turn._turns, turn._counted])
def test_a_number_without_a_unit_is_asked_for_in_a_whole_sentence(check: Callable[[str], str]) -> None:
    with pytest.raises(NotAnAnswer, match=r"^type a number from 0\.05 to 100$"):
        check("many")


def test_sizes_of_a_robot_with_a_name_are_offered(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    conversation = talk(place)
    conversation.silent = False
    monkeypatch.setattr("failstop.setup.talk.read_line", lambda _: "")
    found = sizes.step(conversation, {"board.kind": "rrc", "wheels.layout": "mecanum"}, known=True)
    assert found["wheels.diameter_m"] == 0.08


SLOW = {"board.kind": "feetech", "wheels.layout": "omni3"}
"""A board whose wheels turn no faster than 0.73 times a second."""
SIZES = ["0.08", "0.125"]


def chosen(place: Path, monkeypatch: pytest.MonkeyPatch, *typed: str) -> dict[str, object]:
    """The sizes and limits by somebody who types this for a robot with the board SLOW."""
    answers = iter(typed)
    monkeypatch.setattr("failstop.setup.talk.read_line", lambda _: next(answers))
    conversation = talk(place)
    conversation.silent = False
    found = sizes.step(conversation, SLOW, known=False)
    assert next(answers, None) is None
    checked_board(Settings({**SLOW, **found}), None)
    return found


def test_limits_that_are_offered_are_such_that_the_service_starts(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SettingError, match=r"lower \[limits\]"):
        checked_board(Settings({**SLOW, "wheels.diameter_m": 0.08, "wheels.lever_m": 0.125}), None)
    found = chosen(place, monkeypatch, *SIZES, "", "", "")
    usual = Settings(dict(SLOW))
    shares = [float(str(found[key])) / usual[key] for key in sizes.LIMITS]
    assert shares == pytest.approx([shares[0]] * 3, rel=0.01), "the robot is slower, and drives as it would"
    assert 0.8 < shares[0] < 1


def test_limits_with_which_the_service_would_not_start_are_asked_again(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = chosen(place, monkeypatch, *SIZES, "0.2", "", "", "0.1", "", "0.2")
    assert (found["limits.vx_mps"], found["limits.wz_radps"]) == (0.1, 0.2)
    assert "type the limits again" in capsys.readouterr().out


def test_wrong_limits_that_options_gave_are_refused_and_not_kept(place: Path) -> None:
    given = {"diameter_m": "0.08", "lever_m": "0.125", "vx_mps": "0.2", "vy_mps": "0.2", "wz_radps": "1"}
    conversation = talk(place, **given)
    with pytest.raises(Left, match=r"the board takes 0\.732 turns of a wheel a second, and the limits are "):
        sizes.step(conversation, SLOW, known=False)
    assert list(conversation.draft.answers) == ["diameter_m", "lever_m"]


BRACKETS = "Press Enter to accept the value in brackets."


@pytest.mark.parametrize(
    ("known", "kept", "comes_before"),
    [
        (True, (), "Wheel diameter"),
        (False, (), "Highest speed forward"),
        (False, ("vx_mps",), "Highest turn rate"),
        (True, ("diameter_m", "track_m", "vx_mps", "wz_radps"), ""),
    ],
)
def test_brackets_are_explained_once_before_the_first_question_that_has_them(
    known: bool,
    kept: tuple[str, ...],
    comes_before: str,
    place: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    conversation = talk(place)
    conversation.silent = False
    for key in kept:
        conversation.draft.keep(key, "0.2")

    def answer(prompt: str) -> str:
        print(prompt)
        return "" if prompt.rstrip().endswith("]") else "0.2"

    monkeypatch.setattr("failstop.setup.talk.read_line", answer)
    sizes.step(conversation, VALUES, known=known)
    said = capsys.readouterr().out
    assert said.count(BRACKETS) == bool(comes_before)
    if comes_before:
        assert said.partition(BRACKETS)[2].strip().startswith(comes_before)


NOISE = 0.02
"""What a resting wheel reports, as a share of the commanded speed of the wheel that turns."""


def wheels_found(
    place: Path,
    monkeypatch: pytest.MonkeyPatch,
    kind: str,
    tries: Sequence[tuple[str, float]],
    forward: Sequence[str] = ("yes",),
) -> dict[str, object]:
    """The settings of the third step, for a robot with two wheels. `tries`: for each turn of a wheel alone, what the
    person answers, and the wheel's speed over the commanded one, as the board measures it. The other wheel rests.
    `forward`: the person's answers about all wheels together."""
    board = board_of(*Settings({"board.kind": kind, "wheels.layout": "differential"}).board())
    left, answers = list(tries), list(forward)

    class Spun:
        """A rig that turns no wheel."""

        def __init__(self, _device: str, values: dict[str, object], _halt: Halt) -> None:
            self._alone = "limits.vy_mps" not in values
            self.turned: dict[int, float] = {}
            self.ratio = 0.0

        def __enter__(self) -> Spun:
            return self

        def __exit__(self, *_: object) -> None:
            pass

        def drive(self, velocity: tuple[float, float, float], _seconds: float) -> None:
            if self._alone:
                reports = board.reports
                driven = int(velocity[2] > 0)
                commanded = wheels.RPS * (reports.speed_per_rps or reports.position_per_turn)
                self.turned = {driven: left[0][1] * commanded, 1 - driven: -NOISE * commanded}
                # What rests makes noise, and is the fastest wheel if the board does not measure the driven one.
                self.ratio = max(left[0][1], NOISE)

    def answer(prompt: str) -> str:
        return left.pop(0)[0] if "+ or -" in prompt else answers.pop(0)

    monkeypatch.setattr(wheels, "Rig", Spun)
    monkeypatch.setattr("failstop.setup.talk.read_line", answer)
    conversation = Talk({"stand": "yes", "turn": "yes"}, Draft("x", {"STATE_DIRECTORY": str(place)}), silent=False)
    values = {"board.kind": kind, "wheels.layout": "differential"}
    found = wheels.Trial(conversation, "/nowhere", values, Halt("/nowhere", board, print)).step()
    assert not left
    assert not answers
    return found


def scale_of(found: dict[str, object], kind: str) -> float:
    """The scale over the usual one; 1: it is not set."""
    usual = board_of(*Settings({"board.kind": kind, "wheels.layout": "differential"}).board()).per_rps
    assert found.get("board.per_rps") == found.get("board.per_rps_confirmed")
    return float(str(found.get("board.per_rps", usual))) / usual


OWN_SCALE = ["ugv", "hoverboard", "damiao"]
BOTH = [("left+", 0.95), ("right+", 0.95)]


@pytest.mark.parametrize("kind", OWN_SCALE)
def test_the_noise_of_wheels_at_rest_is_not_taken_for_the_scale(
    kind: str, place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert scale_of(wheels_found(place, monkeypatch, kind, BOTH), kind) == 1
    said = capsys.readouterr().out
    assert [line.split(" that ")[1] for line in said.splitlines() if "The board reports" in line] == [
        "id 0 turned forward.",
        "id 1 turned forward.",
    ], "a wheel at rest has not turned"


@pytest.mark.parametrize("kind", OWN_SCALE)
def test_wheels_that_turn_at_another_speed_than_commanded_correct_the_scale(
    kind: str, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = wheels_found(place, monkeypatch, kind, [("left+", 2.5), ("right+", 2.5)])
    assert scale_of(found, kind) == pytest.approx(1 / 2.5, rel=0.01)


@pytest.mark.parametrize("kind", OWN_SCALE)
def test_a_turn_in_which_nobody_saw_a_wheel_turn_measures_nothing(
    kind: str, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tries = [("again", 0.0), ("again", 0.0), ("left+", 0.95), ("again", 0.0), ("right+", 0.95)]
    assert scale_of(wheels_found(place, monkeypatch, kind, tries), kind) == 1


@pytest.mark.parametrize("kind", OWN_SCALE)
def test_a_wheel_that_the_board_does_not_measure_is_not_taken_for_the_scale(
    kind: str, place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert scale_of(wheels_found(place, monkeypatch, kind, [("left+", 1.0), ("right+", 0.0)]), kind) == 1
    assert "check the plugs of the motors' encoders" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("kind", OWN_SCALE)
def test_wheels_that_are_asked_again_correct_a_scale_once(
    kind: str, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After the first correction they turn as they are commanded."""
    tries = [("left+", 2.5), ("right+", 2.5), *BOTH]
    found = wheels_found(place, monkeypatch, kind, tries, forward=["no", "yes"])
    assert scale_of(found, kind) == pytest.approx(1 / 2.5, rel=0.01)
