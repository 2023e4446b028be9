"""Certificates that the team's authority signed, and `jezero keys` doesn't make."""

import shutil
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID, ObjectIdentifier

from jezero.keys.team import Team

CLIENT, SERVER = ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH


def strange_bundle(
    team: Team,
    folder: Path,
    uses: Sequence[ObjectIdentifier] = (CLIENT,),
    *,
    is_authority: bool = False,
    has_unknown_extension: bool = False,
) -> Path:
    """A copy of the bundle of pilot-ana with another certificate for its key.

    Args:
        uses: purposes of the key.
        is_authority: whether it may sign others.
        has_unknown_extension: whether it has an extension that nobody knows, and that nobody may leave out.
    """
    bundle = Path(shutil.copytree(team.bundle("pilot-ana"), folder))
    authority = x509.load_pem_x509_certificate((team.folder / "ca" / "certificate.pem").read_bytes())
    signer = load_pem_private_key((team.folder / "ca" / "key.pem").read_bytes(), password=None)
    own = load_pem_private_key((bundle / "key.pem").read_bytes(), password=None)
    assert isinstance(signer, EllipticCurvePrivateKey) and isinstance(own, EllipticCurvePrivateKey)
    now = datetime.now(UTC)
    builder = (
        x509.CertificateBuilder()
        .subject_name(x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "pilot-ana")]))
        .issuer_name(authority.subject)
        .public_key(own.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(days=1))
        .not_valid_after(now + timedelta(days=1))
        .add_extension(x509.BasicConstraints(ca=is_authority, path_length=None), critical=True)
        .add_extension(x509.ExtendedKeyUsage(uses), critical=False)
    )
    if has_unknown_extension:
        unknown = x509.UnrecognizedExtension(ObjectIdentifier("1.2.3.4.5"), b"x")
        builder = builder.add_extension(unknown, critical=True)
    (bundle / "certificate.pem").write_bytes(builder.sign(signer, SHA256()).public_bytes(Encoding.PEM))
    return bundle
