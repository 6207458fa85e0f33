"""Segments as WebVTT, the subtitles of web players: each skill is shown while it lasts."""

from freerein.cli.segments.timeline import Timeline

_ESCAPES = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;"})


def webvtt(timeline: Timeline) -> str:
    """Returns the segments as the text of a `.vtt` file."""
    cues = [
        f"{_time(timeline.time_s[segment.start])} --> {_time(timeline.time_s[segment.end])}\n"
        f"{segment.skill.translate(_ESCAPES)}\n"
        for segment in timeline.answer.segments
    ]
    return "\n".join(["WEBVTT\n", *cues])


def _time(seconds: float) -> str:
    """Returns a time as hours:minutes:seconds.milliseconds."""
    ms = round(seconds * 1000)
    return f"{ms // 3_600_000:02}:{ms // 60_000 % 60:02}:{ms // 1000 % 60:02}.{ms % 1000:03}"
