"""The Q-network."""

from itertools import pairwise

from torch import Tensor, nn


class QNetwork(nn.Module):
    """Observation ``(N, inputs)`` -> value of each action ``(N, actions)``.

    Args:
        inputs: columns of the observation.
        actions: number of actions.
        hidden: widths of the layers between.
    """

    def __init__(self, inputs: int, actions: int, hidden: tuple[int, ...] = (128, 128)) -> None:
        super().__init__()
        self.inputs, self.actions, self.hidden = inputs, actions, tuple(hidden)
        layers: list[nn.Module] = []
        for width_in, width_out in pairwise((inputs, *hidden)):
            layers += [nn.Linear(width_in, width_out), nn.ReLU()]
        self.layers = nn.Sequential(*layers, nn.Linear((inputs, *hidden)[-1], actions))

    def forward(self, observation: Tensor) -> Tensor:
        """Values ``(N, actions)``, the higher the better."""
        values: Tensor = self.layers(observation)
        return values
