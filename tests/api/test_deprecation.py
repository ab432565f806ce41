"""Deprecation: an old name goes on working and says what comes instead, and no release loses one that did not."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from failstop import config, version
from failstop.cli import main as cli
from failstop.policy.setting import SettingError
from failstop_lab.pages import public
from tests.support.deb import release

OLD_OPTION, OLD_SETTING = "config --sample", "gate.silence_s"
NEW = {OLD_OPTION: "config --example", OLD_SETTING: "gate.command_timeout_s"}


class Robot:
    """Two names of it are deprecated."""

    turning = 7
    halted = version.Renamed("turning")
    halt = version.Renamed("hold")

    def hold(self, why: str) -> str:
        return f"held: {why}"


@pytest.fixture
def deprecated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(version, "DEPRECATED", NEW)
    monkeypatch.setattr(public, "DEPRECATED", NEW)


def test_an_attribute_and_a_method_give_what_the_new_ones_give_and_warn() -> None:
    with pytest.warns(DeprecationWarning, match=r"Robot\.halted is deprecated, .*: use turning") as told:
        assert Robot().halted == 7
    assert [Path(each.filename) for each in told] == [Path(__file__)]
    with pytest.warns(DeprecationWarning, match=r"Robot\.halt is deprecated, .*: use hold"):
        assert Robot().halt("smoke") == "held: smoke"


@pytest.mark.usefixtures("deprecated")
def test_an_option_does_what_the_new_one_does_and_a_line_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["config", "--sample"]) == 0
    old = capsys.readouterr()
    assert cli.main(["config", "--example"]) == 0
    assert capsys.readouterr() == (old.out, "")
    assert old.err == (
        "failstop: config --sample is deprecated, and the next minor version may refuse it: use config --example\n"
    )
    assert version.options("config", ["--sample=x", "--samples", "--", "sample"]) == [
        *("--example=x", "--samples", "--", "sample")
    ]


@pytest.mark.usefixtures("deprecated")
def test_a_setting_counts_as_the_new_one_and_not_beside_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "failstop.toml"
    path.write_text("[gate]\nsilence_s = 0.4\n")
    assert config.load(str(path)).flat()["gate.command_timeout_s"] == 0.4
    assert f"{OLD_SETTING} is deprecated" in capsys.readouterr().err
    path.write_text("[gate]\nsilence_s = 0.4\ncommand_timeout_s = 0.3\n")
    with pytest.raises(SettingError, match=r"failstop\.toml: a setting is given by its old and its new name"):
        config.load(str(path))


@pytest.mark.usefixtures("deprecated")
def test_the_record_has_every_name_and_says_which_are_deprecated(monkeypatch: pytest.MonkeyPatch) -> None:
    from failstop.api.snapshot import State

    monkeypatch.setattr(State, "stands", version.Renamed("still"), raising=False)
    lines = public.text().splitlines()
    assert {line for line in lines if public.DEPRECATED_FOR in line} == {
        *(f"python {owner}.hold; deprecated: assert_interlocks" for owner in ("Robot", "AsyncRobot")),
        "option config --sample; deprecated: config --example",
        "setting gate.silence_s; deprecated: gate.command_timeout_s",
        "python State.stands; deprecated: still",
    }
    named = ("python Robot.drive(vx)", "python State.enabled", "option drive --for", "setting gate.lease_s")
    told = ("cause requested", "event disabled", "ros cmd_vel geometry_msgs/msg/Twist", "metric failstop_up")
    assert {*named, *told} <= set(lines)


@pytest.mark.parametrize(
    ("now", "minor", "gone"),
    [
        ("a\nb\nc\n", True, []),
        ("a; deprecated: c\n", True, []),
        ("c\n", True, ["a"]),
        ("a\n", False, ["b"]),
    ],
    ids=["more", "one more deprecated", "never deprecated", "a patch version"],
)
def test_a_name_that_is_gone_was_deprecated_in_the_release_before(now: str, minor: bool, gone: list[str]) -> None:
    assert public.lost("a\nb; deprecated: c\n", now, minor=minor) == gone


def test_no_release_is_made_that_lost_a_name_of_the_last(tmp_path: Path) -> None:
    def git(*words: str) -> None:
        who = ("-c", "user.name=a", "-c", "user.email=a@example.org")
        subprocess.run(["git", *who, *words], cwd=tmp_path, check=True, capture_output=True)

    git("init")
    release.lasting("0.2.0", "a\n", "notes", tmp_path)
    (tmp_path / public.PLACE).parent.mkdir(parents=True)
    (tmp_path / public.PLACE).write_text("a\nb; deprecated: c\n")
    git("add", "-A")
    git("commit", "-m", "first")
    git("tag", "v0.2.0")
    git("commit", "--allow-empty", "-m", "second")
    release.lasting("0.3.0", "a\n", "notes", tmp_path)
    for wrong, names in (("0.3.0", "c\n"), ("0.2.1", "a\n")):
        with pytest.raises(release.ReleaseError, match=r"public names of v0\.2\.0 are gone"):
            release.lasting(wrong, names, "notes", tmp_path)
    assert release.series("1.2.0") == release.series("1.1.4") != release.series("0.1.4")
    release.lasting("0.3.0", "c\n", f"{release.AT_ONCE}\n\n- a: it let wheels turn", tmp_path)
    git("tag", "v0.3.0")
    with pytest.raises(release.ReleaseError, match=r"of v0\.2\.0 are gone .*: a; bring them back"):
        release.lasting("0.3.0", "c\n", "notes", tmp_path)
