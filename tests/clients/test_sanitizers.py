"""The C library under the compilers' warnings and sanitizers, and under valgrind: each program does everything at once
against a real service, and nothing may be found."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from failstop_lab.trial import Trial
from tests.support.c_client import SOURCE, compiler

STRICT = ("-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wpedantic", "-Wundef", "-Wformat=2", "-Werror")
HERE = (
    "-D_GNU_SOURCE",
    "-D_FILE_OFFSET_BITS=64",
    '-DFS_VERSION_TEXT="tried"',
    f"-I{SOURCE}/include",
    f"-I{SOURCE}/src",
)
SANITIZERS = {
    "address and undefined": ("-fsanitize=address,undefined", "-fno-sanitize-recover=all"),
    "thread": ("-fsanitize=thread",),
}
COMPILERS = ("gcc", "clang")
TRIED_S = 60.0


def sources() -> list[str]:
    return [str(path) for path in sorted((SOURCE / "src").glob("*.c"))]


def have(name: str) -> str:
    compiler()
    if not shutil.which(name):
        pytest.skip(f"not tried with {name}: apt install {name}")
    return name


@pytest.mark.parametrize("name", COMPILERS)
@pytest.mark.parametrize("standard", ["c11", "c17"])
def test_every_warning_of_a_compiler_is_an_error(name: str, standard: str) -> None:
    command = (have(name), f"-std={standard}", "-fsyntax-only", *STRICT, *HERE, *sources())
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", ["g++", "clang++"])
@pytest.mark.parametrize("standard", ["c++11", "c++20"])
def test_the_headers_are_plain_c_plus_plus(name: str, standard: str, tmp_path: Path) -> None:
    source = tmp_path / "own.cpp"
    source.write_text(
        "#include <failstop.hpp>\n"
        "int main() { failstop::Robot one; failstop::Robot other(std::move(one)); failstop::State state;\n"
        "  if (!other.open() || !other.connect()) return other.last_error().empty();\n"
        "  return other.state(state) == FS_OK && other.drive(failstop::Command(0.1)).code(); }\n"
    )
    command = (have(name), f"-std={standard}", "-fsyntax-only", *STRICT, f"-I{SOURCE}/include", str(source))
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("name", COMPILERS)
@pytest.mark.parametrize("sanitizer", SANITIZERS)
def test_a_sanitizer_finds_nothing(trial: Trial, tmp_path: Path, name: str, sanitizer: str) -> None:
    flags = (*SANITIZERS[sanitizer], "-std=c11", "-g", "-O1", "-pthread", *HERE)
    program = tmp_path / "threads"
    command = (have(name), *flags, "-o", str(program), f"{SOURCE}/tests/threads.c", *sources(), "-lm")
    made = subprocess.run(command, capture_output=True, text=True, check=False)
    if made.returncode and re.search(r"libclang_rt|lib[at]san", made.stderr):
        pytest.skip(f"{name} has no such sanitizer here: apt install libclang-rt-dev")
    assert made.returncode == 0, made.stderr
    judged(trial, str(program))


@pytest.mark.slow
def test_valgrind_finds_nothing(trial: Trial, tmp_path: Path) -> None:
    command = (compiler(), "-std=c11", "-g", "-O1", "-pthread", *HERE, "-o", str(tmp_path / "threads"))
    subprocess.run((*command, f"{SOURCE}/tests/threads.c", *sources(), "-lm"), check=True)
    # A fork has the thread-local storage of its parent's threads, which it can't give back.
    kinds = ("--show-leak-kinds=definite,indirect", "--errors-for-leak-kinds=definite,indirect")
    wanted = ("--error-exitcode=9", "--leak-check=full", *kinds, "--quiet")
    judged(trial, have("valgrind"), *wanted, str(tmp_path / "threads"))


def judged(trial: Trial, *command: str) -> None:
    trial.leave()
    done = subprocess.run((*command, trial.name), capture_output=True, text=True, check=False, timeout=TRIED_S)
    assert (done.returncode, done.stderr) == (0, "")
