"""Run ``python -m <module>`` in a process of its own without seconds of imports each time.

A server (``python tests/support/commands.py``) holds the imports and forks for every command, which has its
own folder, environment and exit code and shares nothing with the tests.
"""

import atexit
import gc
import glob
import json
import os
import runpy
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

#: What trainings, evaluations and drives load; what is missing here costs each command its import again.
PRELOADED = (
    "accelerate", "albumentations", "cv2", "hydra.main", "matplotlib.pyplot", "mujoco", "scipy.stats",
    "tabulate", "torch._inductor.config", "torch.distributed", "torch.utils.flop_counter",
    "torch.utils.tensorboard",
    "eldenet.backbones.pplcnet", "eldenet.data.folder", "eldenet.data.kitti", "eldenet.data.nyu",
    "eldenet.data.rooms", "eldenet.data.transforms", "eldenet.decoders.fast_upconv",
    "eldenet.evaluation.metrics",
    "eldenet.navigation.env", "eldenet.navigation.visualization",
    "eldenet.results.score", "eldenet.results.tables",
    "eldenet.training.trainer", "eldenet.zoo",
)  # fmt: skip


class CommandServer:
    """Runs commands one after another.

    Args:
        environment: of the server and its commands.
        preloaded: modules that the server imports.
    """

    def __init__(self, environment: dict[str, str], preloaded: Sequence[str] = PRELOADED) -> None:
        self.process = subprocess.Popen(
            [sys.executable, __file__, *preloaded],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def run(
        self,
        module: str,
        arguments: Sequence[str],
        cwd: Path,
        *,
        environment: dict[str, str] | None = None,
        timeout: float = 240,
        interrupt_at: str | None = None,
        number: signal.Signals = signal.SIGINT,
        delay: float = 0.0,
    ) -> subprocess.CompletedProcess[str]:
        """Like :func:`subprocess.run` with captured output; a command that takes too long is killed.

        Args:
            module: such as ``eldenet.train``, or the path of a script.
            arguments: of the command.
            cwd: where it runs.
            environment: what it has beside the server's.
            timeout: [s].
            interrupt_at: pattern of files below ``cwd``; ``number`` is sent once one of them is written.
            number: of the signal; it goes to the command and all its processes, as a terminal's Ctrl-C does.
            delay: from the file to the signal [s].
        """
        pattern = None if interrupt_at is None else str(cwd / interrupt_at)
        job = {"module": module, "arguments": arguments, "cwd": str(cwd), "environment": environment or {}}
        job |= {"interrupt_at": pattern, "number": number, "delay": delay}
        (done,) = self._run([job], timeout)
        return done

    def run_ranks(
        self, module: str, arguments: Sequence[str], cwd: Path, *, timeout: float = 240
    ) -> list[subprocess.CompletedProcess[str]]:
        """Run two processes of one training, with what ``torchrun`` tells them in their environment."""
        with socket.socket() as free:
            free.bind(("localhost", 0))
            port = free.getsockname()[1]
        shared = {"WORLD_SIZE": "2", "LOCAL_WORLD_SIZE": "2", "MASTER_ADDR": "localhost"}
        shared |= {"MASTER_PORT": str(port)}
        job = {"module": module, "arguments": arguments, "cwd": str(cwd), "interrupt_at": None}
        ranks = ({"RANK": str(rank), "LOCAL_RANK": str(rank)} for rank in range(2))
        return self._run([job | {"environment": shared | rank} for rank in ranks], timeout)

    def _run(self, jobs: list[dict[str, Any]], timeout: float) -> list[subprocess.CompletedProcess[str]]:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        with tempfile.TemporaryDirectory() as folder:
            for index, job in enumerate(jobs):
                job["outputs"] = [f"{folder}/{index}.{name}" for name in ("stdout", "stderr")]
            self.process.stdin.write(json.dumps({"jobs": jobs, "timeout": timeout}) + "\n")
            self.process.stdin.flush()
            codes = json.loads(self.process.stdout.readline())
            done = [
                subprocess.CompletedProcess(
                    [job["module"], *job["arguments"]],
                    code,
                    *(Path(file).read_text() for file in job["outputs"]),
                )
                for job, code in zip(jobs, codes, strict=True)
            ]
        if None in codes:
            late = done[codes.index(None)]
            raise subprocess.TimeoutExpired(late.args, timeout, late.stdout, late.stderr)
        return done

    def close(self) -> None:
        """End the server."""
        self.process.communicate()


def serve() -> None:
    """Fork for the jobs of every line of standard input and answer with exit codes, null after a timeout."""
    sys.path.append(str(Path(__file__).resolve().parents[1]))  # as pytest has it: scripts may import support
    for name in sys.argv[1:]:
        __import__(name)
    if "torch" in sys.modules:
        from support.composing import compose_each_choice_once, composed
        from support.timings import short_timings

        short_timings()
        compose_each_choice_once()
        for command in ("train", "evaluate", "predict"):  # so that their files are parsed
            composed(command)
            del sys.modules[f"eldenet.{command}"]  # each child starts its own
    gc.freeze()  # so that children do not copy every page when they collect
    for line in sys.stdin:
        order = json.loads(line)
        deadline = time.monotonic() + order["timeout"]
        children = [_fork(job) for job in order["jobs"]]
        before = [_last_written(job["interrupt_at"]) for job in order["jobs"]]
        codes: dict[int, int] = {}
        while len(codes) < len(children) and time.monotonic() < deadline:
            for child, job, start in zip(children, order["jobs"], before, strict=True):
                if child in codes:
                    continue
                ended, status = os.waitpid(child, os.WNOHANG)
                if ended:
                    codes[child] = os.waitstatus_to_exitcode(status)
                elif _last_written(job["interrupt_at"]) > start:
                    time.sleep(job["delay"])
                    os.killpg(child, job["number"])
                    job["interrupt_at"] = None
            time.sleep(0.01)
        for child in children:
            if child not in codes:
                os.killpg(child, signal.SIGKILL)
                os.waitpid(child, 0)
        print(json.dumps([codes.get(child) for child in children]), flush=True)


def _last_written(pattern: str | None) -> int:
    """Return when a file of the pattern was last written [ns]; 0 if there is none."""
    return max((os.stat(file).st_mtime_ns for file in glob.glob(pattern or "")), default=0)


def _fork(job: dict[str, Any]) -> int:
    child = os.fork()
    if not child:
        _become(job)
    return child


def _become(job: dict[str, Any]) -> None:
    """Turn this process into the command; never returns."""
    os.setsid()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's ``&`` has it ignored
    for number, path in enumerate(("/dev/null", *job["outputs"])):
        os.dup2(os.open(path, os.O_RDWR | os.O_CREAT), number)
    os.chdir(job["cwd"])
    os.environ.update(job["environment"])
    sys.path[0] = job["cwd"]  # as python -m has it
    sys.argv = ["", *job["arguments"]]
    code: Any = 1
    try:
        if job["module"].endswith(".py"):
            runpy.run_path(job["module"], run_name="__main__")
        else:
            runpy.run_module(job["module"], run_name="__main__", alter_sys=True)
        code = 0
    except SystemExit as end:
        code = end.code
    except BaseException:
        sys.excepthook(*sys.exc_info())
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code if isinstance(code, int) else 0 if code is None else 1)  # skips the imports' clean-up


if __name__ == "__main__":
    serve()
    os._exit(0)
