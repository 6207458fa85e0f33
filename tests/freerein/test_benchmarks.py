import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROMISED = {
    "render.blocks_vs_stock",
    "batcher.model_batch8_vs_batch1_cost",
    "batcher.lone_latency_on_vs_off",
    "batcher.throughput16_on_vs_off",
}


@pytest.mark.e2e
def test_every_benchmark_runs_and_what_is_promised_has_a_bar(tmp_path: Path) -> None:
    out = tmp_path / "summary.json"

    subprocess.run([sys.executable, "-m", "benchmarks", "--quick", "--out", out], cwd=ROOT, check=True)

    summary = json.loads(out.read_bytes())
    assert {name.partition(".")[0] for name in summary["ratios"]} == {"render", "sim", "segment", "batcher"}
    assert all(ratio["value"] > 0 for ratio in summary["ratios"].values())
    assert {name for name, ratio in summary["ratios"].items() if ratio["bar"] is not None} == PROMISED
