"""Networks that are not used as they were trained: with average-pooling for the detector, at a scale of their own."""

from __future__ import annotations

from dataclasses import replace

from elf_export.errors import LayerError
from elf_export.graph.graph import Graph
from elf_export.graph.passes import average_pools, cut, shrink_image
from elf_export.graph.receptive_field import Field
from elf_export.graph.sizes import Sizes

from .source import Source, Sources


def varied(sources: Sources) -> Sources:
    """The networks as `Request.pool` and `Request.desc_scale` ask for them.

    Where either is asked for, the detector's own layers describe by a second copy of the network, whose pooling is as
    it was trained; what the two compute alike is computed once all the same.

    Raises
    ------
    LayerError
        The detector has no max-pooling, or takes one size only, which its layers then can't see at another scale.
    """
    request = sources.request
    if request.pool == "max" and request.desc_scale == 1.0:
        return sources
    detector = sources.detector
    copies = [replace(detector, layer=detector.descriptors[0])] if detector.descriptors else []
    others = tuple(_smaller(other, request.desc_scale) for other in (*copies, *sources.others))
    detector = replace(detector, descriptors=())
    return Sources(_averaged(detector) if request.pool == "average" else detector, others)


def _averaged(detector: Source) -> Source:
    """The detector with average-pooling in place of max-pooling."""
    if not detector.differentiate:
        raise LayerError(f"--pool average: {detector.name}'s {detector.layer} is the saliency itself")
    model = average_pools(Graph(cut(detector.model, [detector.layer]), copy=False)).model
    return replace(detector, model=model, oracle=detector.oracle.averaging(model))


def _smaller(source: Source, ratio: float) -> Source:
    """A describing network that sees the image at `ratio` of its size."""
    if ratio == 1.0:
        return source
    sizes = _sizes(source, ratio)
    model = shrink_image(Graph(source.model), source.image.name, source.image.layout, ratio).model
    del model.graph.value_info[:]
    return replace(
        source,
        model=model,
        fields={name: _of_whole(field, ratio) for name, field in source.fields.items()},
        sizes=sizes,
        period=source.period / ratio,
        scale=ratio,
        oracle=source.oracle.describing(model, source.image),
    )


def _of_whole(field: Field, ratio: float) -> Field:
    """In pixels of the whole image: pixel i of the smaller one is centred at (i + 1/2) / ratio - 1/2."""
    return Field(field.stride / ratio, (field.offset + 0.5) / ratio - 0.5, field.size / ratio)


def _sizes(source: Source, ratio: float) -> Sizes:
    sizes = source.sizes
    multiple = sizes.multiple / ratio
    if sizes.height or sizes.width or (sizes.multiple > 1 and not multiple.is_integer()):
        raise LayerError(
            f"--desc-scale {ratio:g}: {source.name} takes images of {sizes.describe()}, so its layers can't see "
            "them at another scale"
        )
    # The least size is told by runs of the finished graph.
    return replace(sizes, multiple=int(multiple) if sizes.multiple > 1 else 1)
