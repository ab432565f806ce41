"""Storage: the page's files, which are the list of paired devices and the certificate for HTTPS."""

from __future__ import annotations

import contextlib
import fcntl
import os
import secrets
import ssl
import subprocess
import time
from hashlib import sha256
from typing import NoReturn

from failstop.api.errors import FailstopError
from failstop.files import durable, root
from failstop.web.addresses import own_addresses
from failstop.web.devices import Devices

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping

SYSTEM_BASE = "/var/lib/failstop-web"
DEVICES = "devices.json"
KEY = "key.pem"
CERTIFICATE = "certificate.pem"
CONTROL = "control"
DAYS = 825
"""How long a certificate is valid, days. Browsers refuse certificates that are valid for longer."""
RENEW_S = 30 * 86400.0
OPENSSL_S = 30.0


def folder(name: str, environ: Mapping[str, str]) -> str:
    """Return the folder for the page's files: systemd's $STATE_DIRECTORY, else a folder below $XDG_STATE_HOME or
    ~/.local/state."""
    if given := environ.get("STATE_DIRECTORY", "").split(":")[0]:
        return given
    home = environ.get("XDG_STATE_HOME") or os.path.expanduser("~/.local/state")
    return os.path.join(home, "failstop", name, "web")


def folders(name: str, environ: Mapping[str, str]) -> list[str]:
    """Return the folders in which a running page of this service may have its files: this user's folder, and the
    system's."""
    return [folder(name, environ), os.path.join(root.at(SYSTEM_BASE), name)]


class Storage:
    """The folder with a running page's files. Only this page writes to it, so the page locks it: another page would
    write back devices that were revoked at this one."""

    def __init__(self, place: str) -> None:
        """Makes the folder if it does not exist, and locks it until close(). Raises FailstopError, also if another page
        has locked it."""
        self.place = place
        try:
            os.makedirs(place, exist_ok=True)
            os.chmod(place, 0o700)
            # The lock is on the folder itself, because a full disk has no room for another file.
            self._locked = os.open(place, os.O_RDONLY | os.O_DIRECTORY)
        except OSError as error:
            _fail(place, error)
        try:
            fcntl.flock(self._locked, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.close()
            raise FailstopError(
                f"another page runs with the files in {place}: end it, or give this one another XDG_STATE_HOME"
            ) from None
        except OSError:
            pass  # this file system has no locks

    def close(self) -> None:
        """Unlock the folder. Call it when the page ends."""
        os.close(self._locked)

    def path(self, name: str) -> str:
        """Return the path of a file in the folder."""
        return os.path.join(self.place, name)

    def devices(self) -> Devices:
        """Return the paired devices. Raises FailstopError if their file can't be read, because an empty list instead
        would unpair all devices without a message."""
        try:
            with open(durable.open_own(self.path(DEVICES)), "rb") as file:
                return Devices.load(file.read())
        except FileNotFoundError:
            return Devices()
        except OSError as error:
            _fail(self.path(DEVICES), error)
        except ValueError as error:
            raise FailstopError(f"{self.path(DEVICES)}: {error}: remove it, and pair your devices again") from None

    def keep(self, devices: Devices) -> None:
        """Save the devices. If the new file can't be written, the old file stays as it was. Raises FailstopError."""
        self._write(DEVICES, devices.dump())

    def keep_fewer(self, devices: Devices) -> None:
        """Save the devices after one was revoked. If no new file can be written, for example on a full disk, overwrite
        the old file in place. A crash at that moment may damage the file. The page does not start with a damaged file,
        so no device gets rights by mistake. Raises FailstopError."""
        try:
            self.keep(devices)
        except FailstopError as error:
            try:
                fd = durable.open_own(self.path(DEVICES), os.O_WRONLY)
                try:
                    data = devices.dump().ljust(os.fstat(fd).st_size)
                    if os.pwrite(fd, data, 0) != len(data):
                        raise error
                    os.fsync(fd)
                finally:
                    os.close(fd)
            except OSError:
                raise error from None

    def _write(self, name: str, data: bytes) -> None:
        draft = f"{self.path(name)}.{secrets.token_hex(4)}"
        before = os.umask(0o077)
        try:
            durable.write_draft(draft, data)
            durable.publish(draft, self.path(name))
        except OSError as error:
            _fail(self.path(name), error)
        finally:
            os.umask(before)

    def tls(self, names: list[str]) -> ssl.SSLContext:
        """Return the TLS context for HTTPS. At the first call, this makes a certificate. At a later call, it makes
        a new one if the old one expires within RENEW_S. Raises FailstopError."""
        if not self._valid():
            self._make(names, own_addresses())
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        try:
            context.load_cert_chain(self.path(CERTIFICATE), self.path(KEY))
        except (OSError, ssl.SSLError) as error:
            raise FailstopError(f"{self.path(CERTIFICATE)}: {error}: remove it, and a new one is made") from None
        return context

    def fingerprint(self) -> str:
        """Return the SHA-256 of the certificate, in the form that browsers show. Empty if there is no certificate."""
        try:
            with open(self.path(CERTIFICATE), encoding="ascii") as file:
                found = sha256(ssl.PEM_cert_to_DER_cert(file.read())).hexdigest().upper()
        except (OSError, ValueError):
            return ""
        return ":".join(found[at : at + 2] for at in range(0, len(found), 2))

    def _valid(self) -> bool:
        """Return True if the certificate exists and does not expire within the next RENEW_S."""
        if not (os.path.exists(self.path(KEY)) and os.path.exists(self.path(CERTIFICATE))):
            return False
        words = ("x509", "-in", self.path(CERTIFICATE), "-noout", "-checkend", str(int(RENEW_S)))
        return _openssl(*words).returncode == 0

    def _make(self, names: list[str], addresses: list[str]) -> None:
        others = ",".join([*(f"DNS:{name}" for name in names), *(f"IP:{address}" for address in addresses)])
        draft = self.path(f"{KEY}.{secrets.token_hex(4)}")
        before = os.umask(0o077)
        try:
            made = _openssl(
                *("req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-sha256"),
                *("-days", str(DAYS), "-subj", f"/CN=failstop {time.strftime('%Y-%m-%d')}"),
                *("-addext", f"subjectAltName={others}", "-addext", "basicConstraints=critical,CA:FALSE"),
                *("-addext", "extendedKeyUsage=serverAuth", "-keyout", draft, "-out", f"{draft}.crt"),
            )
            if made.returncode:
                raise FailstopError(f"openssl made no certificate: {made.stderr.strip()[-300:]}")
            durable.publish(draft, self.path(KEY))
            durable.publish(f"{draft}.crt", self.path(CERTIFICATE))
        except OSError as error:
            _fail(self.path(CERTIFICATE), error)
        finally:
            os.umask(before)
            for left in (draft, f"{draft}.crt"):
                with contextlib.suppress(OSError):
                    os.unlink(left)


def _openssl(*words: str) -> subprocess.CompletedProcess[str]:
    """Run openssl with these arguments. Raises FailstopError if openssl is not installed, or does not end in time."""
    try:
        return subprocess.run(("openssl", *words), capture_output=True, text=True, timeout=OPENSSL_S, check=False)
    except FileNotFoundError:
        raise FailstopError("HTTPS needs the program openssl (Debian, Ubuntu: apt install openssl)") from None
    except subprocess.TimeoutExpired:
        raise FailstopError(f"openssl did not end within {OPENSSL_S:g} s") from None


def _fail(path: str, error: OSError) -> NoReturn:
    raise FailstopError(f"{path}: {error.strerror}") from None
