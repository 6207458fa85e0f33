"""The soak's leak detector finds a leak and nothing else."""

import math
import re
import socket

import httpx
import numpy as np
import pytest
from soak.__main__ import Findings
from soak.leak import MOST_MIB_PER_10K_CALLS, Sample, growth_mib_per_10k_calls
from soak.watch import Held, total


def samples(*, leak_mib_per_10k: float = 0.0, seed: int = 0) -> list[Sample]:
    """Returns what a service that warms up, has peaks now and then, and may leak, would show over 30 000 calls."""
    rng, calls = np.random.default_rng(seed), np.linspace(0, 30_000, 60)
    warm = 40 * (1 - np.exp(-calls / 1_000))
    peaks = np.where(rng.random(60) < 0.05, 30.0, 0.0)
    rss = 300 + warm + peaks + leak_mib_per_10k * calls / 1e4 + rng.normal(0, 0.3, 60)
    return [Sample(float(one), float(mib)) for one, mib in zip(calls, rss, strict=True)]


@pytest.mark.fault("G9")
@pytest.mark.parametrize("leak", [1.5, 3.0, 10.0])
def test_a_leak_is_found_and_measured(leak: float) -> None:
    found = growth_mib_per_10k_calls(samples(leak_mib_per_10k=leak))
    assert found > MOST_MIB_PER_10K_CALLS
    assert found == pytest.approx(leak, abs=0.4)


@pytest.mark.fault("G9")
def test_warm_up_noise_and_peaks_are_no_leak() -> None:
    for seed in range(20):
        assert abs(growth_mib_per_10k_calls(samples(seed=seed))) < 0.7 * MOST_MIB_PER_10K_CALLS


@pytest.mark.parametrize("some", [[], [Sample(0, 1)] * 14, [Sample(7, 1)] * 60])
def test_too_little_is_no_measurement(some: list[Sample]) -> None:
    with pytest.raises(ValueError, match="Expected 10 samples"):
        growth_mib_per_10k_calls(some)


@pytest.mark.fault("G9")
async def test_metrics_that_cannot_be_read_are_a_failure() -> None:
    failures: list[str] = []
    with socket.socket() as unheard:
        unheard.bind(("127.0.0.1", 0))  # nobody listens there
        port = unheard.getsockname()[1]
        async with httpx.AsyncClient(trust_env=False) as client:
            assert math.isnan(await total("sim", client, f"http://127.0.0.1:{port}", re.compile("(x)"), failures))
    (failure,) = failures
    assert failure.startswith("sim: /metrics must be answered with 200; got ConnectError")


@pytest.mark.fault("G9")
def test_a_service_that_was_not_measured_or_is_gone_is_a_failure() -> None:
    findings = Findings(before={"sim": Held(1, 1, 0)}, failures=["sim: /metrics"])
    findings.samples["sim"] = samples()[:5]
    assert len(findings.all_failures()) == 3
