"""Chapter 3 in the demo: a policy that follows goal images, learned from random exploration."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from freerein import images
from freerein.cli.demo.context import HELD_OUT_SEED, Context
from freerein.cli.demo.evaluation import landmarks
from freerein.cli.demo.evaluation.landmarks import Flags, LandmarkPursuit, ReachedRates
from freerein.cli.demo.pictures import FilmstripGoal
from freerein.cli.demo.report import Figure
from freerein.cli.demo.rollout import Rollout, ServedPolicy, robot_session
from freerein.clients import ImitationClient
from freerein.metrics import auroc, expected_calibration_error
from freerein.types.common import Goal, ModelRef
from freerein.types.imitation import GetSpecRequest
from freerein.types.learning import Fit
from freerein.types.sim import DemonstrateRequest

_TASK, _DATASET, _CAMERA = "blocks", "exploration", "front"
_MODEL = ModelRef("goal-images")
_TRAJECTORIES = 400
_ROBOTS, _LANDMARKS = 64, 4
_EXPLORATION_STEPS = _LANDMARKS * landmarks.SPACING_STEPS
_LANDMARK_STEPS = landmarks.landmark_steps(_EXPLORATION_STEPS + 1, count=_LANDMARKS)


@dataclass(frozen=True, eq=False)
class GoalImageResult:
    """How well goal images were followed.

    Attributes:
        figures: What was measured.
        filmstrip: The landmarks of the robot of median success.
        exploration: The rollout that the landmarks come from.
    """

    figures: tuple[Figure, ...]
    filmstrip: tuple[FilmstripGoal, ...]
    exploration: Rollout


async def record(context: Context) -> None:
    """Records a gripper that moves at random: images and its own actions, nothing else."""
    request = DemonstrateRequest(_TASK, "random", count=_TRAJECTORIES, seed=context.seed, cameras=(_CAMERA,))
    await context.record(_DATASET, request)


async def start_fit(context: Context) -> tuple[str, Fit]:
    """Starts to learn the policy and its goal recognizer."""
    config = {"method": "goal_conditioned"}
    return await context.start_fit("imitation", _DATASET, model_name=_MODEL.name, config=config)


async def follow_goal_images(context: Context) -> GoalImageResult:
    """Takes landmarks from random rollouts from unseen starts, and has the policy follow them from the same starts."""
    seed = context.seed + HELD_OUT_SEED
    rng = np.random.default_rng(seed)
    async with context.sim() as sim, ImitationClient(context.channel("imitation")) as client:
        spec = await client.get_spec(GetSpecRequest(_MODEL))
        steps = _LANDMARKS * spec.max_steps_per_goal
        async with robot_session(sim, _TASK, camera=_CAMERA, count=_ROBOTS, seed=seed) as session:
            explored = await session.rollout(session.random_policy(rng), steps=_EXPLORATION_STEPS)
            policy = ServedPolicy(client, _MODEL, _goals(explored), _CAMERA)
            with context.reporter.progress("follow goal images", steps) as advance:
                followed = await session.rollout(policy, steps=steps, on_step=advance)
            random = await session.rollout(session.random_policy(rng), steps=steps)
    return _measure(explored, followed, policy, random, max_steps=spec.max_steps_per_goal)


def _goals(explored: Rollout) -> list[Goal]:
    return [
        Goal(images=tuple(images.encode(frame, encoding="raw_rgb8") for frame in frames))
        for frames in _goal_images(explored)
    ]


def _goal_images(explored: Rollout) -> npt.NDArray[np.uint8]:
    """Returns the frames at the landmarks, uint8 (N, landmarks, H, W, C)."""
    return explored.frames[_LANDMARK_STEPS].swapaxes(0, 1)


def _measure(
    explored: Rollout, followed: Rollout, policy: ServedPolicy, random: Rollout, *, max_steps: int
) -> GoalImageResult:
    """Returns the result over those robots whose exploration did not end before its last landmark."""
    indices, confidences = np.stack(policy.goal_index), np.stack(policy.confidence)  # (T, N)
    pursuits: dict[int, LandmarkPursuit] = {}
    at_random, block_moves, confidence, truth = [], [], [], []
    for robot in np.flatnonzero(explored.lengths > _EXPLORATION_STEPS).tolist():
        targets = explored.states[_LANDMARK_STEPS, robot]
        length = min(int(followed.lengths[robot]), len(indices))
        pursuit = landmarks.pursue(followed.states[:length, robot], indices[:length, robot], targets)
        pursuits[robot] = pursuit
        confidence.append(confidences[:length, robot][pursuit.is_active])
        truth.append(pursuit.at_landmark[pursuit.is_active])
        states = random.states[: random.lengths[robot], robot]
        at_random.append(landmarks.reached_at_random(states, targets, max_steps=max_steps))
        block_moves.append(landmarks.needs_block_move(explored.states[0, robot], targets))
    moves = np.concatenate(block_moves)
    shown = sorted(pursuits, key=lambda robot: float(pursuits[robot].recognized.mean()))[len(pursuits) // 2]
    return GoalImageResult(
        figures=(
            *_reached_figures(
                landmarks.reached_rates(np.concatenate([each.reached for each in pursuits.values()]), moves),
                landmarks.reached_rates(np.concatenate(at_random), moves),
            ),
            Figure(
                "imitation.landmarks_recognized",
                float(np.concatenate([each.recognized for each in pursuits.values()]).mean()),
            ),
            *_recognizer_figures(np.concatenate(confidence), np.concatenate(truth)),
        ),
        filmstrip=_filmstrip(explored, followed, policy, pursuits[shown], shown),
        exploration=explored,
    )


def _reached_figures(followed: ReachedRates, random: ReachedRates) -> list[Figure]:
    """Returns the shares of landmarks reached; the random policy goes on to the next landmark by true states."""
    rates = (
        ("landmarks_reached", followed.overall, random.overall),
        ("no_block_moves.landmarks_reached", followed.no_block_moves, random.no_block_moves),
        ("block_moves.landmarks_reached", followed.block_moves, random.block_moves),
    )
    return [
        Figure(f"imitation.{name}", value, baseline, "random actions", beats_baseline=True)
        for name, value, baseline in rates
    ]


def _recognizer_figures(confidence: npt.NDArray[np.float64], at_landmark: Flags) -> list[Figure]:
    """Returns the quality of the goal recognizer on the M states that the policy visited; arguments (M,)."""
    error = expected_calibration_error(confidence, at_landmark)
    return [
        Figure("imitation.visited.at_landmark", float(at_landmark.mean())),
        Figure("imitation.visited.goal_auroc", auroc(confidence, at_landmark), 0.5, "chance", beats_baseline=True),
        Figure("imitation.visited.goal_ece", error, 0.0, "always the base rate"),
    ]


def _filmstrip(
    explored: Rollout, followed: Rollout, policy: ServedPolicy, pursuit: LandmarkPursuit, robot: int
) -> tuple[FilmstripGoal, ...]:
    """Returns the landmarks that a robot was done with."""
    goals = _goal_images(explored)[robot]
    return tuple(
        FilmstripGoal(
            goals[pursuit.landmark[t]],
            followed.frames[t, robot],
            t,
            float(policy.confidence[t][robot]),
            bool(pursuit.at_landmark[t]),
        )
        for t in np.flatnonzero(pursuit.left).tolist()
    )
