"""``mix``: several data sets in one training, drawn by weight."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self, Unpack

import numpy as np
import torch

from eldenet.data.base import DepthDataset, MakeSample, SampleKey, SampleOptions
from eldenet.system.digests import digest_of
from eldenet.types import DepthSample, Frame


@dataclass(frozen=True)
class Source:
    """One data set of a mix."""

    dataset: DepthDataset
    weight: float  # its share of the draws, relative to the other weights
    # depth is known up to a factor (and a shift) only: only loss terms with applies_to: relative count it
    relative: bool


class Mix(DepthDataset):
    """Draws from several data sets, each with its own range, camera and cache.

    Sample ``(epoch, i)`` is of a source chosen by weight and of a frame of it chosen at random, both drawn
    from ``(seed, epoch, i)`` alone. ``names`` are the frames of all sources, ``len`` is the draws per epoch.

    Args:
        sources: name -> ``{data: ..., weight: 1.0, relative: false}``, where ``data`` takes the keywords of
            :class:`~eldenet.data.base.DepthDataset` and returns a data set (``_partial_: true`` in YAML). A
            source of weight 0 is left out.
        frames: draws of an epoch.
        **options: for every source; its own settings come first.

    Raises:
        ValueError: no source has a weight, or a weight is out of range.
    """

    def __init__(
        self, sources: Mapping[str, Mapping[str, Any]], frames: int, **options: Unpack[SampleOptions]
    ) -> None:
        built = {name: _source(name, given, options) for name, given in sources.items()}
        self.sources = {name: source for name, source in built.items() if source is not None}
        if not self.sources:
            raise ValueError("no source has a weight above 0: give one to at least one of them")
        parts = [source.dataset for source in self.sources.values()]
        super().__init__(
            [f"{name}/{frame}" for name, source in self.sources.items() for frame in source.dataset.names],
            min_depth=min(part.min_depth for part in parts),
            max_depth=max(part.max_depth for part in parts),
            **{name: options[name] for name in ("input_size", "seed") if name in options},  # type: ignore[arg-type]
        )
        self.frames = frames
        self.skipped = {
            f"{name}/{frame}": reason
            for name, source in self.sources.items()
            for frame, reason in source.dataset.skipped.items()
        }
        self._ends = np.cumsum([len(part) for part in parts])
        weights = np.array([source.weight for source in self.sources.values()])
        self._shares = weights / weights.sum()

    def __len__(self) -> int:
        return self.frames

    def __getitem__(self, key: SampleKey) -> DepthSample:
        epoch, index, *aspect = key if isinstance(key, tuple) else (0, key)
        generator = np.random.default_rng((self.seed, epoch, index))
        source = list(self.sources.values())[generator.choice(len(self._shares), p=self._shares)]
        place = int(generator.integers(len(source.dataset)))
        # one draw, one augmentation: a frame that an epoch draws twice is augmented in two ways
        draw = epoch * self.frames + index, place
        sample = source.dataset[(*draw, aspect[0]) if aspect else draw]
        sample["relative"] = torch.tensor(source.relative)
        return sample

    def draw_subset(self, places: int | Sequence[int], seed: int) -> None:
        """Raise ValueError: an epoch draws from whole sources."""
        raise ValueError(
            f"subset={places}: a mix has no subset, because it draws from whole sources: set data.frames for "
            "fewer draws per epoch, or data.sources.<name>.weight for a source's share"
        )

    def load_frame(self, index: int) -> Frame:
        """Read frame ``index`` of ``names``."""
        part, place = self._place(index)
        return part.load_frame(place)

    def frame_files(self, index: int) -> Sequence[Path]:
        """Return the files of frame ``index`` of ``names``."""
        part, place = self._place(index)
        return part.frame_files(place)

    def _place(self, index: int) -> tuple[DepthDataset, int]:
        """The source of frame ``index`` of ``names``, and the frame's number there."""
        which = int(np.searchsorted(self._ends, index, side="right"))
        part = list(self.sources.values())[which].dataset
        return part, index - int(self._ends[which]) + len(part)

    def with_samples(self, make_sample: MakeSample) -> Self:
        """Return the same mix with other samples of its sources."""
        other = super().with_samples(make_sample)
        other.sources = {
            name: replace(source, dataset=source.dataset.with_samples(make_sample))
            for name, source in self.sources.items()
        }
        return other

    def open_cache(self) -> None:
        """Open the cache of every source."""
        for source in self.sources.values():
            source.dataset.open_cache()

    @property
    def split_hash(self) -> str:
        """Names the mix in reports: every source's split, weight and kind, and the draws of an epoch."""
        parts = [
            f"{name} {source.dataset.split_hash} {source.weight!r} {source.relative}"
            for name, source in self.sources.items()
        ]
        return digest_of("\n".join([*parts, str(self.frames)]))[:16]


def _source(name: str, given: Mapping[str, Any], options: SampleOptions) -> Source | None:
    """Build a source without its unreadable frames, if they are to be skipped; None for one of weight 0."""
    unknown = set(given) - {"data", "weight", "relative"}
    if unknown or "data" not in given:
        raise ValueError(f"sources.{name}: give data, weight and relative, not {', '.join(sorted(given))}")
    weight = float(given.get("weight", 1.0))
    if not 0 <= weight < float("inf"):
        raise ValueError(f"sources.{name}.weight={weight}: give 0 (left out) or more")
    if weight == 0:
        return None
    build: Callable[..., DepthDataset] = given["data"]
    own = getattr(build, "keywords", {})  # the source's own settings come first
    dataset = build(**{option: value for option, value in options.items() if own.get(option) is None})
    if dataset.on_error == "skip":
        dataset.leave_out_unreadable()
    return Source(dataset, weight, bool(given.get("relative", False)))
