"""Checks of the noun phrases that a reward model is fitted to."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput
from freerein.goal_text import MAX_UNKNOWN_CHARACTERS, bare_words, rival_captions, words
from freerein_reward.methods.shared.frames import resized
from freerein_reward.model import KNOWN, PhraseLocator

MAX_PHRASES = 16
"""Captions grow with the square, and the memory of embeddings of all pairs with the fourth power."""

_SAMPLE = 256
"""Images that are searched for a phrase."""


def check_phrases(phrases: Sequence[str], grounding: PhraseLocator, *, least: int) -> None:
    """Raises InvalidInput unless phrases are distinct, of a bearable number, and known to the grounding model.

    Captions would name something else for a phrase that the grounding model does not know.
    """
    distinct = {bare_words(words(phrase)) for phrase in phrases} - {()}
    if not least <= len(phrases) == len(distinct) <= MAX_PHRASES or any(map(rival_captions, phrases)):
        raise InvalidInput(
            f"`phrases` must be {least} to {MAX_PHRASES} distinct noun phrases without relations such as `on`; "
            f"got {len(phrases)}.",
            field="config.phrases",
            hint="Name every object of the goal texts, "
            'for example: --set \'phrases=["a red block", "a yellow block"]\'.',
        )
    known = zip(phrases, grounding.known(phrases), strict=True)
    unknown = [phrase[:MAX_UNKNOWN_CHARACTERS] for phrase, score in known if score < KNOWN]
    if unknown:
        raise InvalidInput(
            f"`phrases` must name what the grounding model knows; it does not know {', '.join(unknown)}.",
            field="config.phrases",
            hint=f"Name each object by a colour and a noun, such as `a {grounding.names[0]} thing`; it knows "
            f"{', '.join(grounding.names)}."
            if grounding.names
            else "Train another grounding model.",
        )


def check_shown(frames: npt.NDArray[np.uint8], phrases: Sequence[str], grounding: PhraseLocator) -> None:
    """Raises InvalidInput where no image shows a phrase: captions would say of other objects that they are it.

    Here, unlike in captioning, phrases compete with all names that the grounding model knows. `frames` are uint8
    (N, H, W, C), of which a sample is searched.
    """
    sample = np.linspace(0, len(frames) - 1, min(len(frames), _SAMPLE)).round().astype(np.int64)
    presence = grounding.locate(resized(frames[sample], grounding.image_size), phrases).presence.max(axis=0)  # (P,)
    missing = [phrase for phrase, most in zip(phrases, presence.tolist(), strict=True) if most < 0.5]
    if missing:
        raise InvalidInput(
            f"Images must show every phrase; of {len(sample)}, none shows {', '.join(missing)}.",
            field="config.phrases",
            hint=f"Name objects by the colours that the images show; `Ground` tells {', '.join(grounding.names)}.",
        )
