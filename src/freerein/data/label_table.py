"""True labels as people have them: segments in timesteps or seconds, a label for each timestep, exports of ELAN.

    trajectory,start,end,skill        reach 0.0 1.2        Tier   Begin Time - ss.msec   End Time - ss.msec   Annotation
    0,0,41,reach                      pour 1.5 4.0         main   0.0                    1.2                  reach

Columns are recognised by their names, or without names by the contents of the first line.
"""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

from freerein.data.annotation_table import Line, line, rows
from freerein.errors import InvalidInput, must_be, quoted

TimeUnit: TypeAlias = Literal["timesteps", "seconds", "milliseconds"]

_ROLES = {
    **dict.fromkeys(("trajectory", "trajectory index", "episode", "episode index"), "trajectory"),
    **dict.fromkeys(("timestep", "frame", "frame index", "step", "t", "time", "timestamp"), "timestep"),
    **dict.fromkeys(("skill", "label", "annotation", "annotation value", "subtask", "class"), "skill"),
    **dict.fromkeys(("tier", "tier name"), "tier"),
}
_TIME_NAME = re.compile(
    r"(start|begin|onset|end|stop|offset)(?: (?:time|frame|timestep))?(?:[ (\[-]*([a-z:.]+)[)\]]?)?"
)
_TIME_ROLES = {**dict.fromkeys(("start", "begin", "onset"), "start"), **dict.fromkeys(("end", "stop", "offset"), "end")}
_UNITS: dict[str, TimeUnit] = {
    **dict.fromkeys(("s", "sec", "seconds", "ss.msec", "hh:mm:ss.ms"), "seconds"),
    **dict.fromkeys(("ms", "msec", "milliseconds"), "milliseconds"),
    **dict.fromkeys(("frame", "frames", "timestep", "timesteps"), "timesteps"),
}
_NEEDED = ({"start", "end"}, {"timestep", "skill"}, {"trajectory", "skill"})
_OTHERS = re.compile(r"duration.*|participant|annotator|file.*|path|.*id")
_CLOCK = re.compile(r"(?:(\d{1,3}):)?(\d{1,3}):(\d{1,2}(?:\.\d{1,9})?)")
_NUMBER = re.compile(r"\d{1,15}(?:\.\d{0,40})?(?:[eE][-+]?\d{1,2})?")
_ROUNDING_S, _ROUNDING_STEPS = 1e-3, 0.25
"""How much a time may be late that is meant to be a timestep's: files have milliseconds."""

_QUOTES_HINT = "Put text that holds a separator into quotes."
_HINT = "For example: trajectory,start,end,skill; or trajectory,timestep,skill with a line for each timestep."


@dataclass(frozen=True)
class LabelOptions:
    """Options for reading a table of labels.

    Attributes:
        trajectory: Index of the trajectory that a table without a column of it is about.
        unit: Of times; None for that of the columns' names, else seconds where a time has a point, else timesteps.
        tier: Which of several tiers of ELAN's is read.
    """

    trajectory: int | None = None
    unit: TimeUnit | None = None
    tier: str = ""


@dataclass(frozen=True)
class Segment:
    """A skill, as it is written, of the timesteps from `start` to before `end` of a trajectory; and its line.

    `columns` are the names of the columns that hold its start and its skill.
    """

    line: Line
    columns: tuple[str, str]
    trajectory: int
    start: int
    end: int
    skill: str


def read_segments(
    table: bytes,
    lengths: Sequence[int],
    *,
    fps: int,
    options: LabelOptions,
    on_note: Callable[[str], None],
) -> list[Segment]:
    """Returns the segments of a table in its order; lines without a skill are left out.

    Args:
        table: In UTF-8, separated by commas, tabs or spaces.
        lengths: Timesteps of each trajectory.
        fps: Timesteps per second.
        options: How to read it.
        on_note: Called with a sentence where the unit of times was inferred from the numbers.

    Raises InvalidInput, with line and column, where it is no such table, or a segment does not lie in its trajectory.
    """
    found = [(number, cells) for number, cells in rows(table, _delimiter(table)) if not cells[0].startswith("#")]
    if not found:
        raise InvalidInput("Line 1 must name the columns; the table is empty.", field="header", hint=_HINT)
    columns, roles, unit, body = _by_names(found) or _by_contents(found)
    lines = [line(number, cells, columns, hint=_QUOTES_HINT) for number, cells in body]
    lines = _of_tier(lines, columns, roles, options.tier)
    if "trajectory" not in roles and options.trajectory is None:
        raise InvalidInput(
            f"Line 1 must name a column `trajectory`; got {', '.join(map(quoted, columns))}.",
            field="header",
            hint="Or say which one the table is about: --trajectory 0.",
        )
    reader = _Reader(roles, options.unit or unit or _unit_of_numbers(lines, roles, on_note), fps, lengths, options)
    segments = [reader.segment(each, place) for place, each in enumerate(lines)]
    return [each for each in segments if each.skill]


@dataclass(frozen=True)
class _Reader:
    """Reads lines: `roles` are columns by what they hold."""

    roles: dict[str, str]
    unit: TimeUnit
    fps: int
    lengths: Sequence[int]
    options: LabelOptions

    def segment(self, line: Line, place: int) -> Segment:
        """Returns the segment of a line, the `place`-th of the table."""
        trajectory = self._trajectory(line)
        length = self.lengths[trajectory]
        skill = self.roles["skill"]
        first = self.roles.get("start") or self.roles.get("timestep") or skill
        if first != skill:
            start = self._timestep(line, first, least=0, most=length - 1)
        elif place < length:
            start = place
        else:
            raise line.error(first, f"be one of {length}, one for each timestep; it is another", _HINT)
        end = start + 1
        if "start" in self.roles:
            end = self._timestep(line, self.roles["end"], least=end, most=length)
        return Segment(line, (first, skill), trajectory, start, end, line.cells[skill].strip())

    def _trajectory(self, line: Line) -> int:
        if "trajectory" in self.roles:
            return line.integer(self.roles["trajectory"], least=0, most=len(self.lengths) - 1)
        index = self.options.trajectory or 0
        if not 0 <= index < len(self.lengths):
            hint = "`freerein dataset inspect` shows how many there are."
            raise must_be("The trajectory", f"in [0, {len(self.lengths) - 1}]", index, field="trajectory", hint=hint)
        return index

    def _timestep(self, line: Line, column: str, *, least: int, most: int) -> int:
        """Returns the first timestep at or after a time."""
        text = line.cells[column].strip()
        if self.unit == "timesteps" and ":" not in text:
            whole = _seconds(text)
            is_step = whole.is_integer() and least <= whole <= most
            return int(whole) if is_step else line.integer(column, least=least, most=most)
        scale = 1000 if self.unit == "milliseconds" and ":" not in text else 1
        time_s = _seconds(text) / scale
        rounding = min(_ROUNDING_S * self.fps * (1 + 1e-6), _ROUNDING_STEPS)
        step = max(0, math.ceil(time_s * self.fps - rounding)) if math.isfinite(time_s) else -1
        if step == most + 1 and column == self.roles.get("end"):
            return most  # a video may last a little longer than its last frame
        if not least <= step <= most:
            raise line.error(
                column,
                f"be a time in [{least / self.fps:g}, {most / self.fps:g}] seconds, at {self.fps} timesteps per "
                f"second; got {quoted(text)}",
                "Times are counted from the first frame; say their unit with --unit where it was taken wrongly.",
            )
        return step


def _delimiter(table: bytes) -> str:
    lines = (each for each in table.splitlines() if each.strip() and each[:1] != b"#" and each[:2] != b'"#')
    first = next(lines, b"")
    return next((each for each in "\t,;" if each.encode() in first), " ")


_Table: TypeAlias = tuple[list[str], dict[str, str], TimeUnit | None, list[tuple[int, list[str]]]]
"""Names of the columns, those of each role, the unit of times where it is known, and the lines."""


def _by_names(found: list[tuple[int, list[str]]]) -> _Table | None:
    """Returns a table whose first line names its columns; None where it does not."""
    columns = [cell.strip() for cell in found[0][1]]
    roles, units = dict[str, str](), dict[str, TimeUnit | None]()
    for column in columns:
        key = _key(column)
        time = _TIME_NAME.fullmatch(key)
        role = _TIME_ROLES[time[1]] if time and (time[2] is None or time[2] in _UNITS) else _ROLES.get(key)
        unit = _UNITS.get(time[2] or key.rpartition(" ")[2]) if time else None  # such as `start frame`
        if role and (role not in roles or (unit == "seconds" and units[role] != "seconds")):
            roles[role], units[role] = column, unit
    is_named = any(needed <= set(roles) for needed in _NEEDED) or (len(columns) == 1 and "skill" in roles)
    if not is_named or len(set(columns)) != len(columns):
        return None
    return columns, roles, units.get("start"), found[1:]


def _by_contents(found: list[tuple[int, list[str]]]) -> _Table:
    """Returns a table without known names: times in the order of ELAN, and texts, of which the last is the skill."""
    if len(found) > 1 and not _has_time(found[0][1]) and _has_time(found[1][1]):
        found = found[1:]  # names in another language
    number, cells = found[0]
    columns = [str(place) for place in range(1, len(cells) + 1)]
    times = [column for column, cell in zip(columns, cells, strict=True) if math.isfinite(_seconds(cell.strip()))]
    texts = [column for column, cell in zip(columns, cells, strict=True) if cell.strip() and column not in times]
    formats = _formats([_seconds(cells[int(column) - 1].strip()) for column in times])
    if not texts or formats is None:
        got = ", ".join(map(quoted, cells))
        raise InvalidInput(f"Line {number} must name the columns; got {got}.", field="header", hint=_HINT)
    roles = {"skill": texts[-1]} | ({"tier": texts[0]} if len(texts) > 1 else {})
    if len(times) == 1:
        roles["timestep"] = times[0]
    elif times:
        roles |= {"start": times[0], "end": times[formats]}
    return columns, roles, None, found


def _has_time(cells: Sequence[str]) -> bool:
    return any(math.isfinite(_seconds(cell.strip())) for cell in cells)


def _formats(times: Sequence[float]) -> int | None:
    """Returns in how many formats each time is written, given those of a line: starts, ends, and durations or not."""
    if len(times) < 2:
        return 1
    third = len(times) // 3
    if len(times) % 3 == 0 and abs(times[0] + times[2 * third] - times[third]) < 2e-3 * max(1.0, times[third]):
        return third
    return len(times) // 2 if len(times) % 2 == 0 else None


def _of_tier(lines: list[Line], columns: list[str], roles: dict[str, str], asked: str) -> list[Line]:
    """Returns the lines of the tier asked for, or of the only one; it may be a column of its own, as ELAN has them."""
    if "skill" not in roles:
        unknown = [each for each in columns if each not in roles.values()]
        others = [each for each in unknown if not (_TIME_NAME.fullmatch(_key(each)) or _OTHERS.fullmatch(_key(each)))]
        roles["skill"] = _one_tier(others, asked)
        return lines
    if "tier" not in roles:
        return lines
    tier = _one_tier(list(dict.fromkeys(each.cells[roles["tier"]].strip() for each in lines)), asked)
    return [each for each in lines if each.cells[roles["tier"]].strip() == tier]


def _key(column: str) -> str:
    return " ".join(column.casefold().replace("_", " ").split())


def _one_tier(tiers: Sequence[str], asked: str) -> str:
    if asked in tiers or (not asked and len(tiers) == 1):
        return asked or tiers[0]
    found = f"there are {len(tiers)}: {', '.join(tiers[:10])}" if tiers else "there is none"
    raise InvalidInput(
        f"The labels must be those of one tier, or of a column `skill`; {found}.",
        field="tier",
        hint="Name one of them: --tier NAME.",
    )


def _unit_of_numbers(lines: Sequence[Line], roles: dict[str, str], on_note: Callable[[str], None]) -> TimeUnit:
    times = [roles[role] for role in ("start", "end", "timestep") if role in roles]
    if not any(mark in each.cells[column] for each in lines for column in times for mark in ".:"):
        return "timesteps"
    on_note("Times were taken as seconds, because some have a point or a colon; --unit says otherwise.")
    return "seconds"


def _seconds(text: str) -> float:
    """Returns a time such as `1.2` or `00:00:01.200`; NaN for another text."""
    clock = _CLOCK.fullmatch(text)
    if clock:
        return int(clock[1] or 0) * 3600 + int(clock[2]) * 60 + float(clock[3])
    return float(text) if text.isascii() and _NUMBER.fullmatch(text) else math.nan
