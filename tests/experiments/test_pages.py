"""Pages are made of the committed results."""

from pathlib import Path

import pytest
from experiments.pages import pages, render

from freerein.errors import NotFound

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "experiments" / "results"
MOST_BYTES_OF_README = 8_000


def test_pages_follow_from_the_committed_results_and_the_readme_is_short() -> None:
    for path, text in pages(ROOT).items():
        assert path.read_text() == text, "stale: run make tables"
    assert len((ROOT / "README.md").read_bytes()) <= MOST_BYTES_OF_README


@pytest.mark.parametrize(
    ("template", "text"),
    [
        ("{table_2_2/dial value:.1f} ({interval:.0f}, {met})", "90.4 (90 to 91, not met)"),
        ("{robustness/landmarks_free value:p0} %", "96 %"),
        ("{table_2_2/dial cell gap closed}", "0.79, 0.68; 0.71, 0.65"),
        ("{table_2_2/bins-lse-lookahead-5-seed? test.frame_accuracy:p1}", "63.5"),
        ("{robustness/blocks.yellow-left-of-green-ppo-seed0 nominal.return:.0f}", "85"),
    ],
    ids=["claim", "per cent", "cell", "mean of arms", "sample"],
)
def test_a_field_is_of_a_claim_a_table_or_arms(template: str, text: str) -> None:
    assert render(template, RESULTS) == text


@pytest.mark.parametrize(
    "field", ["{robustness/no_such value}", "{table_2_2/dial no_such}", "{value}", "{table no_such}"]
)
def test_a_field_that_no_result_has_is_named(field: str) -> None:
    with pytest.raises(NotFound, match=field):
        render(f"of {field}", RESULTS)
