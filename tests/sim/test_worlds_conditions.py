"""Conditions: what each does, and that they are part of what a session is."""

import io
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from freerein.errors import FailedPrecondition, InvalidInput
from freerein.types.sim import DemonstrateRequest, Recipe
from freerein_sim.workers.demonstrations import make_demonstration
from freerein_sim.workers.handler import RequestHandler
from freerein_sim.workers.vector_env import VectorEnv
from freerein_sim.worlds import blocks, camera_effects, grid, pendulum
from freerein_sim.worlds.blocks import scene
from freerein_sim.worlds.blocks.relations import is_visible
from freerein_sim.worlds.blocks.spec import COLOURS
from freerein_sim.worlds.camera_effects import EFFECTS
from freerein_sim.worlds.varied_world import build
from freerein_sim.worlds.world import TaskDefinition, World

TASKS = {task.name: task for task in (*grid.TASKS, *blocks.TASKS, *pendulum.TASKS)}
README = Path(__file__).parents[2] / "services" / "sim" / "README.md"
PICTURE = np.random.default_rng(0).integers(256, size=(64, 48, 3), dtype=np.uint8)


def begin(task: str, *conditions: str, seed: int = 0) -> World:
    world = build(TASKS[task], conditions)
    world.reset(np.random.default_rng(seed))
    return world


def front(world: World) -> np.ndarray:
    return world.render("front", height=64, width=64)


def test_the_readme_says_what_each_condition_does() -> None:
    _, _, rest = README.read_text().partition("| condition | group | what it does |\n|---|---|---|\n")
    rows = [row.strip("| ").split(" | ") for row in rest.partition("\n\n")[0].splitlines()]
    table = {name.strip("`"): (group, text) for name, group, text in rows}
    declared = {each.name: (each.group, each.text) for task in TASKS.values() for each in task.conditions}

    assert table == declared


def test_hue_turns_by_a_tenth_of_the_circle_and_leaves_value_and_greys() -> None:
    colours = np.array([[[255, 0, 0], [0, 200, 0], [90, 90, 90], [0, 0, 0]]], np.uint8)

    turned = EFFECTS["hue-plus-10"](colours)

    assert turned[0].tolist() == [[255, 153, 0], [0, 200, 120], [90, 90, 90], [0, 0, 0]]
    assert EFFECTS["hue-minus-10"](colours)[0, 0].tolist() == [255, 0, 153]
    assert np.abs(EFFECTS["hue-minus-10"](EFFECTS["hue-plus-10"](PICTURE)).astype(int) - PICTURE).max() <= 2


def test_white_balance_scales_red_and_blue() -> None:
    pixel = np.full((1, 1, 3), 100, np.uint8)

    assert EFFECTS["warm"](pixel).ravel().tolist() == [115, 100, 85]
    assert EFFECTS["cool"](pixel).ravel().tolist() == [85, 100, 115]


@pytest.mark.parametrize("sigma", [10, 20])
def test_noise_has_its_sigma_and_is_equal_for_equal_frames_only(sigma: int) -> None:
    grey = np.full((64, 64, 3), 128, np.uint8)
    noisy = EFFECTS[f"noise-{sigma}"](grey)
    other = EFFECTS[f"noise-{sigma}"](grey + 1)

    assert (noisy.astype(float) - 128).std() == pytest.approx(sigma, rel=0.03)
    np.testing.assert_array_equal(noisy, EFFECTS[f"noise-{sigma}"](grey.copy()))
    assert (noisy + 1 != other).any()


@pytest.mark.parametrize("height", [64, 128])
def test_a_blur_is_a_gaussian_of_one_pixel_at_64_rows(height: int) -> None:
    point = np.zeros((height, height, 3), np.uint8)
    point[height // 2, height // 2] = 255
    sigma = height / 64
    blurred = EFFECTS["blur"](point).astype(float)

    assert blurred[height // 2, height // 2, 0] == pytest.approx(255 / (2 * np.pi * sigma**2), abs=2)
    assert EFFECTS["blur"](np.full_like(point, 77)).tolist() == np.full_like(point, 77).tolist()


def test_a_jpeg_is_of_quality_30() -> None:
    file = io.BytesIO()
    Image.fromarray(PICTURE).save(file, "JPEG", quality=30)

    np.testing.assert_array_equal(EFFECTS["jpeg"](PICTURE), np.array(Image.open(file)))


def test_effects_apply_in_one_order_whatever_the_order_of_their_names() -> None:
    chosen = ("noise-10", "hue-plus-10", "jpeg")
    frames = []
    for order in (chosen, chosen[::-1]):
        with closing(begin("grid", *order)) as world:
            frames.append(world.render("top", height=33, width=30))

    assert all(np.array_equal(frame, frames[0]) for frame in frames)


def test_brighter_lights_make_brighter_frames() -> None:
    means = []
    for conditions in (("light-0.6",), ("light-0.8",), (), ("light-1.2",), ("light-1.4",)):
        with closing(begin("blocks", *conditions)) as world:
            means.append(front(world).mean())

    assert means == sorted(means)
    assert means[0] < 0.7 * means[2] < 0.6 * means[4]


@pytest.mark.parametrize(("condition", "shift_m", "turn_deg"), [("camera-5cm", 0.05, 0), ("camera-3deg", 0, 3)])
def test_cameras_are_moved_anew_in_each_episode_by_as_much_and_the_episode_stays(
    condition: str, shift_m: float, turn_deg: float
) -> None:
    with closing(begin("blocks", condition)) as world, closing(begin("blocks")) as nominal:
        seen = []
        for seed in range(3):
            for each in (world, nominal):
                each.reset(np.random.default_rng(seed))
            moved, still = world._data, nominal._data
            shift = moved.cam_xpos - still.cam_xpos
            axes, before = (each.cam_xmat.reshape(-1, 3, 3) for each in (moved, still))
            turns = np.degrees(np.arccos((np.einsum("cij,cij->c", axes, before) - 1) / 2))
            seen.append(front(world).tobytes())

            np.testing.assert_array_equal(world.truth().state, nominal.truth().state)
            np.testing.assert_allclose(np.linalg.norm(shift, axis=1), shift_m, atol=1e-9)
            np.testing.assert_allclose(np.einsum("ci,ci->c", shift, before[:, :, 2]), 0, atol=1e-9)
            np.testing.assert_allclose(turns, turn_deg, atol=1e-4)

    assert len(shift) == len(scene.CAMERAS)
    assert len(set(seen)) == 3


@pytest.mark.parametrize("condition", ["ball", "picture"])
def test_a_distractor_is_drawn_anew_in_each_episode_and_the_episode_stays(condition: str) -> None:
    task = TASKS["blocks.scatter"]
    with closing(build(task, (condition,))) as world, closing(build(task)) as nominal:
        changed = []
        for seed in range(20):
            for each in (world, nominal):
                each.reset(np.random.default_rng(seed))
            snapshot, seen = world.snapshot(), front(world)
            np.testing.assert_array_equal(world.truth().state, nominal.truth().state)
            differs = (seen != front(nominal)).any(axis=2)
            changed.append(differs.tobytes())
            assert differs.sum() < 200

            world.step(np.zeros(3, np.float32))
            world.reset(np.random.default_rng(seed + 1))
            world.restore(snapshot)
            np.testing.assert_array_equal(front(world), seen)

    assert len(set(changed)) > 15


def test_the_expert_travels_at_its_speed() -> None:
    lengths = {}
    for speed in ("nominal", "speed-0.5", "speed-2"):
        with closing(build(TASKS["blocks"], () if speed == "nominal" else (speed,))) as world:
            request = DemonstrateRequest("blocks", "expert", min_skills=3, count=2, seed=1, height=1, width=1)
            made = [make_demonstration(TASKS["blocks"], world, replace(request, first=i)) for i in range(2)]
            actions = np.concatenate([each.trajectory.actions for each in made])
            lengths[speed] = len(actions)

            assert np.abs(actions).max() <= 1

    assert 1.4 < lengths["speed-0.5"] / lengths["nominal"] < 2.3
    assert 0.6 < lengths["speed-2"] / lengths["nominal"] < 0.99


def test_at_half_the_speed_demonstrations_may_take_twice_as_long_and_sessions_may_not() -> None:
    slow, nominal = ("speed-0.5",), TASKS["blocks"].spec.max_episode_steps
    request = DemonstrateRequest("blocks", "expert", min_skills=4, count=1, height=1, width=1)
    envs = VectorEnv(TASKS["blocks"], num_envs=1, seed=0, conditions=slow)
    with closing(build(TASKS["blocks"], slow)) as world, closing(envs):
        made = make_demonstration(TASKS["blocks"], world, request)
        envs.reset()
        truncated = [envs.step(np.zeros((1, 3), np.float32)).truncated[0] for _ in range(nominal)]

    assert nominal < len(made.trajectory.actions) <= world.spec.max_episode_steps == 2 * nominal
    assert truncated == [False] * (nominal - 1) + [True]


def test_a_recipe_that_names_a_hidden_block_is_refused_and_makes_no_expert() -> None:
    envs = VectorEnv(TASKS["blocks"], num_envs=2, seed=0, privileged=True, conditions=("blocks-2",))
    states = envs.reset().truth.state[:, 3:].reshape(2, len(COLOURS), 7)
    shown = [
        [f"move-{colour}" for colour, pose in zip(COLOURS, state, strict=True) if is_visible(pose[:3])]
        for state in states
    ]
    hidden = next(skill for skill in TASKS["blocks"].spec.skills if skill not in shown[1])
    before = envs.snapshot()

    with pytest.raises(InvalidInput, match="is hidden"):
        envs.expert_actions((Recipe(tuple(shown[0][1:])), Recipe((hidden,))))
    first = envs.expert_actions().actions
    envs.restore(before)

    np.testing.assert_array_equal(first, envs.expert_actions().actions)


def test_demonstrations_with_fewer_blocks_choose_among_those_on_show_and_may_name_no_more() -> None:
    with closing(build(TASKS["blocks"], ("blocks-2",))) as world:
        made = [
            make_demonstration(TASKS["blocks"], world, DemonstrateRequest("blocks", "expert", count=4, first=i))
            for i in range(4)
        ]
        with pytest.raises(InvalidInput, match="<= 2 must hold"):
            make_demonstration(TASKS["blocks"], world, DemonstrateRequest("blocks", "expert", max_skills=3))

    assert all(1 <= len(each.trajectory.skills) <= 2 for each in made)


def test_slow_demonstrations_that_could_exceed_a_message_are_refused() -> None:
    handler = RequestHandler(TASKS)
    request = DemonstrateRequest(
        "blocks", "expert", cameras=("front", "left"), height=256, width=256, conditions=("speed-0.5",)
    )
    with closing(handler), pytest.raises(InvalidInput, match="frames of one reply"):
        handler.handle(request)


@pytest.mark.parametrize(
    ("task", "chosen", "got"),
    [
        ("grid", ("light-0.6",), "got another"),
        ("blocks", ("blur", "start-unseen", "fog"), "got 2 others"),
        ("blocks", ("warm", "blur", "cool"), "several of the group white-balance"),
        ("blocks", ("blur", "blur"), "several of the group blur"),
        ("blocks.scatter", ("speed-2",), "got another"),
    ],
)
def test_conditions_that_are_unknown_or_exclude_each_other_are_refused_with_those_that_there_are(
    task: str, chosen: tuple[str, ...], got: str
) -> None:
    with pytest.raises(InvalidInput, match=got) as refused:
        VectorEnv(TASKS[task], num_envs=1, seed=0, conditions=chosen)

    assert refused.value.field == "conditions"
    assert all(condition.name in refused.value.hint for condition in TASKS[task].conditions)


def test_a_snapshot_restores_only_under_its_conditions_in_any_order() -> None:
    def envs(*conditions: str) -> VectorEnv:
        made = VectorEnv(TASKS["grid"], num_envs=2, seed=3, conditions=conditions)
        made.reset()
        return made

    snapshot = envs("blur", "warm").snapshot()

    envs("warm", "blur").restore(snapshot)
    for other in (envs(), envs("blur"), envs("blur", "cool")):
        with pytest.raises(FailedPrecondition, match="conditions"):
            other.restore(snapshot)


def test_a_task_whose_cameras_see_no_rgb_declares_no_effects() -> None:
    spec = grid.SPEC
    grey = type(spec.cameras[0])("top", 33, 30, 1)
    task = TaskDefinition("grey", "grid", "", type(spec)(**{**vars(spec), "cameras": (grey,)}), TASKS["grid"].make)

    assert task.conditions == ()
    assert TASKS["grid"].conditions == camera_effects.CONDITIONS
