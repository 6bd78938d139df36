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
# The tables of docs/networks.md
SECTIONS = {
    "ELDE-Net": ("eldenet_s", "eldenet_fast", "eldenet_paper", "eldenet", "eldenet_l"),
    "FastDepth and GuideDepth": ("fastdepth", "guidedepth_s", "guidedepth"),
    "Lite-Mono": ("lite_mono_tiny", "lite_mono_small", "lite_mono", "lite_mono_8m"),
    "METER": ("meter_xxs", "meter_xs", "meter_s"),
    "Mobile encoders with UpConv": (
        *("mobilenet_v3_small_upconv", "mobilenet_v3_upconv"),
        *("mobilenet_v1_upconv", "mobilenet_v2_upconv"),
    ),
    "Larger encoders with UpConv": (
        *("resnet18_upconv", "seresnet18_upconv", "vgg16_upconv", "resnet50_upconv"),
        *("seresnet50_upconv", "resnet152_upconv", "senet154_upconv"),
    ),
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


def row(name: str) -> tuple[str, ...]:
    """Cells of a network's row: name, parameters, two GMACs, parts, source."""
    model = eldenet.load(name)
    size = REFERENCE_SIZES.get(family(name), SIZE)
    macs = [f"{count_macs(model, wanted) / 1e9:.3f}" for wanted in (SIZE, size)]
    reference = f"{macs[1]} @ {size[0]} x {size[1]}"
    return (
        f"`{name}`",
        f"{count_params(model):,}",
        macs[0],
        reference,
        parts(model),
        PAPERS[family(name)],
    )


def table(rows: list[tuple[str, ...]], columns: int) -> list[str]:
    """Markdown lines of the first columns, smallest network first."""
    names = ("network", "parameters", f"GMACs @ {SIZE[0]} x {SIZE[1]}", "GMACs at the reference size")
    head = (*names, "parts", "source")[:columns]
    ruler = ("---", "---:", "---:", "---:", "---", "---")[:columns]
    cells = sorted((row[:columns] for row in rows), key=lambda row: int(row[1].replace(",", "")))
    return [f"| {' | '.join(head)} |", f"|{'|'.join(ruler)}|", *(f"| {' | '.join(row)} |" for row in cells)]


def main() -> None:
    rows = {name: row(name) for name in eldenet.list_models()}
    note = (
        "GMACs of one image (height x width): convolutions and matrix products, those of attention too; 1 "
        f"MAC = 2 FLOPs. torch {torch.__version__.partition('+')[0]}. Made by "
        "`python experiments/networks/run.py`."
    )
    missing = [f"| {name} | - | - | - | - | no code identified |" for name in NO_CODE]
    whole = "\n".join([*table(list(rows.values()), 6), *missing, "", note])
    (HERE / "results.md").write_text(f"{whole}\n")
    sections = []
    for title, names in SECTIONS.items():
        sections += [f"### {title}", "", *table([rows[name] for name in names], 5), ""]
    before, _, after = PAGE.read_text().split(MARK)
    PAGE.write_text(f"{before}{MARK}\n" + "\n".join(sections) + f"{MARK}{after}")
    print(whole)


if __name__ == "__main__":
    main()
