"""The page of the packaged weights says what their files say."""

import json
from pathlib import Path

from support.composing import composed

import eldenet
from eldenet.cli.commands import COMMANDS
from eldenet.compose import config_folder
from eldenet.weights import PACKAGED

PAGE = Path(__file__).resolve().parents[2] / "docs" / "weights.md"


def weights_table() -> str:
    """The table of docs/weights.md, from each ``config.json``."""
    lines = [
        "| name | input | depth [m] | any lens | has seen | protocol | δ1 ↑ | RMSE [m] ↓ |",
        "|---|---|---|---|---|---|---:|---:|",
    ]
    for name in eldenet.list_weights():
        config = json.loads((PACKAGED / name / "config.json").read_text())
        info, head = config["info"], config["model"]["head"]
        head = head.get("depth", head)  # of a head with sigma
        cells = [
            f"`{name}`",
            " x ".join(map(str, info["input_size"])),
            f"{head['min_depth']:g} to {head['max_depth']:g}",
            "yes" if config["model"].get("canonical_focal") else "no",
            info["weights have seen"],
            f"`{info['test']['protocol']}`",
            f"{info['test']['delta1']:.3f}",
            f"{info['test']['rmse']:.3f}",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def test_the_page_has_a_row_for_all_weights():
    table = weights_table()
    assert table in PAGE.read_text(), f"docs/weights.md needs this table:\n\n{table}"


def test_names_follow_the_pages_rule_or_the_page_says_which_do_not():
    exception = PAGE.read_text().partition("Three names break the rule")[2].partition("\n\n")[0]
    backbones, decoders = (
        [path.stem for path in (config_folder() / "model" / part).glob("*.yaml")]
        for part in ("backbone", "decoder")
    )
    of_parts = {f"{backbone}_{decoder}" for backbone in backbones for decoder in decoders}
    for name in eldenet.list_weights():
        network = json.loads((PACKAGED / name / "config.json").read_text())["info"]["model_name"]
        assert network in {*eldenet.list_models(), *of_parts}
        if not name.startswith(f"{network}_"):
            assert f"`{name}`" in exception
            assert f"`{network}`" in exception


def test_the_page_names_every_command_that_takes_trusted_modules():
    section = PAGE.read_text().partition("## Networks with code of your own")[2]
    takes, takes_not = section.split("In Python, use")
    for command in COMMANDS:
        settings = composed(command, ["mode=evaluate"] if command == "navigate" else [])
        named = f"`{command}`" in takes or f"`eldenet {command}`" in takes
        assert named == ("trusted_modules" in settings), command
    assert "`navigate` has no such" in takes_not
