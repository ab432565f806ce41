"""The image for containers: one OCI archive for both architectures, of Debian's packages and failstop's own.

Nothing of it runs while it is made, so an image for ARM is made on x86-64 without emulation. Its first layer is what
mmdebstrap unpacks of Debian, its second the packages failstop and failstop-lab. Equal to the byte for equal packages.
"""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import os
import shutil
import subprocess
import tarfile
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

SUITE, PYTHON = "trixie", "3.13"
"""The Debian of the image, and its Python."""
BASE = ("base-files", "base-passwd", "coreutils", "dash", "python3")
"""Debian's packages in it: accounts, a shell for people who look around, the interpreter."""
STATUS = "var/lib/dpkg/status"
"""dpkg's list of what is installed, by which scanners find packages that have known holes."""
LIST = (
    'mkdir -p "$1/var/lib/dpkg"; for deb in "$1"/var/cache/apt/archives/*.deb; do dpkg-deb --field "$deb"; '
    f"printf 'Status: install ok installed\\n\\n'; done >\"$1/{STATUS}\""
)
"""A hook of mmdebstrap, which unpacks packages here without dpkg: it lists them as dpkg would."""
BILL = "usr/share/doc/failstop/failstop.cdx.json"
"""The bill of materials, from failstop's package."""
LEFT_OUT = (
    "usr/share/man/",
    "usr/share/locale/",
    "usr/share/info/",
    "usr/share/lintian/",
    "var/",
    "dev/",
    "proc/",
    "sys/",
)
PREFIX = "opt/failstop/"
"""The part of failstop's packages that the image has: units and rules are for a machine with systemd."""
ACCOUNTS = {"etc/passwd": "usr/share/base-passwd/passwd.master", "etc/group": "usr/share/base-passwd/group.master"}
"""Files that Debian's scripts would make, which do not run: copies of these."""
FOLDERS = ("dev", "proc", "run", "sys", "tmp", "var/lib/failstop", "var/tmp")
CONFIG = {
    "Env": ["PATH=/opt/failstop/bin:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin", "LANG=C.UTF-8"],
    "Cmd": ["failstop", "run"],
}
DESCRIPTION = "Stops a robot when its software fails."
INDEX = "application/vnd.oci.image.index.v1+json"
MANIFEST = "application/vnd.oci.image.manifest.v1+json"
CONFIGURATION = "application/vnd.oci.image.config.v1+json"
LAYER = "application/vnd.oci.image.layer.v1.tar+gzip"
Member = tuple[tarfile.TarInfo, bytes]
Files = dict[str, Member]


def missing() -> str:
    """Why an image can't be made here; empty: it can."""
    return "" if shutil.which("mmdebstrap") else "mmdebstrap is not installed (apt install mmdebstrap)"


def base(architecture: str, kept: Path) -> Path:
    """A tar of Debian's packages for an architecture; made where there is none. Raises CalledProcessError."""
    path = kept / f"debian-{SUITE}-{architecture}.tar"
    if not path.exists():
        kept.mkdir(parents=True, exist_ok=True)
        words = ("mmdebstrap", "--quiet", "--variant=extract", f"--architectures={architecture}", "--format=tar")
        part = path.with_suffix(".part")
        subprocess.run(
            [*words, f"--include={','.join(BASE)}", f"--extract-hook={LIST}", SUITE, part],
            check=True,
        )
        part.rename(path)
    return path


def files(packed: tarfile.TarFile) -> Files:
    """The members of a tar by their paths, without LEFT_OUT, devices, and who owned them where they were packed."""
    found: Files = {}
    for row in packed:
        name = row.name.removeprefix("./").rstrip("/")
        left_out = f"{name}/".startswith(LEFT_OUT) and name != STATUS
        if not name or left_out or row.isdev():
            continue
        content = packed.extractfile(row) if row.isfile() or row.islnk() else None
        # Of a hard link a copy: in the order of names what it links may come after it.
        kind = tarfile.REGTYPE if row.islnk() else row.type
        found[name] = _row(name, kind, row.mode, row), content.read() if content else b""
    return found


def debian(path: Path) -> Files:
    """The first layer."""
    with tarfile.open(path) as packed:
        found = files(packed)
    for target, source in ACCOUNTS.items():
        found[target] = _row(target), found[source][1]
    for folder in FOLDERS:
        found[folder] = _row(folder, tarfile.DIRTYPE, 0o1777 if folder.endswith("tmp") else 0o755), b""
    return found


def failstop(packages: Iterable[Path]) -> Files:
    """The second layer: the environment that the Debian packages hold, with its modules compiled, and their bill."""
    found: Files = {}
    for package in packages:
        data = subprocess.run(["dpkg-deb", "--fsys-tarfile", package], check=True, capture_output=True).stdout
        with tarfile.open(fileobj=io.BytesIO(data)) as packed:
            rows = files(packed)
        compiled = [data for name, (_, data) in rows.items() if name.endswith(f"-{PYTHON}.tar.gz")]
        for one in compiled:
            with tarfile.open(fileobj=io.BytesIO(one)) as packed:
                found |= {
                    f"{PREFIX}{name}": (_named(row, f"{PREFIX}{name}"), data)
                    for name, (row, data) in files(packed).items()
                }
        wanted = {name: row for name, row in rows.items() if f"{name}/".startswith(PREFIX) or name == BILL}
        found |= {name: row for name, row in wanted.items() if not name.startswith(f"{PREFIX}compiled/")}
    return found


def _named(row: tarfile.TarInfo, name: str) -> tarfile.TarInfo:
    row.name = name
    return row


def _row(
    name: str, kind: bytes = tarfile.REGTYPE, mode: int = 0o644, old: tarfile.TarInfo | None = None
) -> tarfile.TarInfo:
    row = tarfile.TarInfo(name)
    row.type, row.mode = kind, mode
    if old:
        row.uid, row.gid, row.mtime, row.linkname = old.uid, old.gid, old.mtime, old.linkname
    return row


def tar(members: Iterable[Member], moment: int) -> bytes:
    """A tar with fixed order, owners' names and, where they are later, times."""
    inside = io.BytesIO()
    with tarfile.open(fileobj=inside, mode="w", format=tarfile.GNU_FORMAT) as packed:
        for row, data in sorted(members, key=lambda member: member[0].name):
            row.mtime = min(int(row.mtime), moment) or moment
            row.size = len(data) if row.isfile() else 0
            packed.addfile(row, io.BytesIO(data) if row.isfile() else None)
    return inside.getvalue()


class Archive:
    """An OCI image layout that grows, blob by blob."""

    def __init__(self, moment: int) -> None:
        self._moment = moment
        self._blobs: Files = {}

    def blob(self, kind: str, data: bytes, **more: Any) -> dict[str, Any]:
        """Keep it; its descriptor."""
        digest = hashlib.sha256(data).hexdigest()
        name = f"blobs/sha256/{digest}"
        self._blobs[name] = _row(name), data
        return {"mediaType": kind, "digest": f"sha256:{digest}", "size": len(data), **more}

    def image(self, architecture: str, layers: Iterable[bytes], version: str, homepage: str = "") -> dict[str, Any]:
        """One architecture's manifest, with these tars as layers; its descriptor."""
        tars = list(layers)
        created = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(self._moment))
        platform = {"architecture": architecture, "os": "linux"}
        words = {"title": "failstop", "version": version, "licenses": "MIT", "created": created, "url": homepage}
        words |= {"description": DESCRIPTION, "source": homepage, "base.name": f"debian:{SUITE}"}
        labels = {f"org.opencontainers.image.{name}": text for name, text in words.items() if text}
        configuration = {
            "created": created,
            **platform,
            "config": {**CONFIG, "Labels": labels},
            "rootfs": {"type": "layers", "diff_ids": [f"sha256:{hashlib.sha256(one).hexdigest()}" for one in tars]},
        }
        manifest = {
            "schemaVersion": 2,
            "mediaType": MANIFEST,
            "config": self.blob(CONFIGURATION, _json(configuration)),
            "layers": [self.blob(LAYER, gzip.compress(one, 6, mtime=0)) for one in tars],
            "annotations": labels,
        }
        return self.blob(MANIFEST, _json(manifest), platform=platform)

    def write(self, path: Path, manifests: list[dict[str, Any]], version: str) -> None:
        """Write all of it as one archive, tagged with the version."""
        images = self.blob(INDEX, _json({"schemaVersion": 2, "mediaType": INDEX, "manifests": manifests}))
        tagged = images | {"annotations": {"org.opencontainers.image.ref.name": version}}
        texts = {
            "index.json": _json({"schemaVersion": 2, "mediaType": INDEX, "manifests": [tagged]}),
            "oci-layout": _json({"imageLayoutVersion": "1.0.0"}),
        }
        members: Iterator[Member] = iter(self._blobs.values())
        path.write_bytes(tar([*members, *((_row(name), text) for name, text in texts.items())], self._moment))


def _json(found: object) -> bytes:
    return json.dumps(found, sort_keys=True, separators=(",", ":")).encode()


def make(version: str, packages: dict[str, list[Path]], kept: Path, out: Path, homepage: str = "") -> Path:
    """The image of both architectures; `packages` by architecture, `kept`: where Debian's part is, or is to be kept."""
    moment = int(os.environ["SOURCE_DATE_EPOCH"])
    archive = Archive(moment)
    manifests = []
    for architecture, debs in packages.items():
        layers = [debian(base(architecture, kept)), failstop(debs)]
        tars = (tar(layer.values(), moment) for layer in layers)
        manifests.append(archive.image(architecture, tars, version, homepage))
    path = out / f"failstop-{version}-image.tar"
    archive.write(path, manifests, version)
    return path
