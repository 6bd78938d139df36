"""Parts of other papers' networks, against plain formulas and torch's own operators."""

import pytest
import torch
import torch.nn.functional as F
from support.networks import picture

from eldenet.baselines import lite_mono, meter
from eldenet.baselines.guidedepth import GuideDepth
from eldenet.baselines.lite_mono import LiteMono


def test_guidedepths_last_step_sees_the_image_at_full_size() -> None:
    torch.manual_seed(0)
    model = GuideDepth("small").eval()
    image = picture(64, 64)
    changed = image.clone()
    changed[..., 33, 33] = 5  # a pixel that the coarser guides skip
    with torch.inference_mode():
        features = model.features(image)
        model.features.forward = lambda _: features
        difference = (model(changed) - model(image)).abs()[0, 0]
    assert difference[31:36, 31:36].max() > 10 * difference[:16, :16].max()


def test_cross_covariance_attention_equals_plain_loops() -> None:
    """El-Nouby et al. 2021, equations 3 and 4."""
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


def test_meters_attention_equals_torchs() -> None:
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


def test_lite_mono_has_the_papers_dilations() -> None:
    def dilations(**options) -> list[list[int]]:
        stages = LiteMono(**options).encoder.stages
        return [[block.branch[0].dilation[0] for block in stage[:-1]] for stage in stages]

    assert dilations() == [[1, 2, 3], [1, 2, 3], [1, 2, 3, 1, 2, 3, 2, 4, 6]]
    assert dilations(size="small", dilations="high") == [[1, 2, 5], [1, 2, 5], [1, 2, 5, 2, 4, 10]]
