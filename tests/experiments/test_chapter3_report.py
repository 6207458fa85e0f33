"""The table of chapter 3: ways of acting that are chosen, gains, scales, and the worst flag of several worlds."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from experiments import doom, office, rope
from experiments.chapter3 import followed_report, reach, resampled
from experiments.chapter3.exploration import (
    CHOICE,
    DATA_OPTION,
    EXPERT,
    EXPLORING,
    FIT_OPTION,
    PILOT,
    RANDOM_SEARCH,
    RATE_OPTION,
    SETTINGS_OPTION,
    TEST,
    Choice,
)
from experiments.chapter3.fits import best_rate
from experiments.chapter3.followed import chosen_acting
from experiments.chapter3.followed_report import WORST_AUROC
from experiments.chapter3.followed_rows import rows_of
from experiments.workbench.claims import Claim
from experiments.workbench.results import ArmResult, Sample
from experiments.workbench.table import Table, markdown


def result(
    world: str,
    method: str,
    options: Mapping[str, str] | None = None,
    *,
    seed: int = 0,
    samples: Mapping[str, Sample] | None = None,
    figures: Mapping[str, float] | None = None,
) -> ArmResult:
    """Returns the result of an arm."""
    return ArmResult(
        name=f"{world}-{method}-{seed}",
        world=world,
        method=method,
        options=options or {},
        seed=seed,
        config={},
        world_version=f"{world}-v1",
        figures=figures or {},
        samples=samples or {},
        minutes=1.0,
        cpu_minutes=1.0,
        machine={},
        command="",
    )


def sample(values: npt.ArrayLike) -> Sample:
    numbers = np.asarray(values, np.float64).ravel().tolist()
    return Sample(numbers, [1] * len(numbers))


def fits_of(
    method: str, values: Sequence[float], *, figure: str = "completion", data: str = "curiosity"
) -> list[ArmResult]:
    """Returns results of fits in `doom` that complete so much in A and B, greedy in both as V1 chose."""
    found = []
    for seed, value in enumerate(values):
        noise = np.random.default_rng(seed).uniform(-0.1, 0.1, 250)
        here = {f"greedy.{name}.{figure}": sample(value + noise) for name in ("a", "v1")}
        drawn = {f"sampled.{name}.{figure}": sample(0 * noise) for name in ("a", "v1")}
        there = {f"greedy.b.{figure}": sample(value + noise)}
        options = {DATA_OPTION: data}
        found.append(result("doom", method, {**options, SETTINGS_OPTION: CHOICE}, seed=seed, samples=here | drawn))
        found.append(result("doom", method, {**options, SETTINGS_OPTION: TEST}, seed=seed, samples=there))
    return found


def explored(world: str, timesteps: float, data: str = "curiosity") -> ArmResult:
    """Returns the result of what made the data."""
    figures = {reach.EXPLORED: timesteps, reach.LEARNED: 94_208.0}
    return result(world, EXPLORING, {DATA_OPTION: data}, figures=figures)


def doom_table(*results: ArmResult) -> Table:
    return followed_report.table(doom.EXPLORATION, results, report=doom.EXPERIMENT.report)


def claims_of(table: Table) -> dict[str, Claim]:
    return {claim.claim: claim for claim in table.claims}


@pytest.mark.parametrize(
    ("greedy", "sampled", "choice", "chosen"),
    [
        ([0, 0, 1], [0.2, 0.2, 0.2], Choice("v", "x", "median"), "sampled"),
        ([0, 0, 1], [0.2, 0.2, 0.2], Choice("v", "x"), "greedy"),
        ([0, 0, 1], [0.2, 0.2, 0.2], Choice("v", "x", is_less=True), "sampled"),
        ([0, 0, 0], [0, 0, 0.5], Choice("v", "x", "median"), "sampled"),
        ([0, 0, 0], [0, 0, 0], Choice("v", "x", "median"), "greedy"),
    ],
    ids=["a median", "a mean", "a cost", "equal medians, by the mean", "equal, greedy"],
)
def test_the_way_of_acting_is_chosen_by_the_statistic_of_the_claim(
    greedy: list[float], sampled: list[float], choice: Choice, chosen: str
) -> None:
    assert chosen_acting({"greedy.v.x": sample(greedy), "sampled.v.x": sample(sampled)}, choice) == chosen
    assert chosen_acting({}, choice) == ""


def test_a_fit_whose_way_of_acting_is_not_chosen_yet_counts_nowhere() -> None:
    (_, test) = fits_of("gsp_features", [0.7])
    (row,) = rows_of(doom.EXPLORATION, [test])
    assert not row.episodes("b", "completion")


def test_data_and_updates_as_many_as_they_have_to_be_are_full_and_others_reduced() -> None:
    fits = [*fits_of("gsp_features", [0.7] * 3), *fits_of("gsp_pixels", [0.7])]
    full = claims_of(doom_table(explored("doom", 380_000), *fits))
    assert (full["doom_gsp_b"].scale, full["doom_gsp_b"].met) == ("full", True)
    assert full["doom_completion_gsp_pixels_curiosity_b"].scale == "reduced"
    short = claims_of(doom_table(explored("doom", 370_000), *fits))
    assert (short["doom_gsp_b"].scale, short["doom_gsp_b"].met) == ("reduced", False)
    assert claims_of(doom_table(*fits))["doom_gsp_b"].scale is None


def test_a_claim_has_random_search_below_and_the_expert_above_it() -> None:
    beside = [
        result("doom", method, {SETTINGS_OPTION: CHOICE}, samples={"greedy.a.completion": sample([value] * 250)})
        for method, value in ((RANDOM_SEARCH, 0.1), (EXPERT, 1.0))
    ]
    made = claims_of(doom_table(*beside, *fits_of("gsp_features", [0.7] * 3)))
    assert (made["doom_gsp"].baseline, made["doom_gsp"].ceiling) == (10.0, 100.0)
    assert (made["doom_gsp_b"].baseline, made["doom_gsp_b"].ceiling) == (None, None)


@pytest.mark.parametrize(
    ("ours", "others", "met", "verdict"),
    [
        ([0.7] * 4, [0.6] * 4, True, "met"),
        ([0.5] * 4, [0.6] * 4, False, "not met"),
        ([0.7, 0.5] * 2, [0.6] * 4, None, "undecided"),
        ([0.7] * 3, [0.6] * 3, None, "undecided"),
    ],
    ids=["above", "below", "interval holds 0", "too few pairs"],
)
def test_what_consistency_brings_is_undecided_where_the_paired_interval_holds_0(
    ours: list[float], others: list[float], met: bool | None, verdict: str
) -> None:
    data = explored("doom", 380_000)
    made = doom_table(data, *fits_of("gsp_features", ours), *fits_of("gsp_no_consistency", others))
    claim = claims_of(made)["doom_consistency"]
    assert claim.met is met
    assert claim.low is not None
    assert claim.high is not None
    assert claim.low <= claim.value <= claim.high
    assert f"| {claim.seeds} | {verdict} |" in markdown(made)


def test_a_gain_is_met_by_its_paired_interval_though_the_two_intervals_overlap() -> None:
    hard = np.linspace(0.1, 0.9, 5)[None, :, None] + np.zeros((3, 5, 50))  # demonstrations differ by more than rows
    both = np.stack([hard + 0.05, hard])
    low, _ = resampled.gain_interval(both, resampled.mean)
    assert low == pytest.approx(0.05)
    assert resampled.interval(both[0], resampled.mean)[0] < resampled.interval(both[1], resampled.mean)[1]


def test_cells_are_shares_or_medians_by_the_name_of_the_figure_with_intervals_over_demonstrations() -> None:
    all_or_none = np.tile([1.0, 0.0, 0.0, 0.0, 0.0], 50)  # trial i follows demonstration i modulo 5
    samples = {"greedy.a.completion": sample(all_or_none), "greedy.a.success": sample(all_or_none)}
    text = markdown(doom_table(result("doom", EXPERT, {SETTINGS_OPTION: CHOICE}, samples=samples)))
    assert "| expert |  | 0 | 20.0% [0.0%, 60.0%] |" in text
    assert "| expert |  | 0 | 0 [0, 1], mean 0.2 |" in text
    assert "## efficiency" not in text


def test_figures_by_landmark_have_a_column_each() -> None:
    samples = {f"greedy.s.tps-rpm{end}": sample([value] * 10) for end, value in (("", 2), (".0", 1), (".1", 3))}
    made = followed_report.table(
        rope.EXPLORATION,
        [result("rope", EXPERT, {SETTINGS_OPTION: TEST}, samples=samples)],
        report=rope.EXPERIMENT.report,
    )
    assert "| row | data | seed | setting | acting | 1 | 2 |" in markdown(made)
    assert "| expert |  | 0 | s | greedy | 1 | 3 |" in markdown(made)


def test_the_worst_flag_is_that_of_all_three_worlds_once_each_has_one() -> None:
    worlds = {"doom": (doom, "a", 0.95), "office": (office, "maze", 0.9), "rope": (rope, "knot", 0.8)}
    results = []
    for name, (world, setting, auroc) in worlds.items():
        row, data = world.EXPLORATION.claimed
        choice = world.EXPLORATION.all_settings[setting].choice
        chosen = {f"greedy.{choice.setting}.{choice.figure}": sample([0.5] * 500)}
        samples = chosen | {f"greedy.{setting}.flag.auroc": sample([auroc] * 500)}
        results.append(explored(name, 1e6, data))
        results += [result(name, row, {DATA_OPTION: data}, seed=seed, samples=samples) for seed in range(3)]
    claim = claims_of(rope.EXPERIMENT.table(results))[WORST_AUROC]
    assert (claim.value, claim.world_version, claim.met) == (0.8, "rope-v1", False)
    assert WORST_AUROC not in claims_of(rope.EXPERIMENT.table([each for each in results if each.world != "doom"]))
    assert WORST_AUROC not in claims_of(doom_table(*[each for each in results if each.world == "doom"]))


def test_the_best_rate_has_the_lowest_held_out_loss_and_is_shown_beside_the_others() -> None:
    losses = {"0.002": 0.9, "0.006": 0.7, "0.02": 0.8}
    tried = [
        result(
            "doom", PILOT, {FIT_OPTION: "inverse_model", RATE_OPTION: rate}, figures={"policy.validation_loss": loss}
        )
        for rate, loss in losses.items()
    ]
    assert best_rate(tried, "inverse_model") == 6e-3
    chosen = replace(doom.EXPLORATION, lr={**doom.EXPLORATION.lr, "inverse_model": 2e-2})
    made = followed_report.table(chosen, tried, report=doom.EXPERIMENT.report)
    assert "| inverse_model | 0.02 | 0.9000 | 0.7000 | 0.8000 |" in markdown(made)
