"""Averages the weights of trainings that began with the same weights, or of stages of one training.

``python experiments/indoor/average.py runs/one runs/other runs/average`` writes the average as a saved model;
``lens_exponent=0.85`` gives it an exponent for long lenses (``experiments/lens/exponent.py``). Wortsman et
al., "Model soups" (ICML 2022).
"""

import sys

import eldenet
from eldenet.results.before_after import MEASURED


def main(*runs: str, output: str, lens_exponent: float | None = None) -> None:
    """Average every tensor of floating point; all else is that of the first run."""
    model = eldenet.load(runs[0])
    for number, run in enumerate(runs[1:], 2):
        theirs = eldenet.load(run).state_dict()
        for name, tensor in model.state_dict().items():
            if tensor.is_floating_point():
                tensor.lerp_(theirs[name], 1 / number)
    if lens_exponent is not None:
        model.lens_exponent = model.config["lens_exponent"] = lens_exponent
    model.info = {name: fact for name, fact in model.info.items() if name not in MEASURED}
    model.save_pretrained(output, info={"averaged": list(runs)})


if __name__ == "__main__":
    words = [word for word in sys.argv[1:] if not word.startswith("lens_exponent=")]
    given = [float(word.partition("=")[2]) for word in sys.argv[1:] if word not in words]
    main(*words[:-1], output=words[-1], lens_exponent=given[0] if given else None)
