"""The card of a saved model, as the Hub's own client reads it."""

from pathlib import Path

import pytest
import yaml
from huggingface_hub import ModelCard
from support.networks import small_net

import eldenet
from eldenet.weights import PACKAGED
from eldenet.weights.model_card import MARK, model_card, summary

TEST = {"delta1": 0.768, "abs_rel": 0.1845, "rmse": 0.5638, "protocol": "rooms", "images": 512}


@pytest.mark.parametrize("name", eldenet.list_weights())
def test_the_hub_reads_the_cards_of_the_packaged_weights(name, tmp_path):
    model = eldenet.load(PACKAGED / name)
    card = ModelCard.load(model.save_pretrained(tmp_path / "model") / "README.md")
    assert card.data.pipeline_tag == "depth-estimation"
    assert card.data.library_name == "eldenet"
    scores = {result.metric_type: result for result in card.data.eval_results}
    stated = model.info.get("test", model.info)
    for metric in ("delta1", "abs_rel", "rmse"):
        if metric in stated:
            assert scores[metric].metric_value == stated[metric]
            assert scores[metric].dataset_name == model.info["data"]
            assert scores[metric].dataset_split == ("test" if "test" in model.info else "validation")
            assert stated["protocol"] in scores[metric].metric_name
    assert scores


def test_a_license_of_the_hub_is_named_and_another_text_is_kept():
    assert ModelCard(model_card({"license": "apache-2.0"}, {})).data.license == "apache-2.0"
    other = ModelCard(model_card({"license": "research: not for sale"}, {})).data
    assert (other.license, other.license_name) == ("other", "research: not for sale")
    assert ModelCard(model_card({}, {})).data.license is None


def test_facts_from_strangers_stay_text():
    hostile = 'a"\n---\npipeline_tag: x\n[b](javascript:c) <img>'
    info = {"model_name": hostile, "data": hostile, "license": hostile, "test": TEST | {"protocol": hostile}}
    text = model_card(info, {"head": {"max_depth": hostile}})
    card = ModelCard(text)
    assert card.data.pipeline_tag == "depth-estimation"
    assert yaml.safe_load(text.split("---\n")[1])["model-index"][0]["name"] == " ".join(hostile.split())
    body = card.text
    assert "<img>" not in body.replace(r"\<img\>", "")
    assert "[b](" not in body.replace(r"\[b\]", "")


def test_a_network_for_any_lens_is_shown_with_its_focal_length():
    head = {"min_depth": 0.1 * 0.4, "max_depth": 20.0}  # 0.04000000000000001
    plain = model_card({}, {"head": head, "canonical_focal": None})
    assert "model(images)" in plain
    assert "- depth: 0.04 to 20 m\n" in plain
    scaled = model_card({}, {"head": {"depth": head}, "canonical_focal": 0.8})  # and with sigma
    assert "model(images, focal)  # (B, 3, H, W) RGB in [0, 1], fx [px of images]" in scaled
    assert "- depth: 0.04 to 20 canonical meters\n" in scaled


def test_a_card_of_ones_own_stays(tmp_path: Path):
    model = small_net()
    card = model.save_pretrained(tmp_path, info={"data": "mine"}) / "README.md"
    assert "- trained on: mine" in card.read_text()
    model.save_pretrained(tmp_path, info={"data": "more"})
    assert "- trained on: more" in card.read_text()
    card.write_text("# Mine\n")
    model.save_pretrained(tmp_path)
    assert MARK not in card.read_text()


def test_a_model_of_the_hub_introduces_itself_in_one_line(tmp_path, monkeypatch, capsys):
    small_net().save_pretrained(tmp_path, info={"model_name": "tiny", "data": "rooms", "test": TEST})
    monkeypatch.setattr("huggingface_hub.snapshot_download", lambda *_, **__: str(tmp_path))
    eldenet.load("somebody/depth")
    assert capsys.readouterr().err == (
        "somebody/depth: tiny trained on rooms; δ1 0.768, AbsRel 0.184, RMSE [m] 0.564 (test frames, "
        "protocol rooms); license of the weights: not stated; https://huggingface.co/somebody/depth\n"
    )
    assert "\n" not in summary({"data": "a\nb"})
