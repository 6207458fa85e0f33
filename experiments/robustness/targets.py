"""The targets of the benchmark: what each claim measures, and what it must reach."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from experiments.robustness import (
    confidence,
    criteria,
    evaluated,
    goal_texts,
    language,
    open_wordings,
    policies,
    scenes,
    speed,
    unfamiliar,
    visited_states,
    wordings,
)
from experiments.robustness.target import Target
from experiments.robustness.worlds import BLOCKS, DEMONSTRATED, DISTRACTORS, NOMINAL, SCATTERED, conditions
from experiments.segmentation.evaluation import FRAME_ACCURACY

OURS, BASELINE = "augmented", "plain"
"""Variants of a fit: the one that claims are of, and the one that they are compared with."""

_PER_CENT = 100
LEAST_RUNS = 5
"""Runs that a claim of runs needs."""
_PUSHER = 5.0
"""Per cent of the expert that a policy earns at most, from starts in the wrong order, that only pushes blocks."""


def _frames(claim: str, text: str, least: float, *named: str) -> Target:
    samples = tuple(f"{condition}.{FRAME_ACCURACY}" for condition in named)
    return Target(claim, f"segmentation, frame accuracy, %: {text}", (DEMONSTRATED,), samples, least, unit=_PER_CENT)


def _relations(claim: str, text: str, least: float, *samples: str) -> Target:
    return Target(claim, f"reward, argmax of 5 relations, {text}", (SCATTERED,), samples, least, unit=_PER_CENT)


def _accuracies(*named: str) -> tuple[str, ...]:
    return tuple(f"{condition}.{blocks}.{scenes.ACCURACY}" for condition in named for blocks in BLOCKS)


def _confidence(prefix: str, model: str, world: str) -> Iterator[Target]:
    figures: tuple[tuple[str, str, str, dict[str, Any]], ...] = (
        ("auroc", "AUROC, right against wrong, all conditions and effects", confidence.AUROC, {"least": 0.9}),
        ("within", "the same within the worst condition", unfamiliar.WITHIN, {"least": 0.9}),
        ("flagged", "nominal answers flagged", confidence.FLAGGED_SHARE, {"most": 0.05}),
        ("flagged_05", "nominal answers under 0.05, the first threshold", confidence.UNDER_05, {}),
        ("harmless", "the most flagged where accuracy falls by less than .02", unfamiliar.HARMLESS, {"most": 0.2}),
        ("harmful", "the fewest flagged where accuracy is below .75", unfamiliar.HARMFUL, {"least": 0.9}),
        ("ece", "ECE of what is not flagged", confidence.CALIBRATION_ERROR, {"most": 0.05}),
    )
    for name, text, figure, bounds in figures:
        told = f"{model}, in-distribution score: {text}"
        yield Target(f"{prefix}_in_distribution_{name}", told, (world,), (figure,), method=unfamiliar.METHOD, **bounds)


def _distracted() -> Iterator[Target]:
    """Yields the claims of rewards in scenes in which a thing that is no block has the colour of one."""
    shown = "a ball or a picture in a block's colour"
    more: dict[str, Any] = {"worlds": (SCATTERED,), "method": unfamiliar.METHOD}
    balanced = tuple(f"{name}.{blocks}.{scenes.BALANCED}" for name in DISTRACTORS for blocks in BLOCKS)
    absent = tuple(f"{name}.blocks-2.{scenes.ABSENT_REWARDED}" for name in DISTRACTORS)
    yield Target(
        "reward_distractors",
        f"reward, balanced accuracy, %: {shown}",
        samples=balanced,
        least=85,
        unit=_PER_CENT,
        also=("reward_distractors_absent",),
        **more,
    )
    yield Target(
        "reward_distractors_absent",
        "answers there about an absent block that are rewarded",
        samples=absent,
        most=0.05,
        **more,
    )


def _visited() -> Iterator[Target]:
    """Yields the claims of rewards on states that the 18 teachers visit, together and by relation."""
    everywhere, relations = ((visited_states.ALL,), visited_states.RELATIONS)
    at_share, recall, told = visited_states.PRECISION_AT_SHARE, visited_states.RECALL, "reward on states of 18 teachers"
    worst = ("reward_recall_worst",)
    also = ("reward_precision_worst", "reward_recall", *worst)
    figures: tuple[tuple[str, str, Sequence[str], str, dict[str, Any]], ...] = (
        ("precision", "precision as if 40 % were of the goal", everywhere, at_share, {"least": 0.97, "also": also}),
        ("precision_worst", "the same, the worst relation", relations, at_share, {"least": 0.93, "also": worst}),
        ("recall", "recall", everywhere, recall, {"least": 0.9}),
        ("recall_worst", "recall, the worst relation", relations, recall, {"least": 0.9}),
        ("false_positives", "share of others rewarded", everywhere, visited_states.FALSE_POSITIVE_RATE, {}),
        ("precision_visited", "precision, as visited", everywhere, visited_states.PRECISION, {}),
        (
            "base_rate",
            "share of the goal: precision of a constant",
            everywhere,
            visited_states.SHARE_TRUE,
            {},
        ),
    )
    for name, text, groups, figure, bounds in figures:
        samples = tuple(visited_states.of_group(group, figure) for group in groups)
        yield Target(f"reward_{name}", f"{told}: {text}", (SCATTERED,), samples, method=visited_states.METHOD, **bounds)


def _criteria() -> Iterator[Target]:
    """Yields the claims of rewards of the second method, which knows the criteria of table 4.1."""
    more: dict[str, Any] = {"worlds": (SCATTERED,), "method": criteria.METHOD}
    about = "reward of criteria, balanced accuracy of 5 relations, %"
    scene_sets: tuple[tuple[str, str, tuple[str, ...], tuple[str, ...], float | None], ...] = (
        ("two", "2 blocks", (NOMINAL,), BLOCKS[:1], 93),
        ("four", "4 blocks", (NOMINAL,), BLOCKS[1:], 85),
        ("light", "light 0.6 or 0.8", ("light-0.6", "light-0.8"), BLOCKS, None),
        ("hue", "hue ±10 %", ("hue-minus-10", "hue-plus-10"), BLOCKS, 88),
        ("distractors", "a ball or a picture in a block's colour", DISTRACTORS, BLOCKS, 85),
    )
    for claim, text, named, blocks, least in scene_sets:
        samples = tuple(f"{name}.{count}.{scenes.BALANCED}" for name in named for count in blocks)
        also = (f"criteria_{claim}_absent",) if claim == "distractors" else ()
        yield Target(
            f"criteria_{claim}", f"{about}: {text}", samples=samples, least=least, unit=_PER_CENT, also=also, **more
        )
    text = "reward of criteria: pairs with an absent block of which any goal is rewarded"
    for claim, shown, most in (("absent", conditions(SCATTERED), 0.02), ("distractors_absent", DISTRACTORS, 0.05)):
        samples = tuple(f"{name}.blocks-2.{scenes.ABSENT_REWARDED}" for name in shown)
        yield Target(f"criteria_{claim}", text, samples=samples, most=most, **more)


def _followed(claim: str, text: str, sample: str, *, least: float | None = None, most: float | None = None) -> Target:
    method, baseline = policies.GOAL_CLONING, policies.GOAL_CONDITIONED
    return Target(claim, text, (DEMONSTRATED,), (sample,), least, most, method=method, baseline=baseline)


def _executed(claim: str, text: str, least: float, sample: str) -> Target:
    method, ceiling = policies.SKILLS, policies.EXPERT
    return Target(claim, text, (DEMONSTRATED,), (sample,), least, unit=_PER_CENT, method=method, ceiling=ceiling)


def _augmented() -> Iterator[Target]:
    """Yields the claims of fits with augmented frames: nominally, and the worst of other lights, hues and cameras."""
    worlds = (DEMONSTRATED,)
    unaugmented: dict[str, Any] = {"baseline": policies.SKILLS, "ceiling": policies.EXPERT}
    skills: dict[str, Any] = {"worlds": worlds, "method": policies.SKILLS_AUGMENTED, "unit": _PER_CENT}
    for claim, text, sample in (
        ("recipe_skills_augmented", "recipes, fit with augmented frames: skills completed, %", policies.RECIPE_SKILLS),
        ("recipe_whole_augmented", "whole recipes, %", policies.RECIPE_WHOLE),
    ):
        yield Target(claim, text, samples=(sample,), **skills, **unaugmented)
    shifted = "light .8, camera moved by 5 cm, hue ±10 %"
    ratios = tuple(policies.under(condition, policies.RECIPE_OF_NOMINAL) for condition in policies.SHIFTED)
    yield Target("recipe_light", f"the same, {shifted}: % of the nominal", samples=ratios, least=75, **skills)
    follower: dict[str, Any] = {"worlds": worlds, "method": policies.GOAL_CLONING_AUGMENTED}
    for claim, text, sample, nominal, least in (
        ("flag", "goal-reached flag, fit with augmented frames: AUROC", evaluated.FLAG_AUROC, "flag_auroc", 0.93),
        ("landmarks", "landmarks there, no block must move", policies.LANDMARKS_FREE, "landmarks_free", 0.85),
    ):
        yield Target(f"{nominal}_augmented", text, samples=(sample,), baseline=policies.GOAL_CLONING, **follower)
        under = tuple(policies.under(condition, sample) for condition in policies.SHIFTED)
        yield Target(f"{claim}_light", f"the same, {shifted}", samples=under, least=least, **follower)


def _reinforced(claim: str, text: str, least: float, worlds: tuple[str, ...], sample: str) -> Target:
    told = f"PPO under `start-on-the-way`, % of the expert: {text}"
    return Target(claim, told, worlds, (sample,), least, unit=_PER_CENT, seeds=policies.PPO_SEEDS, method=policies.PPO)


def _reinforced_augmented() -> Iterator[Target]:
    """Yields the claims of PPO whose eye is fitted to augmented frames: nominally, and in other scenes."""
    shown = "PPO, eye fitted to augmented frames, % of the expert"
    for name, text, worlds in (("sides", "left and right", language.SIDES), ("stack", "stack", (policies.STACK,))):
        for claim, condition, least in (
            ("augmented", NOMINAL, None),
            ("four_blocks", "blocks-4", 70),
            ("light", "light-0.8", None),
            ("camera", "camera-5cm", None),
        ):
            yield Target(
                f"ppo_{claim}_{name}",
                f"{shown}: {text}, {condition}",
                worlds,
                (policies.under(condition, policies.RETURN_ALL),),
                least,
                unit=_PER_CENT,
                seeds=policies.PPO_SEEDS,
                method=policies.PPO_AUGMENTED,
                baseline=policies.PPO if condition == NOMINAL else "",
            )


def _speed(claim: str, text: str, sample: str, *, least: float | None = None, **more: Any) -> Target:
    return Target(claim, text, language.SIDES[:1], (sample,), least, method=policies.PPO_SPEED, of_runs=True, **more)


def _told(claim: str, text: str, *samples: str, least: float | None = None, **more: Any) -> Target:
    return Target(claim, text, (DEMONSTRATED,), samples, least, method=policies.LANGUAGE, **more)


def _done(claim: str, text: str, sample: str, **more: Any) -> Target:
    about = f"language policy that says when its goal is reached: {text}"
    return Target(claim, about, (DEMONSTRATED,), (sample,), **({"method": policies.LANGUAGE_DONE} | more))


def _texts(claim: str, text: str, *samples: str, **more: Any) -> Target:
    return Target(claim, text, (SCATTERED,), samples, seeds=1, method=goal_texts.TEXTS, **more)


def _forbidden(claim: str, text: str, figure: str, *readers: str, **more: Any) -> Target:
    told = f"texts that say what must not be, or how many: share {text}"
    return _texts(claim, told, *(goal_texts.figure(reader, figure) for reader in readers), **more)


TARGETS = (
    _frames("seg_nominal", "nominal", 96, NOMINAL),
    _frames("seg_light", "light 0.6 or 0.8", 92, "light-0.6", "light-0.8"),
    _frames("seg_hue", "hue ±10 %", 92, "hue-minus-10", "hue-plus-10"),
    _frames("seg_camera", "camera moved by 5 cm", 92, "camera-5cm"),
    _relations("reward_two", "balanced accuracy, %: 2 blocks", 93, f"{NOMINAL}.blocks-2.{scenes.BALANCED}"),
    _relations("reward_four", "balanced accuracy, %: 4 blocks", 85, f"{NOMINAL}.blocks-4.{scenes.BALANCED}"),
    _relations("reward_hue", "accuracy, %: hue ±10 %", 88, *_accuracies("hue-minus-10", "hue-plus-10")),
    _relations("reward_noise", "accuracy, %: noise of sigma 20", 88, *_accuracies("noise-20")),
    Target(
        "reward_absent",
        "scenes of 2 blocks in which a goal that names an absent one is rewarded",
        (SCATTERED,),
        tuple(f"{condition}.blocks-2.{scenes.ABSENT_REWARDED}" for condition in conditions(SCATTERED)),
        most=0.02,
    ),
    *_visited(),
    Target(
        "wordings",
        "recall of the reward, worst class of wordings, at a false rate ≤ 0.04",
        (SCATTERED,),
        tuple(f"{name}.{wordings.RECALL}" for name in wordings.CLASSES),
        least=0.85,
        also=("wordings_false_rate",),
    ),
    Target(
        "wordings_false_rate",
        "false rate of the reward, worst class of wordings",
        (SCATTERED,),
        tuple(f"{name}.{wordings.FALSE_RATE}" for name in wordings.CLASSES),
        most=0.04,
    ),
    _texts(
        "wordings_open",
        "classes of open wordings, share understood whole: every text is read, or asked back, as what it means",
        open_wordings.WHOLE,
        least=0.8,
        also=("wordings_open_wrong",),
    ),
    _texts("wordings_open_wrong", "texts there that are read or asked back wrongly", open_wordings.WRONG, most=0),
    _forbidden(
        "negation",
        "that a language policy acts on",
        goal_texts.FOLLOWED,
        *goal_texts.POLICIES,
        most=0,
        also=("negation_read", "negation_named"),
    ),
    _forbidden("negation_read", "that the reward reads", goal_texts.FOLLOWED, goal_texts.REWARD, most=0),
    _forbidden(
        "negation_named",
        "whose refusal names an unknown word, other than those for blocks",
        goal_texts.NAMED,
        *goal_texts.READERS,
        least=1,
    ),
    _forbidden(
        "negation_asked_back",
        "of the rarer forms that are asked back with the statement that they forbid or count",
        goal_texts.ASKED_BACK,
        *goal_texts.READERS,
    ),
    *_confidence("seg", "segmentation", DEMONSTRATED),
    *_confidence("reward", "reward", SCATTERED),
    *_distracted(),
    *_criteria(),
    _followed("flag_auroc", "goal-reached flag on visited states: AUROC", evaluated.FLAG_AUROC, least=0.95),
    _followed("flag_ece", "goal-reached flag there: ECE", evaluated.FLAG_ECE, most=0.05),
    _followed("flag_recall", "goal-reached flag there: recall at precision 0.9", evaluated.FLAG_RECALL, least=0.7),
    _followed(
        "landmarks_free",
        "landmarks 6 steps apart, reached when left: no block must move",
        policies.LANDMARKS_FREE,
        least=0.85,
    ),
    _followed("landmarks_block", "a block must move", policies.LANDMARKS_BLOCK, least=0.55),
    _executed("recipe_skills", "recipes of four skills, skills completed, %", 80, policies.RECIPE_SKILLS),
    _executed("recipe_whole", "whole recipes, %", 45, policies.RECIPE_WHOLE),
    *_augmented(),
    _reinforced("ppo_all", "left and right, all starts", 65, language.SIDES, policies.RETURN_ALL),
    replace(
        _reinforced("ppo_wrong_order", "starts in the wrong order", 45, language.SIDES, policies.RETURN_WRONG_ORDER),
        low_above=_PUSHER,
    ),
    _reinforced("ppo_stack", "stack", 40, (policies.STACK,), policies.RETURN_ALL),
    *_reinforced_augmented(),
    *(
        Target(
            f"{method}_{name}",
            f"PPO whose training episodes begin {begin}, % of the expert: {text}",
            worlds,
            (sample,),
            unit=_PER_CENT,
            method=method,
        )
        for method, begin in (
            (policies.PPO_NEAR, "as the task does, in half with the gripper near the block; repeats of failures"),
            (policies.PPO_NEAR_CARRY, "so, with a reward that carrying shapes; repeats of failures"),
            (policies.PPO_OWN_STARTS, "as the task does"),
            (policies.PPO_PRACTICE, "as the task does, and some where others were on their way to a reward"),
        )
        for name, text, worlds, sample in (
            ("all", "left and right, all starts", language.SIDES, policies.RETURN_ALL),
            ("wrong_order", "starts in the wrong order", language.SIDES, policies.RETURN_WRONG_ORDER),
            ("stack", "stack", (policies.STACK,), policies.RETURN_ALL),
        )
    ),
    _told(
        "language_told",
        "language policy told its task, % of its teachers",
        language.TOLD_OWN,
        least=90,
        unit=_PER_CENT,
        also=("language_other",),
    ),
    _told(
        "language_other",
        "what the word-blind policy earns in a task more than ours told the other task",
        *map(language.told_other, language.SIDES),
        least=0,
        low_above=0,
        apart=tuple((language.word_blind_return(task), language.told_other_return(task)) for task in language.SIDES),
    ),
    _told("language_blind", "the word-blind policy's return", *map(language.word_blind_return, language.SIDES)),
    _told("language_misled", "ours, told the other task", *map(language.told_other_return, language.SIDES)),
    _told(
        "language_wordings",
        "episodes that end as told, wordings and converses that no teacher has, %",
        language.WORDINGS,
        least=90,
        unit=_PER_CENT,
    ),
    _done(
        "language_done", "AUROC on states that it visits", evaluated.FLAG_AUROC, least=0.95, also=("language_done_ece",)
    ),
    _done("language_done_ece", "ECE there", evaluated.FLAG_ECE, most=0.05),
    _done("language_done_told", "told its task, % of its teachers", language.TOLD_OWN, unit=_PER_CENT),
    _done(
        "language_done_at_once",
        "the same, where one frame is enough for it",
        language.TOLD_OWN,
        unit=_PER_CENT,
        method=policies.LANGUAGE_DONE_AT_ONCE,
    ),
    _speed(
        "ppo_speed",
        "PPO on the learned reward over the network, simulated control ticks per second",
        speed.TICKS_PER_S,
        least=850,
        also=("ppo_speed_ratio",),
    ),
    _speed("ppo_speed_held", "the same, each action held for two ticks", speed.TICKS_PER_S_HELD, least=1300),
    _speed("ppo_speed_ratio", "of the same in one process", speed.NETWORK_VS_IN_PROCESS, least=0.8),
)
"""The claims that have a target."""
