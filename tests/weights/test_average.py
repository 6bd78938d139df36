"""The average of trainings: what the packaged indoor weights are made of."""

from pathlib import Path

import torch
from support.networks import canonical_net, small_net
from support.scripts import load_scripts

import eldenet
from eldenet.heads import LinearHead
from eldenet.ray_features import RayFeatures

SIZE = (48, 64)


def test_every_weight_is_the_mean_and_measured_figures_are_left_out(tmp_path: Path) -> None:
    (average,) = load_scripts("indoor", "average")
    seeds = [small_net(seed) for seed in range(3)]
    for number, net in enumerate(seeds):
        net.save_pretrained(tmp_path / f"{number}", info={"input_size": [*SIZE], "test": {"abs_rel": 0.1}})
    average.main(*(str(tmp_path / f"{number}") for number in range(3)), output=str(tmp_path / "mean"))
    mean = eldenet.load(tmp_path / "mean")
    for name, tensor in mean.state_dict().items():
        if tensor.is_floating_point():
            every = torch.stack([net.state_dict()[name] for net in seeds])
            torch.testing.assert_close(tensor, every.mean(0), rtol=1e-5, atol=1e-7)
    assert "test" not in mean.info
    assert mean.info["input_size"] == [*SIZE]
    assert mean.info["averaged"] == [str(tmp_path / f"{number}") for number in range(3)]


def test_a_network_that_sees_no_lens_halves_what_the_lens_changes(tmp_path: Path) -> None:
    (average,) = load_scripts("indoor", "average")
    sees = small_net(rays=RayFeatures, head=LinearHead(), canonical_focal=0.8, canonical_width=SIZE[1])
    for convs in sees.network.rays.convs.values():
        torch.nn.init.normal_(convs[2].weight)
    sees.save_pretrained(tmp_path / "sees")
    canonical_net(*SIZE).save_pretrained(tmp_path / "blind")
    average.main(str(tmp_path / "sees"), str(tmp_path / "blind"), output=str(tmp_path / "mean"))
    rays = eldenet.load(tmp_path / "mean").network.rays
    for stride, convs in rays.convs.items():
        torch.testing.assert_close(convs[2].weight, sees.network.rays.convs[stride][2].weight / 2)
