"""Count parameters and multiply-adds of every named network, at 224 x 224 and at the size of its paper.

python experiments/networks/run.py
"""

from pathlib import Path

import torch

import eldenet
from eldenet.evaluation.cost import count_macs, count_params
from eldenet.model import EncoderDecoder

HERE = Path(__file__).parent
PAGE = HERE.parents[1] / "docs" / "networks.md"
MARK = "<!-- table: experiments/networks/run.py -->"
SIZE = (224, 224)
# (height, width) of the figures in the paper or the public code; other networks: SIZE
REFERENCE_SIZES = {
    "guidedepth": (240, 320),
    "lite_mono": (192, 640),
    "meter": (192, 256),
    "upconv": (228, 304),
}
PAPERS = {
    "eldenet": "this project's network",
    "fastdepth": "Wofk et al., ICRA 2019",
    "guidedepth": "Rudolph et al., ICRA 2022",
    "lite_mono": "Zhang et al., CVPR 2023",
    "meter": "Papa et al., IEEE TCSVT 2023",
    "upconv": "decoder: Ma and Karaman, ICRA 2018",
}
NO_CODE = ("MANet", "Make3D", "MSCA", "SSR", "DCF", "SSDM")


def family(name: str) -> str:
    return next(key for key in PAPERS if name.startswith(key) or name.endswith(key))


def parts(model: eldenet.DepthNet) -> str:
    network = model.network
    if isinstance(network, EncoderDecoder):
        backbone = network.backbone.config.get("name", type(network.backbone).__name__)
        return f"{backbone}, {type(network.decoder).__name__}"
    return type(network).__name__


def row(name: str) -> tuple[int, str]:
    model = eldenet.load(name)
    size = REFERENCE_SIZES.get(family(name), SIZE)
    macs = [f"{count_macs(model, wanted) / 1e9:.3f}" for wanted in (SIZE, size)]
    cells = (
        f"`{name}`",
        f"{count_params(model):,}",
        macs[0],
        f"{macs[1]} @ {size[0]} x {size[1]}",
        parts(model),
        PAPERS[family(name)],
    )
    return count_params(model), f"| {' | '.join(cells)} |"


def main() -> None:
    size = f"{SIZE[0]} x {SIZE[1]}"
    missing = [f"| {name} | - | - | - | - | no code identified |" for name in NO_CODE]
    lines = [
        f"| network | parameters | GMACs @ {size} | GMACs at the reference size | parts | source |",
        "|---|---:|---:|---:|---|---|",
        *(line for _, line in sorted(row(name) for name in eldenet.list_models())),
        *missing,
        "",
        "GMACs of one image (height x width): convolutions and matrix products, those of attention too; 1 "
        f"MAC = 2 FLOPs. torch {torch.__version__.partition('+')[0]}. Made by "
        "`python experiments/networks/run.py`.",
    ]
    table = "\n".join(lines)
    (HERE / "results.md").write_text(f"{table}\n")
    before, _, after = PAGE.read_text().split(MARK)
    PAGE.write_text(f"{before}{MARK}\n{table}\n{MARK}{after}")
    print(table)


if __name__ == "__main__":
    main()
