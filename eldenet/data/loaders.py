"""Loaders whose order depends on nothing but (seed, epoch): resumable at any batch, shared by processes."""

from collections.abc import Iterable, Iterator, Mapping
from itertools import groupby, islice
from multiprocessing import get_context
from multiprocessing.context import BaseContext
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import DataLoader, Sampler, default_collate

from eldenet.data.base import DepthDataset
from eldenet.system.resources import prepare_environment
from eldenet.types import DepthSample


class EpochSampler(Sampler[list[tuple[int, int]]]):
    """Batches of ``(epoch, index)``: a seeded shuffle per epoch, dealt to processes batch by batch.

    Args:
        length: of the data set.
        batch_size: per process.
        seed: of the shuffle.
        rank: of this process.
        processes: that train together.

    Attributes:
        epoch: whose order comes next.
        start: first batch to yield, so that a resumed epoch goes on where it stopped.
    """

    def __init__(self, length: int, batch_size: int, *, seed: int, rank: int = 0, processes: int = 1) -> None:
        self.length, self.batch_size, self.seed = length, batch_size, seed
        self.rank, self.processes = rank, processes
        self.epoch, self.start = 0, 0
        # a smaller last batch would make one step noisier than the others; a tiny data set keeps it
        together = batch_size * processes
        self.batches = length // together if length >= together else 1

    def __len__(self) -> int:
        return self.batches - self.start

    def __iter__(self) -> Iterator[list[tuple[int, int]]]:
        generator = torch.Generator().manual_seed(self.seed * 1_000_003 + self.epoch)
        order = torch.randperm(self.length, generator=generator).tolist()
        for batch in range(self.start, self.batches):
            first = (batch * self.processes + self.rank) * self.batch_size
            indices = order[first : first + self.batch_size] or order[: self.batch_size]
            yield [(self.epoch, index) for index in indices]


def collate(samples: list[DepthSample]) -> dict[str, object]:
    """Stack samples; names the frames if their sizes differ."""
    sizes = {_sizes(sample) for sample in samples}
    if len(sizes) > 1:
        names = ", ".join(sample["name"] for sample in samples[:4])
        raise ValueError(
            f"frames of different sizes in one batch of a training ({names}, ...: {sorted(sizes)}): set "
            "data.input_size"
        )
    return default_collate(samples)


def collate_runs(samples: list[DepthSample]) -> list[dict[str, object]]:
    """Stack samples, in their order, into as many batches as sizes follow each other: for evaluation."""
    return [default_collate(list(run)) for _, run in groupby(samples, key=_sizes)]


def _sizes(sample: DepthSample) -> tuple[tuple[int, ...], ...]:
    return tuple(sample["image"].shape[-2:]), tuple(sample["depth"].shape[-2:])


def training_loader(
    dataset: DepthDataset, sampler: EpochSampler, *, workers: int = 0, pin_memory: bool = False
) -> DataLoader:
    """Loader in the order of ``sampler``, whose ``epoch`` and ``start`` are set before each epoch."""
    dataset.open_cache()
    return DataLoader(
        dataset,
        batch_sampler=sampler,
        generator=torch.Generator(),  # else every start of an epoch, resumed ones too, draws from torch's own
        num_workers=workers,
        collate_fn=collate,
        persistent_workers=workers > 0,
        pin_memory=pin_memory,
        worker_init_fn=_quiet_worker if workers else None,
        multiprocessing_context=_worker_context() if workers else None,
    )


def evaluation_loader(
    dataset: DepthDataset, batch_size: int, *, workers: int = 0, rank: int = 0, processes: int = 1
) -> DataLoader:
    """Loader that gives this process its share of the frames: every frame once, in order, none padded.

    What it yields is a list of batches, each of one size (:func:`collate_runs`). There are at most as many
    workers as there is to yield; they end with the pass over the frames.
    """
    dataset.open_cache()
    batches = list(batched(range(rank, len(dataset), processes), batch_size))
    workers = min(workers, len(batches))
    return DataLoader(
        dataset,
        batch_sampler=batches,
        generator=torch.Generator(),
        num_workers=workers,
        collate_fn=collate_runs,
        worker_init_fn=_quiet_worker if workers else None,
        multiprocessing_context=_worker_context() if workers else None,
    )


def to_device(batch: Mapping[str, Any], device: torch.device, *, channels_last: bool) -> dict[str, Any]:
    """The tensors of a batch there, its images in the memory layout of the network's weights."""
    layout = torch.channels_last if channels_last else torch.contiguous_format
    moved = {
        name: value.to(device, non_blocking=True) if isinstance(value, Tensor) else value
        for name, value in batch.items()
    }
    moved["image"] = moved["image"].contiguous(memory_format=layout)
    return moved


def batched(indices: Iterable[int], size: int) -> Iterator[list[int]]:
    """Runs of ``size`` indices, the last one shorter."""
    rest = iter(indices)
    while run := list(islice(rest, size)):
        yield run


def _worker_context() -> BaseContext:
    """Workers fork from a server that holds the imports: a validation's start in a moment, not in seconds."""
    prepare_environment()  # the server takes it over
    context = get_context("forkserver")
    context.set_forkserver_preload(["__main__", "torch", "cv2", "albumentations", "eldenet.data.loaders"])
    return context


def _quiet_worker(_: int) -> None:
    """One thread per worker: its core is already counted."""
    import cv2

    torch.set_num_threads(1)
    cv2.setNumThreads(0)
