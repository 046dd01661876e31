"""The lean wheel: what a robot runs, out of the whole wheel that `python -m build` made.

    python tools/lean_wheel.py dist/elf_onnx-0.1.0-py3-none-any.whl -o out/lean

It holds `elf_runtime` with the int8 model (with --fp32 both), and asks for the same libraries.  It leaves out the
exporter, the evaluation, their commands and their extras.  It is the same distribution, elf-onnx, of the version
0.1.0+lean: so either wheel replaces the other, and no file belongs to two.
"""

from __future__ import annotations

import argparse
import base64
import hashlib
import re
import zipfile
from pathlib import Path

PACKAGES = ("elf_export", "elf_eval")
EXTRAS = ("dev", "docs", "eval", "export")
FP32 = "elf_runtime/models/elf-vgg.onnx"


def main() -> None:
    parser = argparse.ArgumentParser(description="Make the lean wheel out of the whole one.")
    parser.add_argument("wheel", type=Path, help="the whole wheel")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/lean"), help="folder; default: %(default)s")
    parser.add_argument("--fp32", action="store_true", help="keep the fp32 model, the default of other providers")
    args = parser.parse_args()
    print(lean_wheel(args.wheel, args.output, args.fp32))


def lean_wheel(wheel: Path, folder: Path, fp32: bool = False) -> Path:
    """Write the lean wheel into `folder`, and return its path."""
    with zipfile.ZipFile(wheel) as opened:
        files = {name: opened.read(name) for name in opened.namelist() if not name.endswith("/")}
    parts = re.fullmatch(r"(\w+)-([\w.]+)-(.+)\.whl", wheel.name)
    if parts is None:
        raise SystemExit(f"{wheel}: not named as the whole wheel is")
    name, version, tags = parts.groups()
    whole, info = f"{name}-{version}.dist-info", f"{name}-{version}+lean.dist-info"
    kept = {}
    for path, data in files.items():
        top = path.split("/")[0]
        if top not in PACKAGES and path != f"{whole}/RECORD" and (fp32 or path != FP32):
            kept[path.replace(whole, info, 1)] = data
    kept[f"{info}/METADATA"] = metadata(kept[f"{info}/METADATA"].decode(), version).encode()
    kept[f"{info}/entry_points.txt"] = entry_points(kept[f"{info}/entry_points.txt"].decode()).encode()
    folder.mkdir(parents=True, exist_ok=True)
    made = folder / f"{name}-{version}+lean-{tags}.whl"
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as opened:
        for path, data in [*kept.items(), (f"{info}/RECORD", record(kept, info))]:
            opened.writestr(zipfile.ZipInfo(path, (2020, 2, 2, 0, 0, 0)), data, zipfile.ZIP_DEFLATED)
    return made


def metadata(text: str, version: str) -> str:
    """Another version, without the extras of what is left out; the description behind the headers stays."""
    headers, blank, description = text.partition("\n\n")
    extras = "|".join(EXTRAS)
    left_out = re.compile(rf"Provides-Extra: ({extras})|Requires-Dist: .*extra == ['\"]({extras})['\"]")
    lines = [line for line in headers.splitlines() if not left_out.fullmatch(line)]
    lines[lines.index(f"Version: {version}")] += "+lean"
    return "\n".join(lines) + blank + description


def entry_points(text: str) -> str:
    """Those of the packages that are kept."""
    return "".join(line for line in text.splitlines(True) if not re.search(rf"= ({'|'.join(PACKAGES)})\.", line))


def record(files: dict[str, bytes], info: str) -> bytes:
    """The list of all files with their SHA-256 and size, by the specification of binary distributions."""
    lines = []
    for path, data in files.items():
        digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
        lines.append(f"{path},sha256={digest},{len(data)}\n")
    return "".join([*lines, f"{info}/RECORD,,\n"]).encode()


if __name__ == "__main__":
    main()
