"""Data in memory become the tables that files hold."""

import numpy as np
import pandas as pd
import pytest

from lagsplat.pipelines.diagnose_data import diagnose, to_table

TIMES = np.arange(5) * 0.1
ANGLES = np.stack([np.sin(TIMES), np.cos(TIMES)], axis=1)


@pytest.mark.parametrize(
    "data",
    [
        np.column_stack([TIMES, ANGLES]),
        {"t": TIMES, "q": ANGLES},
        pd.DataFrame({"t": TIMES, "q0": ANGLES[:, 0], "q1": ANGLES[:, 1]}),
        np.rec.fromarrays([TIMES, *ANGLES.T], names="t,q0,q1"),
    ],
    ids=["array", "mapping", "frame", "structured"],
)
def test_every_form_gives_the_same_table(data: object) -> None:
    table = to_table(data)
    assert list(table.columns) == ["t", "q0", "q1"]
    np.testing.assert_array_equal(table.to_numpy(), np.column_stack([TIMES, ANGLES]))


@pytest.mark.parametrize("shape", [(5,), (5, 1), (5, 2, 2)])
def test_an_array_without_coordinates_is_refused_with_its_shape(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"shape \(5.*its first column time"):
        diagnose(np.zeros(shape), np.zeros((5, 2)))


def test_another_type_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match="int is no trajectory"):
        diagnose(3, np.zeros((5, 2)))  # type: ignore[arg-type]
