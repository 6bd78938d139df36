"""``eldenet/ArenaNav-v0``: a Gymnasium environment, for one robot and for many."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv

from eldenet.navigation.episodes import FIXED, TIME_LIMIT, Episodes, EpisodeSettings, Event, Randomization
from eldenet.navigation.noisy_ranges import NoisyRanges
from eldenet.navigation.observer import Observer
from eldenet.navigation.sensors import Ranges, Sensor
from eldenet.navigation.tasks import TrainingArenas
from eldenet.simulation.arenas import Arena
from eldenet.system.checks import one_of

GOAL_REWARD, COLLISION_REWARD, PROGRESS_REWARD, STEP_REWARD = 5.0, -5.0, 0.5, -0.01


def reward(progress: np.ndarray, events: np.ndarray) -> np.ndarray:
    """Reward ``(N,)`` for progress and the goal, less penalties for a collision and for time.

    The terms are those of the paper's prose, but for time; the constants are ours, as Algorithm 1's listing
    is missing from our copy of the text.

    Args:
        progress: toward the way-point ``(N,)`` [m].
        events: :class:`~eldenet.navigation.episodes.Event` numbers ``(N,)``.
    """
    out: np.ndarray = PROGRESS_REWARD * progress + STEP_REWARD
    out = out + GOAL_REWARD * (events == Event.GOAL) + COLLISION_REWARD * (events == Event.COLLISION)
    return out


def make_sensor(sensor: str | Sensor) -> Sensor:
    """Return a sensor by name, "ranges" or "noisy" (with the packaged errors); a sensor is returned as is."""
    if not isinstance(sensor, str):
        return sensor
    one_of("sensor", sensor, ("ranges", "noisy"))
    return Ranges() if sensor == "ranges" else NoisyRanges(errors="packaged")


class ArenaNavVectorEnv(VectorEnv):
    """``num_envs`` robots, each in its own arena.

    When an episode ends, the next one starts within the same step (``AutoresetMode.SAME_STEP``): the returned
    observation is the first of the new episode, and ``info["final_obs"]`` (with the mask
    ``info["_final_obs"]``) is the last of the old one, ``info["seconds"]`` its duration. A collision and the
    goal terminate; the time limit truncates; ``info["event"]`` says which, as numbers of
    :class:`~eldenet.navigation.episodes.Event`. With a camera, ``info["fed_by"]`` ``(num_envs, 5)`` is the
    source of each sector: "depth" or "box".

    Args:
        sensor: "ranges", "noisy" or a :class:`~eldenet.navigation.sensors.Sensor`.
        physics: "kinematic" or "wheels".
        num_envs: number of robots.
        arenas: to train in; None: :class:`~eldenet.navigation.tasks.TrainingArenas`.
        time_limit: of an episode [s].
        goal: "known", "fixes" or "odometry"; see :class:`~eldenet.navigation.episodes.EpisodeSettings`.
        randomization: size (drawn for each arena), speed and latency (for each episode) of the robot.
        observer: options of :class:`~eldenet.navigation.observer.Observer`.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int = 64,
        *,
        sensor: str | Sensor = "ranges",
        physics: str = "kinematic",
        arenas: TrainingArenas | None = None,
        time_limit: float = TIME_LIMIT,
        goal: str = "known",
        randomization: Randomization = FIXED,
        **observer: Any,
    ) -> None:
        self.num_envs = num_envs
        self.observer = Observer(num_envs, **observer)
        settings = EpisodeSettings(physics, goal, time_limit)
        self.episodes = Episodes(num_envs, make_sensor(sensor), settings, randomization)
        self.arenas = arenas or TrainingArenas()
        self._tasks: list[TrainingArenas] = []
        self._rngs: list[np.random.Generator] = []
        self.single_observation_space = gym.spaces.Box(-1.0, 1.0, (self.observer.size,), np.float32)
        self.single_action_space = gym.spaces.Discrete(self.observer.actions)
        self.observation_space = gym.vector.utils.batch_space(self.single_observation_space, num_envs)
        self.action_space = gym.vector.utils.batch_space(self.single_action_space, num_envs)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode in every slot; return ``(num_envs, size)``. Seeds in a list are one per slot."""
        if seed is not None or not self._rngs:
            if isinstance(seed, list):
                streams = [np.random.SeedSequence(s) for s in seed]
            else:
                # a list of one number: trainings stay the same bit for bit
                streams = np.random.SeedSequence(None if seed is None else [seed]).spawn(self.num_envs)
            self._rngs = [np.random.Generator(np.random.PCG64(s)) for s in streams]
            self._tasks = [self.arenas.fresh() for _ in range(self.num_envs)]
        for slot in range(self.num_envs):
            self._begin(slot)
        return self.observer.observe(self.episodes.sense()), {}

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Run one control period of every robot by action numbers ``(num_envs,)``."""
        progress, events = self.episodes.step(self.observer.commands(np.asarray(actions)))
        observation = self.observer.observe(self.episodes.sense())
        terminated = (events == Event.GOAL) | (events == Event.COLLISION)
        truncated = events == Event.TIMEOUT
        ended = np.flatnonzero(terminated | truncated)
        info: dict[str, Any] = {"event": events}
        if len(ended):
            info["final_obs"] = observation.copy()
            info["_final_obs"] = terminated | truncated
            info["seconds"] = self.episodes.seconds.copy()
            for slot in ended.tolist():
                self._begin(slot)
            senses = self.episodes.sense(ended.tolist())
            observation[ended] = self.observer.observe(senses, ended)
        scans = [self.episodes.scans[slot] for slot in range(self.num_envs)]
        if scans[0].image is not None:
            info["fed_by"] = np.array([scan.sectors_fed_by for scan in scans])
        return observation, reward(progress, events), terminated, truncated, info

    def _begin(self, slot: int) -> None:
        rng = self._rngs[slot]
        self.episodes.start(slot, self._tasks[slot].draw(rng), (int(rng.integers(2**31)),))
        self.observer.reset(slot)


class ArenaNavEnv(gym.Env):
    """One robot: what ``gymnasium.make("eldenet.navigation.registration:eldenet/ArenaNav-v0")`` returns.

    ``info["fed_by"]`` is the source of each sector's nearest range, right to left: "simulator", "depth" or
    "box"; after a step, ``info["event"]`` is "none", "goal", "collision" or "timeout".

    Args:
        arena: of every episode, such as :func:`~eldenet.simulation.arenas.triangle_course` or what
            :func:`~eldenet.simulation.arena_files.read_arena` reads; None: a new one each time.
        arenas: source of the new ones.
        render_mode: None or "rgb_array": a top view, with the camera's view beside it.

    ``sensor``, ``physics``, ``time_limit``, ``goal``, ``observer``: as in :class:`ArenaNavVectorEnv`.

    Raises:
        ValueError: an argument is none of its choices.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 5}  # noqa: RUF012

    def __init__(
        self,
        *,
        arena: Arena | None = None,
        arenas: TrainingArenas | None = None,
        sensor: str | Sensor = "ranges",
        physics: str = "kinematic",
        time_limit: float = TIME_LIMIT,
        goal: str = "known",
        render_mode: str | None = None,
        **observer: Any,
    ) -> None:
        one_of("render_mode", render_mode, (None, "rgb_array"))
        self.render_mode = render_mode
        self.observer = Observer(1, **observer)
        self.episodes = Episodes(1, make_sensor(sensor), EpisodeSettings(physics, goal, time_limit))
        self.observation_space = gym.spaces.Box(-1.0, 1.0, (self.observer.size,), np.float32)
        self.action_space = gym.spaces.Discrete(self.observer.actions)
        self._arena, self._arenas = arena, (arenas or TrainingArenas()).fresh()
        self._scene: Any = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode and return ``(size,)``; a seed restarts the stream of arenas."""
        super().reset(seed=seed)
        if seed is not None:
            self._arenas = self._arenas.fresh()
        arena = self._arena or self._arenas.draw(self.np_random)
        self.episodes.start(0, arena, (int(self.np_random.integers(2**31)),))
        self.observer.reset()
        self._scene = None
        observation = self.observer.observe(self.episodes.sense())[0]
        return observation, {"arena": arena.name, "fed_by": self._fed_by}

    def step(self, action: int) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Run one control period; the observation is ``(size,)``."""
        progress, events = self.episodes.step(self.observer.commands(np.array([int(action)])))
        observation = self.observer.observe(self.episodes.sense())[0]
        event = Event(int(events[0]))
        if self._scene is not None:
            self._scene.trail.append(tuple(self.episodes.poses[0]))
        value = float(reward(progress, events)[0])
        info = {"event": event.name.lower(), "is_success": event is Event.GOAL, "fed_by": self._fed_by}
        return observation, value, event in (Event.GOAL, Event.COLLISION), event is Event.TIMEOUT, info

    @property
    def _fed_by(self) -> tuple[str, ...]:
        return self.episodes.scans[0].sectors_fed_by

    def render(self) -> np.ndarray | None:
        """Top view and camera view ``(H, W, 3)`` uint8 RGB; the trail starts at the first call."""
        from eldenet.navigation.visualization import Scene

        if self.render_mode is None or not self.episodes.worlds:
            return None
        if self._scene is None:
            self._scene = Scene(self.episodes.worlds[0].arena)
            self._scene.trail.append(tuple(self.episodes.poses[0]))
        return self._scene.draw(self.episodes, 0)
