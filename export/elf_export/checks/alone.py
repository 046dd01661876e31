"""The file alone against the runtime: keypoints, scores and descriptors of an end-to-end graph and of `ElfRuntime`."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np
import numpy.typing as npt
import onnx
import onnxruntime as ort

from elf_export.calibration import CalibrationSet
from elf_export.end_to_end.build import Form, inputs_of
from elf_export.errors import VerificationError
from elf_runtime import ElfRuntime, Features
from elf_runtime.errors import first_line
from elf_runtime.image.convert import checked
from elf_runtime.pictures.render import displayable

from .views import sources

Image = npt.NDArray[np.uint8]

NEAR = 0.01  # pixels of the source image
LEAST = 0.98  # of the keypoints: where 8 bits round otherwise a few differ
MOST_IMAGES = 4


@dataclass(frozen=True)
class AloneCheck:
    """An end-to-end graph beside the runtime, over photographs, noise, a flat image, and one with a mask.

    Attributes
    ----------
    keypoints : of the runtime, over all images
    near : share of them that have one of the graph's within 0.01 px
    counts : share of the images that have as many
    cosine : the least of the descriptors of such keypoints; 1 without descriptors
    time : of the graph on this machine's CPU, as a share of `ElfRuntime.detect`'s
    rounds : of the suppression, where they are unrolled; see `Form`
    """

    keypoints: int
    near: float
    counts: float
    cosine: float
    time: float
    rounds: int = 0

    @property
    def passed(self) -> bool:
        return self.near >= LEAST

    @property
    def complaint(self) -> str:
        return (
            f"The keypoints of the file alone are not the runtime's: {self.near:.1%} lie within {NEAR:g} px, at least "
            f"{LEAST:.0%} are wanted." + f" {self.rounds} rounds may be too few: more by --rounds." * bool(self.rounds)
        )

    def figures(self) -> dict[str, float]:
        return {"alone_near": self.near, "alone_counts": self.counts, "alone_cosine": self.cosine}

    def table(self) -> str:
        return (
            f"{'':8}{'keypoints':>11}{'< 0.01 px':>11}{'same count':>12}{'cosine >=':>11}{'time':>7}\n"
            f"{'alone':<8}{self.keypoints:>11}{self.near:>11.2%}{self.counts:>12.0%}{self.cosine:>11.4f}"
            f"{self.time:>7.2f}   (held against the runtime's; time on this CPU)"
        )


def compare_alone(graph: onnx.ModelProto, model: bytes, form: Form, images: CalibrationSet) -> AloneCheck:
    """Run both on the same images.

    Raises
    ------
    VerificationError
        If ONNX Runtime can't run the graph.
    """
    elf = ElfRuntime(model)
    options = ort.SessionOptions()
    options.log_severity_level = 3
    try:
        session = ort.InferenceSession(graph.SerializeToString(), options, providers=["CPUExecutionProvider"])
        rows = [_row(elf, session, form, *case) for case in _cases(elf, images)]
    except VerificationError:
        raise
    except Exception as error:  # onnxruntime's own exceptions share no base of theirs
        raise VerificationError(f"ONNX Runtime does not run the end-to-end graph: {first_line(error)}") from error
    counts, near, same, cosines, times = zip(*rows, strict=True)
    total = sum(counts)
    return AloneCheck(
        total, sum(near) / total if total else 1.0, float(np.mean(same)), min(cosines), float(np.median(times)),
        form.rounds,
    )  # fmt: skip


def _cases(elf: ElfRuntime, images: CalibrationSet) -> Iterator[tuple[Image, Image | None]]:
    """Images and masks."""
    rng = np.random.default_rng(0)
    spec, scale = elf.contract.input, elf.contract.detection.scale
    photos = [displayable(checked(image)) for image in islice(sources(images, spec, scale), MOST_IMAGES)]
    yield from ((photo, None) for photo in photos)
    height, width = photos[0].shape[:2]
    mask = np.zeros((height, width), np.uint8)
    mask[height // 5 :, : width * 3 // 4] = 1
    yield photos[0], mask
    side = max(spec.min_size, 96)
    yield rng.integers(0, 256, (side, side + 31, 3), np.uint8), None
    yield np.full((side, side, 3), 77, np.uint8), None


def _row(
    elf: ElfRuntime, session: ort.InferenceSession, form: Form, image: Image, mask: Image | None
) -> tuple[int, int, bool, float, float]:
    """Keypoints, how many are near, whether there are as many, the least cosine, and the ratio of the times."""
    given = image if form.color == "bgr" else image[:, :, ::-1]
    feed = {"image": given[None].astype(form.pixels)} | ({} if mask is None else {"mask": mask})
    if form.required:
        feed = inputs_of(elf.contract.detection) | feed
    names = [output.name for output in session.get_outputs()]
    seconds = []
    for _ in range(2):  # the first is for what is opened then
        start = time.perf_counter()
        wanted = elf.detect(image, mask=mask)
        middle = time.perf_counter()
        found = dict(zip(names, session.run(names, feed), strict=True))
        seconds.append((time.perf_counter() - middle) / (middle - start))
    if form.batch:
        count = int(found["counts"][0])
        found = {name: found[name][0][:count] for name in names if name != "counts"}
    return (len(wanted), *_agreement(wanted, found), seconds[-1])


def _agreement(wanted: Features, found: dict[str, npt.NDArray[np.float32]]) -> tuple[int, bool, float]:
    same = len(wanted) == len(found["keypoints"])
    if not len(wanted) or not len(found["keypoints"]):
        return 0, same, 1.0
    apart = np.abs(wanted.keypoints[:, None] - found["keypoints"][None]).max(axis=2)
    nearest = apart.argmin(axis=1)
    near = apart.min(axis=1) <= NEAR
    cosine = 1.0
    if "descriptors" in found and near.any():
        cosine = float((wanted.descriptors * found["descriptors"][nearest]).sum(axis=1)[near].min())
    return int(near.sum()), same, cosine
