"""The rules of `mcap doctor` and of viewers, checked with the library's own reader."""

import json
from collections import Counter, defaultdict
from pathlib import Path

from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Channel, Chunk, ChunkIndex, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk


def chunks_of(path: Path) -> list[Chunk]:
    """All chunks of a file."""
    with path.open("rb") as file:
        return [record for record in StreamReader(file, emit_chunks=True).records if isinstance(record, Chunk)]


def examine(path: Path) -> Counter[str]:
    """Assert that a finished file is sound; returns the number of messages of each channel.

    Source: the checks of the command `mcap doctor`, and those of Foxglove and PlotJuggler when they open a file.
    """
    counts = _examine_summary(path)
    _examine_chunks(path)
    with path.open("rb") as file:  # in the order of the file, without the indexes
        unindexed = Counter(channel.topic for _, channel, _ in NonSeekingReader(file).iter_messages())
    assert counts == unindexed
    return counts


def _examine_summary(path: Path) -> Counter[str]:
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "jezero"
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        counts: Counter[str] = Counter()
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema is not None and schema.encoding == "jsonschema" and channel.message_encoding == "json"
            assert json.loads(message.data).keys()
            counts[channel.topic] += 1
        statistics = summary.statistics
        assert statistics.message_count == sum(counts.values())
        assert statistics.chunk_count == len(summary.chunk_indexes)
        assert statistics.channel_count == len(summary.channels) == len(counts)
        assert statistics.schema_count == len(summary.schemas)
        by_topic = {summary.channels[channel].topic: n for channel, n in statistics.channel_message_counts.items()}
        assert by_topic == counts
        for channel in summary.channels.values():
            assert json.loads(summary.schemas[channel.schema_id].data)["type"] == "object"
        return counts


def _examine_chunks(path: Path) -> None:
    known_schemas, known_channels = set(), set()
    newest_ns: dict[int, int] = defaultdict(int)
    chunks, indexes = chunks_of(path), _chunk_indexes(path)
    assert len(chunks) == len(indexes)
    for chunk, index in zip(chunks, indexes, strict=True):
        times_ns, channels = [], set()
        for entry in breakup_chunk(chunk, validate_crc=True):
            match entry:
                case Schema():
                    known_schemas.add(entry.id)
                case Channel():
                    assert entry.schema_id in known_schemas
                    known_channels.add(entry.id)
                case Message():
                    assert entry.channel_id in known_channels
                    assert entry.log_time >= newest_ns[entry.channel_id]
                    newest_ns[entry.channel_id] = entry.log_time
                    times_ns.append(entry.log_time)
                    channels.add(entry.channel_id)
        assert (min(times_ns), max(times_ns)) == (chunk.message_start_time, chunk.message_end_time)
        assert (min(times_ns), max(times_ns)) == (index.message_start_time, index.message_end_time)
        assert set(index.message_index_offsets) == channels
        assert index.compression == "zstd"


def _chunk_indexes(path: Path) -> list[ChunkIndex]:
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        return sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset)
