"""Segments as WebVTT, the subtitles of web players: each skill is shown while it lasts."""

from collections.abc import Iterable

_ESCAPES = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;"})


def webvtt(cues: Iterable[tuple[float, float, str]]) -> str:
    """Returns skills as the text of a `.vtt` file, given when each starts and ends, in seconds."""
    texts = (f"{_time(start)} --> {_time(end)}\n{skill.translate(_ESCAPES)}\n" for start, end, skill in cues)
    return "\n".join(["WEBVTT\n", *texts])


def _time(seconds: float) -> str:
    """Returns a time as hours:minutes:seconds.milliseconds."""
    ms = round(seconds * 1000)
    return f"{ms // 3_600_000:02}:{ms // 60_000 % 60:02}:{ms // 1000 % 60:02}.{ms % 1000:03}"
