"""A Fetch gripper above coloured blocks on a table, moving in a plane: the tasks. MuJoCo is imported when one is made.

`blocks` has all four blocks and no goal. A goal task has two, and an oracle: `blocks.red-left-of-green`.
`blocks.scatter` shows two of the four, anywhere: pictures for reward models to learn from (dissertation, 4.2).
"""

from functools import partial
from itertools import permutations

from freerein.types.common import ActionSpec, Camera
from freerein_sim.worlds.blocks.goals import BlockGoal, BlockRelation
from freerein_sim.worlds.opengl import check_mujoco_gl
from freerein_sim.worlds.world import TaskDefinition, World, WorldSpec

COLOURS = ("red", "green", "yellow", "blue")
CONTROL_DT_S = 0.04
GRIPPER_STEP_M = 0.05
FINGER_STEP_M = 0.02

_CAMERAS = tuple(Camera(name, 64, 64, 3) for name in ("front", "left", "tilt"))
_ACTION = ActionSpec(
    size=3,
    choices=0,
    names=("dy", "dz", "gripper"),
    unit="m",
    scale=(GRIPPER_STEP_M, GRIPPER_STEP_M, FINGER_STEP_M),
)
_DEMONSTRATION_STEPS = 150
_GOAL_STEPS = 100
_SCATTER_STEPS = 6
_POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")


def _spec(colours: tuple[str, ...], moved: tuple[str, ...], max_episode_steps: int) -> WorldSpec:
    return WorldSpec(
        cameras=_CAMERAS,
        action=_ACTION,
        control_dt_s=CONTROL_DT_S,
        skills=tuple(f"move-{colour}" for colour in moved),
        max_episode_steps=max_episode_steps,
        state_names=(
            "gripper.y",
            "gripper.z",
            "gripper.opening",
            *(f"{colour}.{part}" for colour in colours for part in _POSE),
        ),
    )


def _make_free_play() -> World:
    check_mujoco_gl()
    from freerein_sim.worlds.blocks import initial_states, simulation

    return simulation.BlocksWorld(_FREE_PLAY, COLOURS, initial_states.line)


def _make_scatter() -> World:
    check_mujoco_gl()
    from freerein_sim.worlds.blocks import initial_states, simulation

    return simulation.BlocksWorld(_SCATTER, COLOURS, initial_states.scatter, pad=True)


def _make_goal(spec: WorldSpec, goal: BlockGoal) -> World:
    check_mujoco_gl()
    from freerein_sim.worlds.blocks import initial_states, simulation

    return simulation.BlocksWorld(spec, (goal.first, goal.second), initial_states.pair, goal=goal)


def _goal_task(first: str, second: str, relation: BlockRelation) -> TaskDefinition:
    goal = BlockGoal(first, relation, second)
    spec = _spec((first, second), (first,), _GOAL_STEPS)
    return TaskDefinition(f"blocks.{goal.name}", "blocks", goal.text, spec, partial(_make_goal, spec, goal))


_FREE_PLAY = _spec(COLOURS, COLOURS, _DEMONSTRATION_STEPS)
_SCATTER = _spec(COLOURS, (), _SCATTER_STEPS)

TASKS = (
    TaskDefinition("blocks", "blocks", "", _FREE_PLAY, _make_free_play),
    TaskDefinition("blocks.scatter", "blocks", "", _SCATTER, _make_scatter),
    *(_goal_task(first, second, relation) for first, second in permutations(COLOURS, 2) for relation in BlockRelation),
)
