"""What `freerein up` and `freerein doctor` say of certificates."""

import asyncio
import contextlib
import ssl
import sys
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import grpc
import pytest
import trustme
from grpc import aio

from freerein.cli.doctor import services
from freerein.clients import Channel, SimClient
from freerein.errors import Unavailable, Unimplemented
from freerein.stack import Stack
from freerein.stack.certificates import tls_problem
from freerein.types.sim import ListTasksRequest

AUTHORITY = trustme.CA()


@pytest.fixture
def issue(tmp_path: Path) -> Callable[..., tuple[Path, Path]]:
    """A function that returns the PEM files of the key and the certificate of a leaf of an authority."""

    def make(*names: str, authority: trustme.CA = AUTHORITY) -> tuple[Path, Path]:
        leaf = authority.issue_cert(*names)
        key, chain = tmp_path / f"{names[0]}.key", tmp_path / f"{names[0]}.crt"
        key.write_bytes(leaf.private_key_pem.bytes())
        chain.write_bytes(leaf.cert_chain_pems[0].bytes())
        return key, chain

    return make


@contextlib.asynccontextmanager
async def listening(key: Path, chain: Path) -> AsyncIterator[int]:
    """A server of TLS that is ready, whatever it is asked; yields its port."""
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(chain, key)

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError, asyncio.IncompleteReadError):
            await reader.readuntil(b"\r\n\r\n")
            writer.write(b'HTTP/1.1 200 OK\r\ncontent-length: 14\r\nconnection: close\r\n\r\n{"live": true}')
            await writer.drain()
        writer.close()

    async with await asyncio.start_server(answer, "127.0.0.1", 0, ssl=context) as server:
        yield server.sockets[0].getsockname()[1]


async def problem(port: int, trusted: Path, **options: str) -> str:
    return await asyncio.to_thread(tls_problem, "127.0.0.1", port, str(trusted), timeout_s=60.0, **options)


async def test_a_leaf_is_trusted_for_itself_or_for_its_authority(issue: Any, tmp_path: Path) -> None:
    key, chain = issue("127.0.0.1")
    authority = tmp_path / "authority.crt"
    authority.write_bytes(AUTHORITY.cert_pem.bytes())
    async with listening(key, chain) as port:
        assert [await problem(port, trusted) for trusted in (chain, authority)] == ["", ""]


async def test_an_untrusted_certificate_is_told_from_nobody_listening(issue: Any, reserve_ports: Any) -> None:
    key, chain = issue("127.0.0.1")
    _, other = issue("localhost", authority=trustme.CA())
    async with listening(key, chain) as port:
        assert "is not trusted: unable to get local issuer certificate" in await problem(port, other)
    assert await problem(reserve_ports(["sim"])["sim"].rest, chain) == ""


async def test_a_certificate_of_other_names_is_told_with_these_names(issue: Any) -> None:
    key, chain = issue("robots.example", "10.0.0.7")
    async with listening(key, chain) as port:
        said = await problem(port, chain)
        assert said.startswith("Its certificate is for robots.example, 10.0.0.7; it is called at 127.0.0.1.")
        assert await problem(port, chain, called="robots.example") == ""


async def test_a_service_without_tls_is_told(issue: Any) -> None:
    _, chain = issue("127.0.0.1")
    async with await asyncio.start_server(
        lambda _, writer: writer.write(b"HTTP/1.1 400\r\n\r\n"), "127.0.0.1", 0
    ) as server:
        assert "Does it speak TLS?" in await problem(server.sockets[0].getsockname()[1], chain)


async def test_the_doctor_names_what_is_wrong_with_a_certificate(
    issue: Any, monkeypatch: pytest.MonkeyPatch, reserve_ports: Any
) -> None:
    key, chain = issue("robots.example")
    monkeypatch.setattr(services, "_TIMEOUT_S", 60.0)
    monkeypatch.setenv("FREEREIN_TLS_CERT", str(chain))
    async with listening(key, chain) as port:
        monkeypatch.setenv("FREEREIN_HTTP_PORT", str(port))
        monkeypatch.setenv("FREEREIN_GRPC_PORT", str(reserve_ports(["sim"])["sim"].grpc))
        (check,) = services.checks(["sim"])
        found = await asyncio.to_thread(check)
    assert (found.state, "robots.example" in found.detail) == ("problem", True)


_READY = """
import http.server, os, ssl
class Answer(http.server.BaseHTTPRequestHandler):
    def do_GET(self):
        self.send_response(200)
        self.end_headers()
    def log_message(self, *_):
        pass
context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
context.load_cert_chain(os.environ["SERVED"], os.environ["FREEREIN_TLS_KEY"])
server = http.server.ThreadingHTTPServer(("127.0.0.1", int(os.environ["FREEREIN_HTTP_PORT"])), Answer)
server.socket = context.wrap_socket(server.socket, server_side=True)
server.serve_forever()
"""


@pytest.mark.parametrize(
    ("names", "is_trusted", "reason"),
    [
        (("127.0.0.1",), True, ""),
        (("robots.example",), True, "Its certificate is for robots.example; it is called at 127.0.0.1."),
        (("127.0.0.1",), False, "Its certificate is not trusted"),
    ],
)
async def test_up_is_ready_with_a_leaf_of_an_authority_and_says_why_it_is_not(
    issue: Any, tmp_path: Path, reserve_ports: Any, names: tuple[str, ...], is_trusted: bool, reason: str
) -> None:
    (tmp_path / "tiny.py").write_text(_READY)
    key, chain = issue(*names)
    _, other = issue("localhost", authority=trustme.CA())
    environ = {
        "PATH": "",
        "PYTHONPATH": ":".join([str(tmp_path), *sys.path]),
        "SERVED": str(chain),
        "FREEREIN_TLS_CERT": str(chain if is_trusted else other),
        "FREEREIN_TLS_KEY": str(key),
    }
    stack = Stack({"sim": "tiny"}, data_dir=tmp_path, environ=environ, ports=reserve_ports(["sim"]))
    async with stack, contextlib.aclosing(stack.watch()) as changes:
        async for (status,) in changes:
            if status.state == "ready" or status.reason.startswith(reason or "never"):
                break
    assert (status.state, status.reason[: len(reason)]) == ("not ready" if reason else "ready", reason)


async def test_a_client_with_tls_of_a_service_without_is_told(issue: Any) -> None:
    server = aio.server()
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    _, chain = issue("127.0.0.1")
    async with SimClient(Channel(f"127.0.0.1:{port}", root_certificates=chain.read_bytes())) as client:
        with pytest.raises(Unavailable) as raised:
            await client.list_tasks(ListTasksRequest(), timeout_s=60.0)
    assert "does not speak TLS" in raised.value.hint
    await server.stop(None)


async def test_a_client_of_a_wrong_name_is_told_who_names_the_right_ones(issue: Any) -> None:
    for names, error in ((("robots.example",), Unavailable), (("127.0.0.1",), Unimplemented)):
        key, chain = issue(*names)
        server = aio.server()
        credentials = grpc.ssl_server_credentials([(key.read_bytes(), chain.read_bytes())])
        port = server.add_secure_port("127.0.0.1:0", credentials)
        await server.start()
        async with SimClient(Channel(f"127.0.0.1:{port}", root_certificates=chain.read_bytes())) as client:
            with pytest.raises(error) as raised:
                await client.list_tasks(ListTasksRequest(), timeout_s=60.0)
        assert ("`freerein doctor`" in raised.value.hint) == (error is Unavailable)
        await server.stop(None)
