"""Parsers of files that users have: what was written comes back, and any other content is read or refused."""

import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from lagsplat.io.files.artifact import load_artifact
from lagsplat.io.files.ply import PlyCloud, read_cloud, read_sharp, write_cloud
from lagsplat.io.files.sysid_yaml import SysidParameter, read_sysid_parameters, write_sysid_parameters
from lagsplat.io.mujoco.model import load_mujoco
from lagsplat.io.sources import find_sources, read_sources
from lagsplat.io.trajectory.tables import read_table

NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
NAMES = st.text("abcdefgh_0123456789", min_size=1, max_size=6).map("x".__add__)
TABLES = st.lists(NAMES, min_size=1, max_size=4, unique=True).flatmap(
    lambda names: st.integers(1, 8).flatmap(
        lambda rows: st.fixed_dictionaries(
            {name: hnp.arrays(float, rows, elements=NUMBERS) for name in names}
        )
    )
)
# What tables, models and settings are made of, in any order, beside any text.
WORDS = st.sampled_from(
    (
        *(
            "t",
            "q0",
            "v0",
            "u0",
            "segment",
            ",",
            ";",
            "\t",
            "\n",
            "\r",
            "1",
            "-2.5e3",
            "nan",
            "1e999",
            '"',
            "#",
        ),
        *(
            "<mujoco>",
            "</mujoco>",
            "<worldbody>",
            "<body>",
            '<joint name="q0"/>',
            "- ",
            "{",
            "}",
            "[",
            "]",
            "\0",
        ),
        *("ply\n", "format binary_little_endian 1.0\n", "element vertex 2\n", "property float x\n"),
        *("end_header\n", "nominal", "value", "bounds", ":", "!!python/object:os.system", "&a", "*a"),
        *("\ufeff", "\u0663", "\U0001d7d9"),
    )
)
CONTENTS = st.lists(WORDS | st.text(max_size=6), max_size=40).map("".join).map(str.encode) | st.binary(
    max_size=300
)


def read(path: Path) -> object:
    return read_sources(find_sources(str(path)))


READERS: dict[str, Callable[[Path], object]] = {
    "log.csv": read,
    "log.parquet": read,
    "log.npz": read,
    "log.mat": read,
    "log.h5": read,
    "log.mcap": read,
    "arm.xml": load_mujoco,
    "arm.urdf": load_mujoco,
    "parameters.yaml": read_sysid_parameters,
    "cloud.ply": read_cloud,
    "sharp.ply": read_sharp,
    "law.safetensors": lambda path: load_artifact(path, kind="law", schema=1),
}


@pytest.mark.parametrize("name", READERS)
@settings(max_examples=60, deadline=None)
@given(content=CONTENTS)
def test_any_content_is_read_or_refused_by_name(name: str, content: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path = Path(folder) / name
        path.write_bytes(content)
        told = name
        try:
            READERS[name](path)
        except (ValueError, OSError) as error:
            told = str(error)
        assert name in told
        assert [file.name for file in Path(folder).iterdir()] == [name]


@settings(max_examples=40, deadline=None)
@given(table=TABLES, separator=st.sampled_from(",;\t"), ending=st.sampled_from(["\n", "\r\n"]))
def test_a_text_gives_the_numbers_that_were_written(
    table: dict[str, np.ndarray], separator: str, ending: str
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        pd.DataFrame(table).to_csv(path, index=False, sep=separator, lineterminator=ending)
        found = read_table(path).columns
    assert list(found) == list(table)
    for name, column in table.items():
        np.testing.assert_array_equal(found[name].astype(float), column)


@settings(max_examples=40, deadline=None)
@given(table=TABLES, kind=st.sampled_from(["parquet", "npz"]))
def test_a_binary_table_gives_the_numbers_that_were_written(table: dict[str, np.ndarray], kind: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"log.{kind}"
        if kind == "parquet":
            pd.DataFrame(table).to_parquet(path)
        else:
            np.savez(path, **table)  # type: ignore[arg-type]
        found = read_table(path).columns
    for name, column in table.items():
        np.testing.assert_array_equal(found[name].astype(float), column)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 5), st.randoms(use_true_random=False))
def test_a_cloud_comes_back_in_single_precision(count: int, random: object) -> None:
    rng = np.random.default_rng(random.getrandbits(32))  # type: ignore[attr-defined]
    cloud = PlyCloud(
        rng.normal(size=(count, 3)),
        rng.uniform(0.01, 2.0, (count, 3)),
        rng.normal(size=(count, 4)),
        rng.uniform(-0.2, 1.2, (count, 3)),
        rng.uniform(0.01, 0.99, count),
    )
    with tempfile.TemporaryDirectory() as folder:
        write_cloud(Path(folder) / "cloud.ply", cloud)
        found = read_cloud(Path(folder) / "cloud.ply")
    for name in ("means", "scales", "colors", "opacities"):
        np.testing.assert_allclose(getattr(found, name), getattr(cloud, name), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(found.covariances(), cloud.covariances(), rtol=1e-4, atol=1e-6)


@settings(max_examples=40, deadline=None)
@given(
    st.dictionaries(
        NAMES,
        st.tuples(
            hnp.arrays(float, hnp.array_shapes(max_dims=1, max_side=3), elements=NUMBERS),
            st.booleans(),
        ),
        min_size=1,
        max_size=4,
    )
)
def test_parameters_of_mujoco_sysid_come_back(values: dict[str, tuple[np.ndarray, bool]]) -> None:
    written = [
        SysidParameter(name, value, value, value - 1.0, value + 1.0, frozen)
        for name, (value, frozen) in values.items()
    ]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "parameters.yaml"
        write_sysid_parameters(path, written)
        found = read_sysid_parameters(path)
    assert [(one.name, one.frozen) for one in found] == [(one.name, one.frozen) for one in written]
    for one, other in zip(found, written, strict=True):
        for part in ("nominal", "value", "low", "high"):
            np.testing.assert_array_equal(np.ravel(getattr(one, part)), np.ravel(getattr(other, part)))
