"""Parameters and multiply-adds of every named network.

python experiments/networks/run.py
"""

from pathlib import Path

import torch

import eldenet
from eldenet.profiling import count_macs, count_params

HERE = Path(__file__).parent
SIZE = (224, 224)


def main() -> None:
    lines = [
        "| network | parameters | GMACs | backbone, decoder |",
        "|---|---:|---:|---|",
    ]
    networks = {name: eldenet.load(name) for name in eldenet.list_models()}
    for name, model in sorted(networks.items(), key=lambda item: count_params(item[1])):
        parts = f"{type(model.network.backbone).__name__}, {type(model.network.decoder).__name__}"
        macs = count_macs(model, SIZE) / 1e9
        lines.append(f"| `{name}` | {count_params(model):,} | {macs:.3f} | {parts} |")
    lines += [
        "",
        f"GMACs of one {SIZE[0]} x {SIZE[1]} image: convolutions and matrix products; 1 MAC = 2 FLOPs. torch "
        f"{torch.__version__.partition('+')[0]}. Made by `python experiments/networks/run.py`.",
    ]
    (HERE / "results.md").write_text("\n".join(lines) + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
