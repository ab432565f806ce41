"""The pages are true: what they show runs and prints that, or is at least accepted; what they link to is there."""

from __future__ import annotations

import itertools
import os
import re
from pathlib import Path

import pytest

from failstop import config
from failstop.cli import main as cli
from failstop_lab.pages import completion
from tests.support.pages import PAGES, ROOT, SHELL, Block, blocks, commands_in, indented, inline

from .session import Session, differs

MARKED = (
    "README.md",
    "your-robot.md",
    "questions.md",
    "quickstart.md",
    "setup.md",
    "architecture.md",
    "safety.md",
    "docs/python.md",
)
"""Pages on which every block of commands is marked."""
ALONE = "run: in a terminal of its own"
AGAIN = "run: in the same terminal, after Ctrl-C"
SAVED = "run: save as "
_numbers = itertools.count()


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def accepted(words: list[str]) -> None:
    """Raises SystemExit with argparse's message when the parser does not accept the words."""
    if words[1].startswith("-") or words[1] == "help":
        return
    assert words[1] in cli.COMMANDS, " ".join(words)
    parser, _ = cli.load(words[1])
    if "--help" not in words:
        parser.parse_args(words[2:])


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_the_parsers_accept_every_command_in_a_block(page: Path) -> None:
    for block in blocks(page):
        if block.language in SHELL:
            for command, _ in block.steps():
                for words in commands_in(command):
                    accepted(words)
    for command in indented(page):
        for words in commands_in(command):
            accepted(words)


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_the_commands_in_the_text_exist_with_their_options(page: Path) -> None:
    for command in inline(page):
        words = [word.strip("[](),;") for word in command.removeprefix("sudo ").split()]
        if words[1].isupper() or words[1].startswith("-"):
            continue
        assert words[1] in cli.COMMANDS, command
        parser, _ = cli.load(words[1])
        arguments = (argument for each in completion.walk(parser) for argument in completion.arguments(each))
        known = {"--help", *(option for argument in arguments for option in argument.option_strings)}
        for word in words[2:]:
            if word.startswith("--"):
                assert word.partition("=")[0] in known, command


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_the_settings_in_a_block_are_accepted(page: Path, tmp_path: Path) -> None:
    file = tmp_path / "page.toml"
    for block in blocks(page):
        if block.language == "toml":
            file.write_text(block.text)
            config.load(str(file))


@pytest.mark.parametrize("page", [page for page in PAGES if str(page).endswith(MARKED)], ids=name_of)
def test_every_block_of_commands_is_marked(page: Path) -> None:
    for block in blocks(page):
        if block.language in (*SHELL, "python"):
            assert block.mark is not None, f"{block}: run it, or say why it is only parsed"
            assert re.fullmatch(rf"run|{ALONE}|{AGAIN}|{SAVED}\w+\.\w+|parse: \w.*", block.mark), block
        assert block.language, f"{block}: which language?"
    assert not indented(page), "fence it, so that it is run or at least marked"


def sessions() -> list[Path]:
    return [page for page in PAGES if any((block.mark or "").startswith("run") for block in blocks(page))]


@pytest.mark.slow
@pytest.mark.parametrize("page", sessions(), ids=name_of)
def test_what_a_page_shows_is_what_happens(page: Path, tmp_path: Path) -> None:
    terminals: list[tuple[Block, list[str]]] = []
    found = blocks(page)
    with Session(f"docs-{os.getpid()}-{next(_numbers)}", tmp_path) as session:
        if not any(block.mark == ALONE for block in found):
            session.stay("failstop sim --device /tmp/board --imu-hz 20")
            session.stay("failstop run --device /tmp/board")
        for block in found:
            if block.mark == ALONE:
                ((command, shown),) = block.steps()
                session.stay(command)
                terminals.append((block, shown))
            elif block.mark == AGAIN:
                ((command, shown),) = block.steps()
                session.stay_again(command)
                terminals.append((block, shown))
            elif block.mark and block.mark.startswith(SAVED):
                session.save(block.mark.removeprefix(SAVED), block.text)
            elif block.mark == "run" and block.language == "python":
                session.python(block.text)
            elif block.mark == "run":
                run(session, block)
        for index, (block, shown) in enumerate(terminals):
            if shown:
                assert not (wrong := differs(shown, session.said(index))), f"{block}: {wrong}"


def run(session: Session, block: Block) -> None:
    for command, shown in block.steps():
        printed, code = session.run(command)
        if block.language == "console":
            assert not (wrong := differs(shown, printed)), f"{block}: $ {command}\n{wrong}"
        else:
            assert code == 0, f"{block}: $ {command}\n{printed}"


TOPS = (
    *("bench", "clients", "examples", "integrations", "lab", "model"),
    *("packaging", "procs", "shm", "supervisor", "systemd", "tests"),
)
FOLDERS = [
    *(ROOT / name for name in ("CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md")),
    *sorted(page for top in TOPS for page in (ROOT / top).rglob("*.md")),
]
"""The pages of folders, for developers: they are on no site, and may link to anything in the checkout."""


@pytest.mark.parametrize("page", [*PAGES, *FOLDERS], ids=name_of)
def test_what_a_page_links_to_is_there(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        if "://" in target:
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        assert file.exists(), target
        assert page not in PAGES[1:] or ROOT / "docs" in file.parents, f"{target} is not on the site"
        if anchor:
            heads = re.findall(r"^#+ (.*)$", file.read_text(), re.MULTILINE)
            assert anchor in {re.sub(r"[^\w -]", "", head.lower()).replace(" ", "-") for head in heads}, target


NAMING = ("", ".c", ".h", ".hpp", ".md", ".py", ".service", ".toml", ".udev", ".xml", ".yml")
NAMED = re.compile(r"(?<![\w/.:-])(?:docs|lab|model|procs|tests)/[\w/.-]*\.md\b")
"""A page that a source, a unit or a message names by its path in the checkout."""


def test_a_page_that_is_named_anywhere_is_there() -> None:
    """Not tests/packaging, which makes changelogs of its own."""
    found = []
    for top in (*TOPS, "failstop", "docs", "Makefile", "pyproject.toml", "CONTRIBUTING.md", "SECURITY.md"):
        place = ROOT / top
        for file in [place] if place.is_file() else sorted(place.rglob("*")):
            if (
                file.suffix in NAMING
                and file.is_file()
                and "packaging" not in file.parts[:-1]
                and "build" not in file.parts
            ):
                text = file.read_text("utf-8", errors="replace")
                found += [(str(file), name) for name in NAMED.findall(text) if not (ROOT / name).exists()]
    assert found == []


def test_the_index_and_the_site_have_every_page() -> None:
    index, site = (ROOT / "docs" / "README.md").read_text(), (ROOT / "mkdocs.yml").read_text()
    for page in PAGES[1:]:
        path = page.relative_to(ROOT / "docs")
        assert path.name == "README.md" or f"({path})" in index, f"docs/README.md does not name {path}"
        assert len(re.findall(rf"[\[ ]{path}[\],\n]", site)) == 1, f"mkdocs.yml does not name {path} once"


def test_the_robot_in_the_browser_is_where_its_page_leads_and_replaces_no_page() -> None:
    made = (ROOT / "Makefile").read_text()
    (address,) = re.findall(r"cp build/browser/index\.html build/site/(\S+)", made)
    assert f'<a href="{address}">' in (ROOT / "docs/touch.md").read_text()
    assert address not in {f"{page.relative_to(ROOT / 'docs').with_suffix('')}/index.html" for page in PAGES[1:]}


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_the_make_targets_exist(page: Path) -> None:
    targets = set(re.findall(r"^([a-z][a-z0-9-]*):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for target in re.findall(r"(?:`|^ {4}|^)make ([a-z][a-z0-9-]*)", page.read_text(), re.MULTILINE):
        assert target in targets, f"make {target}"


def test_blocks_are_found_with_their_marks(tmp_path: Path) -> None:
    page = ROOT / "docs" / "never.md"
    text = "# T\n\n<!-- run -->\n```console\n$ a \\\n  b\nout 1\n\nout 2\n$ c\n```\n\n```text\nx\n```\n"
    found = [Block("p", 1, match["mark"], match["language"], match["text"]) for match in _fences(text)]
    assert [(block.mark, block.language) for block in found] == [("run", "console"), (None, "text")]
    assert found[0].steps() == [("a   b", ["out 1", "out 2"]), ("c", [])]
    assert not page.exists()


def _fences(text: str) -> list[re.Match[str]]:
    from tests.support.pages import FENCE

    return list(FENCE.finditer(text))


@pytest.mark.parametrize(
    ("shown", "printed", "same"),
    [
        (["took 0.3 ms"], "took  12 ms\n", True),
        (["took 0.3 ms"], "took 300 us", True),
        (["took 0.3 ms"], "took no time", False),
        (["next: `enable`"], "next: `enable --name failstop`", True),
        (["a", "...", "b"], "a\nx\ny\nb", True),
        (["a", "..."], "a\nx", True),
        (["a"], "a\nx", False),
        (["kill .... 0.2 ms"], "kill .... 7 ms", True),
        (["kill .... 0.2 ms"], "kill it now 7 ms", False),
        (["a", "b"], "a", False),
        (["pid 7 ... died"], "pid 812 (gate) died", True),
        ([], "anything", False),
    ],
)
def test_output_is_compared_but_for_numbers(shown: list[str], printed: str, same: bool) -> None:
    assert (differs(shown, printed) == "") == same


def test_commands_are_found_in_shell_lines() -> None:
    assert commands_in("sudo failstop stop --wait 2 > file; failstop reset && failstop enable &  # and done") == [
        ["failstop", "stop", "--wait", "2"],
        ["failstop", "reset"],
        ["failstop", "enable"],
    ]
    assert commands_in("sudo systemctl restart failstop; usermod -aG failstop me") == []
    assert commands_in("ssh -t robot failstop status -w | cat") == [["failstop", "status", "-w"]]
