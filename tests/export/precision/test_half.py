"""Float16 throughout, and weights in bfloat16."""

from __future__ import annotations

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from elf_export.dialect import OWN
from elf_export.graph.graph import Graph
from elf_export.precision.half import MANY, bfloat16_weights, half_precision
from elf_export.saliency import build_saliency
from elf_export.sources.forward import NETWORK_INPUT
from elf_export.sources.networks import get_network
from elf_runtime.model.session import open_session


def test_float16_throughout_and_half_the_bytes(vgg) -> None:
    settings = get_network("vgg").preprocessing
    lowered = half_precision(build_saliency(vgg.forward, "pool2", [], NETWORK_INPUT, settings, masks=True))
    onnx.checker.check_model(lowered, full_check=True)
    assert lowered.ByteSize() < 0.51 * vgg.model.ByteSize()
    graph = Graph(lowered)
    inner = {v for node in graph.nodes if not node.name.startswith("pre/") for v in node.output}
    singles = {v for v in inner if graph.dtype(v) == np.float32}
    assert singles == {value.name for value in lowered.graph.output}
    assert {value.type.tensor_type.elem_type for value in (*lowered.graph.input, *lowered.graph.output)} == {
        TensorProto.FLOAT
    }
    assert not any(node.op_type == "HardSigmoid" for node in lowered.graph.node)


def test_tensors_in_attributes_are_float16_too() -> None:
    """The value that a ConstantOfShape repeats; a Constant that Resize reads stays, as its scales are float32."""
    nodes = [
        helper.make_node("Shape", ["x"], ["shape"], name="shape"),
        helper.make_node("ConstantOfShape", ["shape"], ["half"], name="half",
                         value=numpy_helper.from_array(np.array([0.5], np.float32))),
        helper.make_node("Add", ["x", "half"], ["sum"], name="sum"),
        helper.make_node("Constant", [], ["scales"], name="scales",
                         value=numpy_helper.from_array(np.array([1, 1, 2, 2], np.float32))),
        helper.make_node("Resize", ["sum", "", "scales"], ["y"], name="y", mode="nearest"),
    ]  # fmt: skip
    infos = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["N", 3, None, None]) for name in "xy"]
    graph = helper.make_graph(nodes, "g", infos[:1], infos[1:])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    lowered = half_precision(model)
    onnx.checker.check_model(lowered, full_check=True)
    x = np.arange(12, dtype=np.float32).reshape(1, 3, 2, 2)
    (found,) = open_session(lowered.SerializeToString())[0].run(None, {"x": x})
    np.testing.assert_array_equal(found, (x + 0.5).repeat(2, 2).repeat(2, 3))


def test_steps_are_exact_in_float16() -> None:
    """[d > 0] for every float16 there is, the smallest included."""
    every = np.arange(2**16, dtype=np.uint16).view(np.float16)
    values = every[np.isfinite(every)].astype(np.float32)
    node = helper.make_node("Step", ["d"], ["mask"], name="mask", domain=OWN)
    infos = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["N"]) for name in ("d", "mask")]
    graph = helper.make_graph([node], "g", infos[:1], infos[1:])
    lowered = half_precision(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8))
    import onnxruntime

    session = onnxruntime.InferenceSession(lowered.SerializeToString(), providers=["CPUExecutionProvider"])
    (found,) = session.run(None, {"d": values})
    np.testing.assert_array_equal(found, (values > 0).astype(np.float32))


def test_bfloat16_weights_are_rounded_to_nearest_even(vgg) -> None:
    """Against torch's bfloat16; ties drawn on purpose; and half the bytes."""
    import torch

    rng = np.random.default_rng(0)
    bits = rng.integers(0x3F000000, 0x40FFFFFF, 4096, dtype=np.uint32)
    bits[::2] = bits[::2] & 0xFFFF0000 | 0x8000  # halfway between two
    values = bits.view(np.float32) * rng.choice([-1, 1], 4096).astype(np.float32)
    tensors = [numpy_helper.from_array(values, "w"), numpy_helper.from_array(values[: MANY - 1], "few")]
    nodes = [helper.make_node("Identity", [name], [f"{name}_out"], name=name) for name in ("w", "few")]
    infos = [helper.make_tensor_value_info(f"{n}_out", TensorProto.FLOAT, None) for n in ("w", "few")]
    model = helper.make_model(helper.make_graph(nodes, "g", [], infos, tensors), ir_version=8,
                              opset_imports=[helper.make_opsetid("", 17)])  # fmt: skip
    stored = {t.name: t for t in bfloat16_weights(model).graph.initializer}
    assert set(stored) == {"w/bf16", "few"}
    assert stored["w/bf16"].data_type == TensorProto.BFLOAT16
    found = (np.frombuffer(stored["w/bf16"].raw_data, np.uint16).astype(np.uint32) << 16).view(np.float32)
    np.testing.assert_array_equal(found, torch.tensor(values).to(torch.bfloat16).to(torch.float32).numpy())

    lowered = bfloat16_weights(vgg.model)
    onnx.checker.check_model(lowered, full_check=True)
    assert lowered.ByteSize() < 0.52 * vgg.model.ByteSize()
