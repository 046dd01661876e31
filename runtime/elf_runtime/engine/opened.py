"""A model that is open, and what a call to it is turned into: settings, and an image at the working size."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy.typing as npt

from elf_runtime.contract import ModelContract
from elf_runtime.detection.working_image import WorkingImage, prepare
from elf_runtime.errors import SettingError
from elf_runtime.image.file import MAX_PIXELS, ImageLike, check_pixels, image_errors, read
from elf_runtime.model.network import Network
from elf_runtime.model.providers import Provider
from elf_runtime.model.session import read_model
from elf_runtime.params import DetectionParams, is_int
from elf_runtime.presets import preset
from elf_runtime.results.trace import Stopwatch


class OpenedModel:
    """What `ElfRuntime` is built on; its users see that class only."""

    def __init__(
        self,
        model: str | os.PathLike[str] | bytes | None = None,
        *,
        providers: Provider | Sequence[Provider] | None = None,
        threads: int | None = None,
        spin: bool | None = None,
        fallback: bool = False,
        sizes: int = 2,
        max_pixels: int | None = MAX_PIXELS,
    ) -> None:
        """Open and check a model.

        Parameters
        ----------
        model : path or bytes, optional
            A file that ``elf-export`` or `to_ort` wrote; it is read once, here.  None is the bundled model, which works
            offline: in int8 on ONNX Runtime's CPU provider, `fallback` to it included, in fp32 on others.
        providers : str, (str, options) or sequence of them, optional
            ONNX Runtime execution providers in order of preference, by short ("cuda") or full name.  None is the CPU.
        threads : int, optional
            Threads within an operator.  None is one per physical core.
        spin : bool, optional
            Let idle threads spin within a call only (None), never (False: where other processes want the cores), or
            between calls too (True: a core each).  Never costs some 15 % of the time on two cores.
        fallback : bool
            Where a provider is not installed or does not start: warn and go on with the next (True), or raise.
        sizes : int
            For that many image sizes, the ones used last, a session of their own is kept, and a second one where images
            come in batches too: ONNX Runtime is up to a sixth faster in fp32 when it knows the size.  Opening one takes
            some 20 to 100 ms.  On the CPU, a size gets it at once if it is the first or `warmup` names it, any other
            when it comes again among the last `sizes` sizes; until then its images go through one session of any size,
            which counts as one of the `sizes`, with the same result up to float32's rounding.  0 is that one session
            only.  A model in ORT format has one session for all.
        max_pixels : int, optional
            Larger images are refused, files before they are decoded (see `image.read`): the network takes some 100
            bytes for each pixel at the default's working scale.  None is no limit.

        Raises
        ------
        ModelError
            The file is missing, empty or no ONNX model.
        ContractError
            It is an ONNX model, but not an ELF model that this version can run.
        ProviderError
            See `fallback`; or `providers`, `threads` or `spin` is of another kind.
        SettingError
            `sizes` is no integer >= 0, or `max_pixels` none >= 1.
        """
        if not is_int(sizes) or sizes < 0:
            raise SettingError(f"sizes is an integer >= 0, not {sizes!r}")
        if max_pixels is not None and (not is_int(max_pixels) or max_pixels < 1):
            raise SettingError(f"max_pixels is None or an integer >= 1, not {max_pixels!r}")
        self._max_pixels = max_pixels
        options = {"providers": providers, "threads": threads, "spin": spin, "fallback": fallback}
        self._network = Network(None if model is None else read_model(model), options, int(sizes))

    @property
    def contract(self) -> ModelContract:
        """What the model file says of itself."""
        return self._network.contract

    @property
    def providers(self) -> list[str]:
        """Names of the active execution providers, the preferred one first."""
        return self._network.sessions.providers

    @property
    def sha256(self) -> str:
        """SHA-256 of the model's file."""
        return self._network.sessions.sha256

    def __repr__(self) -> str:
        c = self.contract
        layers = ",".join(d.layer for d in c.descriptors) or "none"
        name = type(self).__name__
        return f"{name}({self._network.name!r}: {c.network} {c.layer}, descriptors {layers}, {self.providers[0]})"

    def params(
        self, name: str | None = None, *, params: DetectionParams | None = None, **settings: Any
    ) -> DetectionParams:
        """The settings that a call with this preset, or these `params`, and these changes uses.

        A preset's scale is not for a model that takes one size only: there it is 1.

        Raises
        ------
        SettingError
            On an unknown preset or setting, a value out of range, or a preset and `params` together.
        """
        if params is not None:
            if not isinstance(params, DetectionParams):
                raise SettingError(f"params is a DetectionParams, not {type(params).__name__}")
            if name is not None:
                raise SettingError(f"preset {name!r} and params are both where to start from; give one of them")
            return params.updated(**settings)
        base = self.contract.detection if name in (None, "default") else preset(name, self.contract.network)
        if self.contract.input.is_fixed:
            base = base.updated(scale=1.0)
        return base.updated(**settings)

    def _prepare(
        self,
        image: ImageLike,
        params: DetectionParams,
        mask: npt.ArrayLike | None = None,
        place: str = "",
        watch: Stopwatch | None = None,
    ) -> WorkingImage:
        """Read the image and make it ready; `place` says which of a batch it is, for what is wrong with it."""
        watch = watch or Stopwatch()
        with watch("read"):
            pixels = read(image, max_pixels=self._max_pixels)
        with watch("prepare"), image_errors(image, place):
            check_pixels(pixels.shape, self._max_pixels)
            return prepare(pixels, params, mask, self.contract, self._network.name)
