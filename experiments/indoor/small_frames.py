"""Small copies of what indoor networks train on, for a machine without the data sets, such as a rented GPU.

python experiments/indoor/small_frames.py pack small_frames.tar      # from $ELDENET_DATA: 24 MB
python experiments/indoor/small_frames.py unpack small_frames.tar data    # there; then ELDENET_DATA=data

The 665 training frames of NYU at 240 x 320 (WebP; depth without loss), and the photographs with a short side
of 160. Unpacking writes the layouts that the package reads, NYU's at 480 x 640. Held-out frames stay at home.
"""

import io
import os
import sys
import tarfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from eldenet.data.io import read_image
from eldenet.data.nyu import NYULabelled

NYU = "nyu_depth_v2/labeled/data/nyu2_train/labeled_out"
PHOTOGRAPHS = "unlabelled/openimages_doors"
SIZE, WHOLE = (320, 240), (640, 480)  # (width, height) [px]
SHORT_SIDE = 160  # [px]


def encoded(image: np.ndarray, quality: int = 82, lossless: bool = False) -> bytes:
    """An image as a WebP file."""
    file = io.BytesIO()
    Image.fromarray(image).save(file, "WEBP", quality=quality, lossless=lossless)
    return file.getvalue()


def packed_frame(files: tuple[Path, ...]) -> list[tuple[str, bytes]]:
    """Name and content of a picture, and of its depth if there is one."""
    image = read_image(files[0], upright=True)
    if len(files) == 1:
        ratio = SHORT_SIDE / min(image.shape[:2])
        small = cv2.resize(image, None, fx=ratio, fy=ratio, interpolation=cv2.INTER_AREA)
        return [(f"{PHOTOGRAPHS}/{files[0].stem}.jpg", encoded(small))]
    depth = cv2.resize(cv2.imread(str(files[1]), -1), SIZE, interpolation=cv2.INTER_NEAREST)
    return [
        (f"{NYU}/{files[0].name}", encoded(cv2.resize(image, SIZE, interpolation=cv2.INTER_AREA))),
        (f"{NYU}/{files[1].name}", encoded(depth, lossless=True, quality=100)),
    ]


def pack(archive: Path) -> None:
    """Write the archive from the frames in ``$ELDENET_DATA``."""
    frames = NYULabelled(split="train")
    sources = [tuple(map(Path, frames.frame_files(index))) for index in range(len(frames))]
    pictures = sorted((Path(os.environ["ELDENET_DATA"]) / PHOTOGRAPHS).glob("*.jpg"))
    sources += [(picture,) for picture in pictures]
    with tarfile.open(archive, "w") as tar, ThreadPoolExecutor() as pool:
        for files in pool.map(packed_frame, sources):
            for name, content in files:
                member = tarfile.TarInfo(name)
                member.size = len(content)
                tar.addfile(member, io.BytesIO(content))
    print(f"{len(frames)} frames and {len(pictures)} photographs: {archive.stat().st_size / 1e6:.0f} MB")


def unpack(archive: Path, folder: Path) -> None:
    """Write the frames below ``folder``, which becomes ``$ELDENET_DATA``."""
    for place in (NYU, PHOTOGRAPHS):
        (folder / place).mkdir(parents=True, exist_ok=True)

    def write(name: str, content: bytes) -> None:
        image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
        if name.endswith(".png"):
            image = cv2.resize(image[..., 0], WHOLE, interpolation=cv2.INTER_NEAREST)
        elif name.startswith(NYU):
            image = cv2.resize(image, WHOLE, interpolation=cv2.INTER_CUBIC)
        cv2.imwrite(str(folder / name), image)

    with tarfile.open(archive) as tar:
        contents = {member.name: tar.extractfile(member).read() for member in tar}  # type: ignore[union-attr]
    with ThreadPoolExecutor() as pool:
        list(pool.map(write, contents, contents.values()))
    stems = sorted(Path(name).stem for name in contents if name.endswith(".png"))
    pair = "data/nyu2_train/labeled_out/{0}.jpg,data/nyu2_train/labeled_out/{0}.png\n"
    table = folder / "nyu_depth_v2/labeled/data/nyu2_train.csv"
    table.write_text("".join(pair.format(stem) for stem in stems))


if __name__ == "__main__":
    action, *paths = sys.argv[1:]
    {"pack": pack, "unpack": unpack}[action](*map(Path, paths))
