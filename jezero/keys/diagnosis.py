"""Why no connection to a router comes about, in one sentence. Zenoh itself only times out.

A handshake of Python's own TLS with the same files at the same address fails for the same reason, and has it in words.
"""

import socket
import ssl
from datetime import UTC, datetime
from pathlib import Path

from jezero.base.files import describe_os_error
from jezero.base.router_address import is_loopback, parse_router, shown_router
from jezero.keys.bundle import VARIABLE, Identity, check_private, files_of, identity_of, read_certificate
from jezero.keys.files import read_plain_file
from jezero.keys.members import MEMBERS, ROLES, KeysError, read_members
from jezero.keys.rights import may_send

PROBE_TIMEOUT_S = 0.5
"""A handshake takes some ms, and a radio's round trip some hundred at most."""
NAME_MISMATCHES = frozenset({62, 64})
"""OpenSSL's X509_V_ERR_HOSTNAME_MISMATCH and X509_V_ERR_IP_ADDRESS_MISMATCH."""
EXPIRED, NOT_YET_VALID, WRONG_PURPOSE = 10, 9, 26
OTHER_AUTHORITY = frozenset({7, 18, 19, 20, 21, 30})
"""OpenSSL's verification errors of a certificate that another authority has signed."""
CONNECTING = frozenset({"root_ca_certificate_file", "connect_certificate_file", "connect_private_key_file"})
"""Zenoh's names for the files of a bundle that a connection needs."""
REFUSED_FOR = {
    "TLSV13_ALERT_CERTIFICATE_REQUIRED": "its key is of a kind that TLS 1.3 doesn't take",
    "SSLV3_ALERT_UNSUPPORTED_CERTIFICATE": "it isn't that of a member, who connects to routers",
    "SSLV3_ALERT_CERTIFICATE_UNKNOWN": "it isn't one that `jezero keys` makes for a member",
    "SSLV3_ALERT_BAD_CERTIFICATE": "it is damaged, or isn't one that `jezero keys` makes",
}
"""Why a router refuses a certificate that `jezero keys` has not made, by its alert."""
OTHER_TLS = frozenset({"TLSV1_ALERT_PROTOCOL_VERSION", "SSLV3_ALERT_HANDSHAKE_FAILURE", "UNSUPPORTED_PROTOCOL"})
"""Alerts and errors of two sides that have no version or method of TLS in common."""
REFUSED_TIME = "SSLV3_ALERT_CERTIFICATE_EXPIRED"
"""Alert with which a router refuses a client's certificate that isn't valid at the router's time."""
REFUSED_AUTHORITY = frozenset({"TLSV1_ALERT_UNKNOWN_CA", "TLSV1_ALERT_DECRYPT_ERROR"})
"""Alerts with which a router refuses the authority of a client's certificate. Source: RFC 8446, 6.2. DECRYPT_ERROR is
the alert of a wrong signature, as of another authority with the same name."""


def connection_problem(endpoint: str) -> str:
    """Why a client can't connect to a router, and what to do; "" if that isn't TLS' fault, e.g. no router listens.

    It takes 0.5 s for each step at which the router doesn't reply.

    Args:
        endpoint: Zenoh's endpoint, with the files of the bundle.
    """
    address, shown = parse_router(endpoint), shown_router(endpoint)
    if address.protocol == "tcp" and _speaks_tls(address.host, address.port):
        return f"the router at {shown} speaks TLS only: write tls/… and name a bundle with --keys or {VARIABLE}"
    if address.protocol != "tls":
        return ""
    files = files_of(endpoint)
    if not files.keys() >= CONNECTING:
        return f"a router with TLS lets nobody in without a bundle: name its folder with --keys or {VARIABLE}"
    try:
        own = identity_of(read_certificate(files["connect_certificate_file"]))
        return _own_problem(own, files["connect_certificate_file"].parent) or _handshake_problem(endpoint, own)
    except KeysError as error:
        return str(error)


def listening_problem(endpoint: str) -> str:
    """Why nobody could connect to a router that listens on an endpoint with a bundle, or ""."""
    certificate = files_of(endpoint).get("listen_certificate_file")
    if certificate is None:
        return ""
    try:
        own = identity_of(read_certificate(certificate))
        if not own.hosts:
            return (
                f"{own.name} runs no router: name the bundle of a computer, which `jezero keys add vehicle NAME` makes "
                "(or rover, or ground)"
            )
        return _own_problem(own, certificate.parent)
    except KeysError as error:
        return str(error)


def bundle_problem(endpoint: str) -> str:
    """Why the bundle of an endpoint can't be used, to listen or to connect, in one sentence, or ""."""
    files = files_of(endpoint)
    if not files.keys() >= CONNECTING:
        return ""
    bundle = files["connect_certificate_file"].parent
    try:
        check_private(bundle)
        _context(files)
        read_members(bundle)
        return _own_problem(identity_of(read_certificate(files["connect_certificate_file"])), bundle)
    except KeysError as error:
        return str(error)


def missing_right(endpoint: str, name: str) -> str:
    """Why the router denies what this program sends, or "" where it has the right to send it.

    Args:
        endpoint: Zenoh's endpoint of the router, with the files of the member's bundle for TLS.
        name: name of the endpoint or topic to which the member sends something.
    """
    address = parse_router(endpoint)
    if address.protocol == "tcp" and is_loopback(address.host) and not may_send("pilot", name):
        return (
            f"only services of the vehicle send to {name}: give a program that is one the socket that `jezero ps` "
            "prints, as JEZERO_ROUTER"
        )
    own, problem = _member(endpoint)
    role = next((role for role in ROLES if own is not None and role == own.role), None)
    if own is None or problem or role is None or may_send(role, name):
        return problem
    return f"{own.name} has no right to {name}: only pilots fly, ask for the bundle of one"


def hidden_reason(endpoint: str, vehicle: str) -> str:
    """Why a router shows nothing of a vehicle to the member of a bundle, in one sentence; "" without a bundle.

    A router lets a revoked member connect as any other, and then shows it nothing: its list of members isn't to be had.
    """
    own, problem = _member(endpoint)
    if own is None or problem:
        return problem
    return (
        f"the router at {shown_router(endpoint)} lets {own.name} connect, and shows it nothing of {vehicle}: "
        f"{own.name} is revoked, or not yet in its list of members, or {vehicle} is not the name of its vehicle. Ask "
        "the one who has the team"
    )


def _member(endpoint: str) -> tuple[Identity | None, str]:
    """The member of an endpoint's bundle, or None; and why it is not valid: it is revoked, or a file is damaged."""
    certificate = files_of(endpoint).get("connect_certificate_file")
    if certificate is None:
        return None, ""
    try:
        own = identity_of(read_certificate(certificate))
        return own, _revocation(own, certificate.parent)
    except KeysError as error:
        return None, str(error)


def _time_problem(identity: Identity) -> str:
    """Reason why a certificate is not valid now, or ""."""
    now = datetime.now(UTC)
    if now > identity.expires:
        return f"the certificate of {identity.name} has expired on {_day(identity.expires)}: {_renew(identity.name)}"
    if now < identity.begins:
        return (
            f"the certificate of {identity.name} is valid from {_day(identity.begins)}, and this computer's clock says "
            f"{_day(now)}: set the clock"
        )
    return ""


def _own_problem(own: Identity, bundle: Path) -> str:
    """Why nobody takes this computer's certificate: it is not valid now, or its own list says that it is revoked."""
    return _time_problem(own) or _revocation(own, bundle)


def _revocation(own: Identity, bundle: Path) -> str:
    """Reason why the bundle's member is revoked, by the bundle's own list of members, or ""."""
    if (bundle / MEMBERS).exists() and read_members(bundle).is_revoked(own.name):
        return f"{own.name} is revoked: ask the one who has the team for another bundle"
    return ""


def _handshake_problem(endpoint: str, own: Identity) -> str:
    """Why a handshake with the router fails; "" if it succeeds, or if nobody listens.

    Raises:
        KeysError: a file can't be used.
    """
    address, shown = parse_router(endpoint), shown_router(endpoint)
    context = _context(files_of(endpoint))
    try:
        with (
            socket.create_connection((address.host, address.port), PROBE_TIMEOUT_S) as link,
            context.wrap_socket(link, server_hostname=address.host) as secured,
        ):
            secured.recv(1)  # with TLS 1.3 the router checks our certificate after our side has finished
    except ssl.SSLCertVerificationError as error:
        return _router_refusal(error, endpoint)
    except ssl.SSLError as error:
        return _own_refusal(error, shown, own)
    except socket.gaierror:
        return f"no host is called {address.host}: check the name, or write its IP address"
    except OSError:  # nothing listens, or a router without TLS waits for the rest of what it takes for Zenoh's protocol
        return ""
    return ""


def _context(files: dict[str, Path]) -> ssl.SSLContext:
    """TLS of a client with the files of a bundle.

    Raises:
        KeysError: one of them can't be used.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_3  # Zenoh's
    certificate, key = files["connect_certificate_file"], files["connect_private_key_file"]
    try:
        for path in (files["root_ca_certificate_file"], certificate, key):
            read_plain_file(path)  # OpenSSL would wait for a pipe, and for the end of a device
        context.load_verify_locations(files["root_ca_certificate_file"])
        context.load_cert_chain(certificate, key, password="")
    except ssl.SSLError:
        raise KeysError(
            f"{key} is not the key of {certificate}, or a file is damaged: copy the whole bundle anew"
        ) from None
    except OSError as error:
        raise KeysError(describe_os_error(error)) from None
    return context


def _router_refusal(error: ssl.SSLCertVerificationError, endpoint: str) -> str:
    """Why a client doesn't take the router's certificate."""
    address, shown = parse_router(endpoint), shown_router(endpoint)
    if error.verify_code in OTHER_AUTHORITY:
        return (
            f"the router at {shown} is another team's: its certificate is not signed by the authority of this bundle. "
            "Use a bundle of that team, or check the address"
        )
    router = _certificate_at(address.host, address.port)
    if router is None:
        return f"the certificate of the router at {shown} is refused: {error.verify_message}"
    if error.verify_code in (EXPIRED, NOT_YET_VALID):
        problem = _time_problem(router)
        return f"the router at {shown} can't be trusted: {problem}" if problem else ""
    if error.verify_code in NAME_MISMATCHES:
        known = ", ".join(router.hosts)
        return (
            f"the certificate of {router.name} is for {known}, not for {address.host}: connect to one of these, or "
            f"renew it with all its addresses: `jezero keys renew {router.name} --host {address.host}`"
        )
    if error.verify_code == WRONG_PURPOSE:
        return f"the router at {shown} uses the certificate of {router.name}, who runs none: don't trust it"
    return f"the certificate of {router.name} at {shown} is refused: {error.verify_message}"


def _own_refusal(error: ssl.SSLError, shown: str, own: Identity) -> str:
    """Why the router doesn't take the client's certificate, or speaks no TLS."""
    if error.reason == REFUSED_TIME:
        return (
            f"the router at {shown} takes the certificate of {own.name} for expired, which is valid from "
            f"{_day(own.begins)} to {_day(own.expires)}: set the clock of the router's computer"
        )
    if error.reason in REFUSED_AUTHORITY:
        return (
            f"the router at {shown} doesn't know the authority that signed the certificate of {own.name}: the bundle "
            "is another team's, or was put together from two"
        )
    if error.reason in OTHER_TLS:
        return f"what listens at {shown} has no TLS 1.3, which Zenoh's routers speak: check the address"
    if why := REFUSED_FOR.get(error.reason or ""):
        return (
            f"the router at {shown} refuses the certificate of {own.name}: {why}. Ask the one who has the team for "
            "another bundle"
        )
    if "ALERT" in (error.reason or ""):
        return f"the router at {shown} refuses the certificate of {own.name}: {_words(error)}"
    return f"what listens at {shown} is no router with TLS ({_words(error)}): check the address"


def _certificate_at(host: str, port: int) -> Identity | None:
    """What the certificate of a router says, whoever signed it; None if it isn't to be had."""
    from cryptography import x509

    try:
        with socket.create_connection((host, port), PROBE_TIMEOUT_S) as link, _trusting().wrap_socket(link) as secured:
            return identity_of(x509.load_der_x509_certificate(secured.getpeercert(binary_form=True) or b""))
    except (OSError, ValueError):
        return None


def _speaks_tls(host: str, port: int) -> bool:
    """Whether a server speaks TLS."""
    try:
        with socket.create_connection((host, port), PROBE_TIMEOUT_S) as link, _trusting().wrap_socket(link) as secured:
            return secured.version() is not None
    except OSError:
        return False


def _trusting() -> ssl.SSLContext:
    """TLS that takes every certificate, to look at it; nothing is sent over it."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    return context


def _renew(name: str) -> str:
    return f"`jezero keys renew {name}` on the computer that has the team makes a new one"


def _day(time: datetime) -> str:
    return f"{time:%Y-%m-%d %H:%M} UTC"


def _words(error: ssl.SSLError) -> str:
    return (error.reason or "unknown reason").replace("_", " ").lower()
