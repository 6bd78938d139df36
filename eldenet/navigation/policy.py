"""The trained driver without a simulator: what a robot runs.

``navigator = Navigator.load(); speed, turn = navigator.step(depth, goal, odometry)``, five times a second.
Needs torch, NumPy and safetensors; neither MuJoCo nor Gymnasium is imported.
"""

import copy
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from eldenet.navigation.observer import Observer, Senses
from eldenet.navigation.qnetwork import QNetwork
from eldenet.navigation.ranges import depth_to_ranges
from eldenet.simulation.robot import ROBOT

DEFAULT_WEIGHTS = Path(__file__).resolve().parent.parent / "weights" / "arena_dqn.safetensors"
POLICY = "policy.safetensors"  # of a training, in its run folder
SLOWS_WITHIN = 3.0  # [m] of the observer's speed laws, and so of training


class Driver(Observer):
    """An observer that may drive with another slow-down before the goal than that of its training.

    Args:
        robots: how many at once.
        slows_within: meters from the goal where it begins to slow down.
        options: of :class:`~eldenet.navigation.observer.Observer`.

    Raises:
        ValueError: an argument is out of its range.
    """

    def __init__(self, robots: int = 1, *, slows_within: float = SLOWS_WITHIN, **options: Any) -> None:
        if slows_within <= 0:
            raise ValueError(f"slows_within={slows_within}: give meters from the goal, above 0")
        super().__init__(robots, **options)
        self.trained_with = dict(self.options)
        self.slows_within = float(slows_within)
        self.options["slows_within"] = self.slows_within

    def _speeds(self, distance: np.ndarray, nearest: np.ndarray) -> np.ndarray:
        return super()._speeds(distance * (SLOWS_WITHIN / self.slows_within), nearest)


class Ensemble(nn.Module):
    """Networks of one shape that were trained apart; a value is their mean.

    Raises:
        ValueError: they have different shapes.
    """

    def __init__(self, members: Sequence[QNetwork]) -> None:
        super().__init__()
        shapes = {(member.inputs, member.actions, member.hidden) for member in members}
        if len(shapes) > 1:
            raise ValueError(
                f"networks of {sorted(shapes)} (inputs, actions, hidden): give those of one shape"
            )
        self.members = nn.ModuleList(members)
        ((self.inputs, self.actions, self.hidden),) = shapes

    def forward(self, observation: Tensor) -> Tensor:
        """Values ``(N, actions)``, the greater the better."""
        return torch.stack([member(observation) for member in self.members]).mean(0)


class Navigator:
    """A Q-network, or several, with the observer of their training, for one robot or many.

    Args:
        network: trained.
        observer: options of :class:`Driver`.
        robots: how many drive at once.
        info: what is known of the training.
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
        self.observer = Driver(robots, **observer)
        if network.inputs != self.observer.size or network.actions != self.observer.actions:
            raise ValueError(
                f"the network takes {network.inputs} inputs, values {network.actions} actions; its observer "
                f"gives {self.observer.size} and {self.observer.actions}: they were not trained together"
            )
        # float64, so that a robot drives alike alone and among others: no tie is broken by rounding
        self.network = network.double().eval()
        self.info = info or {}

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
        """Read a policy.

        Args:
            path: of the file, or of its training's run folder; several: their networks drive together, by the
                mean of their values; None: the policy that comes with the package.
            observer: what it must have been trained with; None: anything.
            walkers: follow what moves (:class:`~eldenet.navigation.observer.Observer`), also with a policy
                that was trained without; None: as the file says.
            slows_within: meters from the goal where it begins to slow down; None: as the file says.
            robots: how many drive at once.

        Raises:
            FileNotFoundError: there is none.
            ValueError: a file is no policy, or of another observer than was asked for or another shape than
                the others.
        """
        networks, notes = [], []
        for file in policy_files(path):
            members, content = _read(file)
            networks += members
            notes.append(content)
            wanted = notes[0]["observer"] if observer is None else observer
            if Driver(**wanted).trained_with != Driver(**content["observer"]).trained_with:
                raise ValueError(
                    f"{file} was trained with the observer {content['observer']}, not {wanted}: give the "
                    "checkpoint of a driver that was trained so"
                )
        options = dict(notes[0]["observer"])
        options |= {} if walkers is None else {"walkers": walkers}
        options |= {} if slows_within is None else {"slows_within": slows_within}
        info = notes[0]["info"] if len(notes) == 1 else {"members": [each["info"] for each in notes]}
        network = networks[0] if len(networks) == 1 else Ensemble(networks)
        return cls(network, options, robots=robots, info=info)

    def save(self, path: str | Path) -> None:
        """Write weights and observer into one ``.safetensors`` file; the networks of several as float16."""
        members = len(self.network.members) if isinstance(self.network, Ensemble) else 1
        notes = {
            "inputs": self.network.inputs,
            "actions": self.network.actions,
            "hidden": self.network.hidden,
            "members": members,
            "observer": self.observer.options,
            "info": self.info,
        }
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        stored = torch.float16 if members > 1 else torch.float32
        weights = {name: tensor.to(stored).contiguous() for name, tensor in self.network.state_dict().items()}
        save_file(weights, str(path), metadata={"navigator": json.dumps(notes)})

    def reset(self, robot: int | slice = slice(None), world: Any = None) -> None:
        """Forget what a robot saw: call it whenever a robot starts from somewhere else."""
        self.observer.reset(robot)

    @torch.inference_mode()
    def commands(self, senses: Senses, robots: np.ndarray | None = None) -> np.ndarray:
        """Speed [m/s] and turn rate [rad/s] ``(N, 2)`` of all robots; rows beyond ``robots`` are void."""
        who = np.arange(self.observer.robots) if robots is None else robots
        observation = self.observer.observe(senses, robots)
        actions = np.zeros(self.observer.robots, np.intp)
        actions[who] = self.network(torch.from_numpy(observation).double()).argmax(1).numpy()
        return self.observer.commands(actions)

    def step(
        self,
        sight: np.ndarray,
        goal: tuple[float, float],
        odometry: tuple[float, float, float],
        *,
        intrinsics: np.ndarray | None = None,
    ) -> tuple[float, float]:
        """One decision of one robot; call it every 0.2 s.

        Args:
            sight: depth ``(H, W)`` [m] of a level camera, with ``intrinsics``; or ranges ``(columns,)`` [m],
                equal in angle over the field of view, right to left; or the five sectors' ``(5,)``.
            goal: distance [m] and bearing [rad, counter-clockwise from ahead].
            odometry: x, y [m] and heading [rad] in any frame that stays.
            intrinsics: ``(3, 3)`` of the depth map [px].

        Returns:
            Speed [m/s] and turn rate [rad/s, counter-clockwise].

        Raises:
            ValueError: the sight has none of these shapes, a depth map came without intrinsics, or its camera
                sees less than the 69.4 degrees that the driver was trained with.
        """
        ranges = as_ranges(np.asarray(sight, dtype=np.float64), intrinsics)
        senses = Senses(
            ranges[None], np.array([odometry], dtype=np.float64), np.array([goal], dtype=np.float64)
        )
        speed, turn = self.commands(senses)[0].tolist()
        return speed, turn


def policy_files(path: str | Path | Sequence[str | Path] | None) -> list[Path]:
    """The files that :meth:`Navigator.load` reads: of a run folder its policy, of None the packaged one.

    Raises:
        ValueError: an empty list, or something that is no path.
    """
    given = DEFAULT_WEIGHTS if path is None else path
    paths = [given] if isinstance(given, str | Path) else given
    if not (isinstance(paths, Sequence) and all(isinstance(each, str | Path) for each in paths)):
        raise ValueError(f"no policy: {given} was given, give a run folder, a file or a list of them")
    if not paths:
        raise ValueError("no policy: an empty list was given, give one file or more")
    return [Path(each) / POLICY if Path(each).is_dir() else Path(each) for each in paths]


def _read(path: Path) -> tuple[list[QNetwork], dict[str, Any]]:
    """Networks of a policy's file, and its notes.

    Raises:
        FileNotFoundError: there is none.
        ValueError: the file is no policy.
    """
    if not path.is_file():
        raise FileNotFoundError(
            f"no policy at {path}: train one with python -m eldenet.navigate mode=train, which writes it at "
            "its end, and give its run folder or the file"
        )
    try:
        with safe_open(str(path), framework="pt") as file:
            notes = (file.metadata() or {}).get("navigator")
            weights = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except SafetensorError as error:
        raise ValueError(
            f"{path} is no .safetensors file ({error}): give a training's run folder, or the {POLICY} in it"
        ) from error
    if notes is None:
        raise ValueError(f"{path} holds no navigation policy: no note of the observer in it")
    content: dict[str, Any] = json.loads(notes)
    shape = content["inputs"], content["actions"], tuple(content["hidden"])
    networks = [QNetwork(*shape) for _ in range(content.get("members", 1))]
    (networks[0] if len(networks) == 1 else Ensemble(networks)).load_state_dict(weights)
    return networks, content


def as_ranges(sight: np.ndarray, intrinsics: np.ndarray | None) -> np.ndarray:
    """Ranges ``(columns,)`` [m] from a depth map, from columns, or from sectors."""
    if sight.ndim == 2:
        if intrinsics is None:
            raise ValueError("a depth map needs its camera's intrinsics=(3, 3) [px]")
        return depth_to_ranges(sight, intrinsics)
    if sight.ndim != 1 or not sight.size or ROBOT.columns % sight.size:
        raise ValueError(
            f"sight has shape {sight.shape}: give depth (H, W), ranges ({ROBOT.columns},) or sectors (5,)"
        )
    # unknown (0, nan) reads as near: a camera that is blind close up must not drive on; inf shows nothing
    known = sight > 0
    ranges = np.where(known, np.clip(sight, ROBOT.near, ROBOT.far), ROBOT.near)
    return np.repeat(ranges, ROBOT.columns // sight.size)


def export_onnx(navigator: Navigator, path: str | Path) -> None:
    """Write the network (observation ``(N, inputs)`` float32 -> values ``(N, actions)``) as ONNX.

    The observer's options stand in the file's metadata under "navigator".
    """
    import onnx

    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    network = copy.deepcopy(navigator.network).float()
    rows = torch.export.Dim("robots", min=1)
    torch.onnx.export(
        network.eval(), (torch.zeros(2, network.inputs),), str(path), input_names=["observation"],
        output_names=["values"], dynamic_shapes=({0: rows},), dynamo=True, external_data=False, verbose=False,
    )  # fmt: skip
    model = onnx.load(str(path))
    notes = model.metadata_props.add()
    notes.key, notes.value = "navigator", json.dumps(navigator.observer.options)
    onnx.save(model, str(path))
