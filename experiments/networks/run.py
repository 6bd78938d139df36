"""Parameters, multiply-adds and latency of every named network, side by side in one process.

python experiments/networks/run.py
"""

import statistics
import time
from pathlib import Path

from eldenet.resources import prepare_environment

prepare_environment()

import torch  # noqa: E402

import eldenet  # noqa: E402
from eldenet.profiling import count_macs, count_params  # noqa: E402
from eldenet.record import environment  # noqa: E402

HERE = Path(__file__).parent
SIZE = (224, 224)
REFERENCE = "resnet18_upconv"


def main() -> None:
    torch.set_num_threads(1)
    networks = {name: eldenet.load(name) for name in eldenet.list_models()}
    image = torch.rand(1, 3, *SIZE).contiguous(memory_format=torch.channels_last)
    seconds: dict[str, list[float]] = {name: [] for name in networks}
    with torch.inference_mode():
        for network in networks.values():
            network.to(memory_format=torch.channels_last)(image)
        for _ in range(15):  # interleaved: a drift of the machine hits all alike
            for name, network in networks.items():
                started = time.perf_counter()
                network(image)
                seconds[name].append(1e3 * (time.perf_counter() - started))
    median = {name: statistics.median(values) for name, values in seconds.items()}
    where = environment()
    lines = [
        "| network | parameters | GMACs | latency [ms] | of ResNet18 + UpConv |",
        "|---|---:|---:|---:|---:|",
    ]
    for name, network in sorted(networks.items(), key=lambda item: count_params(item[1])):
        lines.append(
            f"| `{name}` | {count_params(network):,} | {count_macs(network, SIZE) / 1e9:.3f} | "
            f"{median[name]:.1f} | {median[name] / median[REFERENCE]:.2f} |"
        )
    lines += [
        "",
        f"Input {SIZE[0]} x {SIZE[1]}, batch 1, torch {where['versions']['torch']} eager, fp32, "
        f"channels_last, 1 thread, {where['hardware']['processor']}, {where['date'][:10]}; "
        "medians of 15 interleaved rounds.",
        "1 MAC = 2 FLOPs. Made by `python experiments/networks/run.py`.",
    ]
    (HERE / "results.md").write_text("\n".join(lines) + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
