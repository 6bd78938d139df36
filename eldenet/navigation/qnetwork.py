"""The Q-network."""

import torch
from torch import Tensor, nn


class QNetwork(nn.Module):
    """Observation ``(N, inputs)`` -> value of each action ``(N, actions)``.

    Args:
        inputs: columns of the observation.
        quantiles: of each action's return, whose mean is the value; 1: the value only.
    """

    def __init__(
        self, inputs: int, actions: int, hidden: tuple[int, ...] = (128, 128), quantiles: int = 1
    ) -> None:
        super().__init__()
        self.inputs, self.actions, self.hidden, self.quantiles = inputs, actions, tuple(hidden), quantiles
        layers: list[nn.Module] = []
        for width_in, width_out in zip((inputs, *hidden), hidden, strict=False):
            layers += [nn.Linear(width_in, width_out), nn.ReLU()]
        self.layers = nn.Sequential(*layers, nn.Linear((inputs, *hidden)[-1], actions * quantiles))

    def spread(self, observation: Tensor) -> Tensor:
        """Return quantiles of the return ``(N, actions, quantiles)``."""
        out: Tensor = self.layers(observation)
        return out.unflatten(1, (self.actions, self.quantiles))

    def forward(self, observation: Tensor) -> Tensor:
        """Values ``(N, actions)``, the higher the better."""
        return self.spread(observation).mean(2)

    @torch.no_grad()
    def plain(self) -> "QNetwork":
        """Return an equal network without quantiles: the last layer is linear, so its rows are averaged."""
        network = QNetwork(self.inputs, self.actions, self.hidden)
        state = {name: tensor.clone() for name, tensor in self.state_dict().items()}
        for name in list(state)[-2:]:  # weights and bias of the last layer
            state[name] = state[name].unflatten(0, (self.actions, self.quantiles)).mean(1)
        network.load_state_dict(state)
        return network
