"""The bearer token: one for all, compared in constant time, checked by every door but the health checks."""

import hmac

from freerein.errors import Unauthenticated

_SCHEME = "bearer "


def check(authorization: str, token: str) -> None:
    """Lets a call through whose `Authorization` header carries the token.

    Args:
        authorization: The header's value, empty when absent.
        token: What is expected; empty when the service asks for none.

    Raises:
        Unauthenticated: It does not.
    """
    given = authorization[len(_SCHEME) :] if authorization[: len(_SCHEME)].lower() == _SCHEME else ""
    if token and not hmac.compare_digest(given.encode(), token.encode()):
        raise Unauthenticated(
            "A bearer token is expected; got none, or another one.",
            hint="Send the header Authorization: Bearer <the service's FREEREIN_TOKEN>.",
        )
