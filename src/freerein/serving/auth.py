"""Bearer token authentication, for REST and gRPC."""

import hmac

from freerein.errors import Unauthenticated

_SCHEMES = ("bearer", "api-key")  # the second is that of openpi's client


def check(authorization: str, token: str) -> None:
    """Checks the `Authorization` header of a call in constant time; an empty `token` allows every call.

    Raises Unauthenticated when the token is missing or wrong.
    """
    scheme, _, credentials = authorization.partition(" ")
    given = credentials if scheme.lower() in _SCHEMES else ""
    if token and not hmac.compare_digest(given.encode(), token.encode()):
        raise Unauthenticated(
            "The call must carry the service's bearer token; it carries none, or another one.",
            hint="Send the header Authorization: Bearer <the service's FREEREIN_TOKEN>.",
        )
