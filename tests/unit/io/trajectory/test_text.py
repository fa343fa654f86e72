"""Texts that are read fast give what is read line by line, and rows keep the numbers of their lines."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from lagsplat.io.trajectory import text
from lagsplat.io.trajectory.columns import Table
from lagsplat.io.trajectory.text import read_text


def written(tmp_path: Path, content: str) -> Path:
    path = tmp_path / "a.csv"
    path.write_bytes(content.encode())
    return path


def read_slowly(path: Path, monkeypatch: pytest.MonkeyPatch) -> Table:
    with monkeypatch.context() as changed:
        changed.setattr(text, "_parse_tidy", lambda *_: None)
        return read_text(path)


@pytest.mark.parametrize(
    "content",
    [
        "t,q0\n0,1\n0.1,2\n",
        "t,q0\n0,1\n0.1,2",
        "t;q0;u0\n0;1,5;2\n0,1;-2,25e-3;\n",
        "t,q0\n\n0,1\n   \n0.1,2 # late\n# end\n\t\n0.2,nan\n",
        "t,q0,mode\n0,1,idle\n1,2,\n2,3,moving\n3,4,idle\n",
        "t,q0,on\n0,1,True\n1,2,False\n",
        't,q0,mode\n0,1,"a, b"\n1,"2","c"\n',
        "t,q0\n0,NA\n1,null\n2,inf\n3, 7 \n",
        "t,q0\n" + "".join(f"{i},{i * i}\n" for i in range(5000)) + "5000,1e400\n",
        "t,q0\n0,1\n1,two\n",
    ],
)
def test_both_ways_read_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: str) -> None:
    path = written(tmp_path, content)
    fast, slow = read_text(path), read_slowly(path, monkeypatch)
    np.testing.assert_array_equal(fast.lines, slow.lines)
    assert list(fast.columns) == list(slow.columns)
    for name in fast.columns:
        if fast.columns[name].dtype == object:
            assert list(map(str, fast.columns[name])) == list(map(str, slow.columns[name]))
        else:
            np.testing.assert_allclose(fast.numbers(name), slow.numbers(name), rtol=1e-15)


def test_a_late_fault_is_found_in_its_line(tmp_path: Path) -> None:
    rows = [f"{i},{i}" for i in range(100_000)]
    rows[90_000] = "90000,1,2"
    with pytest.raises(ValueError, match="line 90002: 3 cells under 2 names"):
        read_text(written(tmp_path, "t,q0\n" + "\n".join(rows)))
    rows[90_000] = "90000,1O"
    table = read_text(written(tmp_path, "t,q0\n" + "\n".join(rows)))
    with pytest.raises(ValueError, match="line 90002: column 'q0' holds '1O'"):
        table.numbers("q0")


def test_a_tidy_text_is_not_read_line_by_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(text, "_parse_lines", None)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        table = read_text(written(tmp_path, "# log\nt\n0\n1\n\n2\n"))
    np.testing.assert_array_equal(table.lines, [3, 4, 6])
