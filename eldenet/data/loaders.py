"""Data loaders whose order depends on (seed, epoch) alone: resumable at any batch, for several processes."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

import torch
from torch import Tensor
from torch.utils._pytree import tree_map_only
from torch.utils.data import DataLoader, Sampler, default_collate

from eldenet.data.base import DepthDataset, SampleKey
from eldenet.data.device_augmentation import augment, leave_out_idle, raw_sample
from eldenet.data.workers import worker_options
from eldenet.system.resources import available_memory
from eldenet.types import DepthSample

FEW_BATCHES = 4  # up to here an epoch shows all frames, in a smaller last batch too


class EpochSampler(Sampler[list[SampleKey]]):
    """Batches of ``(epoch, index)``: a seeded shuffle per epoch, dealt out to processes batch by batch.

    Args:
        length: of the data set.
        batch_size: per process.
        seed: of the shuffle.
        rank: of this process.
        processes: how many train together.
        aspect_ratios: width / height of batches; each draws one, and its keys are ``(epoch, index, aspect)``.

    Attributes:
        epoch: of the next pass.
        start: first batch of the next pass, where a resumed one continues.
        left_out: frames that an epoch does not show; others in each epoch.
        smallest_batch: samples of the smallest batch.
    """

    def __init__(
        self,
        length: int,
        batch_size: int,
        *,
        seed: int,
        rank: int = 0,
        processes: int = 1,
        aspect_ratios: Sequence[float] = (),
    ) -> None:
        self.length, self.batch_size, self.seed = length, batch_size, seed
        self.aspect_ratios = aspect_ratios
        self.rank, self.processes = rank, processes
        self.epoch, self.start = 0, 0
        # drop a smaller last batch, whose step would be noisier, unless an epoch has few batches
        together = batch_size * processes
        whole, rest = divmod(length, together)
        self.batches = whole + 1 if rest and whole < FEW_BATCHES else whole
        self.left_out = max(0, length - self.batches * together)
        self.smallest_batch = batch_size if self.left_out else (length % batch_size or batch_size)

    def __len__(self) -> int:
        return self.batches - self.start

    def __iter__(self) -> Iterator[list[SampleKey]]:
        generator = torch.Generator().manual_seed(self.seed * 1_000_003 + self.epoch)
        order = torch.randperm(self.length, generator=generator).tolist()
        aspects: list[tuple[float, ...]] = [()] * self.batches
        if ratios := self.aspect_ratios:
            chosen = torch.randint(len(ratios), (self.batches,), generator=generator)
            aspects = [(ratios[which],) for which in chosen.tolist()]
        for batch in range(self.start, self.batches):
            first = (batch * self.processes + self.rank) * self.batch_size
            # a process without a share of a smaller last batch repeats the first frames
            indices = order[first : first + self.batch_size] or order[: self.batch_size]
            yield [(self.epoch, index, *aspects[batch]) for index in indices]


def collate(samples: list[DepthSample]) -> dict[str, object]:
    """Stack samples of one size.

    Raises:
        ValueError: the sizes differ; names the frames.
    """
    sizes = {_sizes(sample) for sample in samples}
    if len(sizes) > 1:
        names = ", ".join(sample["name"] for sample in samples[:4])
        raise ValueError(
            f"frames of different sizes in one training batch ({names}, ...: {sorted(sizes)}): set "
            "data.input_size"
        )
    batch = default_collate(samples)
    if "augmentation" in batch:
        batch["augmentation"] = leave_out_idle(batch["augmentation"])
    return batch


def collate_runs(samples: list[DepthSample]) -> list[dict[str, object]]:
    """Stack consecutive samples of one size, in their order, into one batch each: for evaluation."""
    return [default_collate(list(run)) for _, run in groupby(samples, key=_sizes)]


def _sizes(sample: DepthSample) -> tuple[tuple[int, ...], ...]:
    return tuple(sample["image"].shape[-2:]), tuple(sample["depth"].shape[-2:])


class Loader(DataLoader):
    """A loader that says what to do when one of its workers was killed."""

    def __iter__(self) -> Iterator[Any]:  # type: ignore[override]
        """Yield batches.

        Raises:
            ChildProcessError: a worker was killed.
        """
        try:
            yield from super().__iter__()
        except (RuntimeError, ConnectionError, EOFError) as error:
            # the last two: it was killed while it handed over a batch, unless they name a worker, whose
            # reading of a frame then raised them
            handing_over = not isinstance(error, RuntimeError) and "DataLoader worker" not in str(error)
            if not handing_over and "exited unexpectedly" not in str(error):
                raise
            raise ChildProcessError(
                "a process that loads data was killed, as happens when memory runs out "
                f"({available_memory() / 1e9:.1f} GB are free now): lower runtime.workers"
            ) from error


def training_loader(
    dataset: DepthDataset, sampler: EpochSampler, *, workers: int = 0, device: str = "cpu"
) -> DataLoader:
    """Return a loader in the order of ``sampler``; set its ``epoch`` and ``start`` before each epoch.

    For a ``device`` other than the CPU, its batches are raw, in pinned memory: :func:`batches_on` makes them
    whole.
    """
    dataset.open_cache()
    return Loader(
        dataset if device == "cpu" else dataset.with_samples(raw_sample),
        batch_sampler=sampler,
        collate_fn=collate,
        pin_memory=device == "cuda",
        **worker_options(workers),
    )


def evaluation_loader(
    dataset: DepthDataset, batch_size: int, *, workers: int = 0, rank: int = 0, processes: int = 1
) -> DataLoader:
    """Return a loader of this process's share of the frames: each frame once, in order, without padding.

    It yields lists of batches of one size each (:func:`collate_runs`). Its workers, at most one per item, are
    there for any number of passes.
    """
    dataset.open_cache()
    share = range(rank, len(dataset), processes)
    batches = [list(share[first : first + batch_size]) for first in range(0, len(share), batch_size)]
    options = worker_options(min(workers, len(batches)))
    return Loader(dataset, batch_sampler=batches, collate_fn=collate_runs, **options)


def batches_on(device: torch.device, loader: DataLoader, *, channels_last: bool) -> Iterator[dict[str, Any]]:
    """Yield the batches of a loader on ``device``, augmented, images in the memory layout of the weights.

    On CUDA the next batch is copied and augmented beside the computation with this one.
    """
    if device.type != "cuda":
        for batch in loader:
            yield to_device(batch, device, channels_last=channels_last)
        return
    beside, waiting = torch.cuda.Stream(device), None
    for batch in loader:
        with torch.cuda.stream(beside):
            moved = to_device(batch, device, channels_last=channels_last)
            copied = beside.record_event()
        if waiting is not None:
            yield _ready(*waiting)
        waiting = moved, copied
    if waiting is not None:
        yield _ready(*waiting)


def _ready(batch: dict[str, Any], copied: torch.cuda.Event) -> dict[str, Any]:
    """Let what follows wait for the batch, on the GPU."""
    stream = torch.cuda.current_stream()
    stream.wait_event(copied)
    for value in batch.values():
        if isinstance(value, Tensor):
            value.record_stream(stream)  # its memory is free once this stream is done with it
    return batch


def to_device(batch: Mapping[str, Any], device: torch.device, *, channels_last: bool) -> dict[str, Any]:
    """Move a batch to ``device`` and augment it there if it is raw; images get the layout of the weights."""
    moved = tree_map_only(Tensor, lambda value: value.to(device, non_blocking=True), dict(batch))
    if "augmentation" in moved:
        moved = augment(moved)
    layout = torch.channels_last if channels_last else torch.contiguous_format
    moved["image"] = moved["image"].contiguous(memory_format=layout)
    return moved
