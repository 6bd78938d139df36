"""Weights that come with the package."""

import pytest
import torch

import eldenet
from eldenet import config as cfg
from eldenet.zoo import WEIGHTS


@pytest.mark.parametrize("name", eldenet.list_weights())
def test_shipped_weights_are_of_a_network_by_name(name):
    model = eldenet.load(name)
    network = name.split("_rooms")[0]
    fresh = eldenet.load(network)
    assert {key: value.shape for key, value in model.state_dict().items()} == {
        key: value.shape for key, value in fresh.state_dict().items()
    }
    assert sum(path.stat().st_size for path in (WEIGHTS / name).iterdir()) < 3_000_000
    assert model.info["weights have seen"] == "rendered rooms"
    assert model.info["test"]["protocol"] == "rooms"
    assert not model.training
    named = eldenet.load(network, weights="rooms").state_dict()
    assert all(torch.equal(value, named[key]) for key, value in model.state_dict().items())


@pytest.mark.parametrize("name", eldenet.list_weights())
def test_shipped_weights_know_depth(name, cache):
    """AbsRel on a few test frames: a fresh network is far worse, and these weights 0.19 on all 512."""
    frames = ["data.frames.test=16", f"data.root={cache}"]
    config = cfg.compose("train", ["data=rooms", *frames])
    rooms = cfg.build_split(config, "test", cfg.build_protocol(config), score=True)
    samples = [rooms[index] for index in range(len(rooms))]
    image, depth = (torch.stack([sample[key] for sample in samples]) for key in ("image", "depth"))
    with torch.no_grad():
        fresh, trained = (
            ((eldenet.load(source)(image) - depth).abs() / depth).mean() for source in ("eldenet", name)
        )
    assert trained < 0.25
    assert fresh > 2 * trained


def test_weights_that_do_not_exist():
    with pytest.raises(ValueError, match="no weights 'kitti' of eldenet in the package: it has eldenet_"):
        eldenet.load("eldenet", weights="kitti")
    with pytest.raises(ValueError, match="trained weights"):
        eldenet.load("eldenet_room")
