"""Read the intact messages of an SQLite file of a ROS 2 bag, which may be cut short.

The rows are read in the order in which they were written, without the index, up to the first page that is
missing: the reader of the library `rosbags` opens whole databases only. The format of the tables is that of
rosbag2's plug-in ``sqlite3``; definitions of the messages are in a table since ROS 2 Iron.
"""

import os
import shutil
import sqlite3
import struct
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

from mcap.records import Channel, Message, Schema

from lagsplat.io.files.atomic import StrPath

MAGIC = b"SQLite format 3\0"
PAGE_SIZE = struct.Struct(">16sH")  # the beginning of a database: the magic, and the bytes of a page
JOURNALS = ("-wal", "-journal")  # what a recorder that was killed had not yet put into the database

ROWS = """
    SELECT topic_id, timestamp, data FROM messages
    WHERE typeof(timestamp) = 'integer' AND typeof(data) = 'blob'
"""


def read_sqlite_messages(path: StrPath, losses: list[str]) -> Iterator[tuple[Schema, Channel, Message]]:
    """Yield every intact message with its channel and schema, in the order of writing.

    A schema without data has no definition in the file. A loss adds a sentence to ``losses``.

    Raises:
        FileNotFoundError: there is no file at ``path``.
        ValueError: the file is no SQLite database, or has no table of topics.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; check the path")
    with _open(path) as database:
        schemas, channels = _read_topics(path, database)
        count = orphans = 0
        try:
            for topic, time_ns, data in database.execute(ROWS):
                if topic not in channels:
                    orphans += 1
                    continue
                yield schemas[topic], channels[topic], Message(topic, time_ns, data, time_ns, count)
                count += 1
        except (sqlite3.DatabaseError, MemoryError) as error:  # a damaged length may be beyond any memory
            reason = str(error) or type(error).__name__
            losses.append(f"the database is damaged or cut short ({reason}) after its message {count}")
        if orphans:
            losses.append(f"{orphans} messages belong to a topic that is lost")


@contextmanager
def _open(path: Path) -> Iterator[sqlite3.Connection]:
    """Open the database without changing anything in its folder."""
    journals = [path.with_name(path.name + suffix) for suffix in JOURNALS]
    journals = [file for file in journals if file.is_file() and file.stat().st_size]
    with tempfile.TemporaryDirectory() as folder:
        address = f"{path.resolve().as_uri()}?mode=ro&immutable=1"
        torn = _bytes_of_torn_page(path)
        if journals or torn:
            for file in (path, *journals):
                shutil.copyfile(file, Path(folder) / file.name)
            copy = Path(folder) / path.name
            # SQLite takes what is missing of a page for zeros, and so messages for others.
            os.truncate(copy, copy.stat().st_size - torn)
            address = copy.as_uri()
        with closing(sqlite3.connect(address, uri=True)) as database:
            database.execute("PRAGMA trusted_schema = OFF")
            database.execute("PRAGMA writable_schema = ON")  # SQLite then opens a file that is cut short
            yield database


def _bytes_of_torn_page(path: Path) -> int:
    """How many bytes the file has after its last whole page."""
    with path.open("rb") as file:
        head = file.read(PAGE_SIZE.size)
    if len(head) < PAGE_SIZE.size:
        return 0
    magic, size = PAGE_SIZE.unpack(head)
    page = 65536 if size == 1 else size
    return path.stat().st_size % page if magic == MAGIC and page else 0


def _read_topics(path: Path, database: sqlite3.Connection) -> tuple[dict[int, Schema], dict[int, Channel]]:
    definitions: dict[str, tuple[str, str]] = {}
    try:
        rows = list(database.execute("SELECT id, name, type, serialization_format FROM topics"))
        with suppress(sqlite3.OperationalError):  # there is no such table before Iron
            found = database.execute(
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            )
            definitions = {kind: (encoding, text) for kind, encoding, text in found}
    except sqlite3.DatabaseError as error:
        raise ValueError(
            f"{path}: its topics cannot be read, so it is no bag of ROS 2, or its beginning is damaged "
            f"({error}); copy it again, or name another file"
        ) from error
    schemas, channels = {}, {}
    for number, topic, kind, encoding in rows:
        form, text = definitions.get(kind, ("", ""))
        schemas[number] = Schema(id=number, name=kind, encoding=form, data=text.encode())
        channels[number] = Channel(
            id=number, topic=topic, message_encoding=encoding, metadata={}, schema_id=number
        )
    return schemas, channels
