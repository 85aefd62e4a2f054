"""Certificates: X.509, keys on the curve P-256. Imported where they are made or read: raises MissingExtra."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

from terrafuse.errors import MissingExtra
from terrafuse.keys.names import Host

try:
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, load_pem_private_key
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
except ImportError as error:
    raise MissingExtra("keys", "cryptography", "net") from error

BEFORE = timedelta(days=1)
"""Clocks of robots are often behind: a certificate holds from a day before it was made."""

Key = ec.EllipticCurvePrivateKey


@dataclass(frozen=True)
class Issued:
    """A certificate and its key, as PEM."""

    certificate: bytes
    key: bytes
    serial: str
    expires: datetime


def new_authority(fleet: str, days: int, now: datetime) -> Issued:
    """One that signs itself, and after it nodes, but no further authorities."""
    key = ec.generate_private_key(ec.SECP256R1())
    builder = _builder(fleet, key, now, now + timedelta(days=days)).issuer_name(_name(fleet))
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    return _issued(builder.add_extension(_usage(authority=True), critical=True), key, key)


def new_certificate(
    node: str, hosts: Sequence[Host], authority: tuple[bytes, bytes], days: int, now: datetime
) -> Issued:
    """A node's. `hosts`: where others reach it; none, and it may only connect. `authority`: certificate and key, PEM.
    Raises ValueError for an authority that is none."""
    by, by_key = x509.load_pem_x509_certificate(authority[0]), load_pem_private_key(authority[1], None)
    if not isinstance(by_key, Key) or by.public_key() != by_key.public_key():
        raise ValueError("the authority's key is not that of its certificate")
    key = ec.generate_private_key(ec.SECP256R1())
    until = min(now + timedelta(days=days), by.not_valid_after_utc)
    builder = _builder(node, key, now, until).issuer_name(by.subject)
    builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
    builder = builder.add_extension(_usage(authority=False), critical=True)
    uses = [ExtendedKeyUsageOID.CLIENT_AUTH, *([ExtendedKeyUsageOID.SERVER_AUTH] if hosts else [])]
    builder = builder.add_extension(x509.ExtendedKeyUsage(uses), critical=False)
    if hosts:
        builder = builder.add_extension(x509.SubjectAlternativeName(map(_general, hosts)), critical=False)
    issuer = x509.AuthorityKeyIdentifier.from_issuer_public_key(by_key.public_key())
    return _issued(builder.add_extension(issuer, critical=False), key, by_key)


def common_name(certificate: x509.Certificate) -> str:
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(names[0].value) if names else ""


def may_listen(certificate: x509.Certificate) -> bool:
    try:
        uses = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    except x509.ExtensionNotFound:
        return False
    return ExtendedKeyUsageOID.SERVER_AUTH in uses


def _name(text: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])


def _builder(name: str, key: Key, now: datetime, until: datetime) -> x509.CertificateBuilder:
    builder = x509.CertificateBuilder().subject_name(_name(name)).public_key(key.public_key())
    builder = builder.serial_number(x509.random_serial_number()).not_valid_before(now - BEFORE).not_valid_after(until)
    return builder.add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)


def _usage(authority: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not authority,
        key_cert_sign=authority,
        crl_sign=authority,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _general(each: Host) -> x509.GeneralName:
    return x509.DNSName(each) if isinstance(each, str) else x509.IPAddress(each)


def _issued(builder: x509.CertificateBuilder, key: Key, by: Key) -> Issued:
    certificate = builder.sign(by, hashes.SHA256())
    return Issued(
        certificate.public_bytes(Encoding.PEM),
        key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()),
        f"{certificate.serial_number:x}",
        certificate.not_valid_after_utc,
    )
