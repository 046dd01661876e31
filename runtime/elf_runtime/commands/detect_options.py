"""The command line of elf-detect."""

from __future__ import annotations

import argparse
from pathlib import Path

from elf_runtime.extraction.ray_engine import SHARD_SIZE
from elf_runtime.extraction.shards import FORMATS
from elf_runtime.extraction.store import is_url

from . import options
from .parser import Parser, add_json, new_parser

DESCRIPTION = """\
Detect ELF keypoints in images, videos or what a camera sees, and describe them.

For every image photos/NAME.jpg, DIR gets
  photos/NAME.npz   keypoints (N, 2) as x, y in pixels, scores (N,), descriptors (N, D), image_size (height, width),
                    nms_radius, sizes (N,), angles (N,), and a record of image, model and settings
  photos/NAME.csv   x,y,score,size,angle
  photos/NAME.png   a picture: keypoints, saliency and threshold side by side; of a single image, else with --picture
  photos/NAME.explain.png
                    with --explain: a sheet of image, keypoints, and each working scale's saliency, blurred map with the
                    level's contour, and histogram with Kapur's level and the entropy that it maximises
Where a folder has NAME.png too, they are called NAME.jpg.npz and so on.  Frame 12 of clip.mp4 is clip/000012, and that
of a camera camera0/DATE-TIME/000012.
DIR mirrors the images' folders as they are given; of absolute paths what is below the folder given, or --base.
Results of another image are never overwritten.
Pixel centres are at whole numbers, (0, 0) is the centre of the top left pixel, as in OpenCV.
An image is turned as its EXIF orientation says, and so are its keypoints; --ignore-exif takes it as it is stored.

Several images are worked on at once (--workers), so that decoding and writing overlap with the network.  On a terminal
there is a bar where tqdm is installed, elsewhere a line for each image; failures are listed at the end."""

EPILOG = """\
examples:
  elf-detect photo.jpg -o out/
  elf-detect photos/ 'more/*.png' -o out/ --max-keypoints 1000 --scale 0.5 --skip-existing
  elf-detect /data/sequence -o out/ --base /data/sequence --grid 4x6 --picture
  elf-detect phone/ -r -o out/ --max-side 1600 --workers 2 --jsonl out/log.jsonl
  elf-detect clip.mp4 -o out/ --every 5
  elf-detect --camera 0 -o out/ --limit 100
  elf-detect s3://bucket/photos -o s3://bucket/features --engine ray --skip-existing
  elf-detect photo.jpg -o out/ --preset paper --mask roi.png --json -

exit status: 0 if every image was done, 1 if some could not be, 2 on a wrong command line"""


def build_parser() -> Parser:
    parser = new_parser("elf-detect", DESCRIPTION, EPILOG)
    parser.add_argument(
        "images", nargs="*", metavar="IMAGE", help="image file, folder of images, pattern, or video file"
    )
    parser.add_argument("--camera", type=options.from_zero, metavar="N", help="the frames of a camera, until Ctrl-C")
    parser.add_argument(
        "-r", "--recursive", action="store_true", help="of folders, take the images in their subfolders too"
    )
    parser.add_argument(
        "-o",
        "--output",
        required=True,
        type=_place,
        metavar="DIR",
        help="folder of the results, made where it is missing; with pictures, none that images are taken from",
    )
    parser.add_argument(
        "--base", type=_place, metavar="FOLDER", help="mirror in DIR what is below this folder of the images' paths"
    )
    parser.add_argument(
        "--skip-existing", action="store_true",
        help="leave out images whose results are there, of the same pixels, model and settings",
    )  # fmt: skip
    parser.add_argument(
        "--overwrite", action="store_true", help="replace what is there even if it is not this image's result"
    )
    options.add_mask(parser)
    parser.add_argument(
        "--picture",
        action=argparse.BooleanOptionalAction,
        help="write NAME.png, or not; by default for a single image",
    )
    parser.add_argument(
        "--explain", action="store_true", help="write NAME.explain.png, which shows how the keypoints came about"
    )
    parser.add_argument("--every", type=options.positive, default=1, metavar="N", help="every Nth frame of videos")
    parser.add_argument("--limit", type=options.positive, metavar="N", help="at most N frames of each video or camera")
    parser.add_argument(
        "--workers", type=options.positive, metavar="N",
        help="images at once, each with its share of --threads and memory of its own; default: 1 for one image, else "
        "one per core, at most 4",
    )  # fmt: skip
    _add_machines(parser)
    add_json(parser, "a summary of the run at its end")
    parser.add_argument(
        "--jsonl", metavar="FILE", help="write a line of JSON for each image as it is done; - is standard output"
    )
    options.add_quiet(parser)
    options.add_image_options(parser)
    options.add_detection_options(parser)
    options.add_model_options(parser)
    return parser


def _add_machines(parser: Parser) -> None:
    group = parser.add_argument_group(
        "many machines",
        "With --engine ray, IMAGE, DIR and FOLDER may be URLs that fsspec knows, such as s3://bucket/photos/*.jpg. DIR "
        "gets shards of many images each, which elf_runtime.extraction.shards.read_shards reads. --workers are "
        "processes of --threads cores (1) each, by default as many as Ray has cores for; --overwrite removes the "
        "shards that are there, at its end. See docs/cluster.md.",
    )
    group.add_argument(
        "--engine", choices=("local", "ray"), default="local",
        help="local: threads of this process (default); ray: a cluster of Ray, or this machine where there is none",
    )  # fmt: skip
    group.add_argument("--format", choices=FORMATS, help="of the shards: parquet (default), or hloc's h5")
    group.add_argument(
        "--shard-size", type=options.positive, metavar="N",
        help=f"images in a shard; default: {SHARD_SIZE}, or fewer, so that each worker has one",
    )  # fmt: skip


def _place(text: str) -> Path | str:
    """An argparse type: a path, or a URL as it is."""
    return text if is_url(text) else Path(text)
