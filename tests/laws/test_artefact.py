"""What goes into an artefact comes out of it, whatever it is."""

import math
import tempfile
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from lagsplat.io.files.artifact import DTYPES, load_artifact, save_artifact

SCALARS = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20)
PLAIN = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=12,
)
ARRAYS = st.sampled_from(list(DTYPES.values())).flatmap(
    lambda dtype: hnp.arrays(dtype, hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4))
)
NAMES = st.text(st.characters(codec="utf-8"), min_size=1, max_size=12).filter(
    lambda name: name != "__metadata__"
)


def same(a: object, b: object) -> bool:
    """Equality that holds for NaN, and that tells 1 from 1.0 and True."""
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, float) and isinstance(b, float) and math.isnan(a):
        return math.isnan(b)
    return type(a) is type(b) and a == b


@settings(max_examples=60, deadline=None)
@given(
    header=st.dictionaries(st.text(max_size=8), PLAIN, max_size=4),
    tensors=st.dictionaries(NAMES, ARRAYS, max_size=4),
    mapped=st.booleans(),
)
def test_round_trip_is_identity(header: dict, tensors: dict, mapped: bool) -> None:
    header = {**header, "kind": "law", "schema": 1, "stamp": {}}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "artefact.safetensors"
        save_artifact(path, tensors, header)
        loaded, found = load_artifact(path, kind="law", schema=1, mapped=tuple(tensors) if mapped else ())
        assert same(found, header)
        assert loaded.keys() == tensors.keys()
        for name, array in tensors.items():
            assert loaded[name].dtype == array.dtype
            assert loaded[name].shape == array.shape
            assert loaded[name].tobytes() == array.tobytes()  # NaN payloads and the sign of zero, too
        assert [file.name for file in Path(folder).iterdir()] == ["artefact.safetensors"]


@settings(max_examples=40, deadline=None)
@given(array=ARRAYS.filter(lambda array: array.ndim >= 2), big_endian=st.booleans())
def test_layout_in_memory_does_not_matter(array: np.ndarray, big_endian: bool) -> None:
    scattered = np.asfortranarray(array)
    if big_endian:
        scattered = scattered.astype(array.dtype.newbyteorder(">"))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "artefact.safetensors"
        save_artifact(path, {"x": scattered}, {"kind": "law", "schema": 1, "stamp": {}})
        loaded, _ = load_artifact(path)
        np.testing.assert_array_equal(loaded["x"], array)
        assert loaded["x"].dtype == array.dtype
