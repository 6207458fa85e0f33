/** A recording under a person's hands: where they are in time, what they edited, whether it plays. */
import { computed, effect, signal, type ReadonlySignal, type Signal } from "@preact/signals";
import { say } from "../../parts/say";
import { amend, query } from "../../url/location";
import * as edit from "./edit";
import { timeOf, timestepAt, type Recording } from "./recording";

/** Recordings with edits that are not saved, by title: they are kept until the page is closed. */
const unsaved = new Map<string, { readonly recording: Recording; readonly edited: edit.Edited }>();

/** Returns a recording as it was when its unsaved edits were left; without any, itself. */
export function withEdits(recording: Recording): Recording {
  return unsaved.get(recording.title)?.recording ?? recording;
}

export class Editor {
  readonly edited: Signal<edit.Edited>;
  readonly timestep: Signal<number>;
  readonly isPlaying = signal(false);
  /** What is saved as labels of the dataset; null before it is. */
  readonly saved = signal<readonly edit.Segment[] | null>(null);
  /** Index of the segment that has the timestep. */
  readonly current: ReadonlySignal<number>;
  private dragged: edit.Edited | null = null;
  private readonly stopPlayer: () => void;

  constructor(readonly recording: Recording) {
    this.edited = signal(begin(recording));
    this.timestep = signal(timestepAt(recording, Number(query.peek().t ?? 0)));
    this.current = computed(() => edit.indexAt(this.segments, this.timestep.value));
    this.stopPlayer = effect(() => (this.isPlaying.value ? this.play() : undefined));
  }

  close(): void {
    this.stopPlayer();
    if (this.isChanged && !this.isSaved)
      unsaved.set(this.recording.title, { recording: this.recording, edited: this.edited.peek() });
    else unsaved.delete(this.recording.title);
  }

  get segments(): readonly edit.Segment[] {
    return this.edited.value.segments;
  }

  get isChanged(): boolean {
    return this.edited.value.past.length > 0;
  }

  get isSaved(): boolean {
    return this.saved.value === this.segments;
  }

  goTo(timestep: number): void {
    const at = Math.min(Math.max(Math.round(timestep), 0), this.recording.timesteps - 1);
    if (at === this.timestep.peek()) return;
    this.timestep.value = at;
    amend({ t: at === 0 ? "" : String(Math.round(timeOf(this.recording, at) * 1000) / 1000) });
  }

  /** Goes to where the next segment begins, or the one before. */
  goToBoundary(direction: 1 | -1): void {
    const begins = this.segments.map((each) => each.start);
    const here = this.timestep.peek();
    const to = direction > 0 ? begins.find((each) => each > here) : begins.findLast((each) => each < here);
    this.goTo(to ?? (direction > 0 ? this.recording.timesteps - 1 : 0));
    say(this.describe());
  }

  /** Moves the boundary that is nearest to the timestep, and the timestep with it. */
  nudge(by: number): void {
    const index = this.nearestBoundary(this.timestep.peek());
    if (index === 0) return;
    this.change(edit.moveBoundary(this.edited.peek(), index, this.segments[index]!.start + by));
    this.goTo(this.segments[index]!.start);
    say(`Boundary at ${this.segments[index]!.start}`);
  }

  /** Returns the index of the segment that begins nearest to a timestep; 0 where there is one segment only. */
  nearestBoundary(timestep: number): number {
    const distance = (index: number): number => Math.abs(this.segments[index]!.start - timestep);
    const at = edit.indexAt(this.segments, timestep);
    const near = [at, at + 1].filter((index) => index > 0 && index < this.segments.length);
    return near.length === 0 ? 0 : near.reduce((best, index) => (distance(index) < distance(best) ? index : best));
  }

  drag(index: number, to: number): void {
    this.dragged ??= this.edited.peek();
    this.edited.value = edit.moveBoundary(this.edited.peek(), index, to);
    this.goTo(this.segments[index]!.start);
  }

  drop(): void {
    if (this.dragged) this.edited.value = edit.asOneEdit(this.dragged, this.edited.peek());
    this.dragged = null;
  }

  change(edited: edit.Edited): void {
    this.edited.value = edited;
  }

  split(): void {
    this.change(edit.split(this.edited.peek(), this.timestep.peek()));
    say(`${this.segments.length} segments`);
  }

  join(index: number): void {
    this.change(edit.join(this.edited.peek(), index));
    say(`${this.segments.length} segments`);
  }

  undo(): void {
    this.change(edit.undo(this.edited.peek()));
    say("Undone");
  }

  redo(): void {
    this.change(edit.redo(this.edited.peek()));
    say("Done again");
  }

  /** What is at the timestep, in words. */
  describe(): string {
    const segment = this.segments[this.current.value]!;
    const confidence = this.recording.confidence[this.timestep.value];
    const sure = confidence === undefined ? "" : `, confidence ${confidence.toFixed(2)}`;
    const seconds = timeOf(this.recording, this.timestep.value).toFixed(2);
    return `${seconds} s, timestep ${this.timestep.value}, ${segment.skill || "no skill"}${sure}`;
  }

  private play(): () => void {
    const { time_s, timesteps } = this.recording;
    const [begins_s, ends_s] = [time_s[0]!, time_s[timesteps]!];
    const timer = window.setInterval(
      () => {
        if (this.timestep.peek() >= this.recording.timesteps - 1) this.isPlaying.value = false;
        else this.goTo(this.timestep.peek() + 1);
      },
      (1000 * (ends_s - begins_s)) / timesteps,
    );
    return () => window.clearInterval(timer);
  }

  togglePlaying(): void {
    if (!this.isPlaying.peek() && this.timestep.peek() >= this.recording.timesteps - 1) this.goTo(0);
    this.isPlaying.value = !this.isPlaying.peek();
  }
}

function begin(recording: Recording): edit.Edited {
  const before = unsaved.get(recording.title);
  if (before?.recording === recording) return before.edited;
  const { segments, timesteps } = recording;
  return before ? edit.editingAgain(before.edited, segments, timesteps) : edit.editing(segments, timesteps);
}
