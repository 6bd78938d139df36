"""Makes a data set's files from its official archive.

python -m eldenet.data.prepare nyu_labelled source=nyu_depth_v2_labeled.mat
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from eldenet.data.io import depth_encoding
from eldenet.data.nyu import NYU_RANGE
from eldenet.data.nyu_hdf5 import NYUMat
from eldenet.system.files import part_file, write_text
from eldenet.types import Frame
from eldenet.visualization import write_picture

USAGE = """python -m eldenet.data.prepare nyu_labelled source=nyu_depth_v2_labeled.mat [output=nyu_labelled]
    Writes the 795 labeled training frames of NYU Depth V2 for data=nyu_labelled, and the 654 official test
    frames for data=nyu_densedepth, into one folder (data.root). source: the official file, with splits.mat
    beside it. Needs h5py: pip install -e '.[nyu]'"""
JPEG_QUALITY = 95


def nyu_labelled(source: str, output: str = "nyu_labelled") -> None:
    """Write the labeled frames of NYU Depth V2 in DenseDepth's layout, from the official .mat.

    Training: ``data/nyu2_train/labeled_out/NNNN.jpg`` and 8-bit in-painted depth (``nyu8_labelled``). Test:
    ``data/nyu2_test/NNNN_colors.png`` and 16-bit in-painted depth [mm]. NNNN is a frame's number in the .mat.

    Raises:
        FileNotFoundError: one of the two files is missing.
        ValueError: a file is damaged, or another one.
    """
    mat, folder = Path(source).expanduser(), Path(output).expanduser()
    for file in (mat, mat.with_name("splits.mat")):
        if not file.is_file():
            raise FileNotFoundError(
                f"{file} does not exist: nyu_labelled needs the official file and splits.mat"
            )
    for part, write in (("train", _training_frame), ("test", _test_frame)):
        split = {"train": "trainval", "test": "test"}[part]
        frames = NYUMat(mat.parent, split=split, file=mat.name)
        pairs = []
        for number in range(1, len(frames) + 1):
            pairs.append(write(folder, frames.load_frame(number - 1)))
            if number % 100 == 0 or number == len(frames):
                _say(f"{part}: {number} of {len(frames)} frames")
        write_text(folder / f"data/nyu2_{part}.csv", "".join(f"{image},{depth}\n" for image, depth in pairs))
    _say(f"written to {folder}: eldenet check-data data=nyu_labelled data.root={folder}")


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def _training_frame(root: Path, frame: Frame) -> tuple[str, str]:
    stem = f"data/nyu2_train/labeled_out/{frame.name}"
    encoded = cv2.imencode(".jpg", frame.image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]
    with part_file(root / f"{stem}.jpg") as unfinished:
        unfinished.write_bytes(encoded.tobytes())
    encoding = depth_encoding("nyu8_labelled")
    steps = np.rint(frame.depth / encoding.scale - encoding.offset).clip(1, 255)
    write_picture(root / f"{stem}.png", np.where(frame.depth > 0, steps, 0).astype(np.uint8))
    return f"{stem}.jpg", f"{stem}.png"


def _test_frame(root: Path, frame: Frame) -> tuple[str, str]:
    stem = f"data/nyu2_test/{frame.name}"
    write_picture(root / f"{stem}_colors.png", frame.image)
    millimeters = np.rint(frame.depth.clip(max=NYU_RANGE[1]) * 1000)
    write_picture(root / f"{stem}_depth.png", millimeters.astype(np.uint16))
    return f"{stem}_colors.png", f"{stem}_depth.png"


def main(words: Sequence[str]) -> None:
    """Run ``<data set> source=... [output=...]``; a user's mistake ends in one line."""
    if not words or words[0] in ("-h", "--help"):
        _say(USAGE)
        return
    name, *rest = words
    settings = dict(word.partition("=")[::2] for word in rest)
    if name != "nyu_labelled" or not {"source"} <= set(settings) <= {"source", "output"}:
        raise SystemExit(
            f"{' '.join(words)}: give nyu_labelled, source=<file> and, optionally, output=<folder>"
        )
    try:
        nyu_labelled(**settings)
    except (ValueError, OSError, ImportError) as error:
        raise SystemExit(str(error)) from error


if __name__ == "__main__":
    main(sys.argv[1:])
