"""Puts the pipeline into a wheel, where `lagsplat init` finds it; all else is in pyproject.toml."""

import runpy
import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

ROOT = Path(__file__).resolve().parent


class BuildWithPipeline(build_py):
    """Copies the folders of the pipeline, which a checkout has beside the package, into the package."""

    def run(self) -> None:
        """Build the package; an editable one finds the folders of the checkout."""
        super().run()
        if self.editable_mode:
            return
        project = runpy.run_path(str(ROOT / "lagsplat" / "project.py"))
        target = Path(self.build_lib) / "lagsplat" / project["INSTALLED"]
        shutil.rmtree(target, ignore_errors=True)
        target.mkdir(parents=True)
        for name in project["PARTS"]:
            if (ROOT / name).is_dir():
                compiled = shutil.ignore_patterns("__pycache__", "*.py[cod]")
                shutil.copytree(ROOT / name, target / name, ignore=compiled)
            else:
                shutil.copyfile(ROOT / name, target / name)


setup(cmdclass={"build_py": BuildWithPipeline})
