"""The man page: what the parsers say, and what man(1) takes without a warning."""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from failstop.cli import main as cli
from failstop_lab.pages import completion, man


def test_man_takes_the_page_without_a_warning(tmp_path: Path) -> None:
    if not shutil.which("man") or not shutil.which("groff"):
        pytest.skip("man is not installed")
    page = tmp_path / "failstop.1"
    page.write_text(man.page())
    program = ["man", "--warnings", "-E", "UTF-8", "-l", "-Tutf8", str(page)]
    environ = {**os.environ, "MANWIDTH": "100", "TERM": "dumb"}
    result = subprocess.run(program, capture_output=True, text=True, timeout=60, env=environ)
    assert (result.returncode, result.stderr) == (0, "")
    words = set(re.sub(r"\x1b\[[0-9;]*m|.\x08", "", result.stdout).split())
    for name in cli.COMMANDS:
        assert name in words
    for name in cli.COMMANDS:
        for parser in completion.walk(cli.load(name)[0]):
            flags = {flag for action in completion.arguments(parser) for flag in action.option_strings}
            assert flags <= {word.rstrip(",") for word in words}, parser.prog


def test_the_page_has_the_date_of_its_source(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    assert '\n.TH FAILSTOP 1 "2023-11-14" ' in man.page()


def test_the_page_has_the_parts_of_a_man_page() -> None:
    text = man.page()
    sections = re.findall(r"^\.SH (.*)$", text, re.MULTILINE)
    assert sections[:3] == ["NAME", "SYNOPSIS", "DESCRIPTION"]
    assert sections[-4:] == ["EXIT STATUS", "FILES", "ENVIRONMENT", "SEE ALSO"]
    requests = {"TH", "SH", "SS", "PP", "TP", "B", "I", "RS", "RE", "nf", "fi", "nh", "ad", '\\"'}
    for line in text.splitlines():
        assert line
        assert not line.startswith("'")
        if line.startswith("."):
            assert line[1:].split()[0] in requests, line


def test_no_line_of_the_page_ends_between_a_number_and_its_unit() -> None:
    text = man.page()
    assert "0.3\\~s" in text
    assert not re.search(r"[0-9] (ms|s|m/s|rad/s|Hz|V|%)\b", text)


def test_texts_that_look_like_requests_are_texts() -> None:
    parser = argparse.ArgumentParser(prog="odd", description="'quoted first.", epilog=".B failstop odd")
    parser.add_argument("--odd", metavar="F", help=".SH of 'it' \\ - `x`")
    text = "\n".join(man.command(parser)) + "\n"
    assert "\n\\&.SH of \\(aqit\\(aq \\e \\- \\(gax\\(ga\n" in text
    assert "\n\\(aqquoted first.\n" in text
    assert "\n\\&.B failstop odd\n" in text
