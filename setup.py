"""What pyproject.toml cannot say: the firmware, which lies beside the host, goes into the package."""

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py


class BuildWithFirmware(build_py):
    """An editable install finds the firmware in its checkout, an installed one in hubodo/firmware."""

    def run(self) -> None:
        super().run()
        if not self.editable_mode:
            inside = Path(self.build_lib) / "hubodo" / "firmware"
            shutil.rmtree(inside, ignore_errors=True)
            shutil.copytree("firmware", inside, ignore=shutil.ignore_patterns("__pycache__"))


setup(cmdclass={"build_py": BuildWithFirmware})
