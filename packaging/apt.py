"""`make apt VERSION=x URL=https://... KEY=you@example.org`: a signed apt folder of a release, to host as a static site.

One suite, `stable`, is for every Debian and Ubuntu that failstop runs on, because its packages are. Only a person has
the key: what is signed here is signed with theirs, and nothing is uploaded.
"""

from __future__ import annotations

import argparse
import email.utils
import gzip
import hashlib
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

SUITE, COMPONENT = "stable", "main"
ARCHITECTURES = ("amd64", "arm64")
PUBLIC = "failstop.gpg"
"""The public key, as apt wants it."""
KEYRING = f"/usr/share/keyrings/{PUBLIC}"
LINES = """\
sudo curl -fsSLo {keyring} {url}/{public}
echo "deb [signed-by={keyring}] {url} {suite} {component}" | sudo tee /etc/apt/sources.list.d/failstop.list
sudo apt update && sudo apt install failstop
"""
PAGE = """\
<!doctype html>
<meta charset="utf-8">
<title>failstop's packages</title>
<h1>failstop's packages</h1>
<p>For Debian 12 and 13, Ubuntu 22.04, 24.04 and 26.04, and Raspberry Pi OS (64-bit):</p>
<pre>{lines}</pre>
<p>The key's fingerprint is <code>{fingerprint}</code>.</p>
"""


class AptError(Exception):
    """No folder is made; the message is one line with the remedy."""


def main(words: Sequence[str] | None = None) -> int:
    """Make it, and print its path and the lines that add it; exit code 1 when it can't be made."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0] if __doc__ else None)
    parser.add_argument("release", type=Path, help="the folder of a release, with its packages")
    parser.add_argument("--url", required=True, help="where the folder will be hosted")
    parser.add_argument("--key", required=True, help="the OpenPGP key that signs it, by its address or fingerprint")
    arguments = parser.parse_args(words)
    out = arguments.release / "apt"
    try:
        lines = make(arguments.release, out, arguments.url.rstrip("/"), arguments.key)
    except AptError as error:
        print(f"failstop: {error}", file=sys.stderr)
        return 1
    print(out, lines, sep="\n\n")
    return 0


def make(release: Path, out: Path, url: str, key: str) -> str:
    """Make the folder; returns the lines that add it to a system. Raises AptError."""
    debs = sorted(release.glob("*.deb"))
    if not debs:
        raise AptError(f"no packages in {release}: make release VERSION=x builds them")
    fingerprint = _fingerprint(key)
    shutil.rmtree(out, ignore_errors=True)
    pool, dist = out / "pool", out / "dists" / SUITE
    pool.mkdir(parents=True)
    stanzas = []
    for deb in debs:
        shutil.copy(deb, pool)
        stanzas.append((_field(deb, "Architecture"), _stanza(deb)))
    for architecture in ARCHITECTURES:
        folder = dist / COMPONENT / f"binary-{architecture}"
        folder.mkdir(parents=True)
        text = "\n".join(stanza for wanted, stanza in stanzas if wanted in (architecture, "all")).encode()
        (folder / "Packages").write_bytes(text)
        (folder / "Packages.gz").write_bytes(gzip.compress(text, 9, mtime=0))
    (dist / "Release").write_text(_release(dist))
    _gpg("--local-user", key, "--clearsign", "--output", str(dist / "InRelease"), str(dist / "Release"))
    _gpg("--local-user", key, "--armor", "--detach-sign", "--output", str(dist / "Release.gpg"), str(dist / "Release"))
    _gpg("--export", "--output", str(out / PUBLIC), key)
    shutil.copy(Path(__file__).with_name("rosdep.yaml"), out)
    lines = LINES.format(keyring=KEYRING, url=url, public=PUBLIC, suite=SUITE, component=COMPONENT)
    (out / "index.html").write_text(PAGE.format(lines=lines, fingerprint=fingerprint))
    return lines


def _stanza(deb: Path) -> str:
    """What the index says of a package."""
    data = deb.read_bytes()
    control = subprocess.run(["dpkg-deb", "--field", deb], check=True, capture_output=True, text=True).stdout
    digest = hashlib.sha256(data).hexdigest()
    return f"{control.rstrip()}\nFilename: pool/{deb.name}\nSize: {len(data)}\nSHA256: {digest}\n"


def _field(deb: Path, name: str) -> str:
    return subprocess.run(["dpkg-deb", "--field", deb, name], check=True, capture_output=True, text=True).stdout.strip()


def _release(dist: Path) -> str:
    """The index of the indexes, which the signature covers."""
    moment = int(os.environ.get("SOURCE_DATE_EPOCH", time.time()))
    head = {
        "Origin": "failstop",
        "Label": "failstop",
        "Suite": SUITE,
        "Codename": SUITE,
        "Date": email.utils.formatdate(moment, usegmt=True).replace("GMT", "UTC"),
        "Architectures": " ".join(ARCHITECTURES),
        "Components": COMPONENT,
        "Description": "failstop stops a robot when its software fails",
    }
    sums = [
        f" {hashlib.sha256(path.read_bytes()).hexdigest()} {path.stat().st_size} {path.relative_to(dist)}\n"
        for path in sorted(dist.rglob("Packages*"))
    ]
    return "".join(f"{name}: {text}\n" for name, text in head.items()) + "SHA256:\n" + "".join(sums)


def _fingerprint(key: str) -> str:
    listed = _gpg("--list-secret-keys", "--with-colons", key)
    return next(line.split(":")[9] for line in listed.splitlines() if line.startswith("fpr:"))


def _gpg(*words: str) -> str:
    """Run gpg with the user's keys. Raises AptError."""
    try:
        done = subprocess.run(["gpg", "--batch", "--yes", *words], capture_output=True, text=True, check=False)
    except OSError:
        raise AptError("gpg is not installed: apt install gpg") from None
    if done.returncode:
        why = (done.stderr.strip() or "nothing").splitlines()[-1]
        raise AptError(f"gpg ended with code {done.returncode} and said: {why}; gpg --list-secret-keys has your keys")
    return done.stdout


if __name__ == "__main__":
    sys.exit(main())
