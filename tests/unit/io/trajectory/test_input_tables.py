"""Tables that drive a simulation, and states that it starts from."""

from pathlib import Path

import numpy as np
import pytest

from lagsplat.io.trajectory.inputs import interpolate_inputs, read_initial_state, read_input_table


def test_inputs_and_pushes_are_told_apart_by_their_names(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("f0,u1,t,u0\n9,2,0,1\n8,4,0.5,3\n")
    time_s, u, pushes = read_input_table(tmp_path / "a.csv")
    np.testing.assert_array_equal(time_s, [0.0, 0.5])
    np.testing.assert_array_equal(u, [[1, 2], [3, 4]])
    np.testing.assert_array_equal(pushes, [[9], [8]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,q0\n0,1\n1,2\n", r"columns \['t', 'q0'\]; give t \[s\], inputs u0, u1, ... .* and no others"),
        ("u0\n1\n2\n", r"columns \['u0'\]; give t \[s\]"),
        ("t,u0\n0,1\n1,\n", "line 3: u0 is missing or not finite; fill it in"),
        ("t,u0\n0,1\n1,2\n0.5,3\n", "line 4: t does not increase, 0.5 s after 1 s; drop repeated rows"),
        ("", "empty; the first line names the columns"),
        ("t,u1\n0,1\n1,1\n", r"\['u0'\] are missing; count from u0"),
        ("t,u0\n0,a\n1,1\n", "line 2: column 'u0' holds 'a', which is no number"),
        ("t,u0\n0,1\n", r"1 row\(s\) with a number in every column; give two or more"),
    ],
)
def test_a_table_that_drives_nothing_is_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(ValueError, match=message):
        read_input_table(tmp_path / "a.csv")


def test_inputs_are_interpolated_between_rows() -> None:
    time_s, u = np.array([0.0, 1.0, 3.0]), np.array([[0.0, 1.0], [1.0, 1.0], [5.0, 1.0]])
    even_s, inputs = interpolate_inputs(time_s, u, dt_s=0.5, most=6)
    np.testing.assert_allclose(even_s, 0.5 * np.arange(7))
    np.testing.assert_allclose(inputs, np.stack([[0, 0.5, 1, 2, 3, 4, 5], np.ones(7)], axis=1))
    with pytest.raises(ValueError, match=r"inputs over 3 s, of which 2\.5 can be simulated"):
        interpolate_inputs(time_s, u, dt_s=0.5, most=5)


@pytest.mark.parametrize("text", ["1,-2", "[1, -2]", "(1,-2,0,0)"])
def test_an_initial_state_without_rates_is_at_rest(text: str) -> None:
    q, v = read_initial_state(text, 2)
    assert (q.tolist(), v.tolist()) == ([1.0, -2.0], [0.0, 0.0])


def test_an_initial_state_is_the_first_row_of_a_table(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,v0,q1,v1,q0\n0,3,2,4,1\n1,0,0,0,0\n")
    q, v = read_initial_state(str(tmp_path / "a.csv"), 2)
    assert (q.tolist(), v.tolist()) == ([1.0, 2.0], [3.0, 4.0])


@pytest.mark.parametrize("text", ["1", "1,2,3", "1,2,3,4,5", "nan,0"])
def test_an_initial_state_has_a_number_for_each_coordinate(text: str) -> None:
    with pytest.raises(ValueError, match=r"the sim has 2 coordinate\(s\); give 2, or 4 with the rates"):
        read_initial_state(text, 2)


def test_an_initial_state_that_is_no_number_names_a_table() -> None:
    with pytest.raises(FileNotFoundError, match=r"there\.csv"):
        read_initial_state("there.csv", 1)
