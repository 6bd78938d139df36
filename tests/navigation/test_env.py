"""The Gymnasium environment."""

import subprocess
import sys

import numpy as np
import pytest

from eldenet.navigation.episodes import Episodes, Event
from eldenet.navigation.planners.straight import Straight
from eldenet.navigation.sensors import Ranges
from eldenet.navigation.tasks import TrainingArenas
from eldenet.simulation.arenas import Arena, triangle_course
from eldenet.simulation.obstacle import Obstacle

gym = pytest.importorskip("gymnasium")
from eldenet.navigation.env import ArenaNavEnv, ArenaNavVectorEnv, make_sensor, reward  # noqa: E402

NAME = "eldenet.navigation.registration:eldenet/ArenaNav-v0"


def test_the_rewards_terms_and_numbers_are_as_documented():
    values = reward(
        np.array([0.2, 0.0, -0.1, 0.1]), np.array([Event.NONE, Event.GOAL, Event.COLLISION, Event.TIMEOUT])
    )
    assert values == pytest.approx([0.09, 4.99, -5.06, 0.04])


def test_gymnasium_and_stable_baselines3_accept_the_environment():
    from gymnasium.utils.env_checker import check_env

    env = gym.make(NAME, render_mode="rgb_array")
    check_env(env.unwrapped)
    env.reset(seed=0)
    picture = env.render()
    assert picture.dtype == np.uint8
    assert picture.shape[0] == 500
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(ArenaNavEnv())


def test_make_vec_returns_the_vector_environment():
    env = gym.make_vec(NAME, num_envs=3, vectorization_mode="vector_entry_point")
    observation, _ = env.reset(seed=1)
    assert observation.shape == (3, 39)
    assert env.metadata["autoreset_mode"] == gym.vector.AutoresetMode.SAME_STEP


def test_observer_options_are_options_of_the_environment():
    assert ArenaNavVectorEnv(2, memory=30).observer.options["memory"] == 30
    with pytest.raises(TypeError, match="density"):
        ArenaNavVectorEnv(2, density=80)


def test_registration_loads_no_simulator():
    code = (
        "import gymnasium, sys; import eldenet.navigation.registration; print('mujoco' in sys.modules); "
        f"gymnasium.registry.clear(); del sys.modules['eldenet.navigation.registration']; "
        f"print(gymnasium.make({NAME!r}).unwrapped.observation_space.shape)"
    )
    shown = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    assert shown.stdout.splitlines() == ["False", "(39,)"]


def test_noisy_is_the_same_as_in_the_command():
    from eldenet.compose import compose
    from eldenet.configurable import instantiate
    from eldenet.navigate import NavigateSettings

    assert (
        make_sensor("noisy").errors == instantiate(compose(NavigateSettings, ["sensor=noisy"]).sensor).errors
    )
    with pytest.raises(ValueError, match="give one of ranges, noisy"):
        make_sensor("camera")


def test_equal_seeds_give_equal_episodes_and_a_reset_within_the_step():
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


def test_way_points_are_reached_in_order():
    episodes = Episodes(1, Ranges())
    arena = triangle_course()
    episodes.start(0, arena, (0,))
    policy = Straight()
    reached = []
    for _ in range(400):
        _, events = episodes.step(policy.commands(episodes.sense()))
        if not reached or reached[-1] != episodes.waypoint(0):
            reached.append(episodes.waypoint(0))
        if events[0]:
            break
    assert Event(int(events[0])) is Event.GOAL
    assert reached == list(arena.waypoints)
