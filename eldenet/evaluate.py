"""``python -m eldenet.evaluate``: score any checkpoint or exported file on any data set, by any protocol.

python -m eldenet.evaluate checkpoint=runs/my-run data=nyu_labelled protocol=nyu_inpainted_eigen
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import eldenet
from eldenet.cli.entry_point import entry_point
from eldenet.compose import REQUIRED, listed
from eldenet.data.splits import check_folders, split_settings
from eldenet.deploy.runtimes import check_installed
from eldenet.geometry import size_of_aspect
from eldenet.system.checks import at_least
from eldenet.system.resources import choose_resources
from eldenet.weights import find_checkpoint

if TYPE_CHECKING:
    from eldenet.deploy.runtimes.module import RuntimeNetwork
    from eldenet.evaluation.protocol import EvalProtocol
    from eldenet.evaluation.splits import OwnShape
    from eldenet.model import DepthNet
    from eldenet.results.run_log import RunLog
    from eldenet.system.resources import Resources


@dataclass(frozen=True)
class EvaluateSettings:
    """What ``python -m eldenet.evaluate`` reads."""

    data: dict[str, Any] = REQUIRED
    runtime: dict[str, Any] = REQUIRED
    protocol: dict[str, Any] | None = None  # a name from configs/protocol; null: the data set's own
    # run, model folder, Hub id, packaged weights, or an exported .onnx or .xml file
    checkpoint: str = REQUIRED
    engine: str = "auto"  # for exported files: onnxruntime, openvino, or auto (the fastest)
    precision: str | None = None  # for exported files: bf16 (openvino only); null: the file's own
    split: str = "test"  # train, val or test
    # [height, width] of the network's input; model: as in training, at the same scale, and as predict in the
    # frames' own aspect ratio; data: data.input_size
    input_size: Any = "model"
    # folder: fit the temperature of the network's sigma on these frames and save the network there
    calibrated: str | None = None
    batch_size: int = 16
    trusted_modules: Any = field(default_factory=list)  # packages whose classes foreign weights may name
    output: str = "runs/evaluate-${data.name}-${now:%Y%m%d-%H%M%S}"  # folder of run.json

    def __post_init__(self) -> None:
        at_least(1, batch_size=self.batch_size)
        size = self.input_size
        pair = isinstance(size, list) and [type(side) for side in size] == [int, int] and min(size) >= 1
        if size not in ("model", "data") and not pair:
            raise ValueError(f"input_size={size}: give [height, width] in pixels, or model or data")


def evaluate(s: EvaluateSettings) -> dict[str, Any]:
    """Load, score, measure, write ``run.json`` and show the table.

    Returns:
        What was written to ``run.json``.

    Raises:
        ValueError: the settings do not fit the checkpoint or the protocol, or the folder holds a training.
        FileNotFoundError: there are no such frames, or there is no such checkpoint.
    """
    check_folders(s.data)
    checkpoint = find_checkpoint(s.checkpoint, "checkpoint")
    check_installed(s.checkpoint, s.engine)
    split_settings(s.data, s.split)
    folder = Path(s.output)
    if (folder / "checkpoints").is_dir():
        raise ValueError(
            f"output={folder} holds a training, whose run.json this would replace: give another folder"
        )
    from eldenet.evaluation.splits import chosen_protocol
    from eldenet.results.run_log import RunLog, untrained_note
    from eldenet.results.score import score
    from eldenet.results.tables import closing_table
    from eldenet.training.notes import collapse

    resources = choose_resources(**s.runtime)
    protocol = chosen_protocol(s.data, s.protocol)
    model = open_checkpoint(s, resources)
    folder.mkdir(parents=True, exist_ok=True)
    log = RunLog(folder)
    if checkpoint.kind == "network":
        log.say(untrained_note(s.checkpoint))
    size = chosen_size(s, protocol, model, log)
    takes_lens = model.canonical_px is not None and protocol.scale == "metric"
    if takes_lens and (name := without_lens(s, protocol)):
        what, advice = "for the lens of the training", "give data.intrinsics"
        if not at_training_size(s, model):
            what, advice = f"{what} and at its size", f"{advice}, and else input_size=model"
        log.say(f"note: frames such as {name} have no intrinsics, so meters are only right {what}: {advice}")
    if s.calibrated is not None:
        calibrate(s, Path(s.calibrated).expanduser(), protocol, resources, model, size, log)
    record = score(model, asdict(s), protocol, resources, log, input_size=size, measure=_measure)
    if line := collapse(record):
        log.say(line)
    closing_table(log, record)
    return record


def open_checkpoint(s: EvaluateSettings, resources: "Resources") -> "DepthNet | RuntimeNetwork":
    """Return a model for torch, or an exported file under ``s.engine``.

    A file runs on an accelerator only where that was asked for: it needs another build of its runtime.
    """
    from eldenet.deploy import runtimes
    from eldenet.deploy.runtimes.module import RuntimeNetwork

    if find_checkpoint(s.checkpoint, "checkpoint").kind == "exported":
        device = "cpu" if s.runtime["device"] == "auto" else resources.device
        network = runtimes.load(s.checkpoint, s.engine, s.precision, threads=resources.threads, device=device)
        return RuntimeNetwork(network)
    if (s.engine, s.precision) != ("auto", None):
        raise ValueError("engine and precision are for exported files (eldenet export)")
    return eldenet.load(s.checkpoint, trusted_modules=listed(s.trusted_modules))


def calibrate(
    s: EvaluateSettings,
    folder: Path,
    protocol: "EvalProtocol",
    resources: "Resources",
    model: "DepthNet | RuntimeNetwork",
    input_size: "Sequence[int] | OwnShape | None",
    log: "RunLog",
) -> None:
    """Fit the temperature of the network's sigma on the frames to score; save the network into ``folder``.

    Raises:
        ValueError: the network is an exported file, or predicts no sigma.
    """
    from eldenet.evaluation.calibration import fit_temperature
    from eldenet.evaluation.splits import open_split
    from eldenet.model import DepthNet

    if not isinstance(model, DepthNet):
        raise ValueError(
            "calibrated= stores a temperature in a model: give the model's folder, then export it again"
        )
    frames = open_split(s.data, s.split, protocol, score=True, input_size=input_size)
    model.to(resources.device)
    temperature = fit_temperature(model, frames, protocol, batch_size=s.batch_size)
    source = f"{s.data['name']}/{s.split} {frames.split_hash}"
    model.save_pretrained(folder, info={"temperature_from": source})
    log.say(
        f"sigma times {temperature:.3f}, by {len(frames)} frames of {source}: written to {folder}. The table "
        "below is of these very frames: score others"
    )


def chosen_size(
    s: EvaluateSettings, protocol: "EvalProtocol", model: "DepthNet | RuntimeNetwork", log: "RunLog"
) -> "Sequence[int] | OwnShape | None":
    """Return the ``(height, width)`` [px] that the network sees, or own shapes; None: the data set's size.

    Raises:
        ValueError: a file of fixed size would squeeze the frames.
    """
    from eldenet.evaluation.splits import OwnShape

    wanted = trained_size(model, protocol) if s.input_size == "model" else s.input_size
    if wanted is None or isinstance(wanted, str):
        return None
    own_shapes = s.input_size == "model" and not protocol.changes_frames
    of_data = s.data["input_size"]
    if list(wanted) != of_data:
        what = f"the network sees {wanted[0]} x {wanted[1]} pixels"
        log.say(f"{what}, data.input_size={of_data} is not used")
    if not own_shapes:
        return wanted
    shape = OwnShape((wanted[0], wanted[1]), float(model.info.get("stretch") or 1.0))
    refuse_to_squeeze(s, protocol, model, shape)
    return shape


def refuse_to_squeeze(
    s: EvaluateSettings, protocol: "EvalProtocol", model: "DepthNet | RuntimeNetwork", shape: "OwnShape"
) -> None:
    """Raise ValueError if a file of fixed size would squeeze the frames, of which the first is looked at."""
    from eldenet.deploy.runtimes.module import RuntimeNetwork
    from eldenet.evaluation.splits import open_split

    if not isinstance(model, RuntimeNetwork) or model.network.fixed_size is None:
        return
    frames = open_split(s.data, s.split, protocol, score=True)
    frames.input_size = None
    height, width = frames[0]["image"].shape[-2:]
    size = size_of_aspect(shape.size, (height, width * shape.stretch))
    if size != shape.size:
        seen = list(shape.size)
        raise ValueError(
            f"this file takes {seen} pixels (height, width), which would squeeze frames of {height} x "
            f"{width}: export one with size={list(size)}, or give input_size={seen} to squeeze them"
        )


def at_training_size(s: EvaluateSettings, model: "DepthNet | RuntimeNetwork") -> bool:
    """Whether the settings show frames at the size of the training."""
    from eldenet.model import size_of_frames

    shown = s.data["input_size"] if s.input_size == "data" else s.input_size
    return shown == "model" or list(shown or ()) == list(size_of_frames(model.info) or ())


def without_lens(s: EvaluateSettings, protocol: "EvalProtocol") -> str:
    """Name of the first frame to score if it has no intrinsics, else ""."""
    from eldenet.evaluation.splits import open_split
    from eldenet.training.notes import without_camera

    return without_camera(open_split(s.data, s.split, protocol, score=True))


def trained_size(model: "DepthNet | RuntimeNetwork", protocol: "EvalProtocol") -> Sequence[int] | None:
    """``(height, width)`` [px] at which ``model`` sees what ``protocol`` shows it: a frame, or a part of it.

    Raises:
        ValueError: a file sees whole frames, and the protocol shows a part.
    """
    from eldenet.deploy.runtimes.module import RuntimeNetwork
    from eldenet.model import size_of_frames

    if not protocol.changes_frames:
        return size_of_frames(model.info)
    seen = model.info.get("input_size")
    if isinstance(model, RuntimeNetwork) and seen is not None and model.network.whole_frame_size == seen:
        raise ValueError(
            f"this file takes the camera's whole frames, {seen[0]} x {seen[1]} pixels, but protocol "
            f"{protocol.name} only shows a part of them: to score the network, export it with size= of that "
            "part (the training's data.input_size)"
        )
    return seen


def _measure(model: "DepthNet | RuntimeNetwork", size: tuple[int, int]) -> Any:
    from eldenet.deploy.runtimes.module import RuntimeNetwork, measure_runtime_cost
    from eldenet.evaluation.cost import measure_cost

    if isinstance(model, RuntimeNetwork):
        return measure_runtime_cost(model.network, size)
    return measure_cost(model, size)


main = entry_point(EvaluateSettings)(evaluate)

if __name__ == "__main__":
    main()
