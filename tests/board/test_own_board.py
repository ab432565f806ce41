"""A board in a folder of the user's own: it is driven and stopped like any other, and who may write it may drive."""

from __future__ import annotations

import hashlib
import importlib.util
import marshal
import os
import re
import shutil
import struct
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from failstop import config
from failstop.board import kept, own, wire
from failstop.board.driver import language_of
from failstop.board.kinds import board_of, wire_of
from failstop.board.own import OwnBoardError
from failstop.board.wire import VOCABULARY
from failstop.data import Data
from failstop.messages import layout
from failstop.policy.setting import SettingError
from failstop.policy.settings import Settings, mounted_wheels
from failstop.setup.command import layouts_of
from failstop.supervisor.fit import checked_board
from failstop_lab.boards.line import model_of
from failstop_lab.trial import Trial
from tests.support import commands
from tests.support.boards import own_folder
from tests.support.pages import ROOT
from tests.support.simulated import Simulated


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


def test_setup_offers_only_layouts_that_its_speeds_can_drive(folder: str) -> None:
    assert layouts_of(folder) == ["differential"]


def test_the_page_says_how_to_begin(tmp_path: Path) -> None:
    """Its commands make a folder that drives as the smallest board does, judged by a receiver of its own."""
    [told] = re.findall(r"```sh\n(mkdir .*?)```", (ROOT / "docs" / "porting.md").read_text(), re.DOTALL)
    subprocess.run(["sh", "-e", "-c", told.replace("/etc/failstop/boards", str(tmp_path))], cwd=ROOT, check=True)
    folder = str(tmp_path / "tank")
    assert board_of(folder, 0.08, 0.0).burst == board_of("arduino", 0.08, 0.0).burst
    assert type(language_of(folder, Settings({"board.kind": folder}).flat())).__module__ == f"{own.OWN_PACKAGE}.driver"
    assert type(model_of(folder).live()).__module__ == f"{own.OWN_PACKAGE}.receiver"
    assert not any("failstop.board.arduino" in path.read_text() for path in Path(folder).glob("*.py"))


def test_its_wire_and_its_receiver_are_those_of_the_folder(folder: str) -> None:
    assert wire_of(folder).stop.writes[0].data == wire_of("arduino").stop.writes[0].data
    assert type(model_of(folder).live()).__module__ == f"{own.OWN_PACKAGE}.receiver"
    assert board_of(folder, 0.08, 0.0).motor_speeds((0.0, 0.0), 1.0) == board_of(folder, 0.08, 0.0).stop


def test_it_takes_two_speeds(folder: str) -> None:
    settings = Settings({"board.kind": folder})
    assert (settings.text("wheels.layout"), mounted_wheels(settings.values)) == ("differential", [(0, 1), (1, 1)])
    with pytest.raises(SettingError, match="can't move servos"):
        Settings({"board.kind": folder, "joints.base.servo": 1})


def in_wire(old: str, new: str) -> Callable[[Path], object]:
    """A change of its wire.py."""

    def change(at: Path) -> None:
        text = (at / "wire.py").read_text()
        assert text.count(old) == 1
        (at / "wire.py").write_text(text.replace(old, new))

    return change


def fifo(at: Path) -> None:
    at.unlink()
    os.mkfifo(at)


def many(at: Path) -> None:
    for number in range(2000):
        (at / f"{number}.txt").touch()


def below(at: Path) -> None:
    (at / "notes").mkdir()
    (at / "notes" / "more.txt").touch(0o666)
    (at / "notes" / "more.txt").chmod(0o666)


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
    "two vocabularies": (
        in_wire(SAYS, SAYS * 2),
        "wire.py has 2 lines that begin with VOCABULARY = : keep one of them",
    ),
    "no field": (in_wire("        after_ns=0,\n", ""), "wire.py: TypeError: TimedStop lacks after_ns"),
    "no such field": (in_wire("ping_ns=", "pings_ns="), "wire.py: TypeError: Wire has no field pings_ns"),
    "a field of another type": (
        in_wire("baud=codec.USUAL_BAUD", 'baud="57600"'),
        "wire.py: WIRE.port.baud = '57600', must be of type int",
    ),
    "in a tuple": (
        in_wire('            who="', '            whose="'),
        "wire.py: TypeError: Commander has no field whose",
    ),
    "no such folder": (lambda at: shutil.rmtree(at), "tank: No such file or directory"),
    "no WIRE": (lambda at: (at / "wire.py").write_text(SAYS), "wire.py has no WIRE"),
    "not a Wire": (lambda at: (at / "wire.py").write_text(f"{SAYS}WIRE = 1\n"), "is no failstop.board.wire.Wire"),
    "an error of its own": (
        lambda at: (at / "wire.py").write_text(SAYS + NO_IMPORT),
        "ModuleNotFoundError",
    ),
    "no wire.py": (lambda at: (at / "wire.py").unlink(), "wire.py: No such file or directory"),
    "a link that leads nowhere": (lambda at: (at / "more.py").symlink_to(at / "gone.py"), "No such file or directory"),
    "others may write what it imports": (lambda at: (at / "codec.py").chmod(0o666), "others may write"),
    "others may write it": (lambda at: (at / "wire.py").chmod(0o666), "others may write"),
    "others may write the folder": (lambda at: at.chmod(0o777), "sudo chmod go-w"),
    # A sticky bit lets others add a module to the folder, and at a file it means nothing.
    "a sticky folder": (lambda at: at.chmod(0o1777), "others may write .*tank: sudo chmod go-w"),
    "a sticky file": (lambda at: (at / "codec.py").chmod(0o1666), "others may write .*codec.py"),
    "a compiled module": (lambda at: (at / "codec.cpython-311.so").write_bytes(b""), "only source is imported: rm "),
    "a compiled copy": (lambda at: (at / "codec.pyc").write_bytes(b""), "only source is imported: rm "),
    "a FIFO": (lambda at: os.mkfifo(at / "more"), "more is a FIFO, must be a file: rm "),
    "a FIFO as the description": (lambda at: fifo(at / "wire.py"), "wire.py is a FIFO, must be a file"),
    "a device": (lambda at: (at / "more.py").symlink_to("/dev/zero"), "leads to a device, must lead to a file"),
    "a link to a folder": (lambda at: (at / "more").symlink_to("/usr"), "more leads to a folder, must lead to a file"),
    "links in a circle": (lambda at: (at / "more.py").symlink_to("more.py"), "more.py leads through too many links"),
    "a file in its place": (lambda at: (shutil.rmtree(at), at.write_text("")), "tank is a file, must be a folder"),
    "a huge module": (
        lambda at: (at / "wire.py").write_bytes(b"#" * ((1 << 20) + 1)),
        "wire.py has 1048577 bytes",
    ),
    "more files than a board has": (many, "tank holds more than 2000 files"),
    "others may write below": (below, "others may write .*notes/more.txt"),
    # Its modules lie in the folder itself.
    "a module of a subfolder": (
        in_wire(SAYS, f"{SAYS}from .notes import more\n"),
        "ModuleNotFoundError: No module named 'notes'",
    ),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_folder_that_can_not_be_used_is_named_with_the_reason(folder: str, wrong: str) -> None:
    change, said = WRONG[wrong]
    change(Path(folder))
    with pytest.raises(OwnBoardError, match=said) as refused:
        board_of(folder, 0.08, 0.0)
    assert folder in str(refused.value)


THEIRS: dict[str, Callable[[Path], Path]] = {
    "the folder": lambda at: at,
    "wire.py": lambda at: at / "wire.py",
    "a folder above": lambda at: at.parent,
    "its __pycache__": lambda at: made(at / "__pycache__"),
    "a compiled copy": lambda at: made(at / "__pycache__") / "wire.cpython-311.pyc",
    "a subfolder": lambda at: made(at / "notes"),
    "a file far below": lambda at: made(made(at / "notes") / "old") / "x.txt",
    "a link": lambda at: linked(at / "more.py", at / "codec.py"),
}
"""The paths that somebody else may own, of a board's folder and the way to it."""


def made(folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    for name in ("x.txt", "wire.cpython-311.pyc") if folder.name != "old" else ("x.txt",):
        (folder / name).touch()
    if folder.name != "__pycache__":
        (folder / "wire.cpython-311.pyc").unlink(missing_ok=True)
    return folder


def linked(at: Path, to: Path) -> Path:
    at.symlink_to(to)
    return at


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives a file to another user")
@pytest.mark.parametrize("whose", THEIRS)
def test_a_folder_of_which_something_is_another_users_is_not_run(whose: str, folder: str) -> None:
    path = THEIRS[whose](Path(folder))
    os.chown(path, 65534, 65534, follow_symlinks=False)
    with pytest.raises(OwnBoardError, match=r"belongs to another user: sudo chown (-h )?root") as refused:
        board_of(folder, 0.08, 0.0)
    assert f"{path} belongs" in str(refused.value)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives a link to another user")
@pytest.mark.parametrize("relative", [False, True])
def test_a_link_on_the_way_that_is_another_users_is_not_followed(relative: bool, folder: str, tmp_path: Path) -> None:
    """Its owner may turn it to another folder at any time, though where it leads now belongs to root."""
    (tmp_path / "way").mkdir()
    link = tmp_path / "way" / "boards"
    link.symlink_to(".." if relative else tmp_path)
    assert board_of(f"{link}/tank", 0.08, 0.0).burst == board_of(folder, 0.08, 0.0).burst
    os.chown(link, 65534, 65534, follow_symlinks=False)
    with pytest.raises(OwnBoardError, match=f"{link} belongs to another user: sudo chown -h root"):
        board_of(f"{link}/tank", 0.08, 0.0)


def test_only_its_source_is_imported(folder: str) -> None:
    """A compiled copy of root's own that says something else is left alone, and none is written."""
    source = Path(folder, "codec.py")
    kept = Path(importlib.util.cache_from_source(str(source)))
    kept.parent.mkdir()
    hostile = compile("raise SystemExit('the compiled copy')", str(source), "exec")
    found = source.stat()
    stamp = importlib.util.MAGIC_NUMBER + struct.pack("<III", 0, int(found.st_mtime), found.st_size)
    kept.write_bytes(stamp + marshal.dumps(hostile))
    assert board_of(folder, 0.08, 0.0).burst == board_of("arduino", 0.08, 0.0).burst
    assert [path.name for path in kept.parent.iterdir()] == [kept.name]


def test_a_module_is_compiled_from_the_bytes_that_were_checked(folder: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Somebody may put another file there in between: it is checked in its turn, on the descriptor it is read from."""
    opened = os.open

    def swap(path: str, flags: int, *rest: int, dir_fd: int | None = None) -> int:
        fd = opened(path, flags, *rest, dir_fd=dir_fd)
        if path == "wire.py" and flags & os.O_PATH:
            os.rename(f"{folder}/wire.py", f"{folder}/before.py")
            Path(folder, "wire.py").write_text("raise SystemExit('another file')\n")
        return fd

    before = Path(folder, "wire.py").read_bytes()
    monkeypatch.setattr(os, "open", swap)
    assert own._source(f"{folder}/wire.py") == before


@pytest.mark.starts
@pytest.mark.parametrize("words", [("config", "--check"), ("run", "--config"), ("stop", "--config")], ids=" ".join)
def test_a_command_tells_of_it_in_a_line(words: tuple[str, ...], tmp_path: Path) -> None:
    """A stop that can't be written says so; where none is to be written, nobody is sent to the switch."""
    file = tmp_path / "robot.toml"
    file.write_text(f'[board]\nkind = "{tmp_path}/none"\n[device]\npath = "{tmp_path}/port"\n')
    done = commands.failstop(*words, str(file))
    assert done.returncode == 1
    [line] = done.stderr.splitlines()
    assert f"{tmp_path}/none: No such file or directory" in line
    assert ("; no stop was written: " in line and line.endswith("use the POWER SWITCH")) is (words[0] != "config")
    assert ("POWER SWITCH" in line) is (words[0] != "config")


@pytest.mark.starts
def test_a_service_keeps_the_stop_of_its_board(folder: str) -> None:
    """So that `failstop stop` can write it without running an own board's description, and at the right baud rate."""
    for kind, baud in ((folder, 0), ("arduino", 115_200)):
        made = Simulated({"board.baud": baud}, kind=kind)
        found = made.load("failstop.files.instance").last("failstop")
        board = board_of(kind, 0.08, 0.0, baud=baud)
        assert (found.board, found.stop) == (kind, kept.pack_stop(board))


HELD = {1: "464ac5a532f41919"}
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
