"""The check that the first frame of an episode does not reveal which skills follow.

Else tags could be learned without looking at what is done, and skills would not be found. Two tests look at coarse
frames: a kernel classifier finds what the whole picture tells, a search for the most telling pixel what a corner tells.
Both are permutation tests: chance is what they find when the tags are dealt out to the episodes anew.
"""

from contextlib import closing

import numpy as np
import numpy.typing as npt

from freerein.data.first_frames import first_frame_tests, low_resolution
from freerein_sim.worlds.conformance.assertions import require
from freerein_sim.worlds.conformance.rollouts import SEED
from freerein_sim.worlds.world import TaskDefinition

EPISODES = 300
CHANCE = 0.002
"""p-value at or below which first frames are no chance any more: none of 499 permutations does as well."""

_PERMUTATIONS = 499
_VARIES = 1e-3
"""Standard deviation above which a pixel varies, as a share of white."""


def hides_its_recipe_at_the_start(task: TaskDefinition) -> None:
    """First frames of all cameras predict the tags no better than chance."""
    frames, recipes = _starts(task)
    for test in first_frame_tests(frames, recipes, rng=np.random.default_rng(SEED)):
        require(
            test.p_value > CHANCE,
            f"The first frame hides whether {test.skill} follows; its AUROC is {test.auroc:.2f}, p {test.p_value:.3f}.",
        )
    tags = np.array([[skill in recipe for skill in task.spec.skills] for recipe in recipes])  # (n, K)
    p_value = most_telling_pixel(frames, tags, rng=np.random.default_rng(SEED))
    require(p_value > CHANCE, f"No pixel of the first frame tells the tags; one does, p {p_value:.3f}.")


def most_telling_pixel(
    frames: npt.NDArray[np.float32], tags: npt.NDArray[np.bool_], *, rng: np.random.Generator
) -> float:
    """Returns how probable it is that a pixel agrees with a tag as well as the best one does, by chance.

    Args:
        frames: Coarse first frames, float32 (n, D).
        tags: bool (n, K), whether each skill occurs.
        rng: Draws the permutations.
    """
    pixels = _standard(frames.astype(np.float64), _VARIES)
    dealt = _standard(tags.astype(np.float64), 0.0)
    orders = np.stack([np.arange(len(tags)), *(rng.permutation(len(tags)) for _ in range(_PERMUTATIONS))], axis=1)
    agreement = np.abs(pixels.T @ dealt[orders].reshape(len(tags), -1))  # (D, (1 + permutations) * K)
    best = agreement.max(axis=0, initial=0.0).reshape(orders.shape[1], -1).max(axis=1, initial=0.0)
    return float(np.mean(best >= best[0]))


def _standard(values: npt.NDArray[np.float64], varies: float) -> npt.NDArray[np.float64]:
    """Returns the columns that vary, with mean 0 and standard deviation 1."""
    spread = values.std(axis=0)
    kept = spread > varies
    standard: npt.NDArray[np.float64] = (values[:, kept] - values[:, kept].mean(axis=0)) / spread[kept]
    return standard


def _starts(task: TaskDefinition) -> tuple[npt.NDArray[np.float32], list[tuple[str, ...]]]:
    """Returns coarse first frames of all cameras, float32 (n, D), and the recipes of their episodes."""
    fewest, most = task.recipes.lengths(task.spec.skills)
    frames, recipes = [], []
    with closing(task.make()) as world:
        for child in np.random.SeedSequence(SEED).spawn(EPISODES):
            rng = np.random.default_rng(child)
            recipe = task.recipes.draw(rng, task.spec.skills, fewest=fewest, most=most)
            world.reset(rng, recipe=recipe)
            views = [world.render(each.name, height=each.height, width=each.width) for each in task.spec.cameras]
            frames.append(np.concatenate([low_resolution(view) for view in views]))
            recipes.append(recipe)
    return np.stack(frames), recipes
