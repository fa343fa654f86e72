"""What cannot be written leaves nothing behind; what can is in order of time."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.stream_reader import StreamReader

from lagsplat.io.robot_log.recovery import read_whole_messages
from lagsplat.io.robot_log.write import ImageTopic, NumberTopic, write_mcap

PICTURES = [np.full((4, 4, 3), i, np.uint8) for i in range(3)]
TIMES = np.array([0.0, 0.1, 0.2])


def numbers(values: Any = (1.0, 2.0, 3.0), times: np.ndarray = TIMES, name: str = "x") -> NumberTopic:
    return NumberTopic("/numbers", times, {name: np.asarray(values)}, {name: "N"})


def test_messages_stand_in_the_order_of_time(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    topic = ImageTopic("/camera", TIMES + 0.05, iter(PICTURES))
    write_mcap(path, pictures=[topic], numbers=[numbers()], metadata={"a": "b"}, start_ns=5)
    losses: list[str] = []
    found = [(channel.topic, message.log_time) for _, channel, message in read_whole_messages(path, losses)]
    assert losses == []
    times = [time for _, time in found]
    assert times == sorted(times) == [5 + 50_000_000 * i for i in range(6)]
    assert [topic for topic, _ in found] == ["/numbers", "/camera"] * 3
    with path.open("rb") as file:
        assert list(StreamReader(file, validate_crcs=True).records)


@pytest.mark.parametrize(
    ("topic", "reason"),
    [
        (numbers(times=TIMES - 1.0), "must be 0 or more and increase"),
        (numbers(times=TIMES[::-1]), "must be 0 or more and increase"),
        (numbers(values=(1.0, np.nan, 2.0)), "a value at message 1 is not finite"),
        (numbers(name="timestamp"), "may not be called 'timestamp'"),
        (ImageTopic("/camera", TIMES, PICTURES[:2]), "shorter"),
    ],
)
def test_what_cannot_be_written_leaves_nothing(tmp_path: Path, topic: Any, reason: str) -> None:
    pictures, rest = ([topic], []) if isinstance(topic, ImageTopic) else ([], [topic])
    with pytest.raises(ValueError, match=reason):
        write_mcap(tmp_path / "log.mcap", pictures=pictures, numbers=rest, metadata={})
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_there_stays(tmp_path: Path) -> None:
    (tmp_path / "log.mcap").write_text("mine", encoding="utf-8")
    with pytest.raises(FileExistsError, match="left as it is"):
        write_mcap(tmp_path / "log.mcap", pictures=[], numbers=[numbers()], metadata={})
    assert (tmp_path / "log.mcap").read_text(encoding="utf-8") == "mine"
