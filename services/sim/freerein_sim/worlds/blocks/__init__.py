"""Tasks of the blocks world: a Fetch gripper and coloured blocks in a plane. MuJoCo is imported when one is made.

`blocks` has four blocks and no goal. A goal task, such as `blocks.red-left-of-green`, has two blocks and an oracle.
`blocks.scatter` shows two of the four at random poses: images to train reward models from (dissertation, 4.2).
"""

from collections.abc import Callable
from functools import partial
from itertools import permutations

from freerein.types.common import ActionSpec, Camera
from freerein_sim.worlds.blocks.goals import BlockGoal, BlockRelation
from freerein_sim.worlds.blocks.predicates import BlockPredicates
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
        has_expert=bool(moved),
    )


def _make(
    spec: WorldSpec, colours: tuple[str, ...], initial_state: str, *, goal: BlockGoal | None = None, pad: bool = False
) -> World:
    """Returns a world whose initial states are drawn by the named function of `initial_states`."""
    check_mujoco_gl()
    from freerein_sim.worlds.blocks import initial_states, simulation

    return simulation.BlocksWorld(spec, colours, getattr(initial_states, initial_state), goal=goal, pad=pad)


def _goal_task(first: str, second: str, relation: BlockRelation) -> TaskDefinition:
    goal = BlockGoal(first, relation, second)
    spec = _spec((first, second), (first,), _GOAL_STEPS)
    make = partial(_make, spec, (first, second), "pair", goal=goal)
    predicates = BlockPredicates(spec).landmarks_and_skills()
    return TaskDefinition(f"blocks.{goal.name}", "blocks", goal.text, spec, make, predicates)


def _free_task(name: str, spec: WorldSpec, make: Callable[[], World]) -> TaskDefinition:
    predicates = BlockPredicates(spec)
    return TaskDefinition(name, "blocks", "", spec, make, predicates.landmarks_and_skills() + predicates.relations())


_FREE_PLAY = _spec(COLOURS, COLOURS, _DEMONSTRATION_STEPS)
_SCATTER = _spec(COLOURS, (), _SCATTER_STEPS)

TASKS = (
    _free_task("blocks", _FREE_PLAY, partial(_make, _FREE_PLAY, COLOURS, "line")),
    _free_task("blocks.scatter", _SCATTER, partial(_make, _SCATTER, COLOURS, "scatter", pad=True)),
    *(_goal_task(first, second, relation) for first, second in permutations(COLOURS, 2) for relation in BlockRelation),
)
