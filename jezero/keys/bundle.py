"""A bundle: the folder with everything that one computer or person needs to speak TLS with the team's routers."""

import hashlib
import os
import shlex
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from jezero.base.files import describe_os_error
from jezero.base.router_address import is_insecure, parse_router
from jezero.keys.files import read_plain_file
from jezero.keys.members import MEMBERS, KeysError, Members, read_members

if TYPE_CHECKING:
    from cryptography import x509

VARIABLE = "JEZERO_KEYS"
"""Environment variable that names the folder of the bundle."""
INSECURE_VARIABLE = "JEZERO_INSECURE"
"""Environment variable that is 1 where addresses without TLS may leave this computer."""
CA, CERTIFICATE, KEY = "ca.pem", "certificate.pem", "key.pem"
MAVLINK_KEY = "mavlink.key"
"""A line of text, the same for all that fly the team's vehicles by MAVLink."""
MAVLINK_TEXT_LENGTH = 32
OTHERS_READ_OR_WRITE, OTHERS_WRITE = 0o066, 0o022
"""Bits of a mode: what others than the owner may do, its group included."""
SECRETS, PUBLIC = (KEY, MAVLINK_KEY), (CA, CERTIFICATE, MEMBERS)


class Identity(NamedTuple):
    """What a certificate says.

    Attributes:
        name: common name.
        role: organisational unit: the member's role.
        begins, expires: its validity.
        hosts: names and IP addresses of the member's router.
    """

    name: str
    role: str
    begins: datetime
    expires: datetime
    hosts: tuple[str, ...]


def endpoint_of(address: str, keys: str | Path | None, *, insecure: bool = False) -> str:
    """Zenoh's endpoint for a router's address. An address with `tls` gets the files of the bundle.

    An address of another computer without TLS is refused, unless a person has permitted it.

    Args:
        address: an address; one with settings of its own behind `#` stays as it is.
        keys: folder of the bundle; None or "" without one.
        insecure: whether an address without TLS may be another computer's, or listen to others.

    Raises:
        ValueError: the address's syntax is wrong.
        KeysError: the address needs a bundle and there is none, or it can't be used; or it needs TLS.
    """
    if is_insecure(address) and not insecure:
        raise KeysError(
            f"without TLS whoever is on the network of {address} could fly: write tls/… and name the bundle of "
            f"`jezero keys` with --keys or {VARIABLE}, or give --insecure or {INSECURE_VARIABLE}=1 on a network that "
            "you trust"
        )
    if parse_router(address).protocol != "tls" or "#" in address:
        return address
    if not keys:
        raise KeysError(f"{address} needs keys: name the folder of a bundle with --keys or {VARIABLE}")
    return secured(address, Path(keys))


def given_endpoint(address: str) -> str:
    """`endpoint_of` with the bundle and the permission from the environment."""
    return endpoint_of(address, os.environ.get(VARIABLE), insecure=os.environ.get(INSECURE_VARIABLE) == "1")


def secured(address: str, bundle: Path) -> str:
    """Zenoh's endpoint for an address, with TLS by a bundle: to listen there, or to connect to it.

    Both sides need a certificate of the team's authority, and the one that connects checks that the other's
    certificate is one of the host in the address.

    Args:
        address: such as `tls/192.168.1.10:7447`.
        bundle: folder of the bundle.

    Raises:
        KeysError: a file is missing, can't be read, or can be read by others; or Zenoh can't take the folder's name.
    """
    folder = bundle.expanduser().resolve()
    if ";" in str(folder):
        raise KeysError(f"{folder}: Zenoh reads no folder with ';' in its name: rename it")
    for name in (CA, CERTIFICATE, KEY):
        try:
            read_plain_file(folder / name)  # Zenoh would wait for a pipe, and for the end of a device
        except FileNotFoundError:
            raise KeysError(
                f"{folder / name} is missing: copy the whole folder that `jezero keys add` wrote, and name it"
            ) from None
        except OSError as error:
            raise KeysError(
                f"{describe_os_error(error)}: the keys belong to the user that starts jezero, see `ls -l {folder}`"
            ) from None
    check_private(folder)
    settings = {
        "root_ca_certificate_file": CA,
        "listen_certificate_file": CERTIFICATE,
        "listen_private_key_file": KEY,
        "connect_certificate_file": CERTIFICATE,
        "connect_private_key_file": KEY,
    }
    files = ";".join(f"{setting}={folder / name}" for setting, name in settings.items())
    return f"{address}#{files};enable_mtls=true"


def check_private(folder: Path) -> None:
    """Refuse a bundle whose folder or keys others can read or change, or whose other files others can change.

    Raises:
        KeysError: they can; the message has the command that ends it.
    """
    masks = dict.fromkeys(("", *SECRETS), OTHERS_READ_OR_WRITE) | dict.fromkeys(PUBLIC, OTHERS_WRITE)
    for name, mask in masks.items():
        path = folder / name
        try:
            mode = path.stat().st_mode
        except OSError:  # the program that needs the file says that it is missing
            continue
        if mode & mask:
            what = "read or change" if mode & OTHERS_READ_OR_WRITE & ~OTHERS_WRITE else "change"
            raise KeysError(
                f"other users can {what} {path}, and could pretend to be its owner: type "
                f"`chmod -R go= {shlex.quote(str(folder))}`"
            )


def mavlink_key(bundle: str | None) -> bytes:
    """Key of MAVLink's signatures by a bundle, 32 bytes; b"" without a bundle, or without a text in it.

    It is the SHA-256 of the text, as in MAVProxy, so that a person can give it the text.

    Raises:
        KeysError: the text can't be read, can be read by others, or is damaged.
    """
    path = Path(bundle).expanduser() / MAVLINK_KEY if bundle else None
    if path is None or not path.exists():
        return b""
    try:
        text = read_plain_file(path).strip()
    except OSError as error:
        raise KeysError(describe_os_error(error)) from None
    check_private(path.parent)
    if len(text) != MAVLINK_TEXT_LENGTH or not text.isascii():
        raise KeysError(f"{path} is damaged: it has one line of {MAVLINK_TEXT_LENGTH} characters, copy it anew")
    return hashlib.sha256(text).digest()


def files_of(endpoint: str) -> dict[str, Path]:
    """The files of an endpoint, by Zenoh's names for them."""
    settings = (each.partition("=") for each in endpoint.partition("#")[2].split(";"))
    return {name: Path(value) for name, _, value in settings if name.endswith("_file")}


def members_of(endpoint: str) -> Members:
    """The team's members, from the bundle of an endpoint to listen on.

    Raises:
        KeysError: the endpoint has no bundle, or the bundle's list is missing or damaged.
    """
    certificate = files_of(endpoint).get("listen_certificate_file")
    if certificate is None:
        raise KeysError(f"a router with TLS needs the bundle of its computer: name the folder with {VARIABLE}")
    return read_members(certificate.parent)


def read_certificate(path: Path) -> "x509.Certificate":
    """Read a certificate.

    Raises:
        KeysError: the file is missing, unreadable or damaged.
    """
    from cryptography import x509

    try:
        return x509.load_pem_x509_certificate(read_plain_file(path))
    except OSError as error:
        raise KeysError(describe_os_error(error)) from None
    except KeysError:  # a ValueError too
        raise
    except ValueError:
        raise KeysError(f"{path} is damaged, or no certificate: copy it anew") from None


def identity_of(certificate: "x509.Certificate") -> Identity:
    """What a certificate says.

    Raises:
        KeysError: it has no common name, so jezero has not made it.
    """
    from cryptography import x509
    from cryptography.x509.oid import NameOID

    names, units = (
        certificate.subject.get_attributes_for_oid(oid)
        for oid in (NameOID.COMMON_NAME, NameOID.ORGANIZATIONAL_UNIT_NAME)
    )
    hosts: tuple[str, ...] = ()
    try:
        found = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        hosts = (
            *found.get_values_for_type(x509.DNSName),
            *(str(address) for address in found.get_values_for_type(x509.IPAddress)),
        )
    except x509.ExtensionNotFound:
        pass
    if not names:
        raise KeysError("a certificate without a common name is none that `jezero keys` made")
    role = str(units[0].value) if units else ""
    begins, expires = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    return Identity(str(names[0].value), role, begins, expires, hosts)
