"""What texts may be sent."""

from collections.abc import Sequence

from freerein.errors import InvalidInput

MAX_CHARACTERS = 2_000
MAX_RIVALS = 64


def check_goal_text(text: str) -> None:
    """Does nothing for a text that can be a goal.

    Raises:
        InvalidInput: It is empty, white, or too long.
    """
    _check(text, "goal_text", "Say what is to be seen, such as: a red block on top of a yellow block.")


def check_rivals(rivals: Sequence[str], goal_text: str) -> None:
    """Does nothing for texts that a goal text can beat.

    Raises:
        InvalidInput: They are too many, one is empty, white or too long, or one is the goal text.
    """
    if len(rivals) > MAX_RIVALS:
        raise InvalidInput(
            f"`rivals` may hold at most {MAX_RIVALS} texts; got {len(rivals)}.",
            field="rivals",
            hint="Name what the goal could be mistaken for, and no more.",
        )
    for place, rival in enumerate(rivals):
        _check(rival, f"rivals.{place}", "Leave it out, or say what else could be seen.")
        if rival == goal_text:
            raise InvalidInput(
                f"`rivals` must be other texts than the goal text; rival {place} is the same.",
                field=f"rivals.{place}",
                hint="Leave it out: nothing beats itself.",
            )


def check_phrases(phrases: Sequence[str], *, least: int, most: int) -> None:
    """Does nothing for noun phrases that can be told from one another.

    Raises:
        InvalidInput: They are too few or too many, one is empty, white or too long, or one is repeated.
    """
    if not least <= len(phrases) <= most:
        raise InvalidInput(
            f"`phrases` must hold {least} to {most} noun phrases; got {len(phrases)}.",
            field="phrases",
            hint="Send one for each thing, such as: a red block.",
        )
    for place, phrase in enumerate(phrases):
        _check(phrase, f"phrases.{place}", "Name a thing, such as: a red block.")
        if phrase in phrases[:place]:
            raise InvalidInput(
                f"`phrases` must differ, each being told from the others; phrase {place} is repeated.",
                field=f"phrases.{place}",
                hint="Send each phrase once.",
            )


def _check(text: str, field: str, hint: str) -> None:
    if not 0 < len(text) <= MAX_CHARACTERS:
        raise InvalidInput(
            f"`{field}` must have 1 to {MAX_CHARACTERS} characters; got {len(text)}.", field=field, hint=hint
        )
    if text.isspace():
        raise InvalidInput(f"`{field}` must hold words; got white space alone.", field=field, hint=hint)
