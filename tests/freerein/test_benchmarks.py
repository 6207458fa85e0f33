"""The benchmarks run, and what is promised of speed has a bar."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.e2e, pytest.mark.long]
ROOT = Path(__file__).parents[2]
KINDS = {"render", "sim", "envs", "segment", "batcher", "reward", "act", "control", "ppo"}
PROMISED = {
    "render.blocks_vs_stock",
    "render.blocks_vs_stock_without_shadows",
    "batcher.model_batch8_vs_batch1_cost",
    "batcher.lone_latency_on_vs_off",
    "batcher.throughput16_on_vs_off",
    "act.control-bytes_adds_vs_bare_policy.64px",
    "act.control-bytes_adds_vs_bare_policy.224px",
    "peers.control_vs_vla-eval.64px",
    "peers.control_vs_vla-eval.224px",
    "peers.json_vs_litserve.64px",
    "peers.json_vs_litserve.224px",
    "control.model_batch8_vs_batch1_cost",
    "control.throughput16_on_vs_off",
    "control.p99_vs_bare.32x50hz",
    "reward.goal_cached_vs_uncached.grpc",
    "reward.images32_vs_1.grpc",
    "ppo.network_vs_in_process",
}


@pytest.mark.fault("G1")
@pytest.mark.fault("G3")
def test_benchmarks_run_and_what_is_promised_has_a_bar(tmp_path: Path) -> None:
    out = tmp_path / "summary.json"

    command = [sys.executable, "-m", "benchmarks", "--quick", "--only", *sorted(KINDS), "--out", out]
    subprocess.run(command, cwd=ROOT, check=True)

    summary = json.loads(out.read_bytes())
    assert {name.partition(".")[0] for name in summary["ratios"]} == KINDS
    assert all(math.isfinite(ratio["value"]) for ratio in summary["ratios"].values())
    with_bar = {name for name, ratio in summary["ratios"].items() if ratio["bar"] is not None}
    assert with_bar == {name for name in PROMISED if name.partition(".")[0] in KINDS}


def test_the_benchmark_of_training_runs_and_finds_equal_losses(tmp_path: Path) -> None:
    out = tmp_path / "summary.json"

    command = [sys.executable, "-m", "benchmarks", "--quick", "--only", "training", "--out", out]
    subprocess.run(command, cwd=ROOT, check=True)

    ratios = json.loads(out.read_bytes())["ratios"]
    assert "training.segmentation_33x30x3.glibc_allocator_vs_shipped" in ratios
    assert all(math.isfinite(ratio["value"]) for ratio in ratios.values())


@pytest.mark.skipif(os.environ.get("FREEREIN_FUZZ") != "1", reason="installs the peers; a case of `make fuzz`")
def test_the_benchmark_beside_peers_runs_where_they_can_be_installed(tmp_path: Path) -> None:
    out = tmp_path / "summary.json"

    command = [sys.executable, "-m", "benchmarks", "--quick", "--only", "peers", "--out", out]
    done = subprocess.run(command, cwd=ROOT, check=True, stderr=subprocess.PIPE, text=True)

    ratios = json.loads(out.read_bytes())["ratios"]
    if not ratios:
        assert done.stderr.startswith("peers: skipped.")
        pytest.skip("the peers could not be installed")
    assert {name for name, ratio in ratios.items() if ratio["bar"] is not None} == {
        name for name in PROMISED if name.startswith("peers.")
    }
