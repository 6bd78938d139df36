"""Measure what lower precision costs: accuracy of one trained network, and its distance from torch's depth.

python experiments/table1_efficiency/precision.py runs/nyu/rooms          # a run of +experiment=nyu_labelled
"""

import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import torch

import eldenet
from eldenet.compose import compose
from eldenet.data.base import DepthDataset
from eldenet.deploy import runtimes
from eldenet.deploy.runtimes.module import RuntimeNetwork
from eldenet.evaluation.evaluator import PER_IMAGE_HEADER, evaluate
from eldenet.evaluation.splits import chosen_protocol, open_split
from eldenet.export import ExportSettings, export, map_errors
from eldenet.results.paired_intervals import Scores, paired_interval
from eldenet.results.run_record import environment
from eldenet.results.tables import to_markdown
from eldenet.train import TrainSettings

WORK = Path("runs/table1_efficiency/precision")
VARIANTS = [("onnx", "onnxruntime", "fp32"), ("onnx", "onnxruntime", "int8")] + [
    ("openvino", "openvino", precision) for precision in ("fp32", "bf16", "int8")
]


@torch.inference_mode()
def depth_maps(network: torch.nn.Module, frames: DepthDataset) -> np.ndarray:
    """Depth of all frames at the network's input ``(N, h, w)`` [m]."""
    return np.stack([network(frames[index]["image"][None])[0, 0].numpy() for index in range(len(frames))])


def main() -> None:
    checkpoint = sys.argv[1]
    model = eldenet.load(checkpoint)
    height, width = model.info["input_size"]
    config = compose(TrainSettings, ["data=nyu_labelled", f"data.input_size=[{height},{width}]"])
    protocol = chosen_protocol(config.data, config.protocol)
    val_set = open_split(config.data, "val", protocol, score=True)
    pictures = open_split(config.data, "train", protocol).root / "data/nyu2_train/labeled_out/*.jpg"
    delta1 = PER_IMAGE_HEADER.index("delta1")
    exact = depth_maps(model.eval(), val_set)
    reference, rows = None, []
    for kind, runtime, precision in [("torch", "torch", "fp32"), *VARIANTS]:
        network: torch.nn.Module = model
        if kind != "torch":
            output = WORK / f"{runtime}-{precision}{'.onnx' if kind == 'onnx' else '.xml'}"
            words = [f"checkpoint='{checkpoint}'", f"format={kind}", f"precision={precision}", "checks=1"]
            words += [f"pictures='{pictures}'", f"output='{output}'", "overwrite=true"]
            export(compose(ExportSettings, words))
            network = RuntimeNetwork(runtimes.load(output, runtime, precision, threads=1))
        result = evaluate(network, val_set, protocol, batch_size=1)
        values = np.array([[float(row[delta1]) for row in result.rows]])
        scores = Scores(tuple(row[0] for row in result.rows), values)
        reference = scores if reference is None else reference
        mean, low, high = paired_interval(scores, reference, draw_seeds=False)
        metrics = [f"{result.metrics[name]:.4f}" for name in ("delta1", "abs_rel", "rmse")]
        found = map_errors(depth_maps(network, val_set), exact)
        tail = [f"{100 * found[name]:.2f}" for name in ("median_relative", "max_relative")]
        rows.append([runtime, precision, *metrics, f"{mean:+.4f} [{low:+.4f}, {high:+.4f}]", *tail])
        print(*rows[-1], flush=True)
    notes = [
        f"{len(val_set)} frames of nyu_labelled/val ({val_set.split_hash}), protocol {protocol.name}, "
        f"input {height} x {width}; int8 scales from 128 training frames",
        "δ1 minus torch's: paired, over images, with the 95 % interval of the bootstrap",
        "off torch's depth: relative difference of the median and of the worst pixel of all frames",
        ", ".join(f"{name} {version(name)}" for name in ("torch", "onnxruntime", "openvino", "nncf"))
        + f"; {environment()['hardware']['processor']}, 1 thread; "
        "python experiments/table1_efficiency/precision.py <run of +experiment=nyu_labelled>",
    ]
    header = ["runtime", "precision", "δ1 ↑", "AbsRel ↓", "RMSE [m] ↓", "δ1 minus torch's fp32"]
    header += ["off torch's depth, median pixel [%] ↓", "worst pixel [%] ↓"]
    print(to_markdown(header, rows, notes))


if __name__ == "__main__":
    main()
