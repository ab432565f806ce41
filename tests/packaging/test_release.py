"""A release: its files are equal to the byte whoever builds it, and say what they hold of others."""

from __future__ import annotations

import hashlib
import json
import re
import sys
import tarfile
import xml.etree.ElementTree as ElementTree
import zipfile
from importlib import metadata
from pathlib import Path

import pytest

from failstop_lab.pages import ros_changes
from tests.support.amounts import LONG
from tests.support.deb import release, sbom, tree
from tests.support.pages import ROOT


def test_a_version_that_is_none_and_a_changelog_without_it_are_named(tmp_path: Path) -> None:
    with pytest.raises(release.ReleaseError, match="two is no version: it has three numbers"):
        release.release("two", tmp_path / "out", tmp_path)
    assert not (tmp_path / "out").exists()
    with pytest.raises(release.ReleaseError, match=r"neither a part `## 0\.2\.0` nor"):
        release.notes("# Changes\n\n## 0.1.0\n\n- x\n", "0.2.0")


def test_the_notes_are_the_changelog_s_part() -> None:
    changes = "# Changes\n\nWhat.\n\n## 0.2.0\n\n**Added**\n\n- new\n\n## 0.1.0\n\n- old\n"
    assert release.notes(changes, "0.2.0") == "# failstop 0.2.0\n\n**Added**\n\n- new\n"
    assert release.notes(changes, "0.1.0") == "# failstop 0.1.0\n\n- old\n"


HOME = "https://example.org/me/failstop"


def test_the_links_of_the_long_description_lead_to_the_release() -> None:
    page = "[a](docs/a.md#x) ![p](docs/p.png) [b](https://x.org/y) [c](#here) [d](LICENSE)"
    assert release.absolute(page, "", f"{HOME}/blob/v1.0.0", f"{HOME}/raw/v1.0.0") == (
        f"[a]({HOME}/blob/v1.0.0/docs/a.md#x) ![p]({HOME}/raw/v1.0.0/docs/p.png) [b](https://x.org/y) [c](#here)"
        f" [d]({HOME}/blob/v1.0.0/LICENSE)"
    )
    assert release.absolute("[a](../../docs/a.md)", "integrations/lerobot", HOME, HOME) == f"[a]({HOME}/docs/a.md)"


def test_every_package_names_the_repository(tmp_path: Path) -> None:
    named = [
        *("pyproject.toml", "README.md", "lab/setup.py", "integrations/lerobot/pyproject.toml"),
        *("integrations/lerobot/README.md", "packaging/deb/failstop.control", "packaging/deb/failstop-lab.control"),
        *("packaging/deb/libfailstop0.control", "packaging/deb/libfailstop-dev.control"),
        *(f"{folder}/package.xml" for folder in ros_changes.FOLDERS.values()),
    ]
    for name in named:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text((ROOT / name).read_text())
    with pytest.raises(release.ReleaseError, match="--homepage nowhere is no address"):
        release.addressed(tmp_path, "nowhere", "0.2.0")
    release.addressed(tmp_path, HOME, "0.2.0")
    for name in named:
        assert HOME in (tmp_path / name).read_text(), name
    for folder in ros_changes.FOLDERS.values():
        manifest = ElementTree.parse(tmp_path / folder / "package.xml").getroot()
        assert {url.get("type"): url.text for url in manifest.iter("url")} == {
            "website": HOME,
            "repository": HOME,
            "bugtracker": f"{HOME}/issues",
        }
    linked = re.findall(r"\]\(([^)\s]+)\)", (tmp_path / "README.md").read_text())
    assert [link for link in linked if not link.startswith(("https://", "http://", "#"))] == []
    inside = [link.partition("/v0.2.0/")[2].partition("#")[0] for link in linked if link.startswith(HOME)]
    assert len(inside) > 20
    assert [path for path in inside if not (ROOT / path).exists()] == []


def test_the_maintainer_is_named_in_the_ros_packages_too(tmp_path: Path) -> None:
    for folder in ros_changes.FOLDERS.values():
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "package.xml").write_text((ROOT / folder / "package.xml").read_text())
    release.maintained(tmp_path, "Anna & Sons", "anna@example.org")
    for folder in ros_changes.FOLDERS.values():
        manifest = ElementTree.parse(tmp_path / folder / "package.xml").getroot()
        for tag in ("maintainer", "author"):
            (person,) = manifest.iter(tag)
            assert (person.text, person.get("email")) == ("Anna & Sons", "anna@example.org")


def test_the_workflow_s_maintainer_is_the_repository_s_where_it_has_one(monkeypatch: pytest.MonkeyPatch) -> None:
    workflow = (ROOT / ".github/workflows/release.yml").read_text()
    for name in release.MAINTAINER:
        assert f"{name}: ${{{{ vars.{name} }}}}\n" in workflow
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    monkeypatch.setenv("DEBFULLNAME", "")
    monkeypatch.setenv("DEBEMAIL", "anna@example.org")
    found = release.surroundings()
    assert (found["DEBFULLNAME"], found["DEBEMAIL"]) == (release.MAINTAINER["DEBFULLNAME"], "anna@example.org")


def test_nothing_is_signed_or_published_before_every_test_has_passed() -> None:
    text = (ROOT / ".github/workflows/release.yml").read_text()
    jobs = dict(re.findall(r"^  (\w+):\n((?:    .*\n|\n)*)", text.partition("\njobs:\n")[2], re.MULTILINE))
    needs = {
        name: set(re.findall(r"\w+", (re.findall(r"^    needs: ([^#\n]*)", job, re.MULTILINE) or [""])[0]))
        for name, job in jobs.items()
    }
    assert "bash .ci/run" in jobs["test"]

    def behind(job: str) -> set[str]:
        return needs[job].union(*map(behind, needs[job]))

    acting = [name for name, job in jobs.items() if ": write" in job]
    assert set(acting) == {"attest", "index", "publish"}
    assert all("test" in behind(name) for name in acting)


def test_every_wheel_of_ours_has_the_licence() -> None:
    for folder in ("lab", "integrations/lerobot"):
        assert (ROOT / folder / "LICENSE").read_text() == (ROOT / "LICENSE").read_text()


def wheel(path: Path, order: int, mode: int) -> Path:
    """A small one, its files in one order or the other."""
    rows = [("a/x.py", b"x = 1\n"), ("a-1.dist-info/METADATA", b"Name: a\n"), ("a-1.dist-info/RECORD", b"")][::order]
    with zipfile.ZipFile(path, "w") as packed:
        for name, data in rows:
            row = zipfile.ZipInfo(name, (2000 + mode % 50, 1, 1, 0, 0, 0))
            row.external_attr = mode << 16
            packed.writestr(row, data)
    return path


def test_a_wheel_has_its_bill_and_nothing_of_who_packed_it(tmp_path: Path) -> None:
    for number, (order, mode) in enumerate(((1, 0o600), (-1, 0o664))):
        release.with_bill(wheel(tmp_path / "a.whl", order, mode), tmp_path / f"{number}.whl", "{}")
    assert (tmp_path / "0.whl").read_bytes() == (tmp_path / "1.whl").read_bytes()
    with zipfile.ZipFile(tmp_path / "0.whl") as packed:
        assert packed.read("a-1.dist-info/sboms/failstop.cdx.json") == b"{}"
        record = packed.read("a-1.dist-info/RECORD").decode().splitlines()
    assert [line.split(",")[0] for line in record] == [
        *sorted(row.split(",")[0] for row in record[:-1]),
        "a-1.dist-info/RECORD",
    ]
    assert all(re.fullmatch(r"[^,]+,sha256=[\w-]{43},\d+", line) for line in record[:-1])


def test_an_sdist_has_nothing_of_who_packed_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    for number, (mode, names) in enumerate(((0o600, "ab"), (0o664, "ba"))):
        with tarfile.open(tmp_path / "old.tar.gz", "w:gz") as packed:
            for name in names:
                (tmp_path / name).write_text(name)
                (tmp_path / name).chmod(mode)
                packed.add(tmp_path / name, name)
        release.steady(tmp_path / "old.tar.gz", tmp_path / f"{number}.tar.gz")
    assert (tmp_path / "0.tar.gz").read_bytes() == (tmp_path / "1.tar.gz").read_bytes()
    assert set(release.members(tmp_path / "0.tar.gz")) == {"a", "b"}


def test_the_bill_names_every_package_with_version_and_licence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    needed = tree.needed(("web", "fleet"), without=())
    bill = sbom.packed("0.2.0", needed, "arm64")
    rows = {row["name"]: row for row in bill["components"]}
    assert {"numpy", "tornado", "msgpack"} <= set(rows)
    assert ("posix-ipc" in rows) == (sys.version_info < (3, 14)), "Python 3.14 needs none"
    assert rows["numpy"]["version"] == metadata.version("numpy")
    for name, row in rows.items():
        (licence,) = row["licenses"]
        assert licence.get("expression") or "not said" not in str(licence), name
    refs = {row["bom-ref"] for row in bill["components"]}
    assert {ref for row in bill["dependencies"] for ref in row.get("dependsOn", ())} == refs
    assert bill == sbom.packed("0.2.0", needed[::-1] + needed, "arm64"), "whatever order they are found in"
    assert json.loads(sbom.text(bill))["specVersion"] == "1.6"


def test_the_bill_has_the_hash_of_every_wheel(tmp_path: Path) -> None:
    found = []
    for python in ("3.11", "3.13"):
        path = tmp_path / python / f"a-1-cp{python}.whl"
        path.parent.mkdir()
        with zipfile.ZipFile(path, "w") as packed:
            packed.writestr("a-1.dist-info/METADATA", f"Name: a\nVersion: 1\nKeywords: {python}\n")
            packed.writestr("a-1.dist-info/RECORD", "")
        release.unpack([path], tmp_path / python)
        found.append((path, tree.finder(tmp_path / python)("a")))
    (row,) = sbom.packed("0.2.0", [one for _, one in found], "arm64")["components"]
    assert {one["url"]: one["hashes"][0]["content"] for one in row["externalReferences"]} == {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path, _ in found
    }


def test_wheels_that_were_kept_are_taken_only_where_the_lock_has_their_hashes(tmp_path: Path) -> None:
    digests = []
    for name in ("a", "b"):
        (tmp_path / f"{name}-1.whl").write_text(name)
        digests.append(hashlib.sha256(name.encode()).hexdigest())
    both = "".join(
        f"{name}==1 --hash=sha256:{digest} --hash=sha256:0\n" for name, digest in zip("ab", digests, strict=True)
    )
    assert release.kept(tmp_path, both)
    assert not release.kept(tmp_path, both.replace(digests[1], "1"))
    assert not release.kept(tmp_path, both + "c==1 --hash=sha256:2\n")
    assert not release.kept(tmp_path / "none", both)


@pytest.mark.starts
def test_a_release_is_kept_only_where_it_is_of_this_commit_and_unchanged(tmp_path: Path) -> None:
    out, stamp = tmp_path / "0.9.0", tmp_path / ".0.9.0.built"
    out.mkdir()
    (out / "a.deb").write_text("a")
    (out / "SHA256SUMS").write_text(f"{hashlib.sha256(b'a').hexdigest()}  a.deb\n")
    key = release.made_of("0.9.0", HOME)
    assert not release.whole(out, stamp, key)
    stamp.write_text(key)
    assert release.whole(out, stamp, key)
    assert not release.whole(out, stamp, release.made_of("0.9.0", ""))
    assert not release.whole(out, stamp, release.made_of("0.9.1", HOME))
    (out / "a.deb").write_text("b")
    assert not release.whole(out, stamp, key)
    (out / "a.deb").unlink()
    assert not release.whole(out, stamp, key)


BUNDLES = """\
Name: Fast
Files: a.libs/libfast*.so
Description: bundled
License: BSD-3-Clause
  The text.

Name: Sources
Files: vendored/*
License: MIT

Name: Runtime
Files: a.libs/libruntime*.so
Availability: somewhere
License: GPL-3.0-or-later WITH GCC-exception-3.1
"""
"""What numpy's licence text says of the libraries inside its wheel, in short."""


def test_the_bill_names_the_libraries_inside_a_wheel(tmp_path: Path) -> None:
    libraries = {f"a.libs/lib{name}": name.encode() for name in ("fast-1.so", "runtime-2.so.5.0.0", "other-3.so")}
    with zipfile.ZipFile(tmp_path / "a-1.whl", "w") as packed:
        about = {"METADATA": "Name: a\nVersion: 1\n", "licenses/LICENSE.txt": BUNDLES}
        files = {**libraries, **{f"a-1.dist-info/{name}": text.encode() for name, text in about.items()}}
        for name, data in files.items():
            packed.writestr(name, data)
        packed.writestr("a-1.dist-info/RECORD", "".join(f"{name},,\n" for name in files))
    release.unpack([tmp_path / "a-1.whl"], tmp_path / "site")
    (row,) = sbom.packed("0.2.0", [tree.finder(tmp_path / "site")("a")] * 2, "arm64")["components"]
    assert [(one["name"], *one["licenses"]) for one in row["components"]] == [
        ("Fast", {"expression": "BSD-3-Clause"}),
        ("libother", {"license": {"name": "not said"}}),
        ("Runtime", {"expression": "GPL-3.0-or-later WITH GCC-exception-3.1"}),
    ]
    assert {one["properties"][0]["value"]: one["hashes"][0]["content"] for one in row["components"]} == {
        name: hashlib.sha256(data).hexdigest() for name, data in libraries.items()
    }


def test_of_numpy_the_bill_names_what_is_neither_numpy_s_nor_under_its_licence() -> None:
    """Which libraries these are differs from release to release: numpy's own licence text must name each."""
    numpy = metadata.distribution("numpy")
    inside = {str(file) for file in numpy.files or () if "numpy.libs" in file.parts[0] and ".so" in file.name}
    found = sbom.component(numpy).get("components", [])
    assert {one["properties"][0]["value"] for one in found} == inside
    licences = {one["name"]: str(one["licenses"]) for one in found}
    assert not [name for name, licence in licences.items() if sbom.UNSAID in licence]
    assert all("exception" in licence for name, licence in licences.items() if name.startswith("GCC runtime"))


@pytest.mark.slow
@pytest.mark.starts
@pytest.mark.timeout(1800)
@pytest.mark.skipif(not LONG, reason="`make campaigns` builds a release twice")
def test_built_twice_it_is_equal_to_the_byte(tmp_path: Path) -> None:
    names = {path.name for path in release.twice("0.9.0", tmp_path, tmp_path / "wheels")}
    assert {Path(name).suffix for name in names} >= {".whl", ".gz", ".deb", ".json", ".md"}
    of_each = ("failstop", "libfailstop0", "libfailstop-dev")
    assert names >= {f"{name}_0.9.0_{machine}.deb" for name in of_each for machine in ("amd64", "arm64")}


def test_two_releases_that_are_not_equal_are_told_apart(tmp_path: Path) -> None:
    for number, text in enumerate(("x = 1\n", "x = 2\n")):
        (tmp_path / f"{number}").mkdir()
        with zipfile.ZipFile(tmp_path / f"{number}" / "a.whl", "w") as packed:
            packed.writestr("a/x.py", text)
    assert release.first_difference(tmp_path / "0", tmp_path / "0") == ""
    assert release.first_difference(tmp_path / "0", tmp_path / "1") == "a.whl: a/x.py"
