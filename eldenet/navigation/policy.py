"""The trained driver, without a simulator, for a robot.

``navigator = Navigator.load(); speed, turn = navigator.step(depth, goal, odometry)``, five times per second.
Needs torch, NumPy and safetensors; imports neither MuJoCo nor Gymnasium.
"""

import copy
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from safetensors import safe_open
from safetensors.torch import save
from torch import Tensor, nn

from eldenet.backbones.weights import refuse_not_finite
from eldenet.navigation.observer import SLOWS_WITHIN, Observer, Senses
from eldenet.navigation.on_robot import OnRobot
from eldenet.navigation.policy_files import POLICY, policy_files
from eldenet.navigation.qnetwork import QNetwork
from eldenet.system.digests import KEY, canonical, digest_of, weights_of
from eldenet.system.errors import reading
from eldenet.system.files import parse_json, write_bytes
from eldenet.weights import check_packaged


class Driver(Observer):
    """An observer that can slow down at another distance to the goal than in training.

    Args:
        robots: number of robots.
        slows_within: distance to the goal at which it starts to slow down [m].
        options: of :class:`~eldenet.navigation.observer.Observer`.

    Raises:
        ValueError: an argument is out of range.
    """

    def __init__(self, robots: int = 1, *, slows_within: float = SLOWS_WITHIN, **options: Any) -> None:
        if not 0 < slows_within < math.inf:
            raise ValueError(f"slows_within={slows_within}: give a finite distance above 0 [m]")
        super().__init__(robots, **options)
        self.trained_with = dict(self.options)
        self.slows_within = float(slows_within)
        self.options["slows_within"] = self.slows_within

    def _speeds(self, distance: np.ndarray, nearest: np.ndarray) -> np.ndarray:
        """Speed of each action ``(N, actions)`` [m/s]."""
        return super()._speeds(distance * (SLOWS_WITHIN / self.slows_within), nearest)


class Ensemble(nn.Module):
    """Networks of one shape from separate trainings; an action's value is their mean.

    Raises:
        ValueError: the shapes differ.
    """

    def __init__(self, members: Sequence[QNetwork]) -> None:
        super().__init__()
        shapes = {(member.inputs, member.actions, member.hidden) for member in members}
        if len(shapes) > 1:
            raise ValueError(
                f"networks of shapes {sorted(shapes)} (inputs, actions, hidden): give networks of one shape"
            )
        self.members = nn.ModuleList(members)
        ((self.inputs, self.actions, self.hidden),) = shapes

    def forward(self, observation: Tensor) -> Tensor:
        """Values ``(N, actions)``, the higher the better."""
        return torch.stack([member(observation) for member in self.members]).mean(0)


class Navigator(OnRobot):
    """One or more trained Q-networks with the observer of their training, for one robot or many.

    Args:
        network: observation -> values of the actions.
        observer: options of :class:`Driver`.
        robots: number of robots.
        info: notes about the training; None: none.

    Attributes:
        files: that it was loaded from.
    """

    name = "dqn"

    def __init__(
        self,
        network: QNetwork | Ensemble,
        observer: dict[str, Any],
        *,
        robots: int = 1,
        info: dict[str, Any] | None = None,
    ) -> None:
        super().__init__()
        self.observer: Driver = Driver(robots, **observer)
        # float64, so that a robot drives the same alone and among others: rounding breaks no tie
        self.network = network.double().eval()
        self.info = info or {}
        self.files: list[Path] = []

    @classmethod
    def load(
        cls,
        path: str | Path | Sequence[str | Path] | None = None,
        *,
        observer: dict[str, Any] | None = None,
        walkers: bool | None = None,
        slows_within: float | None = None,
        robots: int = 1,
    ) -> Self:
        """Load a policy.

        Args:
            path: file, or run folder of its training; a list: the networks drive together by the mean of
                their values; None: the packaged policy.
            observer: the observer it must have been trained with; None: any.
            walkers: track pedestrians (:class:`~eldenet.navigation.observer.Observer`), even if it was
                trained without; None: as stored.
            slows_within: distance to the goal at which it starts to slow down [m]; None: as stored.
            robots: number of robots.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: a file is not a policy, its weights are not finite, or it has another observer or
                another shape than it should.
        """
        networks, notes = [], []
        files = policy_files(path)
        for file in files:
            members, content = _read(file)
            networks += members
            notes.append(content)
            wanted = notes[0]["observer"] if observer is None else observer
            if Driver(**wanted).trained_with != Driver(**content["observer"]).trained_with:
                raise ValueError(
                    f"{file} was trained with the observer {content['observer']}, not {wanted}: give a "
                    "checkpoint that was trained with it"
                )
        options = dict(notes[0]["observer"])
        options |= {} if walkers is None else {"walkers": walkers}
        options |= {} if slows_within is None else {"slows_within": slows_within}
        info = notes[0]["info"] if len(notes) == 1 else {"members": [each["info"] for each in notes]}
        network = networks[0] if len(networks) == 1 else Ensemble(networks)
        navigator = cls(network, options, robots=robots, info=info)
        navigator.files = files
        return navigator

    def save(self, path: str | Path) -> None:
        """Write weights, observer and notes to a ``.safetensors`` file; several networks become float16."""
        members = len(self.network.members) if isinstance(self.network, Ensemble) else 1
        notes = {
            "inputs": self.network.inputs,
            "actions": self.network.actions,
            "hidden": self.network.hidden,
            "members": members,
            "observer": self.observer.options,
            "info": self.info,
        }
        stored = torch.float16 if members > 1 else torch.float32
        weights = {name: tensor.to(stored).contiguous() for name, tensor in self.network.state_dict().items()}
        notes = json.loads(json.dumps(notes))
        notes[KEY] = _digest(notes, weights)
        write_bytes(Path(path), save(weights, metadata={"navigator": json.dumps(notes)}))

    def reset(self, robot: int | slice = slice(None), world: Any = None) -> None:
        """Forget what a robot saw; call this at every new start."""
        super().reset(robot, world)
        self.observer.reset(robot)

    @torch.inference_mode()
    def commands(self, senses: Senses, robots: np.ndarray | None = None) -> np.ndarray:
        """Speed [m/s] and turn rate [rad/s] ``(N, 2)``; only the rows of ``robots`` count."""
        who = np.arange(self.observer.robots) if robots is None else robots
        observation = self.observer.observe(senses, robots)
        actions = np.zeros(self.observer.robots, np.intp)
        actions[who] = self.network(torch.from_numpy(observation).double()).argmax(1).numpy()
        return self.observer.commands(actions)


def _read(path: Path) -> tuple[list[QNetwork], dict[str, Any]]:
    """Return the networks and the notes in a policy file.

    Raises:
        ValueError: the file is not a policy, or its weights are not finite.
    """
    check_packaged(path)
    advice = f"give a training's run folder, or its {POLICY}"
    with reading(path, ".safetensors file", advice), safe_open(str(path), framework="pt") as file:
        notes = (file.metadata() or {}).get("navigator")
        weights = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    if notes is None:
        raise ValueError(f"{path} is not a navigation policy: it has no notes about the observer")
    refuse_not_finite(weights, path)
    with reading(path, "navigation policy", advice):
        content: dict[str, Any] = parse_json(notes, "its notes")
        if content.get(KEY) not in (None, _digest(content, weights)):
            raise ValueError("it does not match its digest")
        inputs, actions, hidden = (content[name] for name in ("inputs", "actions", "hidden"))
        members = min(content.get("members", 1), len(weights))
        with torch.device("meta"):  # the notes may claim any size, but only the weights take memory
            networks = [QNetwork(inputs, actions, tuple(hidden)) for _ in range(members)]
        network = networks[0] if len(networks) == 1 else Ensemble(networks)
        network.load_state_dict({name: value.float() for name, value in weights.items()}, assign=True)
        Driver(**content["observer"])
    return networks, content


def _digest(notes: dict[str, Any], weights: dict[str, Tensor]) -> str:
    """SHA-256 of a policy's notes and weights."""
    return digest_of(canonical(notes), *weights_of(weights))


def export_onnx(navigator: Navigator, path: str | Path) -> None:
    """Export the network (observation ``(N, inputs)`` float32 -> values ``(N, actions)``) as ONNX.

    The file's metadata has the observer's options as "navigator".
    """
    network = copy.deepcopy(navigator.network).float()
    rows = torch.export.Dim("robots", min=1)
    program: Any = torch.onnx.export(
        network.eval(), (torch.zeros(2, network.inputs),), input_names=["observation"],
        output_names=["values"], dynamic_shapes=({0: rows},), dynamo=True, verbose=False,
    )  # fmt: skip
    graph = program.model_proto
    graph.metadata_props.add(key="navigator", value=json.dumps(navigator.observer.options))
    write_bytes(Path(path), graph.SerializeToString())
