"""The card of a saved model: its README.md with the metadata that the Hugging Face Hub reads."""

import json
import re
from collections.abc import Mapping
from typing import Any

MARK = "<!-- written by eldenet: save_pretrained replaces this file -->"
#: Metric of ``info`` -> its name on a card.
METRICS = {"delta1": "δ1", "abs_rel": "AbsRel", "rmse": "RMSE [m]", "mae": "MAE [m]"}
LICENSE_ID = re.compile(r"[a-z][a-z0-9.-]*")


def scores(info: Mapping[str, Any]) -> tuple[str, str, dict[str, float]]:
    """Split, protocol and metrics that ``info`` states: of the test frames, else of the best epoch."""
    test = info.get("test")
    split, source = ("test", test) if isinstance(test, Mapping) else ("validation", info)
    found = {
        name: float(source[name])
        for name in METRICS
        if isinstance(source.get(name), int | float) and not isinstance(source[name], bool)
    }
    return split, str(source.get("protocol") or info.get("protocol") or "not stated"), found


def summary(info: Mapping[str, Any]) -> str:
    """One line on a model: what it is, what it was trained on, how it scores, its license."""
    split, protocol, found = scores(info)
    figures = ", ".join(f"{METRICS[name]} {value:.3f}" for name, value in found.items())
    parts = [
        f"{info.get('model_name', 'a depth network')} trained on {info.get('data', 'data not stated')}",
        f"{figures} ({split} frames, protocol {protocol})" if figures else "no scores stated",
        f"license of the weights: {info.get('license', 'not stated')}",
    ]
    return " ".join("; ".join(parts).split())


def model_card(info: Mapping[str, Any], model: Mapping[str, Any]) -> str:
    """Return README.md: the Hub's metadata, the model, its scores with their protocol, how to load it."""
    name, data = str(info.get("model_name", "depth network")), str(info.get("data", "not stated"))
    split, protocol, found = scores(info)
    license_text = str(info.get("license", "not stated"))
    known = LICENSE_ID.fullmatch(license_text)
    lines = ["---", "library_name: eldenet", "pipeline_tag: depth-estimation"]
    if license_text != "not stated":
        lines.append(f"license: {license_text}" if known else "license: other")
        lines += [] if known else [f"license_name: {_text(license_text)}"]
    lines += ["tags:", "- depth-estimation", "- monocular-depth", "- eldenet"]
    if found:
        lines += ["model-index:", f"- name: {_text(name)}", "  results:"]
        lines += ["  - task:", "      type: depth-estimation", "    dataset:"]
        lines += [
            f"      name: {_text(data)}",
            f"      type: {_text(data)}",
            f"      split: {split}",
            "    metrics:",
        ]
        for metric, value in found.items():
            lines += [f"    - type: {metric}", f"      value: {value!r}"]
            lines += [f"      name: {_text(f'{METRICS[metric]}, protocol {protocol}')}"]
    lines += ["---", MARK, f"# {_line(name)}", "", "Depth in meters from one image, with eldenet.", ""]
    if found:
        lines += [f"| {split} frames of {_line(data)}, protocol {_line(protocol)} | |", "|---|---:|"]
        lines += [f"| {METRICS[metric]} | {value:.3f} |" for metric, value in found.items()] + [""]
    lines += [f"- trained on: {_line(data)}", f"- license of the weights: {_line(license_text)}"]
    shown = (
        "input_size",
        "whole_frame_size",
        "weights have seen",
        "started_from",
        "adapted_from",
        "seed",
        "epoch",
    )
    lines += [f"- {key.replace('_', ' ')}: {_line(info[key])}" for key in shown if info.get(key) is not None]
    any_lens = model.get("canonical_focal") is not None
    head = model.get("head")
    if isinstance(head, Mapping) and isinstance(head.get("depth"), Mapping):
        head = head["depth"]  # of a head that predicts sigma
    if isinstance(head, Mapping) and head.get("max_depth") is not None:
        unit = "canonical meters" if any_lens else "m"
        lines.append(f"- depth: {_line(head.get('min_depth'))} to {_line(head['max_depth'])} {unit}")
    lines += ["", "```python", "import eldenet", ""]
    lines += ['model = eldenet.load("owner/name")  # this repository, or a folder']
    call, lens = ("model(images, focal)", ", fx [px of images]") if any_lens else ("model(images)", "")
    lines += [f"depth = {call}  # (B, 3, H, W) RGB in [0, 1]{lens} -> (B, 1, H, W) meters", "```", ""]
    lines += ["`config.json` has all settings and facts.", ""]
    return "\n".join(lines)


def _text(value: object) -> str:
    """A value as a YAML string: JSON's strings are YAML's."""
    return json.dumps(" ".join(str(value).split()), ensure_ascii=False)


def _line(value: object) -> str:
    """A value as plain text on a line of Markdown."""
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return re.sub(r"([\\`*<>|\[\]#])", r"\\\1", " ".join(text.split()))
