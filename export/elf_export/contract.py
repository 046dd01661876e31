"""What the contract of an export says: its parts, as far as they are figures of the finished graph."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence

import onnx
import onnxruntime as ort

import elf_runtime
from elf_runtime import DescriptorSpec, InputSpec
from elf_runtime.contract import ReductionSpec

from .graph.cost import PROBE, fix_sizes, macs, parameters
from .graph.graph import GraphView
from .graph.passes import cut
from .graph.receptive_field import Field
from .graph.sizes import Sizes
from .saliency import SALIENCY, descriptor_output


def input_spec(color: str, sizes: Sizes) -> InputSpec:
    """The image input, of colour order `color`."""
    return InputSpec(
        color=color,
        channels=1 if color == "gray" else 3,
        min_size=sizes.min_size,
        height=sizes.height,
        width=sizes.width,
        batch=sizes.batch,
        multiple=sizes.multiple,
    )


def descriptor_specs(
    model: onnx.ModelProto,
    layers: Sequence[str],
    fields: Mapping[str, Field],
    scales: Mapping[str, float],
    reductions: Mapping[str, ReductionSpec] | None = None,
) -> tuple[DescriptorSpec, ...]:
    """Output, dimension, geometry, scale and reduction, if any, of each descriptor layer."""
    dims = {value.name: value.type.tensor_type.shape.dim[-1].dim_value for value in model.graph.output}
    return tuple(
        DescriptorSpec(
            descriptor_output(name),
            name,
            dims[descriptor_output(name)],
            fields[name].stride,
            fields[name].offset,
            (reductions or {}).get(name),
            scales[name],
        )
        for name in layers
    )


def cost_of(model: onnx.ModelProto, descriptors: Sequence[str], size: int = PROBE) -> dict[str, float]:
    """Parameters, and multiply-adds per pixel of the saliency alone and of all outputs together, at `size` pixels."""
    outputs = [SALIENCY, *(descriptor_output(name) for name in descriptors)]
    return {
        "params": parameters(model),
        "saliency_macs_per_pixel": macs_per_pixel(model, [SALIENCY], size),
        "descriptors_macs_per_pixel": macs_per_pixel(model, outputs, size),
    }


def macs_per_pixel(model: onnx.ModelProto, outputs: Sequence[str], size: int = PROBE) -> float:
    """Multiply-adds per image pixel that `outputs` need: Conv, ConvTranspose, Gemm and MatMul.

    Counted on one image of 512x512 pixels, or of the size that the model's (N, H, W, C) input fixes.
    """
    needed = cut(model, outputs)
    height, width = fix_sizes(needed, needed.graph.input[0].name, "NHWC", size)
    return sum(macs(GraphView(needed))) / (height * width)


def versions(opset: int) -> dict[str, str]:
    """What made a file."""
    found = {
        "elf-onnx": elf_runtime.__version__,
        "opset": str(opset),
        "onnx": onnx.__version__,
        "onnxruntime": ort.__version__,
        "python": platform.python_version(),
    }
    try:
        import torch
    except ImportError:
        return found
    return found | {"torch": torch.__version__}
