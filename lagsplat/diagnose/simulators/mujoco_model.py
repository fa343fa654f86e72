"""A simulator that is a MuJoCo model file or a URDF: mass, bias, passive and actuator forces of its joints.

An actuator with a state counts as one that has settled. Time is continuous: the error of MuJoCo's integrator
is not part of the simulator. Friction loss is dry friction. Contacts, limits and equalities other than those
by which joints follow the chosen ones are left out, with a warning.
"""

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

from lagsplat.diagnose.core.result import Finding
from lagsplat.diagnose.estimation.dataset import OperatingRegion
from lagsplat.diagnose.simulators.projection import FieldFunctions, ProjectedModel, project_fields
from lagsplat.io.mujoco.model import URDF, MujocoSelection
from lagsplat.io.mujoco.package import require_mujoco
from lagsplat.io.mujoco.urdf_spec import load_urdf

TRANSLATED = "URDF as MuJoCo reads it"  # name of the findings


def check_urdf(path: Path) -> tuple[Finding, ...]:
    """What MuJoCo loses of a URDF, and adds to it; nothing of other files.

    Raises:
        FileNotFoundError, ValueError: as `load_urdf`.
    """
    remarks = load_urdf(path)[1] if path.suffix.lower() == URDF else ()
    return tuple(Finding(x.level, TRANSLATED, path.name, x.what, x.why, x.remedy) for x in remarks)


def project_mujoco(path: Path, chosen: MujocoSelection, region: OperatingRegion) -> ProjectedModel:
    """The model of the joints and actuators chosen in a MuJoCo file, with a warning of what it leaves out.

    Raises:
        ValueError: another number of joints or actuators than the recording has columns, or as
            `project_fields`.
    """
    counted = (("joints", chosen.joints, region.d, "q"), ("actuators", chosen.actuators, region.n_u, "u"))
    for what, names, n, letter in counted:
        if len(names) != n:
            raise ValueError(
                f"{path}: {len(names)} {what} {list(names)}, but the recording has {n} column(s) {letter}; "
                f"name those that belong to them with diagnose.{what}=[...]"
            )
    warn_of_omissions(path, chosen, region)
    return project_fields(make_mujoco_fields(chosen), region, what=path.name)


def make_mujoco_fields(chosen: MujocoSelection) -> FieldFunctions:
    """Mass, forces and input map of the chosen joints as functions of many points."""
    mujoco = require_mujoco()
    model, data, rates = chosen.model, chosen.data, chosen.jacobian
    d, n_u = rates.shape[1], len(chosen.at_u)
    dry = np.abs(rates).T @ model.dof_frictionloss
    filters = (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT))
    limited = model.actuator_ctrllimited[chosen.at_u, None].astype(bool)
    low, high = np.where(limited, model.actuator_ctrlrange[chosen.at_u], [-1.0, 1.0]).T
    # by a command within its range, at most 1, the gain of each actuator is measured
    commands = np.diag(np.where(high > 0.0, np.minimum(high, 1.0), np.maximum(low, -1.0)))

    def actuation() -> np.ndarray:
        """Force of actuators that have settled at their command."""
        for i in range(model.nu):
            if model.actuator_actadr[i] >= 0 and model.actuator_dyntype[i] in filters:
                data.act[model.actuator_actadr[i]] = data.ctrl[i]
        mujoco.mj_fwdActuation(model, data)
        return rates.T @ data.qfrc_actuator

    def mass(q: np.ndarray) -> np.ndarray:
        chosen.set_state(q)
        return rates.T @ chosen.measure_mass() @ rates

    def potential_gradient(q: np.ndarray) -> np.ndarray:
        chosen.set_state(q)
        return rates.T @ (data.qfrc_bias - data.qfrc_passive) - actuation()

    def dissipation(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        chosen.set_state(q)
        still = rates.T @ data.qfrc_passive + actuation()
        chosen.set_state(q, v)
        return still - rates.T @ data.qfrc_passive - actuation() + dry * np.sign(v)

    def input_map(q: np.ndarray) -> np.ndarray:
        chosen.set_state(q)
        unloaded, forces = actuation(), np.empty((n_u, d))
        for c, u in enumerate(commands):
            chosen.set_state(q, u=u)
            forces[c] = (actuation() - unloaded) / u[c]
        return forces

    given = (mass, potential_gradient, input_map, dissipation)
    return FieldFunctions(*(_take_many(function) for function in given))


def _take_many(function: Callable[..., np.ndarray]) -> Callable[..., np.ndarray]:
    """The same function for many points, one row each."""
    return lambda *points: np.array([function(*point) for point in zip(*points, strict=True)])


def warn_of_omissions(path: Path, chosen: MujocoSelection, region: OperatingRegion) -> None:
    """Warn of what the model has beyond mass, forces and inputs."""
    model, mujoco, omitted = chosen.model, require_mujoco(), []
    for i, name, values in zip(model.dof_jntid[chosen.at_v], chosen.joints, region.q.T, strict=True):
        low, high = model.jnt_range[i]
        if model.jnt_limited[i] and not _is_within(values, low, high):
            omitted.append(
                f"the range {low:g} to {high:g} of joint {name!r}, beyond which the recording goes"
            )
    for i, name, values in zip(chosen.at_u, chosen.actuators, region.u.T, strict=True):
        low, high = model.actuator_ctrlrange[i]
        if model.actuator_ctrllimited[i] and not _is_within(values, low, high):
            omitted.append(f"the range {low:g} to {high:g} of actuator {name!r}")
        if model.actuator_dyntype[i] != int(mujoco.mjtDyn.mjDYN_NONE):
            omitted.append(f"the state of actuator {name!r}, which counts as settled")
        if model.actuator_delay[i] > 0.0:
            omitted.append(f"the delay of actuator {name!r}")
    left_out = model.neq - len(chosen.followers)
    if left_out:
        omitted.append(f"{left_out} equality constraint(s)")
    for point in region.q[:: max(1, len(region.q) // 50)]:  # 50 points, because contacts are slow to find
        chosen.set_positions(point)
        if chosen.data.ncon:
            omitted.append("contacts between bodies")
            break
    if omitted:
        warnings.warn(f"{path.name}: not in the sim as it is diagnosed: {'; '.join(omitted)}", stacklevel=3)


def _is_within(values: np.ndarray, low: float, high: float) -> bool:
    return bool(low <= values.min() and values.max() <= high)
