"""What an operator may set, and what is refused before a service listens."""

import os
import re
import subprocess
from pathlib import Path

import pytest
from pydantic import ValidationError

from freerein.cli.settings import CliSettings
from freerein.clients import Channel
from freerein.errors import FailedPrecondition, InvalidInput
from freerein.serving.environment import KNOWN, reasons
from freerein.serving.learned import LearnedSettings
from freerein.serving.settings import ServiceSettings
from freerein.stack import configured_ports
from freerein_orchestrator.settings import OrchestratorSettings
from freerein_reward.settings import RewardSettings
from freerein_sim.settings import SimSettings

ROOT = Path(__file__).parents[2]

SELF_SIGNED = "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 1 -subj /CN=localhost"


@pytest.fixture(autouse=True)
def _clean_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for variable in ("TOKEN", "HOST", "HTTP_PORT", "GRPC_PORT", "DATA_DIR", "INSECURE", "DEVICE", "SHIPPED_DIR"):
        monkeypatch.delenv(f"FREEREIN_{variable}", raising=False)
    monkeypatch.chdir(tmp_path)


def test_the_defaults_are_loopback_without_a_token() -> None:
    settings = ServiceSettings()
    assert (settings.host, settings.token_text, settings.data_dir) == ("127.0.0.1", "", Path("var"))
    assert (settings.receipt_s, settings.write_s, settings.queue) == (10.0, 30.0, 256)


def test_the_environment_overrides_and_an_empty_variable_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FREEREIN_QUEUE", "4")
    monkeypatch.setenv("FREEREIN_TOKEN", "")
    monkeypatch.setenv("FREEREIN_UNKNOWN", "")
    settings = ServiceSettings()
    assert (settings.queue, settings.token) == (4, None)


def test_the_token_is_not_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FREEREIN_TOKEN", "secret")
    settings = ServiceSettings()
    assert settings.token_text == "secret"
    assert "secret" not in f"{settings} {settings!r} {settings.model_dump_json()}"


@pytest.mark.parametrize("token", ["schlüssel", "two words", "line\n", "\x7f"])
def test_a_token_that_no_header_carries_is_refused(monkeypatch: pytest.MonkeyPatch, token: str) -> None:
    monkeypatch.setenv("FREEREIN_TOKEN", token)
    with pytest.raises(ValidationError, match="FREEREIN_TOKEN must be printable ASCII") as error:
        ServiceSettings()
    assert token not in error.value.errors()[0]["msg"]
    with pytest.raises(InvalidInput, match="printable ASCII") as refused:
        Channel("127.0.0.1:9104", token=token)
    assert token not in f"{refused.value.detail} {refused.value.hint}"


@pytest.mark.parametrize(
    ("variable", "value"),
    [
        ("HTTP_PORT", "65536"),
        ("GRPC_PORT", "-1"),
        ("HTTP_PORT", "http"),
        ("RECEIPT_S", "0"),
        ("RECEIPT_S", "nan"),
        ("WRITE_S", "-1"),
        ("QUEUE", "0"),
        ("INSECURE", "perhaps"),
        ("LOG_LEVEL", "loud"),
        ("DEVICE", "cuda:x"),
        ("DEVICE", "tpu"),
        ("DATA_DIR", "~nobody-has-this-name/x"),
        ("HTTP_PORT", "8104 8105"),
    ],
)
def test_a_wrong_value_is_refused_by_its_name(monkeypatch: pytest.MonkeyPatch, variable: str, value: str) -> None:
    monkeypatch.setenv(f"FREEREIN_{variable}", value)
    with pytest.raises(ValidationError) as error:
        LearnedSettings()
    assert error.value.errors()[0]["loc"] == (variable.lower(),)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.0.1", "127.0.0.2", "example.org"])
@pytest.mark.parametrize(("variable", "value"), [("TOKEN", "x"), ("INSECURE", "1")])
def test_a_bind_beyond_loopback_needs_a_token_or_a_word_said_aloud(
    monkeypatch: pytest.MonkeyPatch, host: str, variable: str, value: str
) -> None:
    monkeypatch.setenv("FREEREIN_HOST", host)
    with pytest.raises(ValidationError, match="FREEREIN_INSECURE=1"):
        ServiceSettings()
    monkeypatch.setenv(f"FREEREIN_{variable}", value)
    assert ServiceSettings().host == host


def test_a_certificate_and_its_key_come_together_and_can_be_read(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name in ("ours", "other"):
        subprocess.run(
            [*SELF_SIGNED.split(), "-keyout", f"{name}.key", "-out", f"{name}.crt"],
            cwd=tmp_path,
            check=True,
            capture_output=True,
        )
    monkeypatch.setenv("FREEREIN_TLS_CERT", "ours.crt")
    with pytest.raises(ValidationError, match="set together"):
        ServiceSettings()
    for key in ("other.key", "ours.crt", "missing"):
        monkeypatch.setenv("FREEREIN_TLS_KEY", key)
        with pytest.raises(ValidationError, match="belong together"):
            ServiceSettings()
    monkeypatch.setenv("FREEREIN_TLS_KEY", "ours.key")
    monkeypatch.setenv("FREEREIN_HOST", "0.0.0.0")
    assert ServiceSettings().tls_key == Path("ours.key")


def test_the_spellings_that_people_use_are_understood(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    spelled = {
        "DATA_DIR": " ~/freerein ",
        "HOST": " [::1] ",
        "HTTP_PORT": " 8104 ",
        "LOG_LEVEL": "INFO",
        "QUEUE": " 4",
        "INSECURE": " True ",
        "DEVICE": "cuda",
        "SHIPPED_DIR": "~/models",
        "RECEIPT_S": "20 ",
        "CORS_ORIGINS": "http://localhost:3000/, https://robots.example",
    }
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "models").mkdir()
    for variable, value in spelled.items():
        monkeypatch.setenv(f"FREEREIN_{variable}", value)
    settings = LearnedSettings()
    assert (settings.data_dir, settings.shipped_dir) == (tmp_path / "freerein", tmp_path / "models")
    assert (settings.host, settings.http_port, settings.log_level) == ("::1", 8104, "info")
    assert (settings.queue, settings.insecure, settings.device, settings.receipt_s) == (4, True, "cuda:0", 20.0)
    assert settings.origins == ("http://localhost:3000", "https://robots.example")
    assert CliSettings().data_dir == tmp_path / "freerein"


@pytest.mark.parametrize(
    ("value", "expected"), [("CPU", "cpu"), ("CUDA:1", "cuda:1"), ("gpu", "cuda:0"), (" Auto", "auto")]
)
def test_a_device_may_be_spelled_otherwise(monkeypatch: pytest.MonkeyPatch, value: str, expected: str) -> None:
    monkeypatch.setenv("FREEREIN_DEVICE", value)
    assert LearnedSettings().device == expected


@pytest.mark.parametrize(("value", "expected"), [("WARN", "warning"), ("Debug ", "debug"), ("CRITICAL", "error")])
def test_a_level_may_be_spelled_otherwise(monkeypatch: pytest.MonkeyPatch, value: str, expected: str) -> None:
    monkeypatch.setenv("FREEREIN_LOG_LEVEL", value)
    assert ServiceSettings().log_level == expected


def test_a_data_directory_that_is_a_file_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("FREEREIN_DATA_DIR", "file")
    with pytest.raises(ValidationError, match="must be a folder"):
        ServiceSettings()
    monkeypatch.setenv("FREEREIN_DATA_DIR", "new")
    assert ServiceSettings().data_dir == Path("new")


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("FREEREIN_TOKN", "FREEREIN_TOKEN"),
        ("FREEREIN__TOKEN", "FREEREIN_TOKEN"),
        ("FREEREINTOKEN", "FREEREIN_TOKEN"),
        ("freerein_tokken", "FREEREIN_TOKEN"),
        ("FREEREN_TOKEN", "FREEREIN_TOKEN"),
        ("FREEREIN_CERT", "FREEREIN_TLS_CERT"),
        ("FREEREIN_PORT", "FREEREIN_HTTP_PORT"),
        ("FREEREIN_SIM_ADRESS", "FREEREIN_SIM_ADDRESS"),
        ("FREEREIN_SIM_WORKER", "FREEREIN_SIM_WORKERS"),
    ],
)
def test_a_variable_that_there_is_not_is_refused_beside_the_one_that_was_meant(
    monkeypatch: pytest.MonkeyPatch, written: str, meant: str
) -> None:
    monkeypatch.setenv(written, "a secret")
    with pytest.raises(ValidationError, match=f"got `{written}`, did you mean `{meant}`") as error:
        ServiceSettings()
    assert "secret" not in reasons(error.value)
    with pytest.raises(InvalidInput, match=f"got `{written}`, did you mean `{meant}`"):
        CliSettings()


def test_an_unlike_variable_is_refused_and_a_long_one_is_not_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FREEREIN_XYZ", "1")
    monkeypatch.setenv("FREEREIN_" + "Q" * 100, "1")
    with pytest.raises(ValidationError, match="`FREEREIN_XYZ`, which is unknown and a name of 109 characters"):
        LearnedSettings()


@pytest.mark.parametrize(
    ("variable", "value"),
    [
        ("FREEREIN_SIM_WORKERS", "2"),  # of another service
        ("FREEREIN_ROBOTS", "1"),  # of compose
        ("FREEREIN_FUZZ", "1"),  # of tests
        ("FREEREIN_SIM_SERVICE_HOST", "10.0.0.11"),  # of Kubernetes
        ("FREEREIN_SIM_PORT", "tcp://10.0.0.11:9104"),
        ("FREEREIN_SIM_PORT_9104_TCP_ADDR", "10.0.0.11"),
        ("FREEREIN_SERVICE_PORT_GRPC", "9104"),
        ("FREEREIN_HTTP_PORT", "tcp://10.0.0.11:80"),  # of a service called freerein-http
        ("FREEREIN_GRPC_PORT", "udp://10.0.0.11:80"),
        ("FREEREIN_SIM_NAME", "/robot/freerein-sim"),  # of Docker
        ("FREEREIN_SIM_ENV_PATH", "/usr/bin"),
    ],
)
def test_a_variable_of_somebody_else_is_left_alone(monkeypatch: pytest.MonkeyPatch, variable: str, value: str) -> None:
    monkeypatch.setenv(variable, value)
    assert (ServiceSettings().http_port, ServiceSettings().grpc_port, CliSettings().token) == (None, None, None)
    assert configured_ports(["sim", "reward"], os.environ)["sim"].rest == 8104


def test_the_known_variables_are_those_that_settings_compose_and_tests_have() -> None:
    services = (LearnedSettings, CliSettings, OrchestratorSettings, RewardSettings, SimSettings)
    settings = {name.upper() for each in services for name in each.model_fields}
    compose = re.findall(r"FREEREIN_(\w+)", (ROOT / "docker-compose.yml").read_text())
    tests = {"FUZZ", "SOAK_MINUTES", "TESTS_FORK_SERVER"}
    assert set(KNOWN) == settings | {*compose} | tests
    assert len(set(KNOWN)) == len(KNOWN)


def test_a_folder_of_shipped_models_that_is_missing_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FREEREIN_SHIPPED_DIR", "modles")
    with pytest.raises(ValidationError, match="FREEREIN_SHIPPED_DIR must be a folder, or `none`"):
        LearnedSettings()
    monkeypatch.setenv("FREEREIN_SHIPPED_DIR", "none")
    assert LearnedSettings().shipped_dir == Path("none")


def test_a_data_directory_that_cannot_be_made_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FREEREIN_DATA_DIR", "/proc/none/data")
    with pytest.raises(FailedPrecondition, match="one that can be made"):
        ServiceSettings().make_data_dir()


def test_a_wrong_setting_of_the_command_line_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FREEREIN_DATA_DIR", "~nobody-has-this-name/x")
    with pytest.raises(InvalidInput, match=r"FREEREIN_DATA_DIR: .*the name of no user"):
        CliSettings()
