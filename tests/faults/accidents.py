"""Kills at random moments, full disks, two processes in one folder."""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from support import layouts
from support.rooms_network import trained
from support.training import fit, make_trainer

from .campaign import CLEAR, HANG, RAW, SECONDS, SILENT, UNHARMED, Outcome, in_processes, is_clear, judge

REPOSITORY = Path(__file__).resolve().parents[2]


# --- kills --------------------------------------------------------------------------------------------------


def _train(folder: Path) -> None:
    last = folder / "checkpoints/last.pt"
    trainer = make_trainer(epochs=3, checkpoint_every=1, ema_decay=0.9)
    fit(folder, trainer=trainer, ckpt_path=folder if last.is_file() else None)


def _ends(folder: Path) -> list[bytes]:
    """The weights of the best epoch, and the last ones with their average and the optimizer's state."""
    from eldenet.training.checkpoint import load_checkpoint

    state = load_checkpoint(folder)
    parts = {name: state[name] for name in ("model", "ema", "optimizer")}
    flat = [(folder / "model/model.safetensors").read_bytes()]
    for tensor in torch.utils._pytree.tree_leaves(parts):
        flat.append(tensor.numpy().tobytes() if isinstance(tensor, torch.Tensor) else repr(tensor).encode())
    return flat


def kills(folder: Path, number: int) -> list[Outcome]:
    """Each training is killed at up to three random moments and resumed; unharmed if it ends bit-equal."""
    start = time.monotonic()
    (whole,) = in_processes([lambda: _train(folder / "whole")], 10 * SECONDS)
    seconds = time.monotonic() - start
    if whole.what != UNHARMED:
        raise RuntimeError(f"the training without a kill failed: {whole.said}")
    expected = _ends(folder / "whole")
    return [_killed(folder / f"killed{seed}", seed, seconds, expected) for seed in range(number)]


def _killed(folder: Path, seed: int, seconds: float, expected: Sequence[bytes]) -> Outcome:
    generator, count, said = random.Random(seed), 0, None
    for attempt in range(4):
        sys.stdout.flush()
        child = os.fork()
        if not child:
            os.setsid()
            for output in (1, 2):
                os.dup2(os.open(folder.with_suffix(".log"), os.O_RDWR | os.O_CREAT), output)
            try:
                _train(folder)
                os._exit(0)
            except BaseException as error:
                folder.with_suffix(".error").write_text(f"{type(error).__name__}: {error}")
                os._exit(1)
        if attempt < 3:
            time.sleep(generator.uniform(0, seconds))
            os.kill(child, signal.SIGKILL)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        count += code == -signal.SIGKILL
        said = folder.with_suffix(".error")
        if code > 0:
            return Outcome(RAW, f"could not resume: {said.read_text()}")
        if code == 0:
            break
    if _ends(folder) != expected:
        return Outcome(SILENT, f"other weights after {count} kills")
    return Outcome(UNHARMED, f"{count} kills")


# --- a full disk --------------------------------------------------------------------------------------------


def _checkpoint_file(folder: Path) -> None:
    from eldenet.training.checkpoint import save_checkpoint

    save_checkpoint(folder / "last.pt", {"progress": {}, "model": trained().state_dict()})


def _model(folder: Path) -> None:
    trained().save_pretrained(folder)


def _json(folder: Path) -> None:
    from eldenet.system.files import write_json

    write_json(folder / "run.json", {"metrics": {"rmse": 0.5}, "config": ["long"] * 5000})


def _yaml(folder: Path) -> None:
    from eldenet.system.files import write_yaml

    write_yaml(folder / "config.yaml", {"long": ["long"] * 5000})


def _csv(folder: Path) -> None:
    from eldenet.system.files import write_rows

    write_rows(folder / "per_image.csv", ["name", "rmse"], [[f"frame {n}", 0.5] for n in range(5000)])


def _policy(folder: Path) -> None:
    from eldenet.navigation.policy import Navigator

    Navigator.load().save(folder / "policy.safetensors")


def _dqn(folder: Path) -> None:
    from .kinds import _learner

    _learner().save(folder / "dqn.pt")


def _onnx(folder: Path) -> None:
    from eldenet.deploy.onnx_export import write_onnx

    write_onnx(trained(), folder / "net.onnx", (32, 64), batch=1, opset=17)


def _openvino(folder: Path) -> None:
    from eldenet.deploy.onnx_export import write_onnx
    from eldenet.deploy.openvino_export import write_openvino

    source = folder.parent.parent / "source.onnx"  # on another disk
    if not source.is_file():
        write_onnx(trained(), source, (32, 64), batch=1, opset=17)
    write_openvino(source, folder / "net.xml", {})


def _picture(folder: Path) -> None:
    from eldenet.visualization import write_picture

    write_picture(folder / "depth.png", np.random.default_rng(0).integers(0, 255, (300, 300, 3), np.uint8))


WRITERS: dict[str, Callable[[Path], None]] = {
    "last.pt": _checkpoint_file,
    "a model": _model,
    "run.json": _json,
    "config.yaml": _yaml,
    "per_image.csv": _csv,
    "policy.safetensors": _policy,
    "dqn.pt": _dqn,
    "net.onnx": _onnx,
    "net.xml": _openvino,
    "depth.png": _picture,
}
SHARES = (0.0, 0.3, 0.9)  # of the room that a writer needs
BLOCK = 4096


def full_disk(folder: Path) -> dict[str, list[Outcome]] | None:
    """Let every writer write where there is too little room; None where this user may mount nothing."""
    folder.mkdir(parents=True)
    (folder / "disk").mkdir()
    mounting = 'mount -t tmpfs -o size=48m tmpfs "$1" && shift && exec "$@"'
    words = ["unshare", "-rm", "sh", "-c", mounting, "sh", str(folder / "disk")]
    if shutil.which("unshare") is None or subprocess.run([*words, "true"], capture_output=True).returncode:
        return None
    result = folder / "outcomes.json"
    itself = [sys.executable, "-m", "tests.faults", "full-disk", str(folder / "disk"), str(result)]
    ended = subprocess.run([*words, *itself], cwd=REPOSITORY, capture_output=True, text=True)
    if ended.returncode:
        raise RuntimeError(f"the full disk could not be tried: {ended.stderr[-2000:]}")
    return {name: [Outcome(*one) for one in found] for name, found in json.loads(result.read_text()).items()}


def on_this_disk(disk: Path) -> dict[str, list[Outcome]]:
    """Fill ``disk``, a small file system of its own, and write; runs within :func:`full_disk`."""
    return {name: [_write_on(disk, name, share) for share in SHARES] for name in WRITERS}


def _write_on(disk: Path, name: str, share: float) -> Outcome:
    """Clear: one line, and no file but those that stood there before, unchanged."""
    place, ballast = disk / "place", disk / "ballast"

    def write() -> Outcome:
        WRITERS[name](place)
        return Outcome(UNHARMED, "")

    def fill_and_write() -> Outcome:
        size = sum(file.stat().st_size for file in place.rglob("*") if file.is_file())
        before = _files(place)  # written again, as after each epoch: the old file must stay
        free = shutil.disk_usage(disk).free
        with ballast.open("wb") as file:
            file.write(bytes(max(0, free - int(share * size) // BLOCK * BLOCK)))
        found = judge(lambda: WRITERS[name](place), (name, place.name, "left on device"), None)
        after = _files(place)
        if found.what == UNHARMED and after != before:
            return Outcome(SILENT, f"said nothing, but {sorted(after)} are not what they should be")
        if after != before:
            changed = [file for file in {*before, *after} if before.get(file) != after.get(file)]
            return Outcome(RAW, f"left {changed} behind: {found.said}")
        return found

    try:
        first, second = in_processes([write, fill_and_write], 4 * SECONDS)
    finally:
        for path in (place, ballast):
            shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    return second if first.what == UNHARMED else first


def _files(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


# --- two processes in one folder ----------------------------------------------------------------------------


def two_trainings(folder: Path, number: int) -> list[Outcome]:
    """Two commands begin in one run folder: one ends well, the other in one line that names the folder."""
    layouts.folder(folder / "data", count=10)
    return [_two_at_once(folder, folder / f"run{seed}", seed) for seed in range(number)]


def _two_at_once(folder: Path, run: Path, seed: int) -> Outcome:
    command = [
        *(sys.executable, "-m", "eldenet.train", "data=folder", f"data.root={folder / 'data'}"),
        *("model=eldenet_s", "model_name=small", f"output={run}", "data.input_size=[32,64]"),
        *("trainer.epochs=3", "trainer.batch_size=4", "runtime.threads=1", "runtime.workers=0"),
        *("runtime.device=cpu", "ckpt_path=auto"),
    ]
    pipes: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    first = subprocess.Popen(command, cwd=REPOSITORY, **pipes)
    time.sleep(random.Random(seed).uniform(0, 2))
    second = subprocess.Popen(command, cwd=REPOSITORY, **pipes)
    try:
        said = [process.communicate(timeout=10 * SECONDS)[1] for process in (first, second)]
    except subprocess.TimeoutExpired:
        first.kill()
        second.kill()
        return Outcome(HANG, "")
    codes = sorted((first.returncode, second.returncode))
    text = "\n".join(said)
    if "Traceback" in text or not (run / "run.json").is_file():
        return Outcome(RAW, text[-1500:])
    if codes == [0, 0]:
        return Outcome(SILENT, "both ended well, and one result is lost")
    error = next((line for line in text.splitlines() if line.startswith("error:")), "")
    return Outcome(CLEAR if codes == [0, 1] and is_clear(error, (run.name,)) else RAW, text[-1500:])


def two_caches(folder: Path, number: int) -> list[Outcome]:
    """Two processes fill one frame cache, one is killed; whoever reads it then gets whole frames."""
    from .kinds import _read_store, _write_store

    def one(seed: int) -> Outcome:
        path = folder / f"cache{seed}" / "frames.bin"
        path.parent.mkdir(parents=True)
        children = []
        for _ in range(2):
            child = os.fork()
            if not child:
                while True:
                    _write_store(path)
            children.append(child)
        time.sleep(random.Random(seed).uniform(0.02, 0.2))
        for child in children:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
        expected = [(layouts.SMALL.rgb, layouts.SMALL.meters + index) for index in range(2)]
        same = all(
            np.array_equal(mine, theirs)
            for found, wanted in zip(_read_store(path), expected, strict=True)
            for mine, theirs in zip(found, wanted, strict=True)
        )
        return Outcome(UNHARMED if same else SILENT, "")

    return in_processes([partial(one, seed) for seed in range(number)])
