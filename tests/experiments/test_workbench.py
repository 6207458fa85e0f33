import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from experiments import registry
from experiments.table_2_1 import EXPERIMENT as GRID
from experiments.workbench import claims, results
from experiments.workbench.arms import Arm, choose
from experiments.workbench.elapsed import Elapsed
from experiments.workbench.results import ArmResult, Sample

from freerein.errors import FailedPrecondition, NotFound
from freerein_sim.worlds.tasks import tasks

GOLDEN = Path(__file__).parents[1] / "golden" / "worlds"

RESULT = ArmResult(
    name="grid-lse-causal-seed1",
    world="grid",
    method="lse",
    options={"context": "causal"},
    seed=1,
    config={"fit": {"lr": 0.1}},
    world_version="grid-v1",
    figures={"test.frame_accuracy": 0.5},
    samples={"test.frame_accuracy": Sample([1, 2], [3, 3])},
    minutes=1.5,
    cpu_minutes=1.25,
    machine={"cores": 2},
    command="python -m experiments run table_2_1",
)

EVALUATED = replace(
    RESULT,
    figures=dict.fromkeys(
        (
            "test.balanced_accuracy",
            "test.edit_score",
            "test.f1_at_50",
            "test.decoded_accuracy",
            "test.decoded_edit_score",
            "action_loss",
        ),
        0.5,
    ),
    samples={f"{split}.frame_accuracy": Sample([1, 2], [3, 3]) for split in ("train", "validation", "test")},
)


GUESSED = replace(EVALUATED, name="grid-majority-seed0", method="majority", options={}, seed=0)


def test_a_result_comes_back_from_its_file(tmp_path: Path) -> None:
    results.save(RESULT, tmp_path)
    assert results.load_all(tmp_path) == [RESULT]


def test_packed_results_come_back_with_what_was_saved_since_and_pack_again(tmp_path: Path) -> None:
    mil, ccnn = replace(RESULT, name="grid-mil-causal-seed1"), replace(RESULT, name="grid-ccnn-causal-seed1", config={})
    results.save(RESULT, tmp_path)
    results.save(mil, tmp_path)
    results.pack(tmp_path)
    assert "samples" not in (tmp_path / f"{mil.name}.json").read_text()
    changed = replace(mil, samples={})
    results.save(changed, tmp_path)
    results.save(ccnn, tmp_path)
    assert results.load_all(tmp_path) == [ccnn, RESULT, changed]
    results.pack(tmp_path)
    files = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert results.load_all(tmp_path) == [ccnn, RESULT, changed]
    assert len(files) == 4

    results.pack(tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == files


def test_results_that_two_branches_packed_load_from_both_archives(tmp_path: Path) -> None:
    other = replace(RESULT, name="grid-mil-causal-seed1", config={})
    for branch, result in (("ours", RESULT), ("theirs", other)):
        results.save(result, tmp_path / branch)
        results.pack(tmp_path / branch)
        shutil.copytree(tmp_path / branch, tmp_path / "merged", dirs_exist_ok=True)
    assert results.load_all(tmp_path / "merged") == [RESULT, other]


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"samples": {}}', '{"archived": "0123456789ab"}'])
def test_a_file_that_is_no_result_is_refused_with_a_hint(text: str, tmp_path: Path) -> None:
    (tmp_path / "arm.json").write_text(text)
    with pytest.raises(FailedPrecondition) as refused:
        results.load_all(tmp_path)
    assert "run the arm again" in refused.value.hint


def test_a_sample_is_a_ratio_of_sums() -> None:
    assert Sample([1, 9], [10, 10]).mean == 0.5
    assert Sample([1, 90], [10, 90]).mean == 0.91


def test_the_interval_of_equal_trials_is_their_value() -> None:
    constant = [Sample([2, 2, 2], [4, 4, 4])] * 3
    assert claims.mean(constant) == 0.5
    assert claims.interval(constant) == (0.5, 0.5)


def test_the_interval_of_one_network_is_that_of_a_binomial() -> None:
    sample = Sample([1] * 50 + [0] * 50, [1] * 100)
    low, high = claims.interval([sample])
    assert (low, high) == pytest.approx((0.5 - 1.96 * 0.05, 0.5 + 1.96 * 0.05), abs=0.02)


def test_seeds_that_agree_on_each_trial_narrow_no_interval() -> None:
    sample = Sample([1] * 50 + [0] * 50, [1] * 100)
    found = [claims.interval([sample] * seeds) for seeds in (1, 5)]
    assert found[0] == pytest.approx(found[1])
    low, high = claims.difference_interval([sample] * 5, [sample])
    assert (low, high) == pytest.approx((0, 0))


def test_the_interval_covers_seeds_before_trials() -> None:
    networks = [Sample([trial] * 1000, [1] * 1000) for trial in (0.2, 0.5, 0.8)]
    assert claims.interval(networks) == pytest.approx((0.2, 0.8))


def test_the_interval_of_a_ratio_covers_both_of_its_parts() -> None:
    steady, other = [Sample([8] * 50, [10] * 50)] * 3, [Sample([5] * 25 + [10] * 25, [10] * 50)] * 3
    assert claims.ratio_interval(steady, steady) == (1.0, 1.0)
    low, high = claims.ratio_interval(steady, other)
    assert low < 0.8 / 0.75 < high
    assert (low, high) == pytest.approx((0.98, 1.17), abs=0.03)


def test_of_seeds_that_begin_alike_the_interval_of_a_ratio_is_narrower() -> None:
    unequal = [Sample([10 * trial] * 50, [10] * 50) for trial in (0.4, 1.0, 1.0)]
    assert claims.paired_ratio_interval(unequal, unequal) == (1.0, 1.0)
    low, high = claims.ratio_interval(unequal, unequal)
    assert low < 0.9 < 1.1 < high


def test_the_gap_closed_is_a_share_and_none_without_a_gap() -> None:
    assert claims.gap_closed(0.9, baseline=0.6, ceiling=1.0, least_gap=0.1) == pytest.approx(0.75)
    assert claims.gap_closed(0.5, baseline=0.6, ceiling=1.0, least_gap=0.1) == pytest.approx(-0.25)
    assert claims.gap_closed(0.9, baseline=0.95, ceiling=1.0, least_gap=0.1) is None
    assert claims.gap_closed(0.9, baseline=None, ceiling=1.0, least_gap=0.1) is None


def test_arms_are_chosen_by_pattern() -> None:
    grid = registry.load("table_2_1")
    assert [arm.seed for arm in choose(grid, ["grid-lse-causal-*"])] == [0, 1, 2]
    assert choose(grid, []) == list(grid.arms)
    with pytest.raises(NotFound):
        choose(grid, ["grid-mil-*", "dial-*"])


def test_the_behaviour_of_every_world_with_results_is_recorded() -> None:
    for task in {arm.world for name in registry.EXPERIMENTS for arm in registry.load(name).arms}:
        recorded = json.loads((GOLDEN / f"{tasks()[task].world}.json").read_text())
        is_recorded = task in recorded["cases"] or tasks()[task].goal_text  # some goals stand for all of a world
        assert is_recorded, "add the task to WORLDS of tests/sim/test_worlds_golden.py"


def test_an_arm_is_named_by_world_method_options_and_seed() -> None:
    assert Arm("dial", "lse", {"context": "causal"}, 2).name == "dial-lse-causal-seed2"


def test_the_time_of_an_arm_includes_earlier_attempts(tmp_path: Path) -> None:
    path = tmp_path / "elapsed.json"
    path.write_text(json.dumps({"wall_s": 120.0, "cpu_s": 60.0}))

    Elapsed(path).save()

    assert 2.0 < Elapsed(path).minutes < 3.0
    assert 1.0 <= Elapsed(path).cpu_minutes < 2.0


@pytest.mark.parametrize(("steps", "scale"), [(150, "reduced"), (390, "reduced"), (391, "full")])
def test_the_scale_is_full_when_a_network_sees_as_many_trajectories_as_the_dissertations(
    steps: int, scale: str
) -> None:
    study = replace(GRID.studies[0], settings={"steps": steps, "batch_size": 128})
    table = replace(GRID, studies=(study,), report=replace(GRID.report, targets=())).table([EVALUATED])
    assert {claim.scale for claim in table.claims} == {scale}
    seen = f"{min(steps * 128, 50_000):,}".replace(",", " ")
    assert f"{seen} of the dissertation's 50 000" in table.sections[0].title


def test_networks_have_seeds_and_guesses_have_none() -> None:
    claims_made = GRID.table([EVALUATED, GUESSED]).claims
    assert [(claim.claim, claim.seeds) for claim in claims_made if claim.claim.endswith("test")] == [
        ("table_2_1.grid.majority.test", None),
        ("table_2_1.grid.lse.causal.test", 1),
    ]
