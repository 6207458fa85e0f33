"""What a card says about supervision: the dataset's, and that of the policies that acted in it."""

from collections.abc import Mapping, Sequence
from typing import Any


def supervision_of(own: str, teacher_cards: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Returns the card's entries on supervision: `own`, and that of the policies that acted, if any."""
    if teacher_cards:
        theirs = sorted({str(card.get("supervision") or "unknown") for card in teacher_cards})
        own += f" of policies with this supervision: {'; or: '.join(theirs)}"
    return {"supervision": own, "privileged": any(card.get("privileged") is True for card in teacher_cards)}
