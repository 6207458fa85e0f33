"""Bearer token authentication, for REST and gRPC."""

import hmac

from freerein.errors import Unauthenticated

_SCHEME = "bearer "


def check(authorization: str, token: str) -> None:
    """Checks the bearer token of a call in constant time.

    Args:
        authorization: Value of the `Authorization` header, empty when absent.
        token: Expected token; empty when the service needs none.

    Raises:
        Unauthenticated: The token is missing or wrong.
    """
    given = authorization[len(_SCHEME) :] if authorization[: len(_SCHEME)].lower() == _SCHEME else ""
    if token and not hmac.compare_digest(given.encode(), token.encode()):
        raise Unauthenticated(
            "The call must carry the service's bearer token; it carries none, or another one.",
            hint="Send the header Authorization: Bearer <the service's FREEREIN_TOKEN>.",
        )
