"""Caffe's AlexNet (`alexnet`) without local response normalisation."""

from __future__ import annotations

from dataclasses import replace

from . import alexnet
from .parts.architecture import Architecture

_ARCHITECTURE = Architecture(alexnet.CAFFE, alexnet.plain)

NETWORK = replace(
    alexnet.NETWORK,
    name="alexnet_plain",
    title="AlexNet, Caffe's, without normalisation",
    layers=_ARCHITECTURE.layers,
    build=_ARCHITECTURE.build,
    tensor_shapes=_ARCHITECTURE.tensor_shapes,
)
