"""A training says what an epoch is made of, and a signal ends it with everything saved."""

import os
import signal

import pytest
from support.training import digest, fit, make_trainer

from eldenet.data.loaders import EpochSampler
from eldenet.training.checkpoint import load_checkpoint
from eldenet.training.trainer import Trainer


@pytest.fixture(autouse=True)
def interrupts():
    """Ctrl-C as in a terminal: a suite that was started with ``&`` has it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def signaled_at(call: int, number: int) -> type[Trainer]:
    """Trainers that get a signal in their ``call``-th step."""

    class Signaled(Trainer):
        calls = 0

        def train_step(self, batch, *, update):
            Signaled.calls += 1
            if Signaled.calls == call:
                os.kill(os.getpid(), number)
            return super().train_step(batch, update=update)

    return Signaled


@pytest.mark.parametrize(
    ("number", "end"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, SystemExit)]
)
def test_a_signal_saves_the_current_update_and_the_rest_gives_the_same_weights(tmp_path, number, end):
    fit(tmp_path / "whole", epochs=2)
    with pytest.raises(end):
        fit(tmp_path / "part", trainer=make_trainer(signaled_at(6, number)))
    progress = load_checkpoint(tmp_path / "part")["progress"]
    assert (progress["epoch"], progress["batch"], progress["step"]) == (1, 2, 6)
    fit(tmp_path / "part", trainer=make_trainer(), ckpt_path=tmp_path / "part")
    assert digest(tmp_path / "part") == digest(tmp_path / "whole")


@pytest.mark.parametrize(
    ("frames", "batches", "left_out"), [(16, 4, 0), (3, 1, 0), (5, 2, 0), (15, 4, 0), (18, 4, 2)]
)
def test_a_short_epoch_shows_every_frame(frames, batches, left_out):
    sampler = EpochSampler(frames, 4, seed=0)
    assert (sampler.batches, sampler.left_out) == (batches, left_out)
    shown = [index for batch in sampler for _, index in batch]
    assert len(shown) == len(set(shown)) == frames - left_out


@pytest.mark.parametrize(
    ("frames", "line"),
    [
        (16, "16 frames, batch 4: 4 updates an epoch\n"),
        (18, "18 frames, batch 4: 4 updates an epoch, which leaves out 2 frames, others each time\n"),
        (3, "3 frames, batch 4: 1 update an epoch, the last batch with 3 frames\n"),
    ],
)
def test_a_training_says_what_an_epoch_is_made_of(tmp_path, capsys, frames, line):
    fit(tmp_path, trainer=make_trainer(epochs=1), frames=frames)
    assert line in capsys.readouterr().out


INTERRUPTED = """
import os, signal, sys
import eldenet.train

eldenet.train.train = lambda *_: os.kill(os.getpid(), signal.SIGTERM)
from eldenet.train import main

sys.argv = ["eldenet train", "loss=l1", "data.root='my rooms'", "output=run"]
main()
"""


def test_an_interrupted_command_ends_with_the_command_that_goes_on(tmp_path, command_server):
    (tmp_path / "interrupted.py").write_text(INTERRUPTED)
    done = command_server.run(str(tmp_path / "interrupted.py"), [], tmp_path)
    assert done.returncode == 130
    (line,) = done.stderr.splitlines()
    assert line.startswith("stopped; to continue: eldenet train loss=l1 'data.root='")
    assert line.endswith("/run ckpt_path=auto")
