"""The side of Zenoh that services and clients share: how a message travels."""

import zenoh

from jezero.codec import join_attachment


def data_of(sample: zenoh.Sample) -> bytes:
    """A message in one piece, as the codec reads it.

    Zenoh carries the pixels of a picture as the payload, which it doesn't copy, and its JSON as the attachment.
    """
    json, payload = sample.attachment, sample.payload.to_bytes()
    return payload if json is None else join_attachment(json.to_bytes(), payload)
