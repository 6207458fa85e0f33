"""`/session`: a browser gives the token once, and keeps a cookie that stands for it.

The cookie is an HMAC of the token. Nothing is stored: it is valid until the service has another token, and a script
cannot read it. A browser sends it along whatever page makes it call, so that calls with it are checked by
`OriginPolicy.check_session`.
"""

import hmac
from typing import Any

import orjson
from starlette.datastructures import Headers
from starlette.requests import ClientDisconnect, Request, cookie_parser
from starlette.responses import Response
from starlette.routing import Route

from freerein.errors import (
    Cancelled,
    InvalidInput,
    MalformedRequest,
    TooLarge,
    Unauthenticated,
    UnsupportedMedia,
    quoted,
)

PATH = "/session"
_COOKIE = "freerein_session"
_LABEL = b"freerein session"
_MOST_BYTES = 4096


class Session:
    """The session of a service with this token; without one there is nothing to sign in to."""

    def __init__(self, token: str) -> None:
        self._token = token.encode()
        self._value = hmac.digest(self._token, _LABEL, "sha256").hex() if token else ""
        self.route = Route(PATH, self._answer, methods=["GET", "POST", "DELETE"])

    def is_in(self, headers: Headers) -> bool:
        """Returns whether a request has the cookie; compared in constant time."""
        given = cookie_parser(headers.get("cookie", "")).get(_COOKIE, "")
        return bool(self._value) and hmac.compare_digest(given.encode(), self._value.encode())

    async def _answer(self, request: Request) -> Response:
        if request.method == "POST":
            return await self._sign_in(request)
        if request.method == "DELETE":
            response = Response(status_code=204)
            response.delete_cookie(_COOKIE, **_attributes(request))
            return response
        state = {"token_needed": bool(self._token), "signed_in": not self._token or self.is_in(request.headers)}
        return Response(orjson.dumps(state), media_type="application/json", headers={"cache-control": "no-store"})

    async def _sign_in(self, request: Request) -> Response:
        token = await _given_token(request)
        if self._token and not hmac.compare_digest(token.encode(), self._token):
            raise Unauthenticated(
                "The token must be that of the service; it is another one.",
                field="token",
                hint="Give the value of FREEREIN_TOKEN with which the service was started.",
            )
        response = Response(status_code=204)
        if self._token:
            response.set_cookie(_COOKIE, self._value, **_attributes(request))
        return response


async def _given_token(request: Request) -> str:
    """Returns the token in a JSON body; a form of another page could send no such body."""
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if media_type != "application/json":
        raise UnsupportedMedia(
            f"The body must be application/json; got {quoted(media_type)}.", hint='Send {"token": "..."}.'
        )
    try:
        document = orjson.loads(await _body(request))
    except orjson.JSONDecodeError as error:
        raise MalformedRequest(f"The body must be JSON; {error}.", hint='Send {"token": "..."}.') from None
    token = document.get("token") if isinstance(document, dict) else None
    if not isinstance(token, str) or set(document) != {"token"}:
        raise InvalidInput(
            f"The body must be an object with the text `token` alone; got {_described(document)}.",
            field="token",
            hint='Send {"token": "..."}.',
        )
    return token


async def _body(request: Request) -> bytes:
    """Returns the body; it is read before any token was checked, and so is small."""
    body = b""
    try:
        async for part in request.stream():
            body += part
            if len(body) > _MOST_BYTES:
                raise TooLarge(f"The body must have at most {_MOST_BYTES} bytes.", hint='Send {"token": "..."}.')
    except ClientDisconnect:
        raise Cancelled("The client disconnected before the body was complete.") from None
    return body


def _described(document: Any) -> str:
    return f"the keys {quoted(', '.join(document))}" if isinstance(document, dict) else type(document).__name__


def _attributes(request: Request) -> dict[str, Any]:
    return {"path": "/", "httponly": True, "samesite": "strict", "secure": request.url.scheme == "https"}
