"""What the squeeze-and-excitation module costs: the same network with and without it, in pairs of calls.

python experiments/table1_efficiency/squeeze_excite.py     the machine may be busy
"""

import argparse
import time
from collections.abc import Callable
from functools import partial
from importlib.metadata import version

import numpy as np
import torch

from eldenet.compose import compose
from eldenet.configurable import instantiate
from eldenet.deploy import runtimes
from eldenet.results.run_record import environment
from eldenet.results.tables import to_markdown
from eldenet.train import TrainSettings

SIZE = (224, 224)
RUNTIMES = ("torch_channels_last", "onnxruntime", "openvino")
PAIRS = 10  # of calls, in a round


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--rounds", type=int, default=60)
    rounds = options.parse_args().rounds
    image = np.random.default_rng(0).random((1, 3, *SIZE), dtype=np.float32)
    rows = []
    for name in ("eldenet", "eldenet_paper"):
        for runtime in RUNTIMES:
            networks = [open_network(name, runtime, se=se) for se in (True, False)]
            times = in_pairs([partial(network.run, image) for network in networks], rounds)
            ratios = np.median(times[..., 0] / times[..., 1], axis=1)
            middles = [f"{1000 * np.median(times[..., side]):.2f}" for side in (0, 1)]
            rows.append([name, runtime, *middles, interval(ratios)])
            print(*rows[-1], flush=True)
    packages = ", ".join(f"{name} {version(name)}" for name in ("torch", "onnxruntime", "openvino"))
    notes = [
        f"one image of {SIZE[0]} x {SIZE[1]}, fp32, one thread; processor time of a call, which other jobs "
        f"on the machine change little; {rounds} rounds of {PAIRS} pairs of calls, whose order alternates",
        "ratio: with over without, the median over rounds of the median over pairs, with the 95 % interval "
        "of a bootstrap over rounds",
        f"{environment()['hardware']['processor']}; {packages}; "
        "python experiments/table1_efficiency/squeeze_excite.py",
    ]
    titles = ["network", "runtime", "with [ms]", "without [ms]", "ratio"]
    print(to_markdown(titles, rows, notes))


def open_network(name: str, runtime: str, *, se: bool) -> runtimes.Runtime:
    torch.manual_seed(0)
    settings = compose(TrainSettings, [f"model={name}", f"model.backbone.squeeze_excite={str(se).lower()}"])
    return runtimes.load(instantiate(settings.model, "model").eval(), runtime, threads=1, size=SIZE)


def in_pairs(calls: list[Callable[[], object]], rounds: int) -> np.ndarray:
    """Return the processor time of each call ``(rounds, PAIRS, 2)`` [s]."""
    times = np.empty((rounds, PAIRS, 2))
    for call in calls * 5:
        call()
    for round_number in range(rounds):
        for pair in range(PAIRS):
            for side in (0, 1) if pair % 2 else (1, 0):
                started = time.process_time()
                calls[side]()
                times[round_number, pair, side] = time.process_time() - started
    return times


def interval(ratios: np.ndarray) -> str:
    drawn = np.random.default_rng(0).choice(ratios, (10000, len(ratios)))
    low, high = np.percentile(np.median(drawn, axis=1), (2.5, 97.5))
    return f"{np.median(ratios):.3f} [{low:.3f}, {high:.3f}]"


if __name__ == "__main__":
    main()
