"""The image for containers, of small archives in place of Debian's: whole, the same for the same, for each machine."""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import subprocess
import tarfile
from pathlib import Path
from typing import Any

import pytest

from tests.support.deb import image

ENVIRONMENT = "opt/failstop/bin/failstop"


def debian(path: Path) -> None:
    """A tar as mmdebstrap makes one: a hard link before what it links to, a device, and papers."""
    rows = {
        "./etc/": None,
        "./usr/share/base-passwd/passwd.master": b"root:x:0:0::/root:/bin/sh\n",
        "./usr/share/base-passwd/group.master": b"root:x:0:\n",
        "./usr/share/doc/dash/copyright": b"free\n",
        "./usr/share/man/man1/dash.1.gz": b"page",
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
    for name in (ENVIRONMENT, "usr/lib/systemd/system/failstop.service", "DEBIAN/control"):
        (folder / name).parent.mkdir(parents=True)
        (folder / name).write_text("Package: failstop\nVersion: 1\nArchitecture: all\nMaintainer: a\nDescription: b\n")
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
        assert all(name.startswith("opt/failstop") for name in own)


def test_where_there_can_be_no_image_it_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    assert image.missing() == "mmdebstrap is not installed (apt install mmdebstrap)"
