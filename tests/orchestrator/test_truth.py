"""Predicates on true states, judged in requests of bounded size by the real sim service."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from freerein.clients import Channel, SimClient, SyncClient
from freerein.types.sim import ResetRequest
from freerein_orchestrator.envs import truth
from freerein_orchestrator.envs.truth import truth_session


@pytest.fixture(scope="module")
def sim(start_module_service: Callable[..., Any], wait_until: Any) -> str:
    service = start_module_service("freerein_sim", FREEREIN_SIM_WORKERS="1")
    wait_until(service.is_ready, 300)
    return str(service.address)


@pytest.mark.e2e
@pytest.mark.parametrize(("rows", "values"), [(1_000_000, 4_000_000), (12, 4_000_000), (1_000_000, 200), (1, 1)])
def test_sequences_are_judged_alike_in_one_request_and_in_many(
    sim: str, monkeypatch: pytest.MonkeyPatch, rows: int, values: int
) -> None:
    rng, lengths = np.random.default_rng(0), (3, 7, 1, 5, 2)
    with SyncClient(SimClient(Channel(sim))) as client, truth_session(client, "blocks") as session:
        (start,) = client.reset(ResetRequest(session.id)).truth.state  # (S,)
        states = [np.tile(start, (length, 1)) for length in lengths]
        references = [each + rng.integers(2, size=(len(each), 1)) for each in states]
        alone = [session.holds("at-landmark", [one], [other])[0] for one, other in zip(states, references, strict=True)]
        monkeypatch.setattr(truth, "_MAX_ROWS", rows)
        monkeypatch.setattr(truth, "_MAX_VALUES", values)
        found = session.holds("at-landmark", states, references)
        assert session.holds("at-landmark", [], []) == []
    assert [each.tolist() for each in found] == [each.tolist() for each in alone]
    assert {True, False} == set(np.concatenate(found).tolist())


def test_no_request_exceeds_the_limits_and_all_sequences_are_in_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(truth, "_MAX_ROWS", 12)
    monkeypatch.setattr(truth, "_MAX_VALUES", 40)
    states = [np.zeros((length, 2)) for length in (3, 4, 4, 30, 1, 5)]
    assert [(part.start, part.stop) for part in truth._parts(states, paired=False)] == [(0, 3), (3, 4), (4, 6)]
    assert [(part.start, part.stop) for part in truth._parts(states, paired=True)] == [(0, 2), (2, 3), (3, 4), (4, 6)]
