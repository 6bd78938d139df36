"""Navigation: what the driver sees, how it is rewarded, how it learns, who drives, and what is counted."""

import json
import math
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from eldenet.navigation.arcs import ArcTable, arc_table
from eldenet.navigation.crossings import Crossings, Event
from eldenet.navigation.dqn import CHECKPOINT, DQN, Replay, Windows
from eldenet.navigation.evaluation import Crossing, cross, solved_by_all, summarise
from eldenet.navigation.noise import NoisyRanges
from eldenet.navigation.observer import Observer, Senses
from eldenet.navigation.planners.astar import AStarDWA, AStarOnlineDWA
from eldenet.navigation.planners.dwa import DynamicWindow, LocalDWA
from eldenet.navigation.planners.straight import Straight
from eldenet.navigation.policy import DEFAULT_WEIGHTS, Navigator, as_ranges, export_onnx
from eldenet.navigation.qnetwork import QNetwork
from eldenet.navigation.ranges import depth_to_ranges, footprints_to_ranges
from eldenet.navigation.sensors import Drift, Odometry, Ranges
from eldenet.navigation.statistics import mcnemar, spl, wilson_interval
from eldenet.navigation.tasks import TrainingArenas, frozen_arenas
from eldenet.robot import ROBOT
from eldenet.simulation.arena_view import ArenaView
from eldenet.simulation.arena_world import ArenaWorld, arc
from eldenet.simulation.arenas import Arena, Obstacle, generate_arena, triangle_course

gym = pytest.importorskip("gymnasium")
from eldenet.navigation.env import ArenaNavEnv, ArenaNavVectorEnv, reward  # noqa: E402
from eldenet.navigation.registration import register  # noqa: E402

register()  # as the installed package's entry point does

FAR = np.full((1, ROBOT.columns), ROBOT.far)


def senses(ranges=FAR, odometry=(0.0, 0.0, 0.0), goal=(8.0, 0.3)) -> Senses:
    return Senses(np.asarray(ranges, float), np.array([odometry]), np.array([goal]))


# --- the observation ---


def test_observation_columns():
    observer = Observer()
    ranges = FAR.copy()
    ranges[0, :8] = 2.5  # the rightmost sector
    seen = observer.observe(senses(ranges))[0]
    assert seen.shape == (39,)
    assert seen[:5] == pytest.approx([0.5, 1, 1, 1, 1])
    assert seen[5:8] == pytest.approx([8 / 20, math.sin(0.3), math.cos(0.3)])
    assert seen[8:10] == pytest.approx([0, 0])
    observer.commands(np.array([0]))
    seen = observer.observe(senses())[0]
    assert seen[8] == 1.0  # hard to the left
    assert seen[9] == pytest.approx(0.35)


@pytest.mark.parametrize(
    ("law", "expected"), [("paper", 0.5), ("turn", 0.5 * 0.75), ("prox", 0.5 * 0.75 * 0.5)]
)
def test_speed_laws(law, expected):
    observer = Observer(speed=law)
    observer.observe(senses(np.full((1, ROBOT.columns), 0.9), goal=(1.5, 0.0)))
    assert observer.commands(np.array([1]))[0] == pytest.approx([expected, 0.5])


def test_memory_keeps_what_left_the_view():
    observer = Observer(memory=60)
    ranges = FAR.copy()
    ranges[0, 20] = 1.0
    for _ in range(2):  # every second frame is kept
        observer.observe(senses(ranges))
    angle = ROBOT.column_angles[20]
    point = np.array([ROBOT.camera_ahead + math.cos(angle), math.sin(angle)])
    for step in range(1, 40):  # drive past it and turn round: it lies where it lay
        pose = (0.02 * step, -0.5, 0.05 * step)
        seen = observer.observe(senses(odometry=pose))[0]
        dx, dy = point - pose[:2]
        bearing = math.remainder(math.atan2(dy, dx) - pose[2], 2 * math.pi)
        number = int((bearing + math.pi) / (2 * math.pi) * 24)
        assert seen[10 + number] == pytest.approx(math.hypot(dx, dy) / 3, abs=1e-5)
        assert (np.delete(seen[10:34], number) == 1).all()
    for _ in range(70):
        seen = observer.observe(senses(odometry=pose))[0]
    assert (seen[10:34] == 1).all()  # forgotten after 12 s
    observer.observe(senses(ranges))
    observer.reset(0)
    assert (observer.observe(senses())[0][10:34] == 1).all()


def test_arc_tables_agree_with_moving_the_footprint():
    table = ArcTable(((0.8, 0.5), (0.0, 1.2), (1.0, 0.0)), 1.8, 0.04)
    rng = np.random.default_rng(0)
    points = rng.uniform(-2.2, 2.2, (400, 2)).astype(np.float32)
    cells = table.cells(points[:, 0], points[:, 1])
    for number, (speed, turn) in enumerate(table.commands):
        gaps = []
        for step in range(1, 19):
            # exact motion, by a thousand small steps
            t = np.linspace(0, step * 0.1, 1000)
            x = np.trapezoid(speed * np.cos(turn * t), t)
            y = np.trapezoid(speed * np.sin(turn * t), t)
            c, s = math.cos(turn * t[-1]), math.sin(turn * t[-1])
            local = (points - (x, y)) @ np.array([[c, -s], [s, c]])
            gaps.append(np.hypot(*np.maximum(np.abs(local) - (0.30, 0.25), 0).T))
        gaps = np.array(gaps)
        started = np.hypot(*np.maximum(np.abs(points) - (0.30, 0.25), 0).T)
        clear = started > 0.09  # of the footprint, its margin and half a cell
        got = table.gap[cells, number] / 100
        assert np.abs(got - np.minimum(gaps.min(axis=0), 2.55))[clear].max() < 0.05
        time = table.time[cells, number]
        surely, never = (gaps < 0.04 - 0.036).any(axis=0), (gaps > 0.04 + 0.036).all(axis=0)
        assert (time[surely & clear] < 18).all()
        assert (time[never & clear] == 18).all()
    assert arc_table(((0.5, 0.5),), 1.0) is arc_table(((0.5, 0.5),), 1.0)


def test_near_the_table_s_edge_nothing_breaks():
    table = arc_table(((0.5, 0.5),), 1.0)
    edge = np.nextafter(np.float32(2.4), np.float32(0))
    assert table.cells(np.array([edge]), np.array([edge])).max() < len(table.time)


@pytest.mark.parametrize(("options", "message"), [
    ({"speed": "fast"}, "speed='fast'"),
    ({"turn_rates": (1.0,)}, "give one each"),
    ({"memory": -1}, "memory=-1"),
])  # fmt: skip
def test_wrong_observers_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        Observer(**options)


# --- ranges ---


def test_depth_becomes_the_ranges_that_rays_give():
    arena = generate_arena("val", 40, 5)
    world, view = ArenaWorld(arena), ArenaView(arena, (120, 160))
    depth = view.photo(arena.start).depth
    got, true = depth_to_ranges(depth, view.intrinsics), world.ranges()
    near = true < 8
    assert near.sum() > 10
    assert np.median(np.abs(got - true)[near] / true[near]) < 0.03
    assert (got > true * 1.1).mean() < 0.05  # never far where something is near


def test_blindness_reads_as_near():
    intrinsics = ArenaView(triangle_course(), (120, 160)).intrinsics
    assert (depth_to_ranges(np.zeros((120, 160)), intrinsics) == ROBOT.near).all()
    assert (
        as_ranges(np.array([0.0, np.nan, 20.0, 5.0, 0.1]), None).reshape(5, -1)[:, 0]
        == [0.3, 0.3, 10, 5, 0.3]
    ).all()
    with pytest.raises(ValueError, match="intrinsics"):
        as_ranges(np.ones((4, 4)), None)
    with pytest.raises(ValueError, match=r"\(7,\)"):
        as_ranges(np.ones(7), None)


def test_boxes_become_the_ranges_of_their_near_faces():
    box = Obstacle("box", 3.0, 0.7, 0.4, (0.5, 0.3), 1.0)
    arena = Arena("", 1, 0, (box,), (0.0, 0.0, 0.0), ((5.0, 0.0),))
    true = ArenaWorld(arena).ranges()
    got = footprints_to_ranges(np.array([[3.0 - ROBOT.camera_ahead, 0.7, 0.4, 0.5, 0.3]]))
    on_box = got < ROBOT.far
    assert on_box.sum() > 5
    assert got[on_box] == pytest.approx(true[on_box], abs=1e-4)
    assert (footprints_to_ranges(np.empty((0, 5))) == ROBOT.far).all()


def test_noise_has_the_deviations_it_was_given():
    arena = generate_arena("val", 40, 5)
    world = ArenaWorld(arena)
    eye = NoisyRanges(scale=0.1, smooth=0.05, column=0.03).begin(world, np.random.default_rng(0))
    true = world.ranges()
    inside = (true > 0.6) & (true < 7)
    error = np.log(np.array([eye.look().ranges[inside] for _ in range(3000)]) / true[inside])
    # of a sum of independent errors; the interpolated one loses up to half of its variance between knots
    assert (
        math.sqrt(0.1**2 + 0.5 * 0.05**2 + 0.03**2) * 0.93
        < error.std()
        < math.sqrt(0.1**2 + 0.05**2 + 0.03**2) * 1.07
    )
    frames = error.mean(axis=1)
    assert np.corrcoef(frames[1:], frames[:-1])[0, 1] == pytest.approx(0.75, abs=0.1)


def test_odometry_drifts_by_what_it_says():
    poses = [(0.1 * k, 0.0, 0.0) for k in range(101)]  # ten metres straight ahead
    ends = []
    for seed in range(400):
        odometry = Odometry(Drift(0.02, math.radians(1)), np.random.default_rng(seed), poses[0])
        for before, after in pairwise(poses):
            odometry.move(before, after)
        ends.append(odometry.pose)
    ends = np.array(ends)
    assert np.degrees(ends[:, 2]).std() == pytest.approx(10.0, rel=0.15)
    assert ends[:, 0].std() > 0.15
    exact = Odometry(Drift(0.0, 0.0), np.random.default_rng(0), (1.0, 2.0, 0.5))
    exact.move((1.0, 2.0, 0.5), (1.3, 2.2, 0.9))
    assert exact.pose == pytest.approx((1.3, 2.2, 0.9))


# --- the environment ---


def test_reward_is_algorithm_1():
    values = reward(
        np.array([0.2, 0.0, -0.1, 0.1]), np.array([Event.NONE, Event.GOAL, Event.COLLISION, Event.TIMEOUT])
    )
    assert values == pytest.approx([0.09, 4.99, -5.06, 0.04])


def test_check_env_of_gymnasium_and_of_stable_baselines3():
    from gymnasium.utils.env_checker import check_env

    env = gym.make("eldenet/ArenaNav-v0", render_mode="rgb_array")
    check_env(env.unwrapped)
    env.reset(seed=0)
    picture = env.render()
    assert picture.dtype == np.uint8
    assert picture.shape[0] == 480
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(ArenaNavEnv())


def test_make_vec_finds_the_vector_environment():
    env = gym.make_vec("eldenet/ArenaNav-v0", num_envs=3, vectorization_mode="vector_entry_point")
    observation, _ = env.reset(seed=1)
    assert observation.shape == (3, 39)
    assert env.metadata["autoreset_mode"] == gym.vector.AutoresetMode.SAME_STEP


def test_importing_gymnasium_loads_no_simulator():
    import tomllib

    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]
    module, _, function = project["entry-points"]["gymnasium.envs"]["eldenet"].partition(":")
    code = (
        f"import gymnasium, sys; from {module} import {function}; {function}(); "
        "print('mujoco' in sys.modules, 'eldenet/ArenaNav-v0' in gymnasium.registry)"
    )
    shown = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    assert shown.stdout.split() == ["False", "True"]


def test_same_seed_same_episodes_and_autoreset_within_the_step():
    runs = []
    for _ in range(2):
        env = ArenaNavVectorEnv(4, arenas=TrainingArenas((60, 80)), sensor="noisy")
        observation, _ = env.reset(seed=7)
        log, ends = [observation], 0
        for step in range(120):
            observation, values, terminated, truncated, info = env.step(np.full(4, 2 if step % 3 else 1))
            ended = terminated | truncated
            if ended.any():
                ends += 1
                assert (info["_final_obs"] == ended).all()
                # the new episode has no last command; the old one had
                assert (observation[ended, 8:10] == 0).all()
                assert (info["final_obs"][ended, 9] > 0).all()
                assert (info["final_obs"][~ended] == observation[~ended]).all()
                assert np.isin(info["event"][terminated], (Event.GOAL, Event.COLLISION)).all()
            log += [observation, values]
        assert ends > 2
        runs.append(log)
    for first, second in zip(*runs, strict=True):
        np.testing.assert_array_equal(first, second)


def test_the_time_limit_truncates_and_the_goal_terminates():
    arena = Arena("", 0, 0, (), (0.0, 0.0, 0.0), ((3.0, 0.0),))
    env = ArenaNavEnv(arena=arena, time_limit=1.0)
    env.reset(seed=0)
    ends = [env.step(2)[2:4] for _ in range(5)]
    assert ends == [(False, False)] * 4 + [(False, True)]
    env = ArenaNavEnv(arena=arena)
    env.reset(seed=0)
    for _ in range(100):
        _, value, terminated, truncated, info = env.step(2)
        if terminated:
            break
    assert info == {"event": "goal", "is_success": True, "fed_by": ("simulator",) * 5}
    assert value > 4.9
    assert not truncated


def test_a_collision_at_the_goal_is_a_collision():
    box = Obstacle("box", 1.0, 0.0, 0.0, (0.3, 0.3), 1.0)
    env = ArenaNavEnv(arena=Arena("", 1, 0, (box,), (0.0, 0.0, 0.0), ((0.9, 0.0),)), speed="paper")
    env.reset(seed=0)
    events = (env.step(2)[4]["event"] for _ in range(50))
    first = next(event for event in events if event != "none")
    # the goal's circle begins at 0.40 m, where the front already touches the box
    assert first == "collision"


def test_way_points_are_driven_one_after_the_other():
    crossings = Crossings(1, Ranges())
    arena = triangle_course()
    crossings.start(0, arena, (0,))
    policy = Straight()
    reached = []
    for _ in range(400):
        _, events = crossings.step(policy.commands(crossings.sense()))
        if not reached or reached[-1] != crossings.goal(0):
            reached.append(crossings.goal(0))
        if events[0]:
            break
    assert Event(int(events[0])) is Event.GOAL
    assert reached == list(arena.waypoints)


# --- learning ---


def test_windows_are_n_step_returns_that_end_with_the_episode():
    rng = np.random.default_rng(0)
    replay = Replay(10_000, 1)
    windows = Windows(3, 2, 0.9, replay)
    episodes: list[list[list[tuple]]] = [[[]], [[]]]
    for step in range(60):
        obs = np.array([[step / 100], [step / 100 + 0.5]], np.float32)
        values, ended = rng.normal(size=2), rng.random(2) < 0.15
        terminated = ended & (rng.random(2) < 0.5)
        windows.push(obs, np.array([step % 5, step % 3]), values, obs + 0.01, terminated, ended)
        for robot in range(2):
            episodes[robot][-1].append(
                (obs[robot, 0], values[robot], obs[robot, 0] + 0.01, terminated[robot])
            )
            if ended[robot]:
                episodes[robot].append([])
    expected = set()
    for robot in range(2):
        for number, episode in enumerate(episodes[robot]):
            for start in range(len(episode)):
                part = episode[start : start + 3]
                if len(part) < 3 and number == len(episodes[robot]) - 1:
                    continue  # its end is not known yet
                value = sum(0.9**k * row[1] for k, row in enumerate(part))
                discount = 0.9 ** len(part) * (not part[-1][3])
                expected.add(
                    (
                        round(float(part[0][0]), 2),
                        round(value, 4),
                        round(float(part[-1][2]), 2),
                        round(discount, 4),
                    )
                )
    got = {
        (round(float(o), 2), round(float(v), 4), round(float(n), 2), round(float(d), 4))
        for o, v, n, d in zip(
            replay.obs[: len(replay), 0], replay.value, replay.next_obs[:, 0], replay.discount, strict=False
        )
    }
    assert got == expected


def tiny(folder: Path | None, steps: int, **options) -> DQN:
    env = ArenaNavVectorEnv(4, arenas=TrainingArenas((0, 5)))
    settings = {
        "steps": steps,
        "leg": 400,
        "warmup": 100,
        "batch_size": 16,
        "hidden": (16,),
        "seed": 3,
    } | options
    return DQN(env, **settings)


def test_a_resumed_training_equals_one_that_never_stopped(tmp_path):
    whole = tiny(None, 1200)
    whole.learn()
    first = tiny(None, 1200)

    def stop(dqn: DQN) -> None:
        if dqn.done >= 800:
            dqn.save(tmp_path / CHECKPOINT)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        first.learn(after_leg=stop)
    second = tiny(None, 1200)
    second.restore(tmp_path / CHECKPOINT)
    assert second.done == 800
    second.learn()
    assert second.updates == whole.updates > 100
    for name, weights in whole.policy_dqn.state_dict().items():
        torch.testing.assert_close(second.policy_dqn.state_dict()[name], weights, rtol=0, atol=0)
    with pytest.raises(FileNotFoundError, match="no checkpoint"):
        second.restore(tmp_path / "none.pt")


def test_algorithm_2_copies_hard_and_the_default_softly():
    hard = tiny(None, 400, n_step=1, double=False, target_every=10)
    hard.learn()
    rng = np.random.default_rng(0)
    while hard.updates % 10:
        hard.update(rng)
    assert all(
        torch.equal(a, b)
        for a, b in zip(hard.policy_dqn.parameters(), hard.target_dqn.parameters(), strict=True)
    )
    hard.update(rng)
    assert not all(
        torch.equal(a, b)
        for a, b in zip(hard.policy_dqn.parameters(), hard.target_dqn.parameters(), strict=True)
    )
    soft = tiny(None, 400, tau=0.25)
    before = [p.clone() for p in soft.target_dqn.parameters()]
    soft.learn()
    rng, before = np.random.default_rng(0), [p.clone() for p in soft.target_dqn.parameters()]
    soft.update(rng)
    for target, old, policy in zip(
        soft.target_dqn.parameters(), before, soft.policy_dqn.parameters(), strict=True
    ):
        torch.testing.assert_close(target, 0.75 * old + 0.25 * policy, rtol=1e-5, atol=1e-7)


def test_it_learns_what_a_table_would():
    """A corridor of ten cells, left or right; the values of the optimal policy are known."""

    class Corridor:
        num_envs = 8
        single_observation_space = gym.spaces.Box(-1, 1, (10,), np.float32)
        single_action_space = gym.spaces.Discrete(2)

        def _obs(self):
            return np.eye(10, dtype=np.float32)[self.at]

        def reset(self, *, seed=None):
            self.rng = np.random.default_rng(seed)
            self.at = self.rng.integers(0, 9, 8)
            return self._obs(), {}

        def step(self, action):
            self.at = np.clip(self.at + np.where(action == 1, 1, -1), 0, 9)
            done, obs = self.at == 9, self._obs()
            info = {"event": done.astype(int), "final_obs": obs}
            self.at = np.where(done, self.rng.integers(0, 9, 8), self.at)
            return self._obs(), done.astype(float), done, np.zeros(8, bool), info

    learner = DQN(
        Corridor(), steps=12_000, leg=12_000, warmup=200, gamma=0.9, batch_size=64, hidden=(32,), replay=4000,
        learning_rate=3e-3, tau=0.02, exploration_end=0.3,
    )  # fmt: skip
    learner.learn()
    with torch.no_grad():
        values = learner.policy_dqn(torch.eye(10))[:9]
    assert (values.argmax(1) == 1).all()
    assert values[:, 1].numpy() == pytest.approx([0.9 ** (8 - cell) for cell in range(9)], abs=0.12)


def test_gradients_are_clipped_and_rates_fall_only_where_asked():
    rates = []
    for options in ({}, {"learning_rate_end": 1.0, "gradient_clip": 0.0}, {"gradient_clip": 1e-6}):
        learner = tiny(None, 400, **options)
        learner.learn()
        rates.append(learner.optimizer.param_groups[0]["lr"])
        norm = torch.cat([p.grad.flatten() for p in learner.policy_dqn.parameters()]).norm()
        assert (norm <= 1.001e-6) == (options.get("gradient_clip") == 1e-6)
    assert rates == pytest.approx([5e-5, 5e-4, 5e-5], rel=0.1)


def test_wrong_learners_are_refused():
    with pytest.raises(ValueError, match="gamma"):
        tiny(None, 100, gamma=1.0)


# --- policies ---


def test_the_packaged_policy_is_small_and_drives():
    assert DEFAULT_WEIGHTS.stat().st_size < 200_000
    rows = cross(frozen_arenas(5, 12, split="val"), lambda robots: Navigator.load(robots=robots), Ranges())
    assert summarise(rows)["success"] >= 90


def test_a_world_ends_alike_alone_and_among_others():
    arenas = frozen_arenas(80, 5, split="val")
    make = lambda robots: Navigator.load(robots=robots)  # noqa: E731
    together = cross(arenas, make, NoisyRanges(), robots=5)
    by_two = cross(arenas, make, NoisyRanges(), robots=2)
    assert together == by_two


def test_saved_and_loaded_it_decides_alike(tmp_path):
    torch.manual_seed(0)
    navigator = Navigator(QNetwork(39, 5, (16,)), {}, info={"note": "x"})
    navigator.save(tmp_path / "policy.safetensors")
    loaded = Navigator.load(tmp_path / "policy.safetensors")
    assert loaded.info == {"note": "x"}
    rng = np.random.default_rng(0)
    for _ in range(20):
        sight, goal = (
            rng.uniform(0.3, 10, ROBOT.columns),
            (float(rng.uniform(1, 10)), float(rng.uniform(-3, 3))),
        )
        assert navigator.step(sight, goal, (0.0, 0.0, 0.0)) == loaded.step(sight, goal, (0.0, 0.0, 0.0))
    with pytest.raises(FileNotFoundError, match="no policy"):
        Navigator.load(tmp_path / "none.safetensors")
    from safetensors.torch import save_file

    save_file({"a": torch.zeros(1)}, str(tmp_path / "other.safetensors"))
    with pytest.raises(ValueError, match="holds no navigation policy"):
        Navigator.load(tmp_path / "other.safetensors")
    with pytest.raises(ValueError, match="not trained together"):
        Navigator(QNetwork(10, 5), {})


def test_the_robot_s_side_loads_no_simulator():
    code = (
        "import numpy as np, sys; from eldenet.navigation.policy import Navigator; "
        "print(Navigator.load().step(np.full(5, 8.0), (5.0, 0.0), (0.0, 0.0, 0.0))); "
        "print(*sys.modules)"
    )
    shown = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    speed, turn = eval(shown.stdout.splitlines()[0])
    assert 0 < speed <= 1
    assert abs(turn) <= 1.2
    modules = shown.stdout.splitlines()[1].split()
    assert not {"mujoco", "gymnasium", "cv2", "hydra"} & set(modules)
    assert not [name for name in modules if name.startswith("eldenet.simulation")]


def test_onnx_gives_the_same_values(tmp_path):
    runtime = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    navigator = Navigator.load()
    export_onnx(navigator, tmp_path / "policy.onnx")
    session = runtime.InferenceSession(str(tmp_path / "policy.onnx"), providers=["CPUExecutionProvider"])
    observation = np.random.default_rng(0).uniform(-1, 1, (7, navigator.network.inputs)).astype(np.float32)
    (values,) = session.run(None, {"observation": observation})
    with torch.no_grad():
        expected = navigator.network(torch.from_numpy(observation).double()).numpy()
    assert values == pytest.approx(expected, abs=1e-4)
    assert json.loads(session.get_modelmeta().custom_metadata_map["navigator"]) == navigator.observer.options


@pytest.mark.parametrize("make", [AStarDWA, AStarOnlineDWA, LocalDWA], ids=lambda make: make.name)
def test_planners_cross_an_open_arena(make):
    rows = cross(frozen_arenas(5, 3, split="val"), lambda robots: make(robots=robots), Ranges())
    assert [row.outcome for row in rows] == ["success"] * 3
    assert all(row.travelled >= 0.9 * row.shortest for row in rows)


def test_a_star_goes_round_a_wall_that_a_local_planner_does_not():
    fence = [Obstacle("box", 0.0, y, 0.0, (0.2, 0.5), 1.0) for y in np.arange(-7.5, 6.0, 1.0)]
    arena = Arena("", 14, 0, tuple(fence), (-4.0, -1.0, 0.0), ((4.0, -1.0),))
    (row,) = cross([arena], lambda robots: AStarDWA(robots=robots), Ranges())
    assert row.outcome == "success"
    (row,) = cross([arena], lambda robots: LocalDWA(robots=robots), Ranges())
    assert row.outcome != "success"


def test_the_dynamic_window_avoids_what_is_ahead():
    window = DynamicWindow()
    wall = np.stack([np.full(41, 0.9), np.linspace(-1.0, 0.2, 41)], axis=1)
    pose, command = (0.0, 0.0, 0.0), (0.5, 0.0)
    for _ in range(100):
        c, s = math.cos(pose[2]), math.sin(pose[2])
        turned = np.array([[c, -s], [s, c]])
        points, target = (wall - pose[:2]) @ turned, (np.array([2.5, 0.5]) - pose[:2]) @ turned
        assert np.hypot(*np.maximum(np.abs(points) - (0.30, 0.25), 0).T).min() > 0
        command = window.choose(points, tuple(target), command)
        pose = arc(*pose, *command, 0.2)
    assert pose[0] > 1.5  # round its left end
    # a closed ring: no way at all
    angles = np.linspace(0, 2 * math.pi, 200)
    ring = 0.45 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    assert window.choose(ring, (2.0, 0.0), (0.0, 0.0))[0] == 0.0
    assert window.choose(np.empty((0, 2)), (2.0, 0.0), (1.0, 0.0)) == (1.0, 0.0)


# --- what is counted ---


def test_intervals_and_tests_agree_with_scipy():
    from scipy.stats import binomtest

    for successes, trials in ((0, 200), (443, 500), (200, 200), (1, 3)):
        expected = binomtest(successes, trials).proportion_ci(method="wilson")
        assert wilson_interval(successes, trials) == pytest.approx((expected.low, expected.high), abs=1e-6)
    a = [True] * 60 + [False] * 40
    b = [True] * 50 + [False] * 10 + [True] * 2 + [False] * 38
    first, second, p = mcnemar(a, b)
    assert (first, second) == (10, 2)
    assert p == pytest.approx(binomtest(10, 12).pvalue)
    assert mcnemar(a, a) == (0, 0, 1.0)
    with pytest.raises(ValueError, match="same worlds"):
        mcnemar(a, b[:-1])
    assert spl(
        np.array([True, True, False]), np.array([10.0, 20.0, 5.0]), np.array([10.0, 10.0, 5.0])
    ) == pytest.approx(0.5)


def test_times_are_compared_on_worlds_that_all_solved():
    def table(*outcomes):
        return [Crossing(f"w{k}", 5, outcome, 10.0, 10.0, 9.0) for k, outcome in enumerate(outcomes)]

    both = solved_by_all([table("success", "success", "timeout"), table("success", "collision", "success")])
    assert both.tolist() == [True, False, False]
    summary = summarise(table("success", "collision", "timeout", "success"))
    assert summary["success"] + summary["collision"] + summary["timeout"] == 100
    with pytest.raises(ValueError, match="different worlds"):
        solved_by_all([table("success"), table("success", "success")])


# --- the command ---


def test_evaluate_writes_rows_and_a_record(run_command, tmp_path):
    finished = run_command(
        "navigate", "mode=evaluate", "density=[5,20]", "worlds=3", "physics=kinematic", "run_dir=run"
    )
    assert finished.returncode == 0, finished.stderr
    run = json.loads((tmp_path / "run" / "run.json").read_text())
    assert run["metrics"]["5"]["worlds"] == 3
    assert set(run["arenas"]) == {"5", "20"}
    assert (tmp_path / "run" / "worlds_20.csv").read_text().count("\n") == 4
    assert "success [%]" in finished.stdout


def test_watch_films_without_a_display(run_command, tmp_path):
    from PIL import Image

    finished = run_command(
        "navigate", "density=5", "time_limit=2", "film=gif", "physics=kinematic", "run_dir=run", DISPLAY=""
    )
    assert finished.returncode == 0, finished.stderr
    (film,) = (tmp_path / "run").glob("*.gif")
    with Image.open(film) as picture:
        assert picture.n_frames >= 10
        assert picture.size[1] == 480


def test_train_goes_on_and_leaves_a_policy(run_command, tmp_path):
    small = (
        "mode=train", "learner.steps=600", "learner.leg=300", "learner.warmup=100", "learner.batch_size=16",
        "training.robots=4", "training.validate=2", "training.arenas.densities=[0,5]", "run_dir=run",
    )  # fmt: skip
    finished = run_command("navigate", *small)
    assert finished.returncode == 0, finished.stderr
    policy = tmp_path / "run" / "policy.safetensors"
    assert Navigator.load(policy).info == {"steps": 600, "seed": 0}
    note = json.loads((tmp_path / "run" / "training.json").read_text())
    assert [leg["steps"] for leg in note["legs"]] == [300, 600]
    finished = run_command("navigate", *small, "seed=1")
    assert finished.returncode == 1
    assert "other settings" in finished.stderr


@pytest.mark.parametrize(("arguments", "message"), [
    (["mode=fly"], "mode='fly'"),
    (["density=500"], "density=500"),
    (["density=[5,20]"], "films one arena"),
    (["mode=evaluate", "worlds=0"], "worlds=0: give at least one"),
    (["goal=gps", "density=5", "physics=kinematic"], "choose one of known, odometry"),
    (["policy=dqn", "checkpoint=none.safetensors"], "no policy at none.safetensors"),
])  # fmt: skip
def test_a_mistake_is_one_clear_line(run_command, arguments, message):
    finished = run_command("navigate", *arguments)
    assert finished.returncode == 1
    assert message in finished.stderr
    assert "Traceback" not in finished.stderr
