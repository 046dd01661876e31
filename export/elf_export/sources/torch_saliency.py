"""The saliency of an exported model by torch's own autograd: the same network, weights and preprocessing.

`elf-bench` times it beside the exported graph.  It finds this module by name where the export half is
installed, and goes without where it is not.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import numpy_helper

from elf_export.errors import ExportError, WeightsError
from elf_export.preprocessing import LEAST_STD, Preprocessing
from elf_runtime import ModelContract

from .networks import get_network

Saliency = Callable[[npt.NDArray[np.uint8]], npt.NDArray[np.float32]]


def load(model: str | os.PathLike[str]) -> Saliency:
    """Rebuild a model's network in torch, from the weights inside the .onnx file.

    Parameters
    ----------
    model : path
        An ELF model of a named network, with its convolutions' weights stored as floats.

    Returns
    -------
    function
        (H, W, 3) uint8 in the colour order of the model's input -> (H, W) float32, the saliency that the
        graph computes; in float32, with the threads that ``torch.set_num_threads`` set.

    Raises
    ------
    ExportError
        If the network has no name here, or was compressed.
    WeightsError
        If the file does not hold its weights as floats.
    """
    import torch

    from elf_export.checks.averaging import Averaging

    file = os.fspath(model)
    proto = onnx.load(file)
    contract = ModelContract.from_metadata({p.key: p.value for p in proto.metadata_props}, file)
    if contract.compression is not None:
        raise ExportError(
            f"{file}: its convolutions are compressed ({contract.compression.wanted}); torch has the whole"
        )
    network = get_network(contract.network)
    stored = {tensor.name: tensor for tensor in proto.graph.initializer}
    tensors: dict[str, npt.NDArray[np.float32]] = {}
    for name, shape in network.tensor_shapes([contract.layer]).items():
        values = numpy_helper.to_array(stored[name]) if name in stored else None
        if values is None or values.dtype.kind != "f" or values.shape != shape:
            raise WeightsError(f"{file}: holds no float tensor {name!r} of shape {shape}, which torch needs")
        tensors[name] = values.astype(np.float32)
    choices = (network.preprocessing, network.trained_with)
    # A contract that says nothing of it means the network's default.
    stated = contract.preprocessing or network.preprocessing.describe()
    settings = next((s for s in choices if s is not None and s.describe() == stated), None)
    if settings is None or settings.color != contract.input.color or not network.gradient:
        raise ExportError(f"{file}: only a network in its own colours, preprocessed as named here, can be rebuilt")
    built = network.build(tensors, [contract.layer]).requires_grad_(False)
    module = Averaging(built) if contract.pooling else built

    def saliency(image: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
        pixels = torch.from_numpy(np.ascontiguousarray(image)).float().permute(2, 0, 1)[None]
        x = _preprocessed(pixels, settings).contiguous().requires_grad_(True)
        feature = module(x)[0]
        # d(1/2 |F|^2) / dI = F^T dF/dI
        (gradient,) = torch.autograd.grad(feature, x, grad_outputs=feature.detach())
        result: npt.NDArray[np.float32] = gradient.abs().mean(dim=1)[0].numpy()
        return result

    return saliency


def _preprocessed(pixels: Any, settings: Preprocessing) -> Any:
    """`prepend`'s nodes, in torch: (1, C, H, W) -> (1, C, H, W)."""
    import torch

    if settings.standardize:
        std, mean = torch.std_mean(pixels, correction=0)
        return (pixels - mean) / std.clamp_min(LEAST_STD)
    mean, std = (
        torch.tensor(values, dtype=torch.float32).expand(settings.channels)[:, None, None]
        for values in (settings.mean, settings.std)
    )
    return (pixels * settings.scale - mean) / std
