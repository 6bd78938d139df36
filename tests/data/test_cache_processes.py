"""One frame cache serves many processes, and a training is the same with it."""

import multiprocessing
import time
from pathlib import Path

import pytest
import torch
from support.frame_caches import same
from support.synthetic import SyntheticDepth
from support.training import digest, fit

from eldenet.data.loaders import EpochSampler, training_loader
from eldenet.data.transforms import Augmentation
from eldenet.evaluation.constant_baseline import ConstantPredictor
from eldenet.evaluation.evaluator import evaluate
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.system.resources import Resources
from eldenet.training.trainer import Trainer
from eldenet.types import Frame

pytestmark = pytest.mark.usefixtures("store_folder")
PROTOCOL = EvalProtocol("synthetic", min_depth=0.1, ground_truth="dense")


class Counted(SyntheticDepth):
    """Notes every read of a frame in a file, whichever process reads it."""

    def __init__(self, notes: Path, frames: int, **options) -> None:
        super().__init__(frames, **options)
        self.notes = notes

    def frame_files(self, index: int) -> list[Path]:
        return [Path(__file__)]

    def load_frame(self, index: int) -> Frame:
        with self.notes.open("a") as file:
            file.write(f"{index}\n")
        return super().load_frame(index)

    def reads(self) -> int:
        return len(self.notes.read_text().splitlines())


@pytest.mark.slow
def test_workers_share_one_copy(tmp_path: Path) -> None:
    frames = 12
    data = Counted(tmp_path / "notes", frames, cache="disk", transform=Augmentation(affine=0.0))
    plain = SyntheticDepth(frames, transform=Augmentation(affine=0.0))
    sampler = EpochSampler(frames, 4, seed=0)
    loader = training_loader(data, sampler, workers=2)
    for epoch in range(2):
        sampler.epoch = epoch
        seen = 0
        for batch in loader:
            for row, name in enumerate(batch["name"]):
                expected = plain[epoch, int(name.split("/")[1])]
                assert torch.equal(batch["image"][row], expected["image"])
                assert torch.equal(batch["depth"][row], expected["depth"])
                seen += 1
        assert seen == frames
        # one more told the size; which worker has which frame changes with every epoch
        assert data.reads() == frames + 1
    assert all(same(data[5, index], plain[5, index]) for index in range(frames))  # and so does this process
    assert data.reads() == frames + 1


def test_no_worker_outlives_its_loader(tmp_path: Path) -> None:
    data = SyntheticDepth(6)
    model = ConstantPredictor(torch.full((1, 1, 32, 48), 4.0))
    alone = evaluate(model, data, PROTOCOL, batch_size=4)
    assert evaluate(model, data, PROTOCOL, batch_size=4, workers=2) == alone
    assert multiprocessing.active_children() == []
    train(tmp_path, workers=1)
    assert multiprocessing.active_children() == []


def train(folder: Path, *, cache: str = "none", workers: int = 0, **options):
    folder.mkdir(exist_ok=True)
    resources = Resources(device="cpu", precision="fp32", threads=1, workers=workers, cores=2)
    data = Counted(folder / "notes", 12, cache=cache, transform=Augmentation())
    return fit(folder, data=data, val_frames=4, resources=resources, checkpoint_every=1, **options)


@pytest.mark.slow
def test_cached_training_is_the_training_resumed_too(tmp_path: Path, monkeypatch) -> None:
    train(tmp_path / "plain")
    train(tmp_path / "whole", cache="disk", workers=1)
    assert digest(tmp_path / "whole") == digest(tmp_path / "plain")

    class Stopped(Exception):
        pass

    def stop(self, batch, *, update, count=[0]):  # noqa: B006
        count[0] += 1
        if count[0] == 5:
            raise Stopped
        return original(self, batch, update=update)

    original = Trainer.train_step
    monkeypatch.setattr(Trainer, "train_step", stop)
    with pytest.raises(Stopped):
        train(tmp_path / "disk", cache="disk")
    monkeypatch.setattr(Trainer, "train_step", original)
    train(tmp_path / "disk", cache="disk", workers=1, ckpt_path=tmp_path / "disk")
    assert digest(tmp_path / "disk") == digest(tmp_path / "plain")


def test_the_wait_for_data_is_counted(tmp_path: Path) -> None:
    class Slow(SyntheticDepth):
        def load_frame(self, index: int) -> Frame:
            time.sleep(0.05)
            return super().load_frame(index)

    *_, progress = fit(tmp_path, data=Slow(8), val_frames=2, epochs=1)
    assert 0.4 <= progress.waited < 5
