"""Where clients find services."""

import pytest

from freerein.errors import InvalidInput
from freerein.ports import PORTS, address, addresses


def test_a_service_is_on_loopback_at_its_port_unless_told_otherwise() -> None:
    assert address("sim", {}) == "127.0.0.1:9104"
    assert address("sim", {"FREEREIN_SIM_ADDRESS": ""}) == "127.0.0.1:9104"


def test_the_environment_says_where_a_service_is() -> None:
    assert address("segmentation", {"FREEREIN_SEGMENTATION_ADDRESS": "segmentation:9000"}) == "segmentation:9000"


def test_spaces_and_brackets_are_spellings() -> None:
    spelled = " [::1]:9104, sim-2:9104 ,, 10.0.0.3:1 "
    assert addresses("sim", {"FREEREIN_SIM_ADDRESS": spelled}) == ("[::1]:9104", "sim-2:9104", "10.0.0.3:1")
    assert addresses("sim", {"FREEREIN_SIM_ADDRESS": "  "}) == ("127.0.0.1:9104",)


@pytest.mark.parametrize(
    "value",
    [
        "sim",
        "sim:",
        ":9104",
        "http://sim/",
        "http://sim:9104",
        "sim:65536",
        "sim:0",
        "sim:\u0663",
        "::1:9104",
        "a b:9104",
    ],
)
def test_an_address_that_is_no_host_and_port_is_refused_by_the_variables_name(value: str) -> None:
    with pytest.raises(InvalidInput, match="FREEREIN_SIM_ADDRESS") as error:
        address("sim", {"FREEREIN_SIM_ADDRESS": value})
    assert error.value.hint


def test_an_unknown_service_is_refused() -> None:
    with pytest.raises(InvalidInput, match="orchestrator, segmentation"):
        address("oracle", {})


def test_no_two_doors_share_a_port() -> None:
    listed = [port for ports in PORTS.values() for port in (ports.rest, ports.grpc)]
    assert len(set(listed)) == len(listed)
