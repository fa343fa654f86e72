"""From one fixed-camera video to a simulation that can be pushed, and why it differs from the real mechanism.

The names below are loaded when they are first used, so that ``import lagsplat`` takes milliseconds. They are
the public ones; everything else is in the rooms of the package.
"""

from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lagsplat.chart.chart import Chart as Chart
    from lagsplat.config.compose import compose as compose
    from lagsplat.diagnose.effects.registry import list_effects as effects
    from lagsplat.forces.operating_point import OperatingPoint as OperatingPoint
    from lagsplat.io.read import read_trajectory as read_trajectory
    from lagsplat.io.recording.recording import Recording as Recording
    from lagsplat.io.trajectory.trajectory import Trajectory as Trajectory
    from lagsplat.pipelines.apply_diagnosis import apply_diagnosis as apply_diagnosis
    from lagsplat.pipelines.diagnose_data import DiagnosisReport as Diagnosis
    from lagsplat.pipelines.diagnose_data import diagnose as diagnose
    from lagsplat.pipelines.diagnose_data import load_diagnosis as load_diagnosis
    from lagsplat.pipelines.steps import evaluate as evaluate
    from lagsplat.pipelines.steps import find_lever as find_lever
    from lagsplat.pipelines.steps import fit_autoencoder as fit_autoencoder
    from lagsplat.pipelines.steps import fit_chart as fit_chart
    from lagsplat.pipelines.steps import fit_dynamics as fit_dynamics
    from lagsplat.pipelines.steps import hold as hold
    from lagsplat.pipelines.steps import push as push
    from lagsplat.pipelines.steps import read_recording as read_recording
    from lagsplat.pipelines.steps import simulate_recording as simulate_recording
    from lagsplat.pipelines.view import export_page as export_page
    from lagsplat.pipelines.view import view as view
    from lagsplat.runs.fit import fit_run as fit_run
    from lagsplat.runs.run import FittedRun as FittedRun
    from lagsplat.runs.run import open_run as open_run
    from lagsplat.runs.run import rollout as rollout
    from lagsplat.splat.gaussians import Gaussians as Gaussians
    from lagsplat.splat.image_model import rasterize as rasterize
    from lagsplat.stage1.autoencoder import Autoencoder as Autoencoder
    from lagsplat.stage2.lagrangian import Lagrangian as Lagrangian

__version__ = "0.1.0"

_HOMES = {
    "Autoencoder": "lagsplat.stage1.autoencoder",
    "Chart": "lagsplat.chart.chart",
    "Diagnosis": "lagsplat.pipelines.diagnose_data:DiagnosisReport",
    "FittedRun": "lagsplat.runs.run",
    "Gaussians": "lagsplat.splat.gaussians",
    "Lagrangian": "lagsplat.stage2.lagrangian",
    "OperatingPoint": "lagsplat.forces.operating_point",
    "Recording": "lagsplat.io.recording.recording",
    "Trajectory": "lagsplat.io.trajectory.trajectory",
    "apply_diagnosis": "lagsplat.pipelines.apply_diagnosis",
    "compose": "lagsplat.config.compose",
    "diagnose": "lagsplat.pipelines.diagnose_data",
    "effects": "lagsplat.diagnose.effects.registry:list_effects",
    "evaluate": "lagsplat.pipelines.steps",
    "export_page": "lagsplat.pipelines.view",
    "find_lever": "lagsplat.pipelines.steps",
    "fit_autoencoder": "lagsplat.pipelines.steps",
    "fit_chart": "lagsplat.pipelines.steps",
    "fit_dynamics": "lagsplat.pipelines.steps",
    "fit_run": "lagsplat.runs.fit",
    "hold": "lagsplat.pipelines.steps",
    "load_diagnosis": "lagsplat.pipelines.diagnose_data",
    "open_run": "lagsplat.runs.run",
    "push": "lagsplat.pipelines.steps",
    "rasterize": "lagsplat.splat.image_model",
    "read_recording": "lagsplat.pipelines.steps",
    "read_trajectory": "lagsplat.io.read",
    "rollout": "lagsplat.runs.run",
    "simulate_recording": "lagsplat.pipelines.steps",
    "view": "lagsplat.pipelines.view",
}
"""Where each public name is defined: its module, and its name there where that differs."""

__all__ = [
    "Autoencoder",
    "Chart",
    "Diagnosis",
    "FittedRun",
    "Gaussians",
    "Lagrangian",
    "OperatingPoint",
    "Recording",
    "Trajectory",
    "apply_diagnosis",
    "compose",
    "diagnose",
    "effects",
    "evaluate",
    "export_page",
    "find_lever",
    "fit_autoencoder",
    "fit_chart",
    "fit_dynamics",
    "fit_run",
    "hold",
    "load_diagnosis",
    "open_run",
    "push",
    "rasterize",
    "read_recording",
    "read_trajectory",
    "rollout",
    "simulate_recording",
    "view",
]


def _load(name: str) -> Any:
    module, _, inner = _HOMES[name].partition(":")
    return getattr(import_module(module), inner or name)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'lagsplat' has no attribute {name!r}")
    # Kept, so that the next use does not come here.
    globals()[name] = value = _load(name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})


class _CallablePackage(ModuleType):
    """A sub-package that is also the public function of its name.

    `diagnose` and `evaluate` name a folder of the package and a function. Whatever is imported first, Python
    binds ``lagsplat.diagnose`` to the folder's module as soon as anything below it is loaded, so the name
    must mean both: the module stays a module, and calling it calls the function. Setting the class of a
    module is what Python documents for this (Data model, "Customizing module attribute access").
    """

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        return self.__wrapped__(*arguments, **options)

    @property
    def __wrapped__(self) -> Any:
        # `inspect.signature` and notebooks ask here for the arguments and the documentation.
        return _load(self.__name__.rpartition(".")[2])


for _name in ("diagnose", "evaluate"):
    import_module(f"lagsplat.{_name}").__class__ = _CallablePackage
