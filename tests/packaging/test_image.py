"""The image for containers, of small archives in place of Debian's: whole, the same for the same, for each machine."""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import shutil
import subprocess
import tarfile
from pathlib import Path
from typing import Any

import pytest

from tests.support.deb import image

ENVIRONMENT = "opt/failstop/bin/failstop"
BILL = "usr/share/doc/failstop/failstop.cdx.json"
STATUS = b"Package: libssl3\nStatus: install ok installed\nVersion: 3.0.1\n\n"
HOME = "https://example.org/me/failstop"


def debian(path: Path) -> None:
    """A tar as mmdebstrap makes one: a hard link before what it links to, a device, and papers."""
    rows = {
        "./etc/": None,
        "./usr/share/base-passwd/passwd.master": b"root:x:0:0::/root:/bin/sh\n",
        "./usr/share/base-passwd/group.master": b"root:x:0:\n",
        "./usr/share/doc/dash/copyright": b"free\n",
        "./usr/share/man/man1/dash.1.gz": b"page",
        "./var/lib/dpkg/status": STATUS,
        "./var/cache/apt/archives/dash.deb": b"packed",
        "./bin/dash": b"shell",
    }
    with tarfile.open(path, "w") as packed:
        for name, data in rows.items():
            row = tarfile.TarInfo(name)
            row.type, row.size, row.uname, row.mtime = (
                (tarfile.REGTYPE, len(data), "anna", 2**31) if data else (tarfile.DIRTYPE, 0, "", 5)
            )
            packed.addfile(row, io.BytesIO(data or b""))
        for name, kind, target in (
            ("./bin/a", tarfile.LNKTYPE, "./bin/dash"),
            ("./bin/sh", tarfile.SYMTYPE, "dash"),
            ("./dev/null", tarfile.CHRTYPE, ""),
        ):
            row = tarfile.TarInfo(name)
            row.type, row.linkname = kind, target
            packed.addfile(row)


def package(folder: Path) -> Path:
    """A Debian package with a file of the environment and a unit."""
    fields = {"Package": folder.name, "Version": "1", "Architecture": "all", "Maintainer": "a", "Description": "b"}
    for name in (ENVIRONMENT, BILL, "usr/lib/systemd/system/failstop.service", "DEBIAN/control"):
        (folder / name).parent.mkdir(parents=True)
        (folder / name).write_text("".join(f"{field}: {text}\n" for field, text in fields.items()))
    out = folder.with_suffix(".deb")
    subprocess.run(["dpkg-deb", "--root-owner-group", "--build", folder, out], check=True, capture_output=True)
    return out


def blobs(path: Path) -> tuple[dict[str, Any], dict[str, bytes]]:
    """The index of an archive, and its blobs, each of which is what its name says."""
    with tarfile.open(path) as packed:
        found = {row.name: packed.extractfile(row).read() for row in packed}  # type: ignore[union-attr]
    held = {f"sha256:{name.rpartition('/')[2]}": data for name, data in found.items() if name.startswith("blobs/")}
    assert all(f"sha256:{hashlib.sha256(data).hexdigest()}" == digest for digest, data in held.items())
    assert json.loads(found["oci-layout"]) == {"imageLayoutVersion": "1.0.0"}
    return json.loads(found["index.json"]), held


def files(layer: bytes) -> dict[str, tuple[tarfile.TarInfo, bytes]]:
    """The members of a layer by name, with what is in them."""
    with tarfile.open(fileobj=io.BytesIO(layer)) as packed:
        return {row.name: (row, file.read() if (file := packed.extractfile(row)) else b"") for row in packed}


@pytest.mark.starts
def test_an_archive_has_a_whole_image_for_each_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    monkeypatch.setattr(image, "SUITE", "any")
    for machine in ("amd64", "arm64"):
        debian(tmp_path / f"debian-any-{machine}.tar")
    debs = {machine: [package(tmp_path / machine)] for machine in ("amd64", "arm64")}
    path = image.make("0.2.0", debs, tmp_path, tmp_path)
    first = path.read_bytes()
    index, held = blobs(path)
    assert image.make("0.2.0", debs, tmp_path, tmp_path).read_bytes() == first
    [tagged] = index["manifests"]
    assert tagged["annotations"] == {"org.opencontainers.image.ref.name": "0.2.0"}
    manifests = json.loads(held[tagged["digest"]])["manifests"]
    assert [row["platform"]["architecture"] for row in manifests] == ["amd64", "arm64"]
    for row in manifests:
        manifest = json.loads(held[row["digest"]])
        config = json.loads(held[manifest["config"]["digest"]])
        layers = [gzip.decompress(held[layer["digest"]]) for layer in manifest["layers"]]
        assert config["rootfs"]["diff_ids"] == [f"sha256:{hashlib.sha256(layer).hexdigest()}" for layer in layers]
        assert (config["architecture"], config["config"]["Cmd"]) == (
            row["platform"]["architecture"],
            ["failstop", "run"],
        )
        base, own = map(files, layers)
        assert base["bin/a"][1] == b"shell"
        assert {"bin/sh", "etc/passwd", "etc/group", "tmp", "usr/share/doc/dash/copyright"} < set(base)
        assert not {"dev/null", "usr/share/man/man1/dash.1.gz"} & set(base)
        assert {(row.uname, row.mtime <= 1700000000) for row, _ in base.values()} == {("", True)}
        assert ENVIRONMENT in own
        assert all(name.startswith("opt/failstop") or name == BILL for name in own)


@pytest.mark.starts
def test_a_scanner_sees_what_is_in_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By dpkg's list of Debian's packages, by the bill of what failstop brings along, and by labels."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    monkeypatch.setattr(image, "SUITE", "any")
    debian(tmp_path / "debian-any-arm64.tar")
    path = image.make("0.2.0", {"arm64": [package(tmp_path / "arm64")]}, tmp_path, tmp_path, HOME)
    index, held = blobs(path)
    (row,) = json.loads(held[index["manifests"][0]["digest"]])["manifests"]
    manifest = json.loads(held[row["digest"]])
    base, own = (files(gzip.decompress(held[layer["digest"]])) for layer in manifest["layers"])
    assert base[image.STATUS][1] == STATUS
    assert not [name for name in base if name.startswith("var/cache")]
    assert BILL in own
    labels = json.loads(held[manifest["config"]["digest"]])["config"]["Labels"]
    assert manifest["annotations"] == labels
    words = {name.removeprefix("org.opencontainers.image."): text for name, text in labels.items()}
    assert words | {"description": ""} == {
        "title": "failstop",
        "version": "0.2.0",
        "licenses": "MIT",
        "created": "2023-11-14T22:13:20Z",
        "url": HOME,
        "source": HOME,
        "base.name": "debian:any",
        "description": "",
    }


@pytest.mark.skipif(not shutil.which("dpkg-deb"), reason="not installed: dpkg-deb")
@pytest.mark.starts
def test_the_list_of_packages_is_one_that_dpkg_reads(tmp_path: Path) -> None:
    """Of the packages that mmdebstrap has fetched, by the hook that it runs."""
    archives = tmp_path / "var/cache/apt/archives"
    archives.mkdir(parents=True)
    for name in ("one", "two"):
        package(tmp_path / name).rename(archives / f"{name}.deb")
    subprocess.run(["sh", "-euc", image.LIST, "hook", tmp_path], check=True)
    words = ("dpkg-query", f"--admindir={tmp_path / 'var/lib/dpkg'}", "--show", "-f=${Package} ${Status} ${Version}\n")
    done = subprocess.run(words, check=True, capture_output=True, text=True)
    assert done.stdout.splitlines() == ["one install ok installed 1", "two install ok installed 1"]


def test_where_there_can_be_no_image_it_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    assert image.missing() == "mmdebstrap is not installed (apt install mmdebstrap)"
