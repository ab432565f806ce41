"""The binary interface of the C library is the recorded one, so a program that was compiled with it goes on running."""

from __future__ import annotations

import subprocess

import pytest

from tests.clients import abi
from tests.support.c_client import SOURCE, library


def test_the_library_is_the_recorded_one() -> None:
    assert abi.described(library()) == abi.RECORDED.read_text(), abi.HOW


def test_the_library_exports_the_header_and_nothing_else() -> None:
    header = (SOURCE / "include" / "failstop.h").read_text()
    declared = [line for line in header.splitlines() if line.startswith("FS_API ")]
    assert set(abi.exported(library() / abi.SHARED)) == {
        line.partition("(")[0].split()[-1].lstrip("*") for line in declared
    }
    assert (library() / "libfailstop.so").is_symlink()


def test_every_exported_function_has_a_version_and_the_prefix() -> None:
    found = abi.exported(library() / abi.SHARED)
    assert len(found) > 20
    assert all(name.startswith("fs_") for name in found)
    assert set(found.values()) == {"FAILSTOP_0.1"}


def test_the_static_library_takes_no_other_names_from_a_program() -> None:
    listed = subprocess.run(
        ("nm", "--defined-only", "--extern-only", "--format=posix", library() / "libfailstop.a"),
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    names = [line.split()[0] for line in listed.stdout.splitlines() if " " in line]
    assert len(names) > 20
    assert [name for name in names if not name.startswith(("fs_", "fsi_"))] == []


@pytest.mark.parametrize(
    ("before", "after", "named"),
    [
        ("symbol fs_stop FAILSTOP_0.1\n", "", "symbol fs_stop FAILSTOP_0.1: now gone"),
        ("symbol fs_stop OLD\n", "symbol fs_stop NEW\n", "symbol fs_stop OLD: now NEW"),
        ("size fs_state 100\n", "size fs_state 96\n", "size fs_state 100: now 96"),
        ("field fs_state.size 0+4\n", "field fs_state.size 8+4\n", "field fs_state.size 0+4: now 8+4"),
    ],
)
def test_what_would_break_a_program_is_named(before: str, after: str, named: str) -> None:
    assert abi.broken(before, after) == [named]


def test_what_only_adds_breaks_nothing() -> None:
    before = "symbol fs_stop FAILSTOP_0.1\nsize fs_state 100\nfield fs_state.size 0+4\n"
    after = before.replace("state 100", "state 108") + "field fs_state.more 100+8\nsymbol fs_more FAILSTOP_0.2\n"
    assert abi.broken(before, after) == []
