"""A training step neither waits for an accelerator nor copies from the host, for each loss and head.

Checked without one, twice. Fake tensors of a GPU refuse whatever needs a value or another device's tensor;
they have no backward pass. Then real steps of a trainer on the CPU are watched for what would wait.
"""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
import torch
from support.steps import CHOICES, parts
from support.synthetic import SyntheticDepth
from support.training import ONE_THREAD, PROTOCOL, make_trainer
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.utils._python_dispatch import TorchDispatchMode

from eldenet.losses import ssim
from eldenet.losses.base import LossInputs
from eldenet.losses.distillation import DistilledTerm
from eldenet.training.loss_meter import LossMeter
from eldenet.training.trainer import Trainer, TrainingData

SIZE = (4, 48, 64)
WAITS = ("_local_scalar_dense", "nonzero", "masked_select", "unique", "lift_fresh")


class Watch(TorchDispatchMode):
    """Notes operations that make the host wait, and copies between devices."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        result = func(*args, **(kwargs or {}))
        name = func.overloadpacket.__name__
        places = {each.device.type for each in (*args, result) if isinstance(each, torch.Tensor)}
        indices = args[1] if name in ("index", "index_put", "index_put_") else ()
        by_mask = any(index is not None and index.dtype == torch.bool for index in indices)
        if name.startswith(WAITS) or by_mask or (name in ("_to_copy", "copy_") and len(places) > 1):
            self.found.append(name)
        return result


@contextmanager
def watched() -> Iterator[list[str]]:
    """Collect what would wait for a GPU: operations, and Python's ways to read or make a tensor."""
    with ExitStack() as stack:
        watch = stack.enter_context(Watch())

        def noting(owner: Any, name: str) -> None:
            original = getattr(owner, name)

            def call(*args, **kwargs):
                watch.found.append(name)
                return original(*args, **kwargs)

            stack.enter_context(patch.object(owner, name, call))

        for name in ("item", "tolist", "cpu", "numpy", "__bool__", "__float__", "__int__"):
            noting(torch.Tensor, name)
        noting(torch, "tensor")
        noting(torch, "from_numpy")
        yield watch.found


@pytest.fixture(autouse=True)
def _no_fake_tensors_are_kept() -> Iterator[None]:
    ssim._blur_matrix.cache_clear()
    yield
    ssim._blur_matrix.cache_clear()


@pytest.mark.slow
@pytest.mark.parametrize("choice", CHOICES, ids=str)
def test_network_and_loss_need_nothing_of_the_host_on_a_gpu(choice: list[str]) -> None:
    with FakeTensorMode():
        with torch.device("cuda"):
            model, loss = parts(choice)
            image, depth = torch.rand(SIZE[0], 3, *SIZE[1:]), 1 + torch.rand(SIZE[0], 1, *SIZE[1:])
            focal, relative = torch.full(SIZE[:1], 60.0), torch.zeros(SIZE[:1], dtype=torch.bool)
        model.train()._range_checked = True  # by the first step
        loss.setup(model)
        for term in loss.terms.values():
            if isinstance(term, DistilledTerm):  # fake tensors cannot be moved
                term.teacher._place = image.device, torch.contiguous_format
                term.teacher.network._range_checked = True

        def step() -> None:
            found = model(image, focal, with_spread=loss.needs_spread)
            prediction, spread = found if loss.needs_spread else (found, None)
            total, _ = loss(LossInputs(prediction, depth, depth > 1.5, image, focal, relative, spread))
            assert total.device.type == "cuda"

        step()
        with watched() as found:
            step()
    assert not found


@pytest.mark.parametrize("choice", CHOICES, ids=str)
def test_a_step_between_two_log_points_waits_for_nothing(
    choice: list[str], tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setattr(ssim, "_known_everywhere", lambda mask: False)  # as on a GPU
    steps: list[list[str]] = []

    class Watched(Trainer):
        def train_step(self, batch, *, update):
            with watched() as found:
                terms = super().train_step(batch, update=update)
                LossMeter({}, eager=False).add(0, terms)
            steps.append(list(found))
            return terms

    model, loss = parts(choice)
    trainer = make_trainer(
        Watched,
        epochs=1,
        max_grad_norm=1.0,
        accumulate_grad_batches=2,
        optimizer=partial(torch.optim.Adam, lr=1e-4, fused=True),
    )
    frames = SyntheticDepth(16)
    trainer.fit(model.train(), loss, TrainingData(frames, SyntheticDepth(2), PROTOCOL), tmp_path, ONE_THREAD)
    assert not any(steps[1:])  # the first one checks the images
