"""A model is held against its results, and against what its contract may say: only our errors come out of a bad one."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from elf_runtime import ContractError, ElfRuntime, ModelError
from elf_runtime.commands.info import main as info
from elf_runtime.model.onnx_file import has_external_data, read_onnx
from elf_runtime.model.protobuf import encoded, raw_fields
from helpers import TINY, textured

IMAGE = textured(96, 128)
Maps = dict[str, np.ndarray]


class Altered:
    """A session whose maps are altered before anybody sees them."""

    def __init__(self, session: object, alter: Callable[[Maps], Maps]) -> None:
        self._session, self._alter = session, alter

    def run(self, names: list[str], feed: object, options: object) -> list[np.ndarray]:
        values = dict(zip(names, self._session.run(names, feed, options), strict=True))  # type: ignore[attr-defined]
        altered = self._alter(values)
        return [altered[name] for name in names]


def replaced(key: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Maps], Maps]:
    def alter(maps: Maps) -> Maps:
        return {name: change(value) if name.startswith(key) else value for name, value in maps.items()}

    return alter


def spoiled(value: float) -> Callable[[np.ndarray], np.ndarray]:
    """All of a map but its first cell is `value`."""

    def change(array: np.ndarray) -> np.ndarray:
        found = np.full_like(array, value)
        found.ravel()[0] = 1.0
        return found

    return change


@pytest.fixture
def altered() -> Callable[[Callable[[Maps], Maps]], ElfRuntime]:
    def make(alter: Callable[[Maps], Maps]) -> ElfRuntime:
        elf = ElfRuntime(TINY, threads=1)
        get = elf._network.sessions.get

        def altered_get(*arguments: object, **options: object) -> tuple[Altered, object]:
            session, run = get(*arguments, **options)  # type: ignore[arg-type]
            return Altered(session, alter), run

        elf._network.sessions.get = altered_get  # type: ignore[assignment,method-assign]
        return elf

    return make


@pytest.mark.parametrize(
    ("alter", "reason"),
    [
        (replaced("saliency", lambda s: s[:, :-1]), r"gives a saliency of shape \(1, 95, 128\)"),
        (replaced("saliency", lambda s: np.pad(s, ((0, 0), (0, 9), (0, 0)))), r"saliency of shape \(1, 105, 128\)"),
        (replaced("saliency", lambda s: s[0]), r"saliency of shape \(96, 128\)"),
        (replaced("saliency", spoiled(np.nan)), "its saliency has negative, infinite or NaN values"),
        (replaced("saliency", spoiled(np.inf)), "its saliency has negative, infinite or NaN values"),
        (replaced("saliency", spoiled(-1.0)), "its saliency has negative, infinite or NaN values"),
        (replaced("descriptors", lambda d: d[:, :1, :1]), "has 1x1 cells for an image of 96x128 pixels"),
        (replaced("descriptors", lambda d: d[:, :, :0]), "has 48x0 cells"),
        (replaced("descriptors", lambda d: d[:, ::2, ::2]), "has 24x32 cells for an image of 96x128 pixels"),
        (replaced("descriptors", lambda d: np.repeat(d, 2, axis=2)), "has 48x128 cells"),
        (replaced("descriptors", lambda d: d[..., :5]), r"is of shape \(1, 48, 64, 5\), not \(1, h, w, 8\)"),
        (replaced("descriptors", spoiled(np.nan)), "'descriptors_relu2' has NaN or infinite values on this image"),
        (replaced("descriptors", spoiled(np.inf)), "'descriptors_relu2' has NaN or infinite values on this image"),
        (replaced("descriptors", np.zeros_like), "'descriptors_relu2' is zero everywhere on this image"),
    ],
)  # fmt: skip
def test_results_that_the_contract_excludes(
    altered: Callable[..., ElfRuntime], alter: Callable[[Maps], Maps], reason: str
) -> None:
    elf = altered(alter)
    calls: list[Callable[[], object]] = [lambda: elf.detect(IMAGE), lambda: elf.detect_batch([IMAGE, IMAGE])]
    if "saliency" in reason:
        calls.append(lambda: elf.saliency(IMAGE))
    else:
        calls.append(lambda: elf.describe(IMAGE, [(20.0, 30.0), (70.0, 40.0)]))
    for call in calls:
        with pytest.raises(ModelError, match=reason.replace("(1,", "([12],")) as error:
            call()
        assert str(error.value).startswith(str(TINY))


def test_a_single_dead_cell_is_no_error(altered: Callable[..., ElfRuntime]) -> None:
    def alter(array: np.ndarray) -> np.ndarray:
        array = array.copy()
        array[:, :20] = 0
        return array

    found = altered(replaced("descriptors", alter)).detect(IMAGE)
    assert (np.linalg.norm(found.descriptors, axis=1) == 0).any()


def with_metadata(changes: dict[bytes, bytes]) -> bytes:
    """The tiny model with other values, raw bytes, in its metadata."""
    parts = [bytes(raw) for number, _, raw in raw_fields(memoryview(TINY.read_bytes())) if number != 14]
    old = {key.encode(): value.encode() for key, value in read_onnx(TINY).metadata.items()}
    parts += [encoded(14, encoded(1, key) + encoded(2, value)) for key, value in (old | changes).items()]
    return b"".join(parts)


def field_changed(key: str, **changes: object) -> dict[bytes, bytes]:
    value = json.loads(read_onnx(TINY).metadata[key])
    target = value[0] if isinstance(value, list) else value
    target.update(changes)
    return {key.encode(): json.dumps(value).encode()}


def odd_contracts() -> Iterator[tuple[str, dict[bytes, bytes], str]]:
    huge = "9" * 400
    for number in ("NaN", "Infinity", "-Infinity", "1e999", "-1", huge, f"{huge}.5", "true", '"2"', "null", "[]"):
        yield f"stride {number[:10]}", {b"elf.stride": number.encode()}, "'elf.stride'"
    yield "stride 0", {b"elf.stride": b"0"}, "'elf.stride' is 0"
    for name in ("stride", "offset"):
        for value in (float("nan"), float("inf"), int(huge), 1e300, None, "1"):
            yield f"descriptor {name} {str(value)[:9]}", field_changed("elf.descriptors", **{name: value}), "'elf.descr"
    yield "descriptor stride 0", field_changed("elf.descriptors", stride=0.0), "'elf.descriptors'"
    for value in (0, -1, int(huge), 1.5, True):
        yield f"dim {str(value)[:9]}", field_changed("elf.descriptors", dim=value), "'elf.descriptors'"
    for name, values in {
        "value_range": (0.0, -1.0, float("nan"), float("inf")), "min_size": (0, -5, 8192, 10**6, int(huge)),
        "multiple": (0, 10**6, 2000), "height": (-1, 20000), "width": (20000, 1e300), "batch": (2, -1),
        "channels": (0, 4), "color": ("cmyk", 7), "layout": ("NCHW",), "dtype": ("uint8",), "name": (5,),
    }.items():  # fmt: skip
        for value in values:
            yield f"input {name} {str(value)[:9]}", field_changed("elf.input", **{name: value}), "'elf.input'"
    for name, value in {"scale": float("nan"), "max_keypoints": -1, "nms_radius": 1e300, "denoise": [4, 1]}.items():
        yield f"detection {name}", field_changed("elf.detection", **{name: value}), "'elf.detection'"
    yield "a vast image", field_changed("elf.input", height=8000, width=8000), "'elf.input'"
    yield "a vast field", {b"elf.receptive_field": b"1e6"}, "'elf.receptive_field'"
    yield "no list", {b"elf.descriptors": b"{}"}, "'elf.descriptors'"
    yield "brackets", {b"elf.cost": b"[" * 100_000 + b"]" * 100_000}, "'elf.cost' is unreadable"
    yield "objects", {b"elf.parity": b'{"a":' * 100_000 + b"1" + b"}" * 100_000}, "'elf.parity' is unreadable"
    yield "cost text", {b"elf.cost": b'{"params": "many"}'}, "'elf.cost'"
    yield "cost NaN", {b"elf.cost": b'{"params": NaN}'}, "'elf.cost'"
    yield "versions", {b"elf.versions": b'{"opset": 17}'}, "'elf.versions'"
    yield "not JSON", {b"elf.network": b"vgg"}, "'elf.network'"
    yield "schema", {b"elf.schema": b"9" * 1_000_000}, "'elf.schema' is 9999"
    yield "not UTF-8", {b"elf.network": b'"\xff\xfe"'}, ""
    yield "key not UTF-8", {b"elf.\xff": b"1"}, ""


ODD = list(odd_contracts())


@pytest.mark.parametrize(("changes", "reason"), [row[1:] for row in ODD], ids=[row[0] for row in ODD])
def test_contracts_that_no_model_has(
    changes: dict[bytes, bytes], reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = with_metadata(changes)
    with pytest.raises(ModelError) as error:
        ElfRuntime(data)
    assert reason in str(error.value)
    assert len(str(error.value)) < 3000
    path = tmp_path / "odd.onnx"
    path.write_bytes(data)
    assert info([str(path)]) == 1
    said = capsys.readouterr()
    assert said.err.count("\n") == 1
    assert said.err.startswith("elf-info: error: ")
    assert len(said.err) < 3000


def test_text_from_a_model_is_safe_to_print(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    odd = json.dumps("\x1b[31mred\x1b]0;title\x07" + "x" * 1_000_000).encode()
    path = tmp_path / "odd.onnx"
    path.write_bytes(with_metadata({b"elf.preprocessing": odd, b"elf.command": odd, b"elf.layer": odd}))
    assert info([str(path), "--provider", "cpu"]) == 0
    said = capsys.readouterr().out
    assert "\x1b" not in said
    assert "\x07" not in said
    assert "\\x1b[31mred" in said
    assert len(said) < 20_000
    path.write_bytes(with_metadata({b"elf.command": odd, b"elf.stride": b"0"}))
    with pytest.raises(ContractError) as error:
        ElfRuntime(path)
    assert "\x1b" not in str(error.value)
    assert len(str(error.value)) < 1500


def test_figures_of_any_name_and_number(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    odd = json.dumps({"{x}": 1.0, "{": 2.0, **{f"figure {i}": float(i) for i in range(20_000)}}).encode()
    path = tmp_path / "odd.onnx"
    path.write_bytes(with_metadata({b"elf.parity": odd}))
    assert info([str(path), "--provider", "cpu"]) == 0
    said = capsys.readouterr().out
    assert "{x}: 1\n" in said
    assert "and 19982 more\n" in said
    assert said.count("\n") < 80


def test_weights_in_other_files_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """ONNX Runtime would look for them in whatever folder the program runs in."""
    entry = encoded(13, encoded(1, b"location") + encoded(2, b"weights.bin"))
    stored = encoded(8, b"w") + bytes([2 << 3, 1]) + bytes([1 << 3, 1]) + entry + bytes([14 << 3, 1])
    attribute = encoded(5, encoded(1, b"value") + encoded(5, stored))
    node = encoded(1, encoded(4, b"Constant") + encoded(2, b"c") + attribute)
    for graph in (encoded(5, stored), node):
        parts = [bytes(raw) for number, _, raw in raw_fields(memoryview(TINY.read_bytes())) if number != 7]
        (old,) = (value for number, value, _ in raw_fields(memoryview(TINY.read_bytes())) if number == 7)
        assert isinstance(old, memoryview)
        data = b"".join([*parts, encoded(7, bytes(old) + graph)])
        (tmp_path / "weights.bin").write_bytes(bytes(4))
        monkeypatch.chdir(tmp_path)
        assert has_external_data(data)
        with pytest.raises(ModelError, match="its weights lie in other files"):
            ElfRuntime(data)
    assert not has_external_data(TINY.read_bytes())
    assert not has_external_data(b"location")


@pytest.mark.parametrize("which", ["shape", "type"])
def test_an_output_without_a_shape_or_a_type(which: str) -> None:
    data = memoryview(TINY.read_bytes())
    (graph,) = (value for number, value, _ in raw_fields(data) if number == 7)
    assert isinstance(graph, memoryview)
    tensor = encoded(2, encoded(1, bytes([1 << 3, 1]))) if which == "shape" else b""
    outputs = encoded(12, encoded(1, b"saliency") + tensor)
    kept = [bytes(raw) for number, _, raw in raw_fields(graph) if number != 12]
    parts = [bytes(raw) for number, _, raw in raw_fields(data) if number != 7]
    with pytest.raises(ModelError):
        ElfRuntime(b"".join([*parts, encoded(7, b"".join([*kept, outputs]))]))
