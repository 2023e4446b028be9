"""Certificates: what the team's authority signs. Pure: no file, no clock; `cryptography` does the work."""

from collections.abc import Sequence
from datetime import datetime, timedelta
from ipaddress import ip_address
from typing import TYPE_CHECKING

from jezero.keys.members import HOST_ROLES, Role

if TYPE_CHECKING:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey, EllipticCurvePublicKey

AUTHORITY_NAME = "jezero team"
AUTHORITY_DAYS = 3650
BACKDATED = timedelta(days=1)
"""A certificate is valid from a day before it was made: clocks of computers without a network are late."""
LOOPBACK_HOSTS = ("localhost", "127.0.0.1", "::1")
"""Every computer with a router is reached by its own programs under these."""


def new_key() -> "EllipticCurvePrivateKey":
    """A private key on the curve P-256, which every TLS library has."""
    from cryptography.hazmat.primitives.asymmetric import ec

    return ec.generate_private_key(ec.SECP256R1())


def issue_authority(key: "EllipticCurvePrivateKey", now: datetime) -> "x509.Certificate":
    """The authority's own certificate, signed by itself.

    Args:
        key: the authority's private key.
        now: present time, with a time zone.
    """
    from cryptography import x509
    from cryptography.hazmat.primitives.hashes import SHA256
    from cryptography.x509.oid import NameOID

    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, AUTHORITY_NAME)])
    return (
        _builder(name, key.public_key(), now, now + timedelta(days=AUTHORITY_DAYS))
        .issuer_name(name)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage("key_cert_sign", "crl_sign"), critical=True)
        .sign(key, SHA256())
    )


def issue(
    public_key: "EllipticCurvePublicKey",
    role: Role,
    name: str,
    hosts: Sequence[str],
    validity: tuple[datetime, datetime],
    authority: "tuple[x509.Certificate, EllipticCurvePrivateKey]",
) -> "x509.Certificate":
    """The certificate of a member.

    All members connect, so every certificate is one of a TLS client. Only computers with a router get that of a TLS
    server too: with a pilot's or a viewer's key nobody can pretend to be a vehicle's router.

    Args:
        public_key: the member's.
        name: common name.
        hosts: names and IP addresses by which others reach the member's router, besides those of the loopback.
        validity: present time and end. The certificate ends with the authority's at the latest.
        authority: the authority's certificate and private key.
    """
    from cryptography import x509
    from cryptography.hazmat.primitives.hashes import SHA256
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

    (now, end), (authority_certificate, authority_key) = validity, authority
    subject = x509.Name(
        [
            x509.NameAttribute(NameOID.ORGANIZATIONAL_UNIT_NAME, role),
            x509.NameAttribute(NameOID.COMMON_NAME, name),
        ]
    )
    uses = [ExtendedKeyUsageOID.CLIENT_AUTH]
    builder = (
        _builder(subject, public_key, now, min(end, authority_certificate.not_valid_after_utc))
        .issuer_name(authority_certificate.subject)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage("digital_signature"), critical=True)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(authority_key.public_key()), critical=False)
    )
    if role in HOST_ROLES:
        uses.append(ExtendedKeyUsageOID.SERVER_AUTH)
        names = [_general_name(host) for host in dict.fromkeys((*hosts, *LOOPBACK_HOSTS))]
        builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
    return builder.add_extension(x509.ExtendedKeyUsage(uses), critical=False).sign(authority_key, SHA256())


def _builder(
    subject: "x509.Name", public_key: "EllipticCurvePublicKey", now: datetime, end: datetime
) -> "x509.CertificateBuilder":
    """What all certificates have."""
    from cryptography import x509

    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .public_key(public_key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - BACKDATED)
        .not_valid_after(end)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(public_key), critical=False)
    )


def _usage(*used: str) -> "x509.KeyUsage":
    """A key usage with these of its names."""
    from cryptography import x509

    names = (
        "digital_signature", "content_commitment", "key_encipherment", "data_encipherment", "key_agreement",
        "key_cert_sign", "crl_sign", "encipher_only", "decipher_only",
    )  # fmt: skip
    return x509.KeyUsage(**{name: name in used for name in names})


def _general_name(host: str) -> "x509.GeneralName":
    from cryptography import x509

    try:
        return x509.IPAddress(ip_address(host))
    except ValueError:
        return x509.DNSName(host)
