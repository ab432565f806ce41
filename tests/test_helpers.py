"""Helper processes find what their starter finds, and nothing in the current folder; nobody starts Python otherwise."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop import helpers
from tests.support.pages import ROOT
from tests.support.rooms import package

MAY_NAME_THE_INTERPRETER = {
    "failstop/helpers.py": "it is the one way",
    "supervisor/starter.py": "the service's own processes: -I -S, and the search path of a command",
    "lab/failstop_lab/prove/frozen.py": "-I -S, and nothing but Python's own modules",
    "failstop/extras.py": "advice for a person",
    "failstop/cli/missing.py": "advice for a person",
    "lab/failstop_lab/simulate/tested_controls.py": "pytest, in a changed copy of the checkout",
}
STARTS = frozenset({"Popen", "run", "call", "check_call", "check_output", "create_subprocess_exec"})
OF_OS = frozenset({"system", "popen", "execv", "execl", "execvp", "execlp", "spawnv", "spawnl", "spawnlp", "spawnvp"})
POOLS = frozenset({"multiprocessing", "mp", "concurrent", "futures"})


def python_starts(tree: ast.AST) -> Iterator[str]:
    """The calls in a module that may start a Python process past the one way."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and node.attr in ("executable", "_base_executable"):
            yield ast.unparse(node)
        if not isinstance(node, ast.Call):
            continue
        whole = ast.unparse(node.func)
        top, name = whole.partition(".")[0], whole.rpartition(".")[2]
        first = node.args[0] if node.args else None
        words = [getattr(word, "value", None) for word in getattr(first, "elts", [first])]
        named = [os.path.basename(str(word)).startswith(("python", "failstop")) for word in words if word]
        another = (
            name in STARTS and named[:1] == [True],
            top == "os" and name in OF_OS,
            name in ("get_context", "set_start_method") and words != ["fork"],
            whole in (f"{top}.Process", f"{top}.Pool") and top in POOLS,
            name == "ProcessPoolExecutor",
        )
        if any(another):
            yield ast.unparse(node)


@pytest.mark.parametrize(
    "source",
    [
        'subprocess.Popen([sys.executable, "-m", "failstop"])',
        'subprocess.run(("python3", "-m", "failstop_lab.sim"))',
        'subprocess.run(["failstop", "stop"])',
        'os.system("python -m failstop")',
        'multiprocessing.get_context("spawn").Pool()',
        "multiprocessing.Process(target=work)",
        "concurrent.futures.ProcessPoolExecutor()",
    ],
)
def test_another_way_is_seen(source: str) -> None:
    assert list(python_starts(ast.parse(source)))


def test_nothing_in_the_package_starts_python_another_way() -> None:
    found = {str(path.relative_to(ROOT)): list(python_starts(ast.parse(path.read_text()))) for path in package()}
    assert len(found) > 300
    others = {name: starts for name, starts in found.items() if starts and name not in MAY_NAME_THE_INTERPRETER}
    assert others == {}
    assert [name for name in MAY_NAME_THE_INTERPRETER if not found[name]] == []


@pytest.fixture
def theirs(tmp_path: Path) -> Path:
    """A folder of somebody else's, with modules that say so."""
    folder = tmp_path / "theirs"
    (folder / "lib").mkdir(parents=True)
    for module in ("json", "sitecustomize", "usercustomize"):
        (folder / f"{module}.py").write_text("raise SystemExit('theirs')")
    return folder


def ran(program: str, begins_with: list[str], folder: Path | str, named: str = "") -> list[str]:
    """The lines that a program prints, run in a folder with these first on its path, and that PYTHONPATH."""
    before = f"import os, sys; sys.path[:0] = {begins_with!r}; from failstop import helpers; "
    environment = {**os.environ, "PYTHONPATH": named}
    command = [sys.executable, "-I", "-c", before + program]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=True
    ).stdout.splitlines()


def test_the_current_folder_is_left_out_however_it_came_there(theirs: Path) -> None:
    program = "helpers.leave_current_folder(); print(os.environ['PYTHONPATH'], *sys.path, sep='\\n')"
    ways = [str(theirs), "/opt/ros/lib", str(theirs / "lib"), "", ".", "lib"]
    named, *found = ran(program, ways, theirs, f"/opt/ros/lib:lib:{os.pathsep}")
    assert named == "/opt/ros/lib"
    assert {"/opt/ros/lib", str(ROOT)} <= {*found}
    assert not [path for path in found if path.startswith(str(theirs)) or not os.path.isabs(path)]


@pytest.mark.parametrize("meant", ["PYTHONPATH", "failstop", "Python"])
def test_a_folder_that_was_meant_stays(meant: str, theirs: Path) -> None:
    folder = {"PYTHONPATH": str(theirs), "failstop": str(ROOT), "Python": os.path.dirname(os.__file__)}[meant]
    found = ran("print(*helpers.search_path(), sep='\\n')", [folder], folder, str(theirs))
    assert folder in found


def test_a_folder_that_was_removed_is_no_error(theirs: Path) -> None:
    program = "import shutil; shutil.rmtree(os.getcwd()); print(*helpers.search_path(), sep='\\n')"
    assert str(ROOT) in ran(program, [], theirs)


@pytest.mark.parametrize("named", ["PYTHONPATH", "the path alone"])
def test_a_helper_finds_what_its_starter_finds(named: str, theirs: Path, tmp_path: Path) -> None:
    """As ROS's modules, and those of a user's site-packages."""
    ros = tmp_path / "ros"
    ros.mkdir()
    (ros / "of_ros.py").write_text("import json, sys; print(sys.argv, __name__)")
    program = "import subprocess; subprocess.run(helpers.python('of_ros', 'a', 'b c'), check=True)"
    found = ran(program, [str(ros), str(theirs)], theirs, f":{ros}" if named == "PYTHONPATH" else ":")
    assert found == [f"['{ros}/of_ros.py', 'a', 'b c'] __main__"]


def test_a_program_is_run_as_python_runs_it() -> None:
    program = "import sys; assert __name__ == '__main__'; print(sys.argv)"
    done = subprocess.run(helpers.python("-c", program, "a"), capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "['-c', 'a']"


def test_a_library_reads_no_settings_of_the_current_folder(theirs: Path) -> None:
    """And the current folder is the same afterwards. matplotlib reads a matplotlibrc there, before any other."""
    pytest.importorskip("matplotlib")
    (theirs / "matplotlibrc").write_text("backend: module://of_theirs\nfigure.facecolor: red\n")
    (theirs / "of_theirs.py").write_text("raise SystemExit('theirs')")
    shown = "print(sys.modules['matplotlib'].rcParams['figure.facecolor'], os.getcwd())"
    program = f"helpers.import_elsewhere('matplotlib'); {shown}"
    assert ran(program, [*filter(os.path.isabs, sys.path)], theirs) == [f"white {theirs}"]


def test_matplotlib_is_imported_elsewhere_wherever_it_is_used() -> None:
    texts = {str(path.relative_to(ROOT)): path.read_text() for path in package()}
    users = {name for name, text in texts.items() if "from matplotlib" in text or '"matplotlib.' in text}
    assert users == {name for name, text in texts.items() if 'import_elsewhere("matplotlib")' in text}
    assert len(users) == 2
