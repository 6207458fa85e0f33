"""Options and errors that the commands which make a grounding model share."""

import argparse
import json
import re

from freerein.errors import must_be, quoted


def device(text: str) -> str:
    """Returns the name of a device, as an option's type of `argparse`."""
    if not re.fullmatch(r"auto|cpu|cuda(:\d+)?", text):
        raise argparse.ArgumentTypeError(f"must be auto, cpu or cuda:N; got {quoted(text)}")
    return text


def setting(text: str) -> tuple[str, object]:
    """Returns the key and value of KEY=VALUE, the value in JSON; raises InvalidInput for another text."""
    key, _, value = text.partition("=")
    try:
        return key, json.loads(value)
    except ValueError:
        hint = "Write seed=1."
        raise must_be("A setting", "KEY=VALUE, the value in JSON", quoted(text), field="settings", hint=hint) from None


def file_problem(error: OSError) -> str:
    """Returns what a person can do about a file or folder that cannot be read or written."""
    where = "a file" if error.filename is None else error.filename
    return (
        f"All files and folders must be readable, and writable where something is made; {where} is not: "
        f"{error.strerror}. Correct the path or its permissions, or make room."
    )
