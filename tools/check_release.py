"""What `make release-check` asks of the wheel and the source archive in a folder.

    python tools/check_release.py dist

The wheel must hold all files of the three packages, such as the bundled models and the type markers, and state the
dependencies and commands of pyproject.toml.  The source archive must hold what a wheel is built from.  Both must be of
the version that `elf_runtime.__version__` states.  Then the wheel is installed into a fresh environment, away from the
checkout, where every command must say that version and `elf-detect` must find keypoints in the demo's photograph.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tarfile
import tempfile
import venv
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("export/elf_export", "runtime/elf_runtime", "evaluation/elf_eval")
BUILT_FROM = {"pyproject.toml", "README.md", "LICENSE", "tools/dependencies.py"}


def main(folder: Path) -> int:
    (version,) = stated(r'^__version__ = "(.+)"$', "runtime/elf_runtime/version.py")
    wheel, archive = folder / f"elf_onnx-{version}-py3-none-any.whl", folder / f"elf_onnx-{version}.tar.gz"
    faults = [f"{path} is missing" for path in (wheel, archive) if not path.is_file()]
    faults = faults or [*faults_of_wheel(wheel), *faults_of_archive(archive)]
    faults = faults or faults_once_installed(wheel, version)
    print("\n".join(faults) or f"{wheel.name} and {archive.name}: sound")
    return 1 if faults else 0


def stated(pattern: str, file: str = "pyproject.toml") -> list[str]:
    """What `pattern` finds in a file of the checkout."""
    return re.findall(pattern, (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE)


def package_files() -> set[str]:
    """Every file of the three packages, from the checkout's root on."""
    paths = [path for package in PACKAGES for path in (ROOT / package).rglob("*") if path.is_file()]
    return {path.relative_to(ROOT).as_posix() for path in paths if path.parent.name != "__pycache__"}


def faults_of_wheel(wheel: Path) -> list[str]:
    with zipfile.ZipFile(wheel) as opened:
        names = {name for name in opened.namelist() if not name.endswith("/")}
        (info,) = {name.split("/")[0] for name in names if ".dist-info/" in name}
        metadata = opened.read(f"{info}/METADATA").decode().splitlines()
        commands = opened.read(f"{info}/entry_points.txt").decode().splitlines()
    wanted = {name.split("/", 1)[1] for name in package_files()}
    content = {name for name in names if not name.startswith(f"{info}/")}
    faults = [f"lacks {name}" for name in sorted(wanted - content)]
    faults += [f"has {name}, which is no file of the packages" for name in sorted(content - wanted)]
    faults += [] if f"{info}/licenses/LICENSE" in names else ["lacks the licence"]
    for requirement in stated(r'^    "([\w.-]+>=[\w.]+)",$'):
        if f"Requires-Dist: {requirement}" not in metadata:
            faults.append(f"does not ask for {requirement}: `python -m build` makes one that does")
    for line in stated(r'^elf-\w+ = "[\w.:]+"$'):
        if line.replace('"', "") not in commands:
            faults.append(f"lacks the command {line}")
    return [f"{wheel.name} {fault}" for fault in faults]


def faults_of_archive(archive: Path) -> list[str]:
    with tarfile.open(archive) as opened:
        names = {name.split("/", 1)[-1] for name in opened.getnames()}
    return [f"{archive.name} lacks {name}" for name in sorted((BUILT_FROM | package_files()) - names)]


def faults_once_installed(wheel: Path, version: str) -> list[str]:
    with tempfile.TemporaryDirectory() as away:
        venv.create(Path(away, "env"), with_pip=True)
        programs = Path(away, "env", "Scripts" if os.name == "nt" else "bin")
        pip = (programs / "python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check")
        run(away, *pip, "--constraint", ROOT / "constraints.txt", wheel.resolve())
        commands = stated(r'^(elf-\w+) = "')
        said = {name: run(away, programs / name, "--version").strip() for name in commands}
        detected = run(away, programs / "elf-detect", ROOT / "demo" / "palace.jpg", "-o", "out").strip()
    faults = [f"{name} --version says {text!r}" for name, text in said.items() if text != f"{name} {version}"]
    if ": 500 keypoints" not in detected:
        faults.append(f"elf-detect does not find 500 keypoints in demo/palace.jpg: {detected}")
    return [f"{wheel.name}, installed: {fault}" for fault in faults]


def run(folder: str, *words: str | Path) -> str:
    """What a program prints that runs in `folder` and sees nothing of the checkout."""
    away = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run([*map(str, words)], cwd=folder, env=away, check=False, text=True, stdout=subprocess.PIPE)
    if done.returncode:
        raise SystemExit(f"{' '.join(map(str, words))}: exit status {done.returncode}")
    return done.stdout


if __name__ == "__main__":
    raise SystemExit(main(Path(sys.argv[1])))
