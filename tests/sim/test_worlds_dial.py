from contextlib import closing

import numpy as np

from freerein import metrics
from freerein_sim.worlds.dial import TASKS, ik, keypad, scene
from freerein_sim.worlds.dial.predicates import PREDICATES
from freerein_sim.worlds.dial.spec import RECIPES, SPEC
from freerein_sim.worlds.episodes import record_expert
from freerein_sim.worlds.world import World

TASK, UNEVEN = TASKS
STILL = np.zeros(SPEC.action.size, np.float32)
JUDGES = {predicate.name: predicate for predicate in PREDICATES}


def begin(seed: int = 0) -> World:
    world = TASK.make()
    world.reset(np.random.default_rng(seed))
    return world


def state(fingertip: tuple[float, float], digit: int, depth: float) -> np.ndarray:
    row = np.zeros(len(SPEC.state_names))
    row[[SPEC.state_names.index(f"fingertip.{axis}") for axis in "xy"]] = fingertip
    row[SPEC.state_names.index(f"key-{digit}.depth")] = depth
    return row


def test_the_targets_of_every_key_are_over_it_and_below_its_top() -> None:
    arm, targets = ik.ArmKinematics(scene.build().model), ik.key_targets()

    for digit, at in enumerate(keypad.CENTRES_M):
        hover, press = arm.fingertip(targets.hover[digit]), arm.fingertip(targets.press[digit])
        np.testing.assert_allclose(hover, [*at, keypad.TOP_M + ik.HOVER_M], atol=1e-3)
        np.testing.assert_allclose(press, [*at, keypad.TOP_M + ik.PRESS_M], atol=1e-3)


def test_the_keypad_is_laid_out_as_on_a_telephone() -> None:
    x, y = keypad.CENTRES_M.T

    assert x[[1, 2, 3]].tolist() == [x[1]] * 3
    assert y[[2, 5, 8, 0]].tolist() == [0.0] * 4
    assert x[1] < x[4] < x[7] < x[0]
    assert y[1] < y[2] < y[3]


def test_every_key_has_a_face_of_its_own() -> None:
    assert len({keypad.face(digit).tobytes() for digit in keypad.DIGITS}) == len(keypad.DIGITS)


def test_without_torque_the_arm_rests_and_no_key_is_pressed() -> None:
    with closing(begin()) as world:
        before = world.truth().state
        for _ in range(20):
            world.step(STILL)

        np.testing.assert_allclose(world.truth().state, before, atol=1e-3)


def test_a_key_is_completed_when_the_fingertip_begins_to_hold_it_down() -> None:
    over, beside = tuple(keypad.CENTRES_M[4]), tuple(keypad.CENTRES_M[5])
    pressed, up = keypad.PRESSED_M + 1e-4, keypad.PRESSED_M - 1e-4
    judge = JUDGES["completed/press-4"]

    def judged(*states: np.ndarray) -> list[bool]:
        return [bool(holds) for holds in judge.holds(np.stack(states)[None])[0]]

    assert judged(state(over, 4, 0), state(over, 4, pressed), state(beside, 4, 0)) == [False, True, True]
    assert judged(state(over, 4, up), state(over, 4, up)) == [False, False]
    assert judged(state(over, 4, pressed), state(over, 4, pressed)) == [False, False]
    assert judged(state(over, 4, 0), state(beside, 4, pressed)) == [False, False]
    assert judged(state(over, 4, 0), state(over, 5, pressed)) == [False, False]


def test_uneven_presses_are_some_many_times_as_long_as_others() -> None:
    ratios = []
    with closing(UNEVEN.make()) as world:
        for seed in range(7):
            rng = np.random.default_rng(seed)
            recipe = RECIPES.draw(rng, SPEC.skills, fewest=5, most=5)
            shown = record_expert(world, recipe, rng)
            steps = np.diff([*metrics.run_starts(shown.labels), len(shown.labels)])
            ratios.append(steps.max() / steps.min())

            assert shown.success

    assert np.median(ratios) > 4
