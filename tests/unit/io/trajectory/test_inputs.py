"""Tables of inputs beside a film."""

from pathlib import Path

import numpy as np
import pytest

from lagsplat.io.trajectory.inputs import read_input_log


def test_times_and_inputs_in_their_order(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("u1,t,u0\n1,0,5\n2,0.5,\n3,1.5,7\n")
    with pytest.warns(UserWarning, match="1 rows lack a number"):
        time_s, inputs = read_input_log(path)
    np.testing.assert_array_equal(time_s, [0.0, 1.5])
    np.testing.assert_array_equal(inputs, [[5, 1], [7, 3]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,q0\n0,1\n1,2\n", "no column u0"),
        ("t,u0\n0,1\n0,2\n", "line 3: t does not increase, 0 s after 0 s"),
        ("t,u0\n0,1\n", r"1 row\(s\) with a number"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(ValueError, match=message):
        read_input_log(tmp_path / "a.csv")
