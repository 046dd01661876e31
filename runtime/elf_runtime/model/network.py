"""An ELF model that is open: its contract, and runs of its graph that are held against it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from elf_runtime.contract import DescriptorSpec, ModelContract
from elf_runtime.errors import ElfError, first_line
from elf_runtime.params import DetectionParams

from .bundled import read_bundled
from .heap import trim_heap
from .outputs import check_map, check_saliency
from .providers import Provider, computes_int8, is_cpu, resolve_providers
from .sessions import Sessions

Array = npt.NDArray[np.float32]


class Network:
    """One model, opened and checked.

    Parameters
    ----------
    model : (bytes, name), optional
        As `read_model` gives it; None is the bundled model that suits the provider.
    options : mapping
        ``providers``, ``threads``, ``spin`` and ``fallback``, as `open_session` takes them.
    sizes : int
        See `Sessions`.

    Raises
    ------
    ModelError, ContractError, ProviderError

    Attributes
    ----------
    name : str
        The model's name for messages.
    contract : ModelContract
    sessions : Sessions

    Notes
    -----
    Copied or pickled, it opens its model again, in any process: what is kept of it is the model's bytes, unless it is
    the bundled one, and the options.
    """

    def __init__(self, model: tuple[bytes, str] | None, options: Mapping[str, Any], sizes: int) -> None:
        self.given = (model, options, sizes)
        providers = resolve_providers(options["providers"], options["fallback"])
        self._open(providers)
        if is_cpu(self.sessions.providers) and not is_cpu(providers):
            # Installed, but it did not start, and need not be tried again for each size.
            self._open(["CPUExecutionProvider"])
        self.contract = ModelContract.from_metadata(self.sessions.metadata, self.name)
        self.contract.check_tensors(self.sessions.inputs, self.sessions.outputs, self.name)

    def _open(self, providers: list[Provider]) -> None:
        model, options, sizes = self.given
        data, self.name = model or read_bundled("int8" if computes_int8(providers) else "fp32")
        self.sessions = Sessions(data, self.name, {**options, "providers": providers}, sizes)

    def __reduce__(self) -> tuple[Any, ...]:
        return Network, self.given

    def run(
        self, images: Sequence[Array], spec: DescriptorSpec | None, saliency: bool = True, levels: int = 1
    ) -> dict[str, Array]:
        """The outputs for N images, by name: the saliency, (N, h, w), and a descriptor map, (N, h', w', D).

        Parameters
        ----------
        images : sequence of (h, w, C) arrays, of one size
        spec : DescriptorSpec, optional
            Which descriptor; None computes none.
        saliency : bool
            Whether to compute it.
        levels : int
            How many sizes of the same images are looked at.

        Raises
        ------
        ModelError
            If they are not what the contract says.
        ElfError
            If ONNX Runtime fails.
        """
        pixels = np.stack(images) if len(images) > 1 else images[0][None]  # one alone is not copied: it may be large
        shape = (pixels.shape[0], pixels.shape[1], pixels.shape[2])
        found = self.fetched(self._outputs(spec, saliency), {self.contract.input.name: pixels}, shape, levels)
        if saliency:
            check_saliency(found[self.contract.saliency_output], shape, self.name)
        if spec is not None:
            check_map(found[spec.output], spec, shape, self.name)
        return found

    def fetched(
        self, names: Sequence[str], feed: Mapping[str, npt.NDArray[Any]], shape: tuple[int, int, int], levels: int = 1
    ) -> dict[str, Array]:
        """The outputs of these names for inputs of these names, of which images (N, h, w) of this `shape` come first.

        Raises
        ------
        ElfError
            If ONNX Runtime fails.
        """
        session, options = self.sessions.get(names, shape, levels=levels)
        try:
            values = session.run(names, dict(feed), options)
        except Exception as error:  # onnxruntime's own exceptions share no base of theirs
            given, why = next(iter(feed.values())).shape, first_line(error)
            raise ElfError(f"{self.name}: the network failed on a {given} input: {why}") from error
        if options is not None:
            trim_heap()
        return dict(zip(names, values, strict=True))

    def expect(
        self, size: tuple[int, int], spec: DescriptorSpec | None, saliency: bool = True, levels: int = 1
    ) -> None:
        """Open the session for single images of this working size (h, w), one of `levels`, which are to come."""
        self.sessions.get(self._outputs(spec, saliency), (1, *size), expected=True, levels=levels)

    def _outputs(self, spec: DescriptorSpec | None, saliency: bool) -> list[str]:
        return [self.contract.saliency_output] * saliency + ([spec.output] if spec is not None else [])


def alone_feed(
    pixels: npt.NDArray[Any], params: DetectionParams, mask: npt.NDArray[np.uint8] | None = None
) -> dict[str, npt.NDArray[Any]]:
    """The inputs of a graph that gives keypoints itself, for images (N, H, W, C) of the kind that it takes."""
    levels = {"kapur": -1.0, "none": 0.0}
    level = levels[params.threshold] if isinstance(params.threshold, str) else params.threshold
    return {
        "image": pixels,
        "max_keypoints": np.array(params.max_keypoints, np.int64),
        "threshold": np.array(level, np.float32),
        "mask": np.ones((1, 1), np.uint8) if mask is None else mask,
    }
