"""Wheels: finds out which motor id turns which wheel, and in which direction. It turns each wheel alone, and then all
wheels together."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from statistics import median

from failstop.board.kinds import board_of, facts_of
from failstop.cli import style
from failstop.policy import scale
from failstop.policy.layouts import WHEEL_NAMES, speeds_of, wheel_count
from failstop.policy.settings import Settings
from failstop.setup import turn
from failstop.setup.halt import Halt
from failstop.setup.rig import Rig, alone, rim_mps
from failstop.setup.talk import AS_BEFORE, YES, Left, NotAnAnswer, Talk, begun, yes_or_no

SECONDS = 1.0
RPS = 0.5
"""How fast a wheel turns at first, turns per second, if no limit is lower. This is slow, but fast enough to be seen."""
FASTEST_RPS = 2.0
RESTS = 0.2
"""A wheel whose reported speed is below this share of the fastest wheel's speed is at rest, and its speed is noise."""
AGAIN_WORD, FASTER, NONE = "again", "faster", "none"
WAYS = {"+": 1, "forward": 1, "f": 1, "-": -1, "backward": -1, "back": -1, "b": -1}
STAND = (
    "WHEELS TURN NEXT. The robot is on a stand: every wheel is off the ground and free, nobody and nothing is near, "
    "and the power switch is at hand. Ctrl-C stops the wheels at any time."
)
STEERED_BY, STEERING = "steering.servo", "steering.sign"
SCALE = (scale.PER_RPS, scale.PER_RPS_CONFIRMED)
FOUND: dict[str, Callable[[str], object]] = {STEERING: int, **dict.fromkeys(SCALE, float)}
"""The settings that this step may find besides the ids and directions, which follow from the answers about the wheels.
The value reads a setting from its text."""
SUPPLY = "are the motors' supply and that motor's plug in?"


def short(name: str) -> str:
    """Return the short name of a wheel: `front left` becomes `fl`, and `left` stays `left`."""
    return "".join(word[0] for word in name.split()) if " " in name else name


def names(count: int) -> list[str]:
    """Return the short names of a robot's wheels, in the order of the wheels' numbers."""
    return [short(name) for name in WHEEL_NAMES[count]]


def parsed(answer: str, words: list[str], spare: bool) -> str:
    """Check the answer about a wheel, and return it in its usual form. For example, `fl+` means that the front left
    wheel turned forward. The answers "again" and "faster" are also allowed. With `spare`, "none" is allowed too, for an
    id without a wheel. Raises NotAnAnswer."""
    text = answer.lower().strip()
    if text in (AGAIN_WORD, FASTER) or (text == NONE and spare):
        return text
    if text == NONE:
        raise NotAnAnswer(f"every id of this robot has a wheel: {SUPPLY} Then type {AGAIN_WORD} or {FASTER}")
    for said, way in WAYS.items():
        if text.endswith(said) and (word := begun(text.removesuffix(said), words)):
            return f"{word}{'+' if way > 0 else '-'}"
    raise NotAnAnswer(f"type the wheel ({', '.join(words)}), then + for forward or - for backward, as {words[0]}+")


def stand(talk: Talk) -> None:
    """Ask the person whether the wheels may turn. Earlier answers don't count. Raises Left after a no."""
    talk.say(STAND, style.STRONG)
    if talk.ask("stand", "Is all of this true? Type yes:", "", yes_or_no, keep=False) != YES:
        raise Left("nothing was moved: put the robot on a stand")


class Trial:
    """Turns the wheels, and asks the person which wheel has turned, and in which direction. This is the third step of
    the setup."""

    def __init__(self, talk: Talk, device: str, values: Mapping[str, object], halt: Halt) -> None:
        """`values`: the settings so far. `halt` stops the wheels of this board. Raises SettingError."""
        self._talk, self._device, self._values, self._halt = talk, device, dict(values), halt
        settings = Settings(dict(values))
        self._kind = settings.text("board.kind")
        self._diameter_m = settings["wheels.diameter_m"]
        self._count = wheel_count(self._kind, settings.text("wheels.layout"))
        layout = settings.text("wheels.layout")
        self._speeds = speeds_of(self._kind, layout) or board_of(self._kind, 1.0, 0.0).wheels
        self._words = names(self._count)
        self._way = "the way that turns the robot to the left" if self._count == 3 else "forward"
        self._explained = False
        """True once the person has been told how to answer the questions about the wheels."""
        self._ratios: list[float] = []
        """The measured speed divided by the commanded speed, for each wheel that somebody has seen turning. Empty if
        the board reports no speeds, or if its reports depend on board.per_rps."""
        self._set_speeds()

    def _set_speeds(self) -> None:
        """Choose the speeds for turning the wheels, capped until somebody has confirmed the scale."""
        board = self._board = board_of(*Settings(dict(self._values)).board())
        # Half of the board's highest speed, because a wheel may have to drive and turn the robot at the same time.
        self._fastest = min(FASTEST_RPS, board.most_rps / 2)
        if board.scale_assumed:
            self._fastest = min(self._fastest, turn.SLOWEST_MPS / rim_mps(1.0, self._diameter_m))
        self._rps = min(RPS, self._fastest)

    def step(self) -> dict[str, object]:
        """Turn the wheels and ask about them. Returns settings: the motor ids and directions, and the scale if it was
        found. Raises Left."""
        talk = self._talk
        talk.step(3, "The wheels")
        stand(talk)
        by_hand = self._speeds == self._count == 4 and self._kind.startswith("/")
        found = turn.asked(talk, self._device, self._values, self._halt, self._speeds, single=not by_hand)
        found |= self._found_before()
        self._values |= found
        self._set_speeds()
        if by_hand:
            talk.warn("On your own board with four wheels, setup can't turn a single wheel.", "set [wheels] by hand")
        while True:
            if not by_hand:
                found |= self._ids()
                found |= self._scale()
            values = {**self._values, **found}
            wrong = self._together(values)
            if not wrong:
                return found
            talk.draft.forget("forward", "turn")
            if wrong == "turn" and STEERED_BY in Settings(values).flat():
                found[STEERING] = sign = -int(Settings(values)[STEERING])
                self._keep({STEERING: sign})
                facts = facts_of(self._kind)
                still = f"; if it does not move at all: {facts.no_steering}" if facts and facts.no_steering else ""
                talk.warn(
                    "So the steering servo turns the other way.", f"{STEERING} is {sign} now; watch it again{still}"
                )
                continue
            if by_hand:
                raise Left("the settings [wheels] of your board's wheels must be wrong: correct them by hand")
            talk.draft.forget(*(f"wheel_{id_}" for id_ in range(self._speeds)))
            text = "one of the answers about the wheels must be wrong"
            if talk.silent:
                raise Left(f"{text}: give them all again")
            talk.warn(f"{text[0].upper()}{text[1:]}.", "let's go through the wheels again")

    def _found_before(self) -> dict[str, object]:
        """Return the settings that were found before the setup was left. The answers from that time count only with
        these settings."""
        found: dict[str, object] = {}
        for key, kind in FOUND.items():
            with contextlib.suppress(KeyError, ValueError):
                found[key] = kind(self._talk.draft.found[key])
                self._talk.say(f"{key}: {found[key]} ({AS_BEFORE})", style.DIM)
        return found

    def _keep(self, found: Mapping[str, object]) -> None:
        for key, value in found.items():
            self._talk.draft.keep_found(key, value)

    def _ids(self) -> dict[str, object]:
        answers: dict[int, str] = {}
        self._explained = False
        self._ratios.clear()  # the scale may have been corrected since
        left = list(range(self._speeds))
        while left:
            id_ = left.pop(0)
            spare = self._speeds - self._count > sum(answer == NONE for answer in answers.values())
            answer = self._asked(id_, spare)
            twin = next((other for other, said in answers.items() if answer != NONE and said[:-1] == answer[:-1]), None)
            if twin is not None:
                self._talk.draft.forget(f"wheel_{id_}", f"wheel_{twin}")
                text = f"{answer[:-1]} can't be the wheel of both id {twin} and id {id_}"
                if self._talk.silent:
                    raise Left(text)
                self._talk.warn(f"{text}. Both turn again.")
                del answers[twin]
                left = [twin, id_, *left]
            elif len(answers) + 1 == self._speeds and sum(said != NONE for said in (*answers.values(), answer)) == 0:
                raise Left(f"no wheel turned: {SUPPLY}")
            else:
                answers[id_] = answer
        found: dict[str, object] = {}
        ids = {answer[:-1]: (id_, 1 if answer[-1] == "+" else -1) for id_, answer in answers.items() if answer != NONE}
        for number, word in enumerate(self._words, 1):
            found[f"wheels.id_{number}"], found[f"wheels.sign_{number}"] = ids[word]
        return found

    def _scale(self) -> dict[str, object]:
        """Return a corrected scale as settings if the wheels' measured and commanded speeds differ too much, otherwise
        nothing. Reports that depend on board.per_rps are not used, because they agree with the commands even if the
        scale is wrong."""
        if not self._ratios:
            return {}
        if min(self._ratios) < RESTS * max(self._ratios):
            self._talk.warn(
                "The board reports very different speeds for wheels that turned equally fast.",
                "setup does not correct the scale by these reports; check the plugs of the motors' encoders",
            )
            return {}
        ratio, board = median(self._ratios), self._board
        if not (wrong := scale.wheels_differ(ratio, board.per_rps, holds_speed=board.reports.holds_speed)):
            return {}
        self._talk.say(f"{wrong[0].upper()}{wrong[1:]}.", style.WARN)
        found: dict[str, object] = dict.fromkeys(SCALE, float(f"{board.per_rps / ratio:.4g}"))
        self._values |= found
        self._keep(found)
        self._set_speeds()
        return found

    def _legend(self) -> None:
        """Explain how to answer the questions. This is printed before the first question about the wheels."""
        if self._explained:
            return
        self._explained = True
        wheels = ", ".join(f"{word} {name}" for word, name in zip(self._words, WHEEL_NAMES[self._count], strict=True))
        self._talk.say(
            "The wheels turn slowly, one after the other, for a second each. Type which wheel it was, and which way:"
        )
        self._talk.say(f"wheel   {wheels}" if self._count == 4 else f"wheel   {', '.join(self._words)}", indent=5)
        self._talk.say(f"way     + {self._way}, - the other way; for example {self._words[0]}+", indent=5, hang=8)
        self._talk.say(f"or      {AGAIN_WORD}: turn it again; {FASTER}: turn it twice as fast", indent=5)

    def _asked(self, id_: int, spare: bool) -> str:
        """Turn the motor with this id, and ask which wheel has turned. Repeat this after "again" or "faster"."""
        talk, key, ratio = self._talk, f"wheel_{id_}", 0.0
        while True:
            if not talk.known(key):
                self._legend()
                ratio = self._turn(id_)
            none = f"; {NONE}" if spare else ""
            question = f"Id {id_}: which wheel turned, and which way? ({', '.join(self._words)} with + or -{none})"
            passing = AGAIN_WORD, FASTER
            answer = talk.ask(key, question, "", lambda said: parsed(said, self._words, spare), passing=passing)
            if answer not in (AGAIN_WORD, FASTER):
                if ratio and answer != NONE:  # if nobody has seen a wheel turn, the board has measured noise
                    self._ratios.append(ratio)
                return answer
            talk.draft.forget(key)
            if answer == FASTER:
                self._rps = min(self._fastest, 2 * self._rps)

    def _turn(self, id_: int) -> float:
        """Turn the motor with this id. Returns the measured speed of its wheel divided by the commanded speed, or 0.0
        if the board does not measure it by a scale of its own."""
        rim = rim_mps(self._rps, self._diameter_m)
        values, velocity = alone(self._kind, self._speeds, id_, rim, self._diameter_m)
        values |= {key: value for key, value in self._values.items() if key in (*SCALE, "board.baud", "board.can_id")}
        self._talk.say(f"Id {id_} turns its wheel alone for {SECONDS:g} s ...", style.DIM)
        with Rig(self._device, values, self._halt) as rig:
            rig.drive(velocity, SECONDS)
        # Only this wheel was driven, so the others are at rest, although a board may report some noise for them.
        fastest = max(map(abs, rig.turned.values()), default=0.0)
        if rig.turned and not fastest:
            self._talk.warn("The board reports that no wheel turned.", f"{SUPPLY} Or type {FASTER}.")
        for other, speed in rig.turned.items():
            if abs(speed) > RESTS * fastest:
                self._talk.say(f"The board reports that id {other} turned {'forward' if speed > 0 else 'backward'}.")
        return rig.ratio

    def _together(self, values: Mapping[str, object]) -> str:
        """Turn all wheels together, forward and then to the left, and ask about each turn. Returns the key of the first
        question that was answered with no, or "". Raises Left."""
        talk = self._talk
        rim = rim_mps(self._rps, self._diameter_m)
        settings = Settings(dict(values))
        reach_m = settings["wheels.track_m"] if "wheels.track_m" in settings.flat() else settings["wheels.lever_m"]
        tries: list[tuple[str, str, tuple[float, float, float]]] = [
            ("forward", "Did every wheel turn forward?", (rim, 0.0, 0.0)),
            ("turn", "Did the left wheels turn backward, the right ones forward?", (0.0, 0.0, rim / reach_m)),
        ]
        if self._count == 3:
            tries = [
                (
                    "forward",
                    "Did the left wheel turn -, the right one +, and the rear one not at all?",
                    (rim, 0.0, 0.0),
                ),
                ("turn", "Did all three turn the way that turns the robot to the left?", (0.0, 0.0, rim / reach_m)),
            ]
        elif STEERED_BY in settings.flat():
            tries[1] = ("turn", "Do the steered wheels point to the left?", (rim, 0.0, rim / reach_m))
        wanted = [key for key, _, _ in tries if key not in talk.given and talk.draft.answers.get(key) != YES]
        limits = {"limits.vx_mps": rim, "limits.vy_mps": 0.01, "limits.wz_radps": max(0.01, rim / reach_m)}
        for key, question, velocity in tries:
            if key in wanted:
                talk.say("All wheels turn together for a second ...", style.DIM)
                with Rig(self._device, {**values, **limits}, self._halt) as rig:
                    rig.drive(velocity, SECONDS)
            if talk.ask(key, question + " (yes, no)", "", yes_or_no) != YES:
                return key
        return ""
