"""The camera's messages, turned into shaped pictures as they come: memory holds those and no others."""

from collections.abc import Callable
from typing import Any

import numpy as np

from lagsplat.io.mcap_message import field_of
from lagsplat.io.mcap_picture import VIDEO, bytes_of, message_kind, picture_of
from lagsplat.io.mcap_video import PacketFile

Shape = Callable[[np.ndarray], np.ndarray]


class CameraReader:
    """Pictures of one topic, by the number of their message.

    ``shape`` takes a BGR picture to the one that is kept. A message that does not make a picture is left out
    and told of in ``damaged``, unless it is the first one. A context, because films wait in a temporary file.
    """

    def __init__(self, topic: str, shape: Shape) -> None:
        self.topic = topic
        self.pictures: dict[int, np.ndarray] = {}
        self.damaged: list[str] = []
        self._shape = shape
        self._packets = PacketFile()
        self._wanted: list[bool] = []

    def __enter__(self) -> "CameraReader":
        return self

    def __exit__(self, *error: object) -> None:
        self._packets.close()

    def add(self, message: Any, schema_name: str, *, wanted: bool) -> None:
        """Take the next message; its picture is kept where it is ``wanted``.

        Raises:
            ValueError: the topic holds no pictures, the first one cannot be decoded, or a film changes
            format.
        """
        number = len(self._wanted)
        self._wanted.append(wanted)
        kind = message_kind(schema_name)
        if kind is None:
            raise ValueError(
                f"topic {self.topic} holds {schema_name}, which is no picture; choose a topic of "
                "CompressedImage, Image, RawImage or CompressedVideo"
            )
        try:
            if kind == VIDEO:
                self._packets.add(bytes_of(message), format=str(field_of(message, "format")))
            elif wanted:
                self.pictures[number] = self._shape(picture_of(message, kind))
        except ValueError as error:
            if kind == VIDEO or not self.pictures:
                raise ValueError(f"topic {self.topic}, message {number}: {error}") from error
            self.damaged.append(f"message {number}: {error}")

    def finish(self) -> None:
        """Decode the film, if it is one.

        Raises:
            ValueError: it cannot be decoded, or its pictures are not as many as its packets.
        """
        if self._packets.count:
            for number, picture in enumerate(self._packets.pictures()):
                if self._wanted[number]:
                    self.pictures[number] = self._shape(picture)
