"""A board in a folder of the user's own: it is driven and stopped like any other, and who may write it may drive."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from failstop import config
from failstop.board import own, wire
from failstop.board.kinds import board_of, wire_of
from failstop.board.own import OwnBoardError
from failstop.board.wire import VOCABULARY
from failstop.data import Data
from failstop.lab.boards.line import model_of
from failstop.lab.trial import Trial
from failstop.messages import layout
from failstop.policy.setting import SettingError
from failstop.policy.settings import Settings, mounted_wheels
from failstop.supervisor.fit import checked_board
from tests.support import commands
from tests.support.boards import own_folder
from tests.support.pages import ROOT


@pytest.fixture
def folder(tmp_path: Path) -> str:
    return own_folder(tmp_path / "tank")


@pytest.mark.starts
def test_a_board_of_the_users_own_is_stopped_for_every_process(folder: str) -> None:
    with Trial(f"own-{os.getpid()}", kind=folder) as trial:
        for process in layout.PROCESS_NAMES:
            trial.enable()
            pid = trial.service.pids()[process]
            stopped = trial.kill(process, 0.2)
            assert (stopped.was_turning, stopped.motion_after) == (True, 0), process
            assert stopped.still_ns is not None, process
            trial.recover(process, pid)


def test_a_layout_that_its_wire_does_not_drive_is_refused(folder: str, tmp_path: Path) -> None:
    file = tmp_path / "robot.toml"
    file.write_text(f'board.kind = "{folder}"\nwheels.layout = "omni3"\n')
    with pytest.raises(SettingError) as refused:
        checked_board(config.load(str(file)), str(file))
    assert str(refused.value) == f"{file}: board.kind {folder} takes 2 speeds, and wheels.layout omni3 has 3 wheels"


def test_the_page_says_how_to_begin(tmp_path: Path) -> None:
    """Its commands make a folder that drives as the smallest board does, judged by a receiver of its own."""
    [told] = re.findall(r"```sh\n(mkdir .*?)```", (ROOT / "docs" / "dev" / "porting.md").read_text(), re.DOTALL)
    subprocess.run(["sh", "-e", "-c", told.replace("/etc/failstop/boards", str(tmp_path))], cwd=ROOT, check=True)
    folder = str(tmp_path / "tank")
    assert board_of(folder, 0.08, 0.0).burst == board_of("arduino", 0.08, 0.0).burst
    assert type(model_of(folder).live()).__module__ == f"{own.OWN_PACKAGE}.receiver"
    assert not any("failstop.board.arduino" in path.read_text() for path in Path(folder).glob("*.py"))


def test_its_wire_and_its_receiver_are_those_of_the_folder(folder: str) -> None:
    assert wire_of(folder).stop.writes[0].data == wire_of("arduino").stop.writes[0].data
    assert type(model_of(folder).live()).__module__ == f"{own.OWN_PACKAGE}.receiver"
    assert board_of(folder, 0.08, 0.0).motor_speeds((0.0, 0.0), 1.0) == board_of(folder, 0.08, 0.0).stop


def test_it_takes_two_speeds(folder: str) -> None:
    settings = Settings({"board.kind": folder})
    assert (settings.text("wheels.layout"), mounted_wheels(settings.values)) == ("differential", [(0, 1), (1, 1)])
    with pytest.raises(SettingError, match="has no servos"):
        Settings({"board.kind": folder, "joints.base.servo": 1})


def in_wire(old: str, new: str) -> Callable[[Path], object]:
    """A change of its wire.py."""

    def change(at: Path) -> None:
        text = (at / "wire.py").read_text()
        assert text.count(old) == 1
        (at / "wire.py").write_text(text.replace(old, new))

    return change


SAYS = f"VOCABULARY = {VOCABULARY}\n"
NO_IMPORT = "import nothing_like_that\n"
WRONG: dict[str, tuple[Callable[[Path], object], str]] = {
    # It is told before the module runs, which may ask for what is not there any more.
    "another vocabulary": (
        in_wire(SAYS, f"VOCABULARY = {VOCABULARY + 1}  # of a newer one\n{NO_IMPORT}"),
        rf"wire.py was written for vocabulary {VOCABULARY + 1}, and failstop .* offers vocabulary {VOCABULARY} of",
    ),
    "no vocabulary": (
        in_wire(SAYS, NO_IMPORT),
        rf"wire.py has no line VOCABULARY = {VOCABULARY}, and failstop .* offers",
    ),
    "no field": (in_wire("        after_ns=0,\n", ""), "wire.py: WIRE.stop.after_ns is missing"),
    "no such field": (in_wire("ping_ns=", "pings_ns="), "wire.py: WIRE.pings_ns: Wire has no such field"),
    "a field of another type": (
        in_wire("baud=57_600", 'baud="57600"'),
        "wire.py: WIRE.port.baud = '57600', must be of type int",
    ),
    "in a tuple": (
        in_wire('            who="', '            whose="'),
        r"WIRE.commanders\[0\].whose: Commander has no such",
    ),
    "no such folder": (lambda at: shutil.rmtree(at), "tank: No such file or directory"),
    "no WIRE": (lambda at: (at / "wire.py").write_text(SAYS), "wire.py has no WIRE"),
    "not a Wire": (lambda at: (at / "wire.py").write_text(f"{SAYS}WIRE = 1\n"), "is no failstop.board.wire.Wire"),
    "an error of its own": (
        lambda at: (at / "wire.py").write_text(SAYS + NO_IMPORT),
        "ModuleNotFoundError",
    ),
    "no wire.py": (lambda at: (at / "wire.py").unlink(), "wire.py: ModuleNotFoundError"),
    "a link that leads nowhere": (lambda at: (at / "more.py").symlink_to(at / "gone.py"), "No such file or directory"),
    "others may write what it imports": (lambda at: (at / "codec.py").chmod(0o666), "others may write"),
    "others may write it": (lambda at: (at / "wire.py").chmod(0o666), "others may write"),
    "others may write the folder": (lambda at: at.chmod(0o777), "sudo chmod go-w"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_folder_that_can_not_be_used_is_named_with_the_reason(folder: str, wrong: str) -> None:
    change, said = WRONG[wrong]
    change(Path(folder))
    with pytest.raises(OwnBoardError, match=said) as refused:
        board_of(folder, 0.08, 0.0)
    assert folder in str(refused.value)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives a file to another user")
def test_a_folder_of_another_user_is_not_run(folder: str) -> None:
    os.chown(f"{folder}/wire.py", 65534, 65534)
    with pytest.raises(OwnBoardError, match="belongs to another user: sudo chown root"):
        board_of(folder, 0.08, 0.0)


@pytest.mark.starts
@pytest.mark.parametrize("words", [("config", "--check"), ("run", "--config"), ("stop", "--config")], ids=" ".join)
def test_a_command_tells_of_it_in_a_line(words: tuple[str, ...], tmp_path: Path) -> None:
    """A stop that can't be written says so."""
    file = tmp_path / "robot.toml"
    file.write_text(f'[board]\nkind = "{tmp_path}/none"\n[device]\npath = "{tmp_path}/port"\n')
    done = commands.failstop(*words, str(file))
    assert done.returncode == 1
    [line] = done.stderr.splitlines()
    assert f"{tmp_path}/none: No such file or directory" in line
    assert "no stop can be written to it: use the POWER SWITCH" in line


HELD = {1: "575691b41e89033d"}
"""Of each vocabulary the words and samples that it offers, shortened. A sample more asks nothing of a description that
there is: then this is renewed, and the number stays."""


def test_a_vocabulary_that_asks_for_something_else_has_another_number() -> None:
    """An own board must be told. A new field with a default asks for nothing."""
    words = [(name, word) for name, word in vars(wire).items() if name.isupper() and isinstance(word, str)]
    kinds = [kind for kind in vars(wire).values() if isinstance(kind, type) and issubclass(kind, Data)]
    asked = [(kind.__name__, [it for it in kind.__annotations__.items() if not hasattr(kind, it[0])]) for kind in kinds]
    assert len(words) > 5
    assert len(asked) > 10
    digest = hashlib.sha256(repr((words, asked)).encode()).hexdigest()
    assert digest[:16] == HELD[VOCABULARY], "raise VOCABULARY of wire.py"
