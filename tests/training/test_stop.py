"""A training says what an epoch is made of, and a signal ends it with everything saved."""

import multiprocessing
import os
import signal
import time
from pathlib import Path

import pytest
from support.training import TWO_WORKERS, digest, fit, make_trainer

from eldenet.data.loaders import EpochSampler, Loader
from eldenet.system.errors import line_of
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


WITH_WORKERS = """
import multiprocessing, os, signal, subprocess, sys
from multiprocessing import forkserver
from pathlib import Path

from support.training import TWO_WORKERS, fit, make_trainer

from eldenet.data import workers
from eldenet.training import trainer

def act():
    if what == "kill":
        server, children = forkserver._forkserver._forkserver_pid, multiprocessing.active_children()
        Path("pids").write_text(" ".join(str(pid) for pid in (server, *(child.pid for child in children))))
        os.kill(os.getpid(), signal.SIGKILL)
    subprocess.run(["kill", "-TERM", "--", f"-{os.getpgid(0)}"])

class Acting(trainer.Trainer):
    def train_step(self, batch, *, update):
        if what != "validation" and self.progress.step == 5:
            act()
        return super().train_step(batch, update=update)

def evaluate_batches(*arguments, advance, **options):
    def act_and_advance(count):
        if what == "validation":
            act()
        advance(count)
    return evaluate(*arguments, advance=act_and_advance, **options)

if __name__ == "__main__":
    what = sys.argv[1]
    workers.PRELOADED = ("torch", "cv2")
    trainer.evaluate_batches, evaluate = evaluate_batches, trainer.evaluate_batches
    fit(Path("run"), trainer=make_trainer(Acting), resources=TWO_WORKERS, transform=None)
"""


def run_with_workers(command_server, folder: Path, what: str):
    (folder / "with_workers.py").write_text(WITH_WORKERS)
    return command_server.run(str(folder / "with_workers.py"), [what], folder)


@pytest.mark.parametrize(("what", "step"), [("training", 6), ("validation", 4)])
def test_a_signal_to_all_processes_stops_at_a_checkpoint(tmp_path, command_server, what, step):
    """As ``timeout`` and SLURM send it."""
    done = run_with_workers(command_server, tmp_path, what)
    assert (done.returncode, done.stderr) == (128 + signal.SIGTERM, "")
    assert load_checkpoint(tmp_path / "run")["progress"]["step"] == step


def test_a_killed_trainer_leaves_no_process(tmp_path, command_server):
    done = run_with_workers(command_server, tmp_path, "kill")
    assert done.returncode == -signal.SIGKILL, done.stderr
    pids = [int(pid) for pid in (tmp_path / "pids").read_text().split()]
    assert len(pids) == 5  # the server, two workers for training and two for validation
    deadline = time.monotonic() + 10  # two seconds on an idle machine
    while any(map(runs, pids)):
        assert time.monotonic() < deadline
        time.sleep(0.1)


def runs(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def test_a_killed_worker_ends_the_training_in_one_line(tmp_path):
    class Killing(Trainer):
        def train_step(self, batch, *, update):
            os.kill(multiprocessing.active_children()[0].pid, signal.SIGKILL)
            return super().train_step(batch, update=update)

    with pytest.raises(ChildProcessError) as error:
        fit(tmp_path, trainer=make_trainer(Killing), resources=TWO_WORKERS, frames=40, transform=None)
    line = line_of(error.value)
    assert "memory" in line
    assert "lower runtime.workers" in line
    assert "\n" not in line


@pytest.mark.parametrize("error", [ConnectionResetError(104, "Connection reset by peer"), EOFError()])
def test_a_worker_killed_while_it_hands_over_a_batch_is_said_in_the_same_line(monkeypatch, error):
    def broken(loader):
        raise error

    monkeypatch.setattr("torch.utils.data.DataLoader.__iter__", broken)
    with pytest.raises(ChildProcessError, match=r"lower runtime\.workers"):
        next(iter(Loader([])))


@pytest.mark.parametrize(
    ("frames", "batches", "left_out"), [(16, 4, 0), (3, 1, 0), (5, 2, 0), (15, 4, 0), (18, 4, 2)]
)
def test_a_short_epoch_shows_every_frame(frames, batches, left_out):
    sampler = EpochSampler(frames, 4, seed=0)
    assert (sampler.batches, sampler.left_out) == (batches, left_out)
    shown = [index for batch in sampler for _, index in batch]
    assert len(shown) == len(set(shown)) == frames - left_out


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
