/** Segments under a person's hands: they cover [0, timesteps) without gaps or overlaps, before and after every edit. */

export interface Segment {
  /** First timestep. */
  readonly start: number;
  /** One past the last timestep. */
  readonly end: number;
  /** Name of the skill; empty for none. */
  readonly skill: string;
}

export interface Edited {
  readonly segments: readonly Segment[];
  readonly past: readonly (readonly Segment[])[];
  readonly future: readonly (readonly Segment[])[];
}

const SKILL = /^[a-z0-9][a-z0-9._-]{0,63}$/;

/** Begins with segments in order; what lies between them has no skill. */
export function editing(segments: readonly Segment[], timesteps: number): Edited {
  const whole: Segment[] = [];
  let at = 0;
  for (const each of segments) {
    if (each.start > at) whole.push({ start: at, end: each.start, skill: "" });
    whole.push({ start: each.start, end: each.end, skill: each.skill });
    at = each.end;
  }
  if (at < timesteps) whole.push({ start: at, end: timesteps, skill: "" });
  return { segments: whole, past: [], future: [] };
}

/** Begins with other segments of what was edited: undo goes back to the edits. */
export function editingAgain(before: Edited, segments: readonly Segment[], timesteps: number): Edited {
  const begun = editing(segments, timesteps);
  const isSame = before.segments.at(-1)?.end === timesteps;
  return isSame ? { ...begun, past: [...before.past, before.segments] } : begun;
}

/** Returns the index of the segment that has a timestep. */
export function indexAt(segments: readonly Segment[], timestep: number): number {
  let low = 0;
  let high = segments.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (segments[middle]!.start <= timestep) low = middle;
    else high = middle - 1;
  }
  return low;
}

/** Moves the boundary before segment `index`, not beyond its neighbours: each keeps a timestep at least. */
export function moveBoundary(edited: Edited, index: number, to: number): Edited {
  const [left, right] = [edited.segments[index - 1], edited.segments[index]];
  if (!left || !right) return edited;
  const at = Math.min(Math.max(Math.round(to), left.start + 1), right.end - 1);
  if (at === right.start) return edited;
  return replaced(edited, index - 1, 2, [
    { ...left, end: at },
    { ...right, start: at },
  ]);
}

/** Cuts the segment that has a timestep before it. */
export function split(edited: Edited, timestep: number): Edited {
  const index = indexAt(edited.segments, timestep);
  const cut = edited.segments[index]!;
  if (cut.start >= timestep) return edited;
  return replaced(edited, index, 1, [
    { ...cut, end: timestep },
    { ...cut, start: timestep },
  ]);
}

/** Joins segment `index` to the one before it, whose skill it takes; the first joins the second. */
export function join(edited: Edited, index: number): Edited {
  const [kept, first] = index > 0 ? [index - 1, index - 1] : [1, 0];
  const skill = edited.segments[kept]?.skill;
  if (skill === undefined || !edited.segments[index]) return edited;
  const { start: from } = edited.segments[first]!;
  const { end } = edited.segments[first + 1]!;
  return replaced(edited, first, 2, [{ start: from, end, skill }]);
}

/** Gives segment `index` another skill. */
export function rename(edited: Edited, index: number, skill: string): Edited {
  const old = edited.segments[index];
  if (!old || old.skill === skill) return edited;
  return replaced(edited, index, 1, [{ ...old, skill }]);
}

/** Whether a name may be that of a skill. */
export function isSkillName(name: string): boolean {
  return SKILL.test(name);
}

export function undo(edited: Edited): Edited {
  const last = edited.past.at(-1);
  if (!last) return edited;
  return { segments: last, past: edited.past.slice(0, -1), future: [edited.segments, ...edited.future] };
}

export function redo(edited: Edited): Edited {
  const [next, ...future] = edited.future;
  return next ? { segments: next, past: [...edited.past, edited.segments], future } : edited;
}

/** Ends a drag of a boundary, of which `before` is the beginning: its many moves are undone as one. */
export function asOneEdit(before: Edited, after: Edited): Edited {
  if (after.segments === before.segments) return before;
  return { segments: after.segments, past: [...before.past, before.segments], future: [] };
}

function replaced(edited: Edited, at: number, count: number, by: readonly Segment[]): Edited {
  const segments = edited.segments.toSpliced(at, count, ...by);
  return { segments, past: [...edited.past, edited.segments], future: [] };
}
