"""What an installation asks for: the builds of OpenCV and ONNX Runtime that are there, or else the usual ones.

Either library comes in several packages (opencv-python, opencv-contrib-python, ..., onnxruntime-gpu,
onnxruntime-openvino, ...) that write the same module.  pip does not know that: asked for another one it overwrites the
files of the first, and windows or an accelerator are gone.  So where a build is installed, that one is asked for, in
the same versions; where one is there that pip did not install, none.

pip builds a checkout by the interpreter that it installs for, so that its site-packages are found here.  Who builds in
an environment apart (`python -m build`, uv) finds none, and gets the list of pyproject.toml as it stands.
"""

from __future__ import annotations

import re
import site
import sys
from collections.abc import Iterable, Sequence
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

BUILDS = {"opencv-python-headless": ("opencv", "cv2"), "onnxruntime": ("onnxruntime", "onnxruntime")}


class Dependencies(MetadataHookInterface):
    """Fills in `dependencies` from the list in ``[tool.hatch.metadata.hooks.custom]``."""

    def update(self, metadata: dict[str, Any]) -> None:
        metadata["dependencies"] = suited(self.config["dependencies"], site_packages())


def suited(requirements: Iterable[str], folders: Sequence[str]) -> list[str]:
    """The requirements, in terms of what is installed in `folders`."""
    found = []
    for requirement in requirements:
        name, versions = re.fullmatch(r"([\w-]+)(.*)", requirement).groups()
        if name in BUILDS:
            prefix, module = BUILDS[name]
            installed = builds(prefix, module, folders)
            if not installed and has_module(module, folders):
                continue
            if installed and name not in installed:
                name = installed[0]
        found.append(name + versions)
    return found


def builds(prefix: str, module: str, folders: Sequence[str]) -> list[str]:
    """The installed packages, by name, that begin with `prefix` and hold `module`."""
    found = set()
    for package in distributions(path=list(folders)):
        name = re.sub(r"[-_.]+", "-", package.metadata["Name"] or "").lower()
        if name.startswith(prefix):
            tops = {file.parts[0].split(".")[0] for file in package.files or ()}
            if module in tops:
                found.add(name)
    return sorted(found)


def has_module(module: str, folders: Sequence[str]) -> bool:
    """Whether `module` can be imported: a folder that a removed package left behind can't."""
    return any(
        (Path(folder) / module / "__init__.py").is_file() or any(Path(folder).glob(f"{module}.*")) for folder in folders
    )


def site_packages() -> list[str]:
    """Of the interpreter, even where pip hides them from its `sys.path` for the build."""
    folders = site.getsitepackages()
    if sys.prefix == sys.base_prefix:
        folders.append(site.getusersitepackages())
    return folders
