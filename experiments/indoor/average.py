"""Averages the weights of two stages of one training.

``python experiments/indoor/average.py runs/one runs/other runs/average`` writes the average as a saved model.
Wortsman et al., "Model soups" (ICML 2022).
"""

import sys

import eldenet
from eldenet.results.before_after import MEASURED


def main(one: str, other: str, output: str) -> None:
    """Average every tensor of floating point; the others are those of ``one``."""
    model = eldenet.load(one)
    theirs = eldenet.load(other).state_dict()
    for name, tensor in model.state_dict().items():
        if tensor.is_floating_point():
            tensor.lerp_(theirs[name], 0.5)
    model.info = {name: fact for name, fact in model.info.items() if name not in MEASURED}
    model.save_pretrained(output, info={"averaged": [one, other]})


if __name__ == "__main__":
    main(*sys.argv[1:])
