"""A node's own keys: read, checked, and what Zenoh is told of them."""

from __future__ import annotations

import os
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from terrafuse.errors import InputError
from terrafuse.keys.access import access_control
from terrafuse.keys.certificates import common_name, may_listen
from terrafuse.keys.fleet import CA, CERTIFICATE, KEY, ROSTER, read_roster


@dataclass(frozen=True)
class Identity:
    """Keys of a folder, and the rules that its node goes by if it listens."""

    folder: Path
    access: dict[str, Any] | None
    seen: tuple[int, ...]
    """What the rules and certificates were like when they were read."""

    @property
    def ca_file(self) -> Path:
        return self.folder / CA

    @property
    def certificate_file(self) -> Path:
        return self.folder / CERTIFICATE

    @property
    def key_file(self) -> Path:
        return self.folder / KEY

    @property
    def tls(self) -> dict[str, Any]:
        """Zenoh's section on TLS: both sides show a certificate."""
        key, certificate = str(self.key_file), str(self.certificate_file)
        return {
            "root_ca_certificate": str(self.ca_file),
            "listen_private_key": key,
            "listen_certificate": certificate,
            "connect_private_key": key,
            "connect_certificate": certificate,
            "enable_mtls": True,
            "verify_name_on_connect": True,
            "close_link_on_expiration": True,
        }

    def changed(self) -> bool:
        """Whether the files are others than when they were read."""
        return _seen(self.folder) != self.seen


def load_identity(folder: str | Path, node: str, listens: bool) -> Identity:
    """Raises InputError for keys that this node can't use now, and says which to make."""
    folder = Path(folder).resolve()
    seen = _seen(folder)
    _check(folder, node, listens)
    access = access_control(read_roster(_existing(folder / ROSTER))) if listens else None
    return Identity(folder, access, seen)


def _seen(folder: Path) -> tuple[int, ...]:
    times = []
    for name in (ROSTER, CERTIFICATE, CA):
        try:
            status = os.stat(folder / name)
        except OSError:
            times += [0, 0]
        else:
            times += [status.st_mtime_ns, status.st_ino]
    return tuple(times)


def _check(folder: Path, node: str, listens: bool) -> None:
    try:
        authority = x509.load_pem_x509_certificate(_existing(folder / CA).read_bytes())
        certificate = x509.load_pem_x509_certificate(_existing(folder / CERTIFICATE).read_bytes())
        key = load_pem_private_key(_existing(folder / KEY).read_bytes(), None)
    except (ValueError, TypeError) as error:
        raise InputError(f"{folder}: damaged ({error}); renew it: terrafuse keys renew {node}") from error
    except OSError as error:
        raise InputError(f"{folder}: {error.strerror}; make its files readable to this user") from error
    name = common_name(certificate)
    if name != node:
        raise InputError(f"{folder} has the keys of '{name}', not of '{node}'; give --keys the folder of '{node}'")
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature) as error:
        raise InputError(f"{folder}: cert.pem and ca.pem are of different fleets; renew it: {_renew(node)}") from error
    if key.public_key() != certificate.public_key():
        raise InputError(f"{folder}: key.pem is not that of cert.pem; renew it: {_renew(node)}")
    _check_dates(folder, certificate, node)
    if listens and not may_listen(certificate):
        raise InputError(
            f"the certificate of '{node}' is for connecting only; to listen it has to name where others reach it: "
            f"{_renew(node)} --host ADDRESS"
        )


def _check_dates(folder: Path, certificate: x509.Certificate, node: str) -> None:
    now, last, first = datetime.now(UTC), certificate.not_valid_after_utc, certificate.not_valid_before_utc
    if now > last:
        raise InputError(f"{folder}: the certificate of '{node}' expired on {last:%Y-%m-%d}; {_renew(node)}")
    if now < first:
        raise InputError(
            f"{folder}: the certificate of '{node}' holds from {first:%Y-%m-%d} on, and this machine's clock says "
            f"{now:%Y-%m-%d}; set the clock"
        )


def _existing(path: Path) -> Path:
    if not path.is_file():
        raise InputError(f"{path} is not there; give --keys a folder of `terrafuse keys add`, nodes/NAME of a fleet")
    return path


def _renew(node: str) -> str:
    return f"terrafuse keys renew {node}"
