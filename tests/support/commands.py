"""Run ``python -m eldenet.<command>`` in a process of its own without seconds of imports each time.

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
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

PRELOADED = (
    "accelerate", "albumentations", "cv2", "hydra.main", "scipy.stats", "torch.utils.tensorboard",
    "eldenet.training.trainer", "eldenet.results.score", "eldenet.results.tables", "eldenet.zoo",
    "eldenet.data.rooms",
    "eldenet.data.nyu", "eldenet.data.kitti", "eldenet.data.folder", "eldenet.data.transforms",
)  # fmt: skip


class CommandServer:
    """Runs commands one after another.

    Args:
        environment: of the server and its commands.
    """

    def __init__(self, environment: dict[str, str]) -> None:
        self.process = subprocess.Popen(
            [sys.executable, __file__],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def run(
        self,
        command: str,
        arguments: tuple[str, ...],
        cwd: Path,
        environment: dict[str, str],
        timeout: float,
        interrupt_at: str | None = None,
    ) -> subprocess.CompletedProcess[str]:
        """Like :func:`subprocess.run` with captured output; a command that takes too long is killed.

        Ctrl-C is sent once a file of the pattern ``interrupt_at`` exists.
        """
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        with tempfile.TemporaryDirectory() as folder:
            outputs = [Path(folder) / name for name in ("stdout", "stderr")]
            job = {
                "module": f"eldenet.{command}",
                "arguments": arguments,
                "cwd": str(cwd),
                "environment": environment,
                "outputs": [str(path) for path in outputs],
                "timeout": timeout,
                "interrupt_at": None if interrupt_at is None else str(cwd / interrupt_at),
            }
            self.process.stdin.write(json.dumps(job) + "\n")
            self.process.stdin.flush()
            code = json.loads(self.process.stdout.readline())
            texts = [path.read_text() for path in outputs]
        if code is None:
            raise subprocess.TimeoutExpired([command, *arguments], timeout, *texts)
        return subprocess.CompletedProcess([command, *arguments], code, *texts)

    def close(self) -> None:
        """End the server."""
        self.process.communicate()


def serve() -> None:
    """Fork for every line of standard input and answer with the exit code, null after a timeout."""
    for name in PRELOADED:
        __import__(name)
    gc.freeze()  # so that children do not copy every page when they collect
    for line in sys.stdin:
        job = json.loads(line)
        child = os.fork()
        if not child:
            _become(job)
        deadline = time.monotonic() + job["timeout"]
        interrupt_at = job["interrupt_at"]
        while not (ended := os.waitpid(child, os.WNOHANG))[0] and time.monotonic() < deadline:
            if interrupt_at and glob.glob(interrupt_at):
                os.kill(child, signal.SIGINT)
                interrupt_at = None
            time.sleep(0.01)
        if not ended[0]:
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
        print(json.dumps(os.waitstatus_to_exitcode(ended[1]) if ended[0] else None), flush=True)


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
