"""The parts of other papers' networks, against numbers by hand and torch's own."""

import pytest
import torch
import torch.nn.functional as F
from support.networks import picture

from eldenet.backbones.mobilenet import MobileNetV1
from eldenet.baselines import lite_mono, meter
from eldenet.baselines.ddrnet import DDRNet
from eldenet.baselines.guidedepth import GuideDepth
from eldenet.baselines.lite_mono import LiteMono
from eldenet.configurable import build
from eldenet.decoders.fastdepth import FastDepthDecoder
from eldenet.heads import ScaledHead
from eldenet.model import EncoderDecoder


def test_fastdepth_adds_the_skips() -> None:
    torch.manual_seed(0)
    network = EncoderDecoder(MobileNetV1(), FastDepthDecoder).eval()
    features = list(network.backbone(picture(64, 64)))
    with torch.inference_mode():
        whole = network.decoder(features)
        for index in range(3):  # strides 2, 4, 8
            changed = [*features]
            changed[index] = torch.zeros_like(changed[index])
            assert not torch.equal(network.decoder(changed), whole)
        changed = [*features]
        changed[3] = torch.zeros_like(changed[3])  # stride 16 is no skip
        assert torch.equal(network.decoder(changed), whole)


def test_fastdepths_upconv_has_two_equal_forms() -> None:
    torch.manual_seed(0)
    info = MobileNetV1().feature_info
    slow = FastDepthDecoder(info, operator="upconv", skips=False).eval()
    fast = FastDepthDecoder(info, operator="upconv", skips=False, fast=True).eval()
    fast.load_state_dict(slow.state_dict())
    features = [torch.rand(1, width, 64 // stride, 64 // stride) for width, stride in info]
    with torch.inference_mode():
        torch.testing.assert_close(slow(features), fast(features), rtol=1e-4, atol=1e-5)


def test_guidedepth_sees_the_image_at_full_size() -> None:
    torch.manual_seed(0)
    model = GuideDepth("small").eval()
    image = picture(64, 64)
    changed = image.clone()
    changed[..., 33, 33] = 5  # no other stride's guide has this pixel
    with torch.inference_mode():
        features = model.features(image)
        model.features.forward = lambda _: features
        difference = (model(changed) - model(image)).abs()[0, 0]
    assert difference[31:36, 31:36].max() > 10 * difference[:16, :16].max()


def test_ddrnet_ends_at_stride_eight() -> None:
    with torch.inference_mode():
        assert DDRNet(5).eval()(picture(97, 131)).shape == (1, 5, 13, 17)


def test_cross_covariance_attention_by_hand() -> None:
    """Against plain loops over heads (El-Nouby et al. 2021, equations 3 and 4)."""
    torch.manual_seed(0)
    attention = lite_mono.CrossCovarianceAttention(16).eval()
    attention.temperature.data.uniform_(0.5, 2)
    tokens = torch.randn(1, 7, 16)
    query, key, value = (tokens[0] @ attention.qkv.weight.T + attention.qkv.bias).split(16, dim=-1)
    heads = []
    for head in range(8):
        part = slice(2 * head, 2 * head + 2)
        q, k = (x[:, part] / x[:, part].norm(dim=0) for x in (query, key))
        weights = (q.T @ k * attention.temperature[head, 0, 0]).softmax(dim=-1)
        heads.append(value[:, part] @ weights.T)
    expected = torch.cat(heads, dim=1) @ attention.out.weight.T + attention.out.bias
    torch.testing.assert_close(attention(tokens)[0], expected, rtol=1e-4, atol=1e-5)


def test_meters_attention_is_torchs() -> None:
    torch.manual_seed(0)
    attention = meter.Attention(24)
    tokens = torch.randn(2, 4, 9, 24)
    query, key, value = (
        part.view(2, 4, 9, 4, 8).transpose(2, 3) for part in attention.qkv(tokens).chunk(3, dim=-1)
    )
    expected = attention.out(F.scaled_dot_product_attention(query, key, value).transpose(2, 3).flatten(3))
    torch.testing.assert_close(attention(tokens), expected)


def test_drop_path_grows_with_depth() -> None:
    network = LiteMono("tiny", drop_path=0.3)
    rates = [block.drop_path.p for stage in network.encoder.stages for block in stage]
    assert (rates[0], rates[-1]) == (0, pytest.approx(0.3))
    assert rates == sorted(rates)


def test_lite_monos_dilations() -> None:
    def dilations(**options) -> list[list[int]]:
        stages = LiteMono(**options).encoder.stages
        return [[block.branch[0].dilation[0] for block in stage[:-1]] for stage in stages]

    assert dilations() == [[1, 2, 3], [1, 2, 3], [1, 2, 3, 1, 2, 3, 2, 4, 6]]
    assert dilations(size="small", dilations="high") == [[1, 2, 5], [1, 2, 5], [1, 2, 5, 2, 4, 10]]


def test_scaled_head() -> None:
    head = ScaledHead(0.01, 0.5, 8.0)
    raw = torch.tensor([-5.0, 100.0, 250.0, 900.0])
    torch.testing.assert_close(head(raw), torch.tensor([0.5, 1.0, 2.5, 8.0]))
    assert build(head.config).config == head.config
