"""The end of the certificate with which this computer links with others."""

from datetime import datetime, timedelta
from pathlib import Path

from jezero.keys.bundle import CERTIFICATE, identity_of, read_certificate
from jezero.keys.members import KeysError

ENDS_SOON = timedelta(days=14)


def certificate_problem(bundle: str | None, now: datetime) -> str:
    """Why the links with other computers end soon, or have ended, for people; "" for no reason, and without keys.

    Args:
        bundle: folder of this computer's keys; None or "" for none.
        now: present time, with its time zone.
    """
    if not bundle:
        return ""
    try:
        certificate = read_certificate(Path(bundle) / CERTIFICATE)
        name = identity_of(certificate).name
    except KeysError as error:
        return str(error)
    end = certificate.not_valid_after_utc
    if end - now > ENDS_SOON:
        return ""
    verb = "has ended" if end <= now else "ends"
    return f"the certificate of {name} {verb} on {end:%Y-%m-%d}: jezero keys renew {name} where the team's keys are"
