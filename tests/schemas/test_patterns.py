"""Patterns of texts match the whole text."""

from collections.abc import Iterator
from types import UnionType
from typing import Annotated, Any, get_args

import msgspec
import pytest
from msgspec import Meta, inspect

from jezero.cli.reference.settings import FILES
from jezero.cli.reference.topics import all_topics
from jezero.runtime.instance import Instance
from jezero.schemas.struct import Name
from jezero.schemas.topics import ENDPOINTS

EXAMPLES = ("", "a", "A", "0" * 64, "tcp/127.0.0.1:7447")


def patterns_of(found: Any, seen: set[int]) -> Iterator[str]:
    """Patterns of all texts within a type, as msgspec's `inspect` describes it."""
    if id(found) in seen:
        return
    seen.add(id(found))
    if isinstance(found, inspect.StrType) and found.pattern is not None:
        yield found.pattern
    for value in msgspec.structs.asdict(found).values() if isinstance(found, msgspec.Struct) else ():
        for part in value if isinstance(value, tuple) else (value,):
            yield from patterns_of(part, seen)


def all_patterns() -> list[str]:
    """Patterns in all messages, requests, replies and settings."""
    messages = [topic.type for topic in all_topics()]
    requests = [kind for endpoint in ENDPOINTS for kind in (endpoint.request_type, endpoint.reply_type)]
    settings = [Instance, *(kind for kind, _ in FILES.values())]
    kinds = [*messages, *requests, *settings]
    kinds = [part for kind in kinds for part in (get_args(kind) if isinstance(kind, UnionType) else (kind,))]
    seen: set[int] = set()
    found = inspect.multi_type_info(kinds)
    return sorted({pattern for kind in found for pattern in patterns_of(kind, seen)})


@pytest.mark.parametrize("pattern", all_patterns())
def test_a_pattern_refuses_a_line_feed_after_what_it_accepts(pattern: str) -> None:
    kind = Annotated[str, Meta(pattern=pattern)]

    def accepts(text: str) -> bool:
        try:
            msgspec.convert(text, kind)
        except msgspec.ValidationError:
            return False
        return True

    accepted = [text for text in EXAMPLES if accepts(text)]
    assert accepted
    assert not [text for text in accepted if accepts(f"{text}\n")]


def test_the_patterns_of_messages_and_of_settings_are_all_looked_at() -> None:
    assert len(all_patterns()) >= 7


def test_a_name_with_a_line_feed_at_its_end_is_refused() -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.json.decode(b'"uav1\\n"', type=Name)
