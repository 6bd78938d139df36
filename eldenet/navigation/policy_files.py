"""Where policies lie; finding them loads no torch."""

from collections.abc import Sequence
from pathlib import Path

DEFAULT_WEIGHTS = Path(__file__).resolve().parent.parent / "weights" / "arena_dqn.safetensors"
POLICY = "policy.safetensors"  # in the run folder of a training


def policy_files(path: str | Path | Sequence[str | Path] | None) -> list[Path]:
    """Files for :meth:`Navigator.load`: a run folder stands for its policy, None for the packaged one.

    Raises:
        FileNotFoundError: there is no such file.
    """
    given = DEFAULT_WEIGHTS if path is None else path
    paths = [given] if isinstance(given, str | Path) else given
    files = [Path(each) / POLICY if Path(each).is_dir() else Path(each) for each in paths]
    for file in files:
        if not file.is_file():
            raise FileNotFoundError(
                f"no policy at {file}: give a policy file or the run folder of a finished training (python "
                "-m eldenet.navigate mode=train)"
            )
    return files
