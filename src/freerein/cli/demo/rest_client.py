"""A REST client that prints the first call to each path as a curl command."""

import base64
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import httpx
import numpy as np
import numpy.typing as npt

from freerein import tensors
from freerein.cli.demo.report import Reporter
from freerein.cli.services import trust
from freerein.cli.settings import CliSettings
from freerein.errors import Internal, Unavailable, by_code

_TIMEOUT_S = 60.0


class RestClient:
    """REST client of one service.

    Args:
        url: URL of the service.
        settings: Token and certificate of the service.
        requests: Folder for large request bodies, so that a printed command can be repeated.
        reporter: Prints the calls.
    """

    def __init__(self, url: str, settings: CliSettings, *, requests: Path, reporter: Reporter) -> None:
        self._url = url
        self._requests = requests
        self._reporter = reporter
        self._shown: set[str] = set()
        headers = {"authorization": f"Bearer {settings.token_text}"} if settings.token else {}
        verify = trust(str(settings.tls_cert) if settings.tls_cert else None)
        self._client = httpx.AsyncClient(
            base_url=url, headers=headers, timeout=_TIMEOUT_S, trust_env=False, verify=verify
        )

    async def __aenter__(self) -> Self:
        """Opens the connection."""
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Closes the connection."""
        await self._client.aclose()

    async def post(self, path: str, body: dict[str, Any]) -> dict[str, Any]:
        """Returns the JSON reply to a POST.

        Raises:
            ServiceError: The service answered with an error, or the connection was lost.
        """
        self._show(path, json.dumps(body))
        with self._connected():
            return _answer(await self._client.post(path, json=body))

    async def get(self, path: str, **query: str) -> dict[str, Any]:
        """Returns the JSON reply to a GET.

        Raises:
            ServiceError: The service answered with an error, or the connection was lost.
        """
        self._reporter.command(f'curl "{self._address(path, query)}"')
        with self._connected():
            return _answer(await self._client.get(path, params=query))

    async def segment(self, model: str, frames: npt.NDArray[np.uint8], actions: npt.NDArray[Any]) -> dict[str, Any]:
        """Returns the JSON labels of a trajectory, frames uint8 (T, H, W, C); raises as `post`."""
        body = {"model": {"name": model}, "frames": _tensor(frames), "actions": _tensor(actions), "smoothing": 1.0}
        text = json.dumps(body)
        if "/v1/segment" not in self._shown:
            self._requests.mkdir(exist_ok=True)
            path = self._requests / f"segment-{model}.json"
            path.write_text(text)
            self._show("/v1/segment", f"@{path}")
        headers = {"content-type": "application/json"}
        with self._connected():
            return _answer(await self._client.post("/v1/segment", content=text, headers=headers))

    @contextmanager
    def _connected(self) -> Iterator[None]:
        """Raises connection errors as `Unavailable`."""
        try:
            yield
        except httpx.HTTPError as error:
            raise Unavailable(
                f"{self._url} must answer; the connection failed: {error or type(error).__name__}.",
                hint="Read logs/<service>.log in the data directory, then run the demo again.",
            ) from error

    def _address(self, path: str, query: Mapping[str, str]) -> str:
        return f"{self._url}{path}?" + "&".join(f"{name}={value}" for name, value in query.items())

    def _show(self, path: str, body: str) -> None:
        if path not in self._shown:
            self._shown.add(path)
            self._reporter.command(f"curl {self._url}{path} --json '{body}'")


def _tensor(array: npt.NDArray[Any]) -> dict[str, Any]:
    datatype, shape, raw = tensors.encode(array)
    return {"datatype": datatype, "shape": shape, "raw": base64.b64encode(raw).decode("ascii")}


def _answer(response: httpx.Response) -> dict[str, Any]:
    try:
        answer: dict[str, Any] = response.json()
    except ValueError:
        raise Internal("The service must answer with JSON; got something else.", hint="Read its log.") from None
    if response.is_error:
        raise by_code(answer["code"])(answer["detail"], field=answer["field"], hint=answer["hint"])
    return answer
