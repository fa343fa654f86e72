"""Motions read from files of every kind, tidy and untidy, and refused with the row named."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lagsplat.io.trajectory.trajectory import Trajectory, read_trajectory_file

TIDY = "t,q0,u0\n0.0,1.0,0.5\n0.1,2.0,0.25\n0.2,3.0,-1e-3\n"


def written(tmp_path: Path, text: str, name: str = "a.csv") -> Path:
    path = tmp_path / name
    path.write_bytes(text.encode())
    return path


def steps(n: int, dt_s: float = 0.1) -> str:
    return "t,q0\n" + "".join(f"{dt_s * k},{k}\n" for k in range(n))


@pytest.mark.parametrize(
    "text",
    [
        TIDY,
        "\ufeff" + TIDY,
        TIDY.replace("\n", "\r"),
        TIDY.replace("\n", "\r\n"),
        TIDY.replace("t,q0,u0", " t , q0 ,  u0 "),
        "# a log\n\n" + TIDY + "# the end\n",
        TIDY.replace("2.0,0.25", "2.0,0.25  # a remark"),
        TIDY.replace(",", ";"),
        TIDY.replace(",", ";").replace(".", ","),
        TIDY.replace(",", "\t"),
        TIDY.replace(",", ", "),
        '"t","q0","u0"\n' + TIDY.partition("\n")[2],
        "# made by savetxt\n# " + TIDY,
    ],
    ids=[
        "tidy",
        "bom",
        "cr",
        "crlf",
        "spaces",
        "comments",
        "remark",
        "semicolons",
        "decimal commas",
        "tabs",
        "blanks",
        "quotes",
        "names in a comment",
    ],
)
def test_one_table_in_many_dresses(tmp_path: Path, text: str) -> None:
    motion = read_trajectory_file(written(tmp_path, text))
    np.testing.assert_array_equal(motion.time_s, [0.0, 0.1, 0.2])
    np.testing.assert_array_equal(motion.q, [[1.0], [2.0], [3.0]])
    np.testing.assert_array_equal(motion.u, [[0.5], [0.25], [-1e-3]])
    assert (motion.d, motion.n_u, motion.v, motion.segments) == (1, 1, None, ((0, 3),))
    assert motion.dt_s == pytest.approx(0.1)
    assert motion.duration_s == pytest.approx(0.2)


def test_every_kind_of_file_holds_the_same_motion(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    frame = pd.DataFrame(rng.normal(size=(20, 6)), columns=["q1", "v0", "q0", "v1", "u0", "u1"])
    frame.insert(3, "t", np.cumsum(rng.uniform(0.01, 0.1, 20)))
    frame["segment"] = [3] * 8 + [0] * 12
    frame.to_csv(tmp_path / "a.csv", index=False)
    frame.to_parquet(tmp_path / "a.parquet")
    frame.set_index("t").to_parquet(tmp_path / "b.parquet")
    columns = {name: frame[name].to_numpy() for name in frame}
    np.savez(tmp_path / "a.npz", **columns)
    blocks = {letter: frame[[f"{letter}0", f"{letter}1"]].to_numpy() for letter in "qvu"}
    np.savez(tmp_path / "b.npz", t=columns["t"], segment=columns["segment"], **blocks)
    for name in ("a.csv", "a.parquet", "b.parquet", "a.npz", "b.npz"):
        motion = read_trajectory_file(tmp_path / name)
        # to two units of the last binary digit, by which pandas 2 may miss a number in a text
        np.testing.assert_array_almost_equal_nulp(motion.time_s, frame["t"].to_numpy(), nulp=2)
        for letter in "qvu":
            np.testing.assert_array_almost_equal_nulp(getattr(motion, letter), blocks[letter], nulp=2)
        assert motion.segments == ((0, 8), (8, 20))
        assert (motion.q_names, motion.u_names, motion.source) == (("q0", "q1"), ("u0", "u1"), name)


def test_other_names_are_mapped_and_else_proposed(tmp_path: Path) -> None:
    path = written(tmp_path, "time,position,velocity,torque\n0,1,2,3\n1,2,3,4\n")
    asked = {"t": "time", "q0": "position", "v0": "velocity", "u0": "torque"}
    motion = read_trajectory_file(path, columns=asked)
    np.testing.assert_array_equal(np.hstack([motion.q, motion.v, motion.u]), [[1, 2, 3], [2, 3, 4]])
    proposal = r"diagnose.columns=\{t: time, q0: position, v0: velocity, u0: torque\}"
    with pytest.raises(ValueError, match=rf"a.csv: no column t and no q0; the columns are .*{proposal}"):
        read_trajectory_file(path)
    with pytest.raises(ValueError, match=r"no column 'positon' for q0, only .*did you mean 'position'"):
        read_trajectory_file(path, columns={**asked, "q0": "positon"})
    with pytest.raises(ValueError, match=r"diagnose.columns names 'x0'"):
        read_trajectory_file(path, columns={**asked, "x0": "torque"})
    with pytest.warns(UserWarning, match=r"column\(s\) torque are not used"):
        assert read_trajectory_file(path, columns={key: asked[key] for key in ("t", "q0", "v0")}).n_u == 0


def test_a_column_mapped_away_is_not_read_twice(tmp_path: Path) -> None:
    path = written(tmp_path, "t,q0,q1\n0,1,5\n1,2,6\n")
    motion = read_trajectory_file(path, columns={"q0": "q1", "u0": "q0"})
    np.testing.assert_array_equal(np.hstack([motion.q, motion.u]), [[5, 1], [6, 2]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty"),
        ("t,q0\n", "no row of numbers"),
        ("0.0,1.0\n0.1,2.0\n", "line 1: numbers where the names"),
        ("t,q0,q0\n0,1,2\n", "two columns are called 'q0'"),
        ("t,q0,q2\n0,1,2\n", r"\['q1'\] are missing"),
        ("t,q0,q1,v1\n0,1,2,3\n", r"columns \['v1'\], but \['v0'\] are missing"),
        ("t,q0,v0,v1\n0,1,2,3\n", "only 1 coordinates have a rate"),
        ("t,q0,u1\n0,1,2\n", r"\['u0'\] are missing"),
        ("t,q00\n0,1\n", "no column q0"),
        ("t,q0\n0,1\n0.1,two\n", "line 3: column 'q0' holds 'two'"),
        ("# c\nt,q0\n0,1\n\n0.1,1,5\n", "line 5: 3 cells under 2 names"),
        ("t,q0\n0,1\n0.1,2\n0.1,3\n", r"line 4: t stands still at 0.1 s \(1 such rows\)"),
        ("t,q0\n0,1\n\n0.2,2\n0.1,3\n", "line 5: t runs back from 0.2 s to 0.1 s"),
        ("t,q0\n0,nan\n0.1,\n", "no row has a number in every column .*q0"),
        ("t,q0,segment\n0,1,0\n0.1,2,0.5\n", "line 3: segment is 0.5"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ValueError, match=f"a.csv.*{message}"):
        read_trajectory_file(written(tmp_path, text))


def test_files_that_are_no_table(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no such file"):
        read_trajectory_file(tmp_path / "none.csv")
    with pytest.raises(ValueError, match=r"\.mp4 is no table"):
        read_trajectory_file(written(tmp_path, "", "a.mp4"))
    for name in ("a.npz", "a.parquet"):
        with pytest.raises(ValueError, match="damaged"):
            read_trajectory_file(written(tmp_path, "PAR1 or PK, and then nothing", name))
    (tmp_path / "b.csv").write_bytes("t,q0\n0,\xe9\n".encode("latin-1"))
    with pytest.raises(ValueError, match="not a text in UTF-8"):
        read_trajectory_file(tmp_path / "b.csv")
    np.savez(tmp_path / "o.npz", t=np.arange(2.0), q0=np.array([1, "x"], dtype=object))
    with pytest.raises(ValueError, match="Python objects"):
        read_trajectory_file(tmp_path / "o.npz")
    np.savez(tmp_path / "l.npz", t=np.arange(2.0), q0=np.arange(3.0))
    with pytest.raises(ValueError, match="different lengths"):
        read_trajectory_file(tmp_path / "l.npz")


def test_rows_without_numbers_are_left_out_and_tear_only_when_long(tmp_path: Path) -> None:
    lines = steps(30).splitlines()
    lines[6] = "0.5,nan"  # one row: two steps pass
    lines[16] = lines[17] = lines[18] = "1.5,"  # three rows, whose times do not matter
    with pytest.warns(
        UserWarning, match=r"4 of 30 rows lack a number \(the first at a.csv, line 7\).*t = 1.8"
    ):
        motion = read_trajectory_file(written(tmp_path, "\n".join(lines)))
    np.testing.assert_array_equal(motion.q[:, 0], [k for k in range(30) if k not in (5, 15, 16, 17)])
    assert motion.segments == ((0, 14), (14, 26))


def test_segments_cut_and_each_may_have_its_own_clock(tmp_path: Path) -> None:
    path = written(tmp_path, "t,q0,segment\n0,1,1\n0.1,2,1\n0,5,2\n0.1,6,2\n0.2,7,2\n9,8,1\n")
    with pytest.warns(UserWarning, match=r"1 clip\(s\) begin their own clock"):
        motion = read_trajectory_file(path)
    assert motion.segments == ((0, 2), (2, 5), (5, 6))
    np.testing.assert_allclose(motion.time_s, [0, 0.1, 0.2, 0.3, 0.4, 9.2])


def test_an_unevenly_timed_motion_is_read_as_it_is(tmp_path: Path) -> None:
    motion = read_trajectory_file(written(tmp_path, "t,q0\n-1.5,1\n0,2\n0.001,3\n7,4\n"))
    np.testing.assert_array_equal(motion.time_s, [-1.5, 0, 0.001, 7])
    assert motion.segments == ((0, 4),)


@given(
    st.integers(1, 40).flatmap(
        lambda n: st.tuples(st.just(n), st.sets(st.integers(0, n - 1)), st.sets(st.integers(0, n - 1)))
    )
)
def test_cuts_keep_every_sample_and_never_mind_the_order(case: tuple[int, set[int], set[int]]) -> None:
    n, one, other = case
    motion = Trajectory(time_s=np.arange(n) + 1.0, q=np.arange(2 * n).reshape(n, 2), u=np.zeros((n, 0)))
    both = motion.cut(sorted(one | other))
    assert both.segments == both.cut([]).segments
    assert both.segments == motion.cut(sorted(one)).cut(sorted(other)).segments
    assert [start for start, _ in both.segments] == sorted({0} | one | other)
    np.testing.assert_array_equal(np.concatenate([clip.q for clip in both.clips()]), motion.q)
    assert sum(clip.duration_s for clip in both.clips()) == pytest.approx(both.duration_s)
    some = both.pieces(both.segments[1:]) if len(both.segments) > 1 else both
    np.testing.assert_array_equal(some.time_s, motion.time_s[-some.n :])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"time_s": np.zeros((1, 1))}, "time_s of shape"),
        ({"time_s": np.array([0.0, 1.0, 1.0])}, "goes from 1 s to 1 s at sample 2"),
        ({"q": np.zeros((3, 0))}, "q of shape"),
        ({"q": np.arange(3.0)}, "q of shape"),
        ({"u": np.zeros((2, 1))}, "u of shape"),
        ({"v": np.zeros((3, 2))}, "v of shape .* rates of q"),
        ({"q": np.array([[0.0], [np.nan], [0.0]])}, "q is nan at sample 1"),
        ({"segments": ((0, 1), (2, 3))}, "clips must follow one another"),
        ({"segments": ((0, 3), (3, 3))}, "clips must follow one another"),
        ({"q_names": ("a", "b")}, "q_names"),
    ],
)
def test_a_motion_checks_its_fields(changes: dict, message: str) -> None:
    fields = {"time_s": np.arange(3.0), "q": np.zeros((3, 1)), "u": np.zeros((3, 0)), "source": "bag"}
    assert Trajectory(**fields).dt_s == 1.0
    with pytest.raises(ValueError, match=f"bag: .*{message}"):
        Trajectory(**(fields | changes))


def test_a_spacing_needs_two_samples_and_a_cut_an_index_inside() -> None:
    motion = Trajectory(time_s=np.arange(3.0), q=np.zeros((3, 1)), u=np.zeros((3, 0)))
    with pytest.raises(ValueError, match="no two samples stand in one clip"):
        _ = motion.cut([1, 2]).dt_s
    with pytest.raises(ValueError, match="cut at"):
        motion.cut([3])
    with pytest.raises(ValueError, match="of no range"):
        motion.pieces([])


def test_a_text_of_another_encoding_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(b"t\0,\0q\x000\0\n\0")
    with pytest.raises(ValueError, match="NUL bytes"):
        read_trajectory_file(path)
