import numpy as np
import pytest

from freerein_sim.worlds.bins.durations import PLAIN_STEPS, uneven_tempos
from freerein_sim.worlds.tempo import Tempo, draw_log_uniform, draw_tempo


def test_slower_motion_and_hesitation_take_the_extra_steps() -> None:
    rng = np.random.default_rng(0)

    drawn = [draw_tempo(rng, 30.0, moving_steps=10, least_speed=0.1) for _ in range(200)]

    taken = [10 / tempo.speed - 10 + tempo.hesitation_steps for tempo in drawn]
    assert taken == pytest.approx([30.0] * 200)
    assert {min(3, int(tempo.hesitation_steps // 7.5)) for tempo in drawn} == {0, 1, 2, 3}


def test_no_motion_is_slower_than_the_least_speed() -> None:
    rng = np.random.default_rng(0)

    speeds = [draw_tempo(rng, 1000.0, moving_steps=10, least_speed=0.2).speed for _ in range(200)]

    assert min(speeds) == pytest.approx(0.2)


def test_a_skill_without_extra_steps_is_at_full_speed() -> None:
    assert draw_tempo(np.random.default_rng(0), 0.0, moving_steps=10, least_speed=0.1) == Tempo(1.0, 0.0)


def test_as_many_log_uniform_numbers_are_below_the_geometric_mean_as_above() -> None:
    rng = np.random.default_rng(0)

    drawn = np.array([draw_log_uniform(rng, 1, 100) for _ in range(2000)])

    assert drawn.min() >= 1
    assert drawn.max() <= 100
    assert (drawn < 10).mean() == pytest.approx(0.5, abs=0.03)


def test_uneven_moves_that_do_not_fit_into_an_episode_are_shorter() -> None:
    rng = np.random.default_rng(0)

    drawn = uneven_tempos(rng, 4, 4 * PLAIN_STEPS)

    assert drawn == [Tempo(1.0, 0.0)] * 4
