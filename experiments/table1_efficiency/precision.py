"""Measure how much accuracy lower precision costs: one trained network on the same real frames.

python experiments/table1_efficiency/precision.py runs/nyu/rooms          # a run of +experiment=nyu_labelled
"""

import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import torch

import eldenet
from eldenet.config import build_export, build_protocol, build_split, compose
from eldenet.deploy import runtimes
from eldenet.deploy.exporting import export
from eldenet.deploy.runtimes.module import RuntimeNetwork
from eldenet.evaluation.evaluator import PER_IMAGE_HEADER, evaluate
from eldenet.results.run_record import environment
from eldenet.results.statistics import Scores, paired_interval
from eldenet.results.tables import to_markdown

HERE = Path(__file__).parent
WORK = Path("runs/table1_efficiency/precision")
VARIANTS = [("onnx", "onnxruntime", "fp32"), ("onnx", "onnxruntime", "int8")] + [
    ("openvino", "openvino", precision) for precision in ("fp32", "bf16", "int8")
]


def main() -> None:
    checkpoint = sys.argv[1]
    model = eldenet.load(checkpoint)
    height, width = model.info["input_size"]
    config = compose("train", ["data=nyu_labelled", f"data.input_size=[{height},{width}]"])
    protocol = build_protocol(config)
    val_set = build_split(config, "val", protocol, score=True)
    pictures = build_split(config, "train", protocol).root / "data/nyu2_train/labeled_out/*.jpg"
    delta1 = PER_IMAGE_HEADER.index("delta1")
    reference, rows = None, []
    for kind, runtime, precision in [("torch", "torch", "fp32"), *VARIANTS]:
        network: torch.nn.Module = model
        if kind != "torch":
            output = WORK / f"{runtime}-{precision}{'.onnx' if kind == 'onnx' else '.xml'}"
            words = [f"checkpoint='{checkpoint}'", f"format={kind}", f"precision={precision}", "checks=1"]
            words += [f"pictures='{pictures}'", f"output='{output}'", "overwrite=true"]
            export(build_export(compose("export", words)))
            network = RuntimeNetwork(runtimes.load(output, runtime, precision, threads=1))
        result = evaluate(network, val_set, protocol, batch_size=1)
        values = np.array([[float(row[delta1]) for row in result.rows]])
        scores = Scores(tuple(row[0] for row in result.rows), values)
        reference = scores if reference is None else reference
        mean, low, high = paired_interval(scores, reference, draw_seeds=False)
        metrics = [f"{result.metrics[name]:.4f}" for name in ("delta1", "abs_rel", "rmse")]
        rows.append([runtime, precision, *metrics, f"{mean:+.4f} [{low:+.4f}, {high:+.4f}]"])
        print(*rows[-1], flush=True)
    notes = [
        f"{len(val_set)} frames of nyu_labelled/val ({val_set.split_hash}), protocol {protocol.name}, "
        f"input {height} x {width}; int8 scales from 128 training frames",
        "difference: paired, over images, with the 95 % interval of the bootstrap",
        ", ".join(f"{name} {version(name)}" for name in ("torch", "onnxruntime", "openvino", "nncf"))
        + f"; {environment()['hardware']['processor']}, 1 thread; "
        "python experiments/table1_efficiency/precision.py <run of +experiment=nyu_labelled>",
    ]
    header = ["runtime", "precision", "δ1 ↑", "AbsRel ↓", "RMSE [m] ↓", "δ1 minus torch's fp32"]
    (HERE / "precision.md").write_text(to_markdown(header, rows, notes))


if __name__ == "__main__":
    main()
