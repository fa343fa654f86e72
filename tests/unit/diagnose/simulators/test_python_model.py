"""Sims that are Python: what is accepted, and what is refused with which words."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from lagsplat.diagnose.estimation.dataset import OperatingRegion
from lagsplat.diagnose.simulators.python_model import load_python, project_python

RNG = np.random.default_rng(0)


def region(d: int = 1, n_u: int = 1) -> OperatingRegion:
    return OperatingRegion(*(RNG.uniform(-1.0, 1.0, (400, k)) for k in (d, d, n_u)))


def pendulum(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    return -30.0 * np.sin(q) - 0.2 * v + 2.0 * u


@pytest.mark.parametrize(
    "sim",
    [
        pendulum,
        lambda q, v, u: -30.0 * np.sin(q[0]) - 0.2 * v[0] + 2.0 * u[0],
        lambda q, v, u: -30.0 * torch.sin(q) - 0.2 * v + 2.0 * u,
        lambda q, v, u: [-30.0 * float(np.sin(q[0])) - 0.2 * float(v[0]) + 2.0 * float(u[0])],
    ],
    ids=["many points", "one point", "torch", "list"],
)
def test_an_acceleration_of_any_kind_is_sampled(sim: object) -> None:
    where = region()
    model = project_python(sim, where, what="sim").model
    np.testing.assert_allclose(
        model.acceleration(where.q, where.v, where.u), pendulum(where.q, where.v, where.u), atol=0.01
    )


def test_an_object_is_sampled_and_agrees_with_its_acceleration() -> None:
    where = region(2, 1)
    mass = np.array([[2.0, 0.3], [0.3, 1.0]])
    fields = {
        "mass": mass,
        "potential": lambda q: 20.0 * q[..., 0] ** 2 + 15.0 * q[..., 1] ** 4,
        "damping": lambda q: np.diag([0.1, 0.2]),
        "input_map": np.array([[1.0, -0.5]]),
    }
    whole = SimpleNamespace(**fields, friction=lambda q, v: 0.5 * np.abs(v) * v)
    model = project_python(whole, where, what="sim").model
    slope = np.stack([40.0 * where.q[:, 0], 60.0 * where.q[:, 1] ** 3], axis=1)
    force = where.u @ fields["input_map"] - slope
    force -= where.v * [0.1, 0.2] + 0.5 * np.abs(where.v) * where.v
    np.testing.assert_allclose(
        model.acceleration(where.q, where.v, where.u), force @ np.linalg.inv(mass).T, atol=1e-4
    )
    np.testing.assert_allclose(model.inertia / model.inertia[1, 1], mass, atol=1e-9)


def test_a_file_a_factory_and_a_class_are_loaded(tmp_path: Path) -> None:
    path = tmp_path / "sims.py"
    path.write_text(
        "class Free:\n    mass = [[2.0]]\n    def potential(self, q): return 0.0 * q[..., 0]\n"
        "def build(): return Free()\ndef rates(q, v): return -q\n"
    )
    assert load_python(f"{path}:build").mass == [[2.0]]
    assert load_python(f"{path}:Free").mass == [[2.0]]
    where = region(1, 0)
    model = project_python(load_python(f"{path}:rates"), where, what="sim").model
    np.testing.assert_allclose(model.acceleration(where.q, where.v, where.u), -where.q, atol=1e-6)
    assert load_python("math:pi") == pytest.approx(np.pi)


@pytest.mark.parametrize(
    ("name", "reason"),
    [("no_such_module:x", "No module named"), ("math:py", "has no 'py'")],
)
def test_a_name_that_is_not_there_is_told(name: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        load_python(name)


def test_a_file_that_is_missing_or_fails_is_told(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"gone\.py"):
        load_python(f"{tmp_path / 'gone.py'}:x")
    (tmp_path / "bad.py").write_text("1 / 0\n")
    with pytest.raises(ValueError, match="ZeroDivisionError"):
        load_python(f"{tmp_path / 'bad.py'}:x")


def spring(**changes: object) -> SimpleNamespace:
    usual = {"mass": [[1.0]], "potential": lambda q: 5.0 * q[..., 0] ** 2, "input_map": [[1.0]]}
    return SimpleNamespace(**(usual | changes))


@pytest.mark.parametrize(
    ("sim", "reason"),
    [
        (3.0, "a float is no sim"),
        (lambda q: -q, "takes 1 arguments"),
        (lambda q, v, u: np.zeros(3), r"has shape \(3,\) at one point"),
        (lambda q, v, u: q["x"], "fails at"),
        (lambda q, v, u: np.log(q - 2.0), "not finite"),
        (spring(mass=[[-1.0]]), "not positive"),
        (SimpleNamespace(mass=[[1.0]]), "no potential"),
        (spring(potential_gradient=lambda q: -10.0 * q), "is not the gradient"),
        (spring(mass=np.eye(2)), r"mass has shape \(2, 2\)"),
    ],
)
@pytest.mark.filterwarnings("ignore:invalid value encountered in log")
def test_what_is_no_sim_is_refused(sim: object, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        project_python(sim, region(1, 1), what="sim")


def test_a_mass_that_is_not_symmetric_is_refused() -> None:
    sim = SimpleNamespace(mass=[[1.0, 0.5], [0.0, 1.0]], potential=lambda q: (q**2).sum(-1))
    with pytest.raises(ValueError, match="not symmetric"):
        project_python(sim, region(2, 0), what="sim")


@pytest.mark.parametrize("n", [1, 2])
def test_what_a_sim_without_friction_loses_by_rounding_is_no_energy_that_is_fed(n: int) -> None:
    sampled = project_python(lambda q, v, u: -39.5 * q, region(n, 0), what="sim")  # a warning is an error
    assert sampled.error < 1e-6


def test_energy_that_comes_from_nowhere_and_inputs_that_are_ignored_are_told() -> None:
    with pytest.warns(UserWarning, match="feeds energy"):
        project_python(lambda q, v, u: -10.0 * q + 0.5 * v + u, region(), what="sim")
    free = SimpleNamespace(mass=[[1.0]], potential=lambda q: q[..., 0] ** 2)
    with pytest.warns(UserWarning, match="not driven"):
        project_python(free, region(), what="sim")


@pytest.mark.parametrize(
    "program", ["import sys\nsys.exit(0)\n", "import sys\ndef build():\n    sys.exit(0)\n"]
)
def test_a_program_that_ends_itself_does_not_end_the_diagnosis(tmp_path: Path, program: str) -> None:
    path = tmp_path / "ends.py"
    path.write_text(program)
    with pytest.raises(ValueError, match=r"fails with SystemExit"):
        load_python(f"{path}:build")
