"""What the tests of frame caches share."""

import torch

from eldenet.data.base import DepthDataset


def same(one, other) -> bool:
    tensors = ("image", "depth", "mask", "intrinsics")
    return one["name"] == other["name"] and all(torch.equal(one[key], other[key]) for key in tensors)


def count_reads(data: DepthDataset) -> list[int]:
    """The indices that ``data`` reads from its files from now on."""
    reads: list[int] = []
    load = data.load_frame
    data.load_frame = lambda index: (reads.append(index), load(index))[1]  # type: ignore[method-assign]
    return reads


def reads_of(data: DepthDataset) -> list[int]:
    """What is read from files, but for the frame that tells the size."""
    data.open_cache()
    reads = count_reads(data)
    _ = [data[index] for index in range(len(data))]
    return reads
