"""Whether a converted model still computes what its file does."""

from __future__ import annotations

import onnx

from elf_export.errors import ExportError
from elf_export.graph.image_input import ImageInput
from elf_export.graph.passes import opset_of
from elf_export.graph.sizes import Sizes, with_sizes
from elf_export.sources.sizes.free import Runner, unlike
from elf_runtime.errors import first_line

AT = ((53, 71), (97, 128), (230, 247))  # about so many pixels of height and width; what rounds, does at odd sizes


def unchanged(before: onnx.ModelProto, after: onnx.ModelProto, image: ImageInput, sizes: Sizes) -> tuple[str, ...]:
    """What to tell of a conversion that could not be checked; nothing of one that was, or where there was none.

    An op may mean something else in another opset, such as a Resize, or a Softmax along one of several axes, and a
    converter that overlooks it leaves a model that runs.  So both models are run on noise, at sizes that they take.

    Raises
    ------
    ExportError
        If they differ.
    """
    own, new = opset_of(before), opset_of(after)
    if own == new:
        return ()
    try:
        reference = Runner(with_sizes(before, image, sizes), image)
        wanted = {size: reference.outputs_at((sizes.batch or 1, *size)) for size in {sizes.near(*at) for at in AT}}
    except Exception as error:  # onnxruntime's own exceptions share no base of theirs
        return (
            f"the model was converted from opset {own} to {new}; ONNX Runtime can't run it as it was "
            f"({first_line(error)}), so that the two could not be compared",
        )
    runner = Runner(after, image)
    for size, maps in wanted.items():
        if reason := unlike(runner.outputs_at((sizes.batch or 1, *size)), maps, f"it gave in opset {own}"):
            raise ExportError(
                f"the model was converted from opset {own} to {new}, but {reason} on an image "
                f"of {size[1]}x{size[0]} pixels; export it again with opset {new}"
            )
    return ()
