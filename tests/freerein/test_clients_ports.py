"""Where clients find services."""

import pytest

from freerein.errors import InvalidInput
from freerein.ports import PORTS, address, addresses, rest_url


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


@pytest.mark.parametrize(
    ("environ", "url"),
    [
        ({}, "http://127.0.0.1:8104"),
        ({"FREEREIN_PORT_BASE": "18100"}, "http://127.0.0.1:18104"),
        ({"FREEREIN_SIM_ADDRESS": "sim-1:9200,sim-2:9200"}, "http://sim-1:8104"),
        ({"FREEREIN_SIM_ADDRESS": "[::1]:9104", "FREEREIN_TLS_CERT": "cert.pem"}, "https://[::1]:8104"),
        ({"FREEREIN_SIM_ADDRESS": "sim:9104", "FREEREIN_SIM_URL": " https://elsewhere:81/ "}, "https://elsewhere:81"),
    ],
)
def test_the_rest_api_of_a_service_is_on_the_host_of_its_address_unless_told_otherwise(
    environ: dict[str, str], url: str
) -> None:
    assert rest_url("sim", environ) == url


@pytest.mark.parametrize(
    "value",
    ["sim:8104", "http://sim", "http://sim:0", "http://sim:65536", "ftp://sim:21", "http://a@b:1", "http://s:1/v1"],
)
def test_a_url_that_is_no_host_and_port_is_refused_by_the_variables_name(value: str) -> None:
    with pytest.raises(InvalidInput, match="FREEREIN_SIM_URL") as error:
        rest_url("sim", {"FREEREIN_SIM_URL": value})
    assert error.value.hint


def test_an_unknown_service_is_refused() -> None:
    with pytest.raises(InvalidInput, match="orchestrator, segmentation"):
        address("oracle", {})


def test_no_two_doors_share_a_port() -> None:
    listed = [port for ports in PORTS.values() for port in (ports.rest, ports.grpc)]
    assert len(set(listed)) == len(listed)
