"""`elf-export --elf FILE --end-to-end`: what follows the network put into an ELF model that is there."""

from __future__ import annotations

import argparse
import shlex
from dataclasses import replace

import onnx

from elf_export.calibration import calibration_set
from elf_export.detection import chosen
from elf_export.errors import ExportError
from elf_export.file import check_output, write
from elf_export.pipeline import ExportResult, with_post_processing
from elf_export.request import Log
from elf_runtime import ElfRuntime
from elf_runtime.model.bundled import BUNDLED, bundled_model
from elf_runtime.params import setting_text

from .asked import form_of

DEFAULT_OUTPUT = "elf-alone.onnx"


def finished(args: argparse.Namespace, log: Log) -> ExportResult:
    """Write the file that the options ask for, with the model's own settings and those of --set; needs no PyTorch.

    Raises
    ------
    ElfError
        If the file is no ELF model, or can't have it in its graph.
    """
    output, form = check_output(args.output or DEFAULT_OUTPUT, args.force), form_of(args)
    path = bundled_model(args.elf) if args.elf in BUNDLED else args.elf
    contract = ElfRuntime(path).contract
    if contract.end_to_end is not None:
        raise ExportError(f"{path} gives keypoints itself already")
    try:
        model = onnx.load(path)
    except Exception as error:  # protobuf's; a model in ORT format
        raise ExportError(f"{path}: not an .onnx file") from error
    settings = [word for name, value in args.set for word in ("--set", f"{name}={setting_text(value)}")]
    command = f"{contract.command} {shlex.join([*form.words(), *settings])}" if form else contract.command
    contract = replace(contract, detection=chosen(contract.detection, dict(args.set)), command=command)
    model, contract, checks = with_post_processing(model, contract, form, calibration_set(), log)
    write(model, contract, output)
    return ExportResult(output, contract, checks)
