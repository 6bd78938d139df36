"""One frame cache serves many processes, and a training is the same with it."""

import copy
import multiprocessing
import pickle
import time
from pathlib import Path

import pytest
import torch
from support.frame_caches import same
from support.synthetic import SyntheticDepth
from support.training import digest, make_trainer

import eldenet
from eldenet.data.io import ENCODINGS
from eldenet.data.loaders import EpochSampler, training_loader
from eldenet.data.transforms import Augmentation
from eldenet.evaluation.constant_baseline import ConstantPredictor
from eldenet.evaluation.evaluator import evaluate
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.losses.base import WeightedSum, WeightedTerm
from eldenet.losses.pointwise import L1Loss
from eldenet.system.resources import Resources, seed_everything
from eldenet.training.trainer import Trainer, TrainingData
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


@pytest.mark.parametrize("kind", ["ram", "disk"])
def test_workers_share_one_copy(kind: str, tmp_path: Path) -> None:
    frames = 24
    data = Counted(tmp_path / "notes", frames, cache=kind, transform=Augmentation(affine=0.0))
    plain = SyntheticDepth(frames, transform=Augmentation(affine=0.0))
    sampler = EpochSampler(frames, 4, seed=0)
    loader = training_loader(data, sampler, workers=2)
    for epoch in range(3):
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


def test_a_copy_has_a_memory_of_its_own(tmp_path: Path) -> None:
    data = Counted(tmp_path / "notes", 3, cache="ram")
    first = data[0]
    other = copy.deepcopy(data)
    assert same(other[0], first)
    assert same(data[0], first)


def test_no_worker_outlives_its_loader(tmp_path: Path) -> None:
    data = SyntheticDepth(6)
    model = ConstantPredictor(torch.full((1, 1, 32, 48), 4.0))
    alone = evaluate(model, data, PROTOCOL, batch_size=4)
    assert evaluate(model, data, PROTOCOL, batch_size=4, workers=2) == alone
    assert multiprocessing.active_children() == []
    train(tmp_path, workers=1)
    assert multiprocessing.active_children() == []


def train(folder: Path, *, cache: str = "none", workers: int = 0, epochs: int = 2, **options):
    seed_everything(0)
    folder.mkdir(exist_ok=True)
    resources = Resources(device="cpu", precision="fp32", threads=1, workers=workers, cores=2)
    data = Counted(folder / "notes", 12, cache=cache, transform=Augmentation())
    loss = WeightedSum({"l1": WeightedTerm(L1Loss())})
    trainer = make_trainer(epochs=epochs, checkpoint_every=1)
    model = eldenet.load("eldenet_s").train()
    return trainer.fit(
        model, loss, TrainingData(data, SyntheticDepth(4), PROTOCOL), folder, resources, **options
    )


def test_cached_training_is_the_training_resumed_too(tmp_path: Path, monkeypatch) -> None:
    train(tmp_path / "plain")
    train(tmp_path / "ram", cache="ram", workers=1)
    assert digest(tmp_path / "ram") == digest(tmp_path / "plain")

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

    loss = WeightedSum({"l1": WeightedTerm(L1Loss())})
    resources = Resources(device="cpu", precision="fp32", threads=1, workers=0, cores=2)
    model = eldenet.load("eldenet_s").train()
    progress = make_trainer(epochs=1).fit(
        model, loss, TrainingData(Slow(8), SyntheticDepth(2), PROTOCOL), tmp_path, resources
    )
    assert 0.4 <= progress.waited < 5


def test_encodings_travel_to_workers() -> None:
    for encoding in ENCODINGS.values():
        assert pickle.loads(pickle.dumps(encoding)) == encoding
