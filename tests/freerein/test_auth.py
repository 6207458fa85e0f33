"""The bearer token."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from freerein.errors import Unauthenticated
from freerein.serving import auth

TOKEN = "correct horse"


@pytest.mark.parametrize("header", ["Bearer correct horse", "bearer correct horse", "BEARER correct horse"])
def test_the_token_opens(header: str) -> None:
    auth.check(header, TOKEN)


@given(st.text())
def test_where_no_token_is_asked_for_anything_opens(header: str) -> None:
    auth.check(header, "")


@pytest.mark.parametrize(
    "header",
    [
        "",
        "Bearer",
        "Bearer ",
        "Bearer wrong",
        "Bearer correct horse ",
        "Bearer  correct horse",
        "Basic correct horse",
        TOKEN,
    ],
)
def test_anything_else_does_not_and_the_error_tells_nothing(header: str) -> None:
    with pytest.raises(Unauthenticated) as error:
        auth.check(header, TOKEN)
    assert "horse" not in error.value.detail + error.value.hint
    assert "FREEREIN_TOKEN" in error.value.hint


@given(st.text())
def test_no_header_but_the_right_one_opens(header: str) -> None:
    if header[:7].lower() != "bearer " or header[7:] != TOKEN:
        with pytest.raises(Unauthenticated):
            auth.check(header, TOKEN)
