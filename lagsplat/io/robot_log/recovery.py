"""Read the intact messages of an MCAP file that may be damaged, and report what is lost.

A log is cut short when its recorder is killed, and then has no index. So the index is never used: records
are read from the start up to the first incomplete one; of a cut chunk, whatever can be decompressed is read.
"""

import struct
from collections.abc import Callable, Iterator
from io import BufferedReader, BytesIO
from pathlib import Path

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Footer, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from lagsplat.io.files.atomic import StrPath

MAGIC = b"\x89MCAP0\r\n"
HEAD_BYTES = 9  # of a record: its type, and the number of bytes that follow
PARTS: dict[str, Callable[[bytes], bytes]] = {
    "": bytes,
    "lz4": lambda data: lz4.frame.LZ4FrameDecompressor().decompress(data),
    "zstd": lambda data: zstandard.ZstdDecompressor().decompressobj().decompress(data),
}  # decompressors by codec: return as much as a truncated stream gives


def read_whole_messages(path: StrPath, losses: list[str]) -> Iterator[tuple[Schema | None, Channel, Message]]:
    """Yield every intact message with its channel and schema, in file order.

    Each loss adds a sentence to ``losses``: bytes after the last intact record, and chunks whose checksum
    does not match.

    Raises:
        FileNotFoundError: there is no file at ``path``.
        ValueError: the file is no MCAP, or is compressed with an unknown codec.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; check the path")
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise ValueError(f"{path}: it does not begin as an MCAP file does; check which file was given")
        schemas, channels = _summary(file)
        file.seek(len(MAGIC))
        orphans = 0
        for record in _records(path, file, losses):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message):
                if channel := channels.get(record.channel_id):
                    yield schemas.get(channel.schema_id), channel, record
                else:
                    orphans += 1
        if orphans:
            losses.append(f"{orphans} messages belong to a channel that is lost")


def _summary(file: BufferedReader) -> tuple[dict[int, Schema], dict[int, Channel]]:
    """Schemas and channels of the summary at the end, so that a topic survives the loss of their chunk."""
    file.seek(0)
    try:
        summary = make_reader(file).get_summary()
    # a file that is cut short has none, or one that tells of lengths beyond any memory
    except (McapError, ValueError, OSError, struct.error, OverflowError, MemoryError):
        summary = None
    return (summary.schemas, summary.channels) if summary else ({}, {})


def _records(path: Path, file: BufferedReader, losses: list[str]) -> Iterator[McapRecord]:
    size, end = path.stat().st_size, file.tell()
    for record in _until_break(file, size):
        end = file.tell()
        if isinstance(record, Footer):
            return
        if not isinstance(record, Chunk):
            yield record
        elif record.compression not in PARTS:
            codecs = "those read are lz4, zstd and none. Rewrite it with `mcap compress`"
            raise ValueError(f"{path}: compressed with {record.compression!r}; {codecs}")
        else:
            try:
                yield from breakup_chunk(record, validate_crc=True)
            except Exception as error:  # every codec raises its own errors
                span_s = (record.message_end_time - record.message_start_time) / 1e9
                losses.append(f"a chunk of {span_s:.3f} s is damaged ({error})")
    losses.append(f"the file ends without its footer, {size - end} bytes after its last whole record")
    file.seek(end)
    if file.read(HEAD_BYTES)[:1] == bytes([Opcode.CHUNK]):
        yield from _whole_part(file.read(), losses)


def _until_break(stream: BufferedReader | BytesIO, size: int) -> Iterator[McapRecord]:
    """Records outside chunks, up to the footer or the first that is incomplete or damaged."""
    reader = StreamReader(stream, skip_magic=True, emit_chunks=True, record_size_limit=size)
    try:
        yield from reader.records
    except (McapError, struct.error, UnicodeDecodeError, OverflowError, MemoryError):
        return


def _whole_part(content: bytes, losses: list[str]) -> Iterator[McapRecord]:
    """Records of a chunk that is cut short, as far as its codec can decompress."""
    try:
        # A truncated stream gives short reads; the data end there.
        chunk = Chunk.read(ReadDataStream(BytesIO(content)))
        data = PARTS[chunk.compression](chunk.data)
    except Exception as error:  # cut within its head, or within the first block of its codec
        losses.append(f"nothing of the last chunk can be read ({type(error).__name__})")
        return
    count = 0
    for record in _until_break(BytesIO(data), len(data)):
        count += isinstance(record, Message)
        yield record
    losses.append(f"{count} messages of the last chunk, which is cut short, are whole")
