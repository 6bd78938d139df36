"""How a training's settings travel: which function hands them, or a section of them, to which.

python tests/support/settings_walk.py        prints every step of a tiny training
"""

import json
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from types import FrameType
from typing import Any

TINY = (
    *(
        "model=eldenet_s",
        "data.size=[32,40]",
        "data.input_size=[32,40]",
        "data.frames={train: 8, val: 8, test: 8}",
    ),
    *("trainer.epochs=1", "trainer.batch_size=4", "runtime.workers=0", "runtime.threads=1"),
)
Step = tuple[str, str]  # module and function that hands on, module and function that receives


def walk(folder: Path) -> list[Step]:
    """Train in ``folder`` and return every pair of functions of which one hands the other settings."""
    import eldenet
    from eldenet.compose import compose
    from eldenet.train import TrainSettings, train

    package = str(Path(eldenet.__file__).parent)
    s = compose(TrainSettings, [*TINY, f"output='{folder}'"])
    sections = list(_parts(asdict(s)))
    steps: dict[Step, None] = {}

    def is_settings(value: Any) -> bool:
        if isinstance(value, TrainSettings):
            return True
        return type(value) is dict and value in sections

    def name(frame: FrameType) -> str:
        path = Path(frame.f_code.co_filename).relative_to(package).with_suffix("")
        return f"{'.'.join(path.parts)}:{frame.f_code.co_qualname}"

    def watch(frame: FrameType, event: str, argument: Any) -> None:
        code, caller = frame.f_code, frame.f_back
        if event != "call" or caller is None or not code.co_filename.startswith(package):
            return
        if not caller.f_code.co_filename.startswith(package) or code.co_name.startswith("<"):
            return
        given = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
        if any(is_settings(frame.f_locals.get(one)) for one in given):
            steps[name(caller), name(frame)] = None

    sys.settrace(watch)  # watch returns no tracer of lines, so only calls cost time
    try:
        train(s)
    finally:
        sys.settrace(None)
    return list(steps)


def _parts(value: Any) -> Iterator[Mapping[str, Any]]:
    """A mapping and all below it that say something."""
    if isinstance(value, Mapping) and value:
        yield value
        for one in value.values():
            yield from _parts(one)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        found = walk(Path(place) / "run")
    print(json.dumps(found, indent=1))
