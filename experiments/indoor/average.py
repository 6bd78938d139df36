"""Averages the weights of trainings that began with the same weights, or of stages of one training.

``python experiments/indoor/average.py runs/one runs/other runs/average`` writes the average of two or
more as a saved model. Wortsman et al., "Model soups" (ICML 2022). Where the first sees its lens
(``model/rays=film``), others need not: rays of zeros change nothing.
"""

import sys

import torch

import eldenet
from eldenet.results.before_after import MEASURED


def main(*runs: str, output: str) -> None:
    """Average every tensor of floating point; the others are those of the first run."""
    model = eldenet.load(runs[0])
    for number, run in enumerate(runs[1:], 2):
        theirs = eldenet.load(run).state_dict()
        for name, tensor in model.state_dict().items():
            if tensor.is_floating_point():
                if name.startswith("network.rays."):
                    theirs.setdefault(name, torch.zeros_like(tensor))
                tensor.lerp_(theirs[name], 1 / number)
    model.info = {name: fact for name, fact in model.info.items() if name not in MEASURED}
    model.save_pretrained(output, info={"averaged": list(runs)})


if __name__ == "__main__":
    main(*sys.argv[1:-1], output=sys.argv[-1])
