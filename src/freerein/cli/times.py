"""Times and durations in words."""

_UNITS = ((86_400, "day"), (3600, "h"), (60, "min"), (1, "s"))


def duration(seconds: float) -> str:
    """Returns a duration in its two largest units, such as `1 h 50 min`."""
    left, parts = max(0, int(seconds)), list[str]()
    for size, unit in _UNITS:
        if left >= size or (unit == "s" and not parts):
            parts.append(_counted(left // size, unit))
        left %= size
    return " ".join(parts[:2])


def ago(time_ns: int, *, now_ns: int) -> str:
    """Returns how long ago a Unix time in nanoseconds was, such as `3 min ago`; empty for 0, an unknown time."""
    seconds = max(0, now_ns - time_ns) // 10**9
    size, unit = next((each for each in _UNITS if seconds >= each[0]), _UNITS[-1])
    return f"{_counted(seconds // size, unit)} ago" if time_ns else ""


def _counted(count: int, unit: str) -> str:
    return f"{count} {unit}{'s' if unit == 'day' and count > 1 else ''}"
