/** A policy that acts in a world, step by step: what it sees, what it does, whether its goal is reached. */
import { signal } from "@preact/signals";
import { call } from "../../api/client";
import { asProblem, type Problem } from "../../api/problem";
import { numbersOf, pixelsOf } from "../../api/tensors";
import type { ActResponse, GetSpecResponse, ResetResponse, Tensor } from "../../api/types";
import { say } from "../../parts/say";
import { imagesOf, SimSession } from "../../sim/session";
import { nameOf, partsOf, sentGoal, type Goal } from "./goal";

export const SHOWN_SIDE = 256;
const KEPT_STEPS = 400;

export type Outcome = "reached" | "abandoned";

/** One control step, for the strips. */
export interface Moment {
  readonly actions: readonly number[];
  readonly confidence: number;
  readonly familiar: number;
  readonly event: "" | Outcome | "new goal";
}

export type Status = "opening" | "ready" | "acting" | "paused" | "holding" | "failed" | "closed";

export class Episode {
  readonly status = signal<Status>("opening");
  readonly problem = signal<Problem | null>(null);
  /** What the first camera shows people; larger than what the policy sees. */
  readonly picture = signal<ImageData | null>(null);
  readonly reply = signal<ActResponse | null>(null);
  /** Of each part of the goal that is over. */
  readonly outcomes = signal<readonly Outcome[]>([]);
  readonly history = signal<readonly Moment[]>([]);
  readonly goal = signal<Goal | null>(null);
  readonly stepsPerSecond = signal(0);
  /** Actions since the reset. */
  readonly executed = signal<readonly (readonly number[])[]>([]);
  private session: SimSession | null = null;
  private frames: ResetResponse["frames"] = {};
  /** The act in flight: another one would send the same policy state and step id. */
  private acting: Promise<void> | null = null;
  private policyState = "";
  private last: readonly number[] | null = null;
  private isNewGoal = false;

  constructor(
    readonly spec: GetSpecResponse,
    readonly task: string,
    readonly seed: number,
  ) {
    void this.open();
  }

  get cameras(): string[] {
    return this.spec.cameras.map((each) => each.name);
  }

  get sessionId(): string {
    return this.session?.id ?? "";
  }

  private async open(): Promise<void> {
    try {
      const session = await SimSession.create(this.task, { seed: this.seed });
      if (this.status.peek() === "closed") return void session.close();
      this.session = session;
      this.frames = (await session.reset(this.cameras)).frames;
      this.picture.value = pixelsOf(await session.render(this.cameras[0]!, SHOWN_SIDE));
      if (this.status.peek() === "opening") this.status.value = "ready";
    } catch (error) {
      this.fail(error);
    }
  }

  close(): void {
    this.status.value = "closed";
    void this.session?.close().catch(() => undefined);
  }

  /** Gives another goal, also in the middle of one. */
  give(goal: Goal): void {
    this.goal.value = goal;
    this.policyState = "";
    this.isNewGoal = true;
    this.reply.value = null;
    this.outcomes.value = [];
    if (this.status.peek() === "holding") this.status.value = "paused";
  }

  /** Acts until it is paused, holds or fails. */
  async run(): Promise<void> {
    await this.acting; // what a pause left in flight
    if (!this.canAct()) return;
    this.status.value = "acting";
    while (this.status.peek() === "acting") {
      const before = performance.now();
      await this.act();
      const rate = 1000 / (performance.now() - before);
      this.stepsPerSecond.value =
        this.stepsPerSecond.peek() === 0 ? rate : 0.8 * this.stepsPerSecond.peek() + 0.2 * rate;
    }
  }

  /** Pauses; afterwards no act is in flight. */
  async pause(): Promise<void> {
    if (this.status.peek() === "acting") this.status.value = "paused";
    await this.acting;
  }

  /** Acts once. */
  async stepOnce(): Promise<void> {
    if (this.canAct()) await this.act();
  }

  private canAct(): boolean {
    return this.acting === null && this.goal.peek() !== null && ["ready", "paused"].includes(this.status.peek());
  }

  private act(): Promise<void> {
    this.acting = this.decide().finally(() => (this.acting = null));
    return this.acting;
  }

  private async decide(): Promise<void> {
    try {
      const goal = this.goal.peek()!;
      const reply = await call("imitation/act", {
        model: this.spec.model ?? undefined,
        observation: { images: imagesOf(this.frames, this.cameras) },
        executed_actions: this.last ? [this.last] : [],
        goal: sentGoal(goal),
        state: this.policyState,
      });
      if (goal !== this.goal.peek()) return;
      this.policyState = reply.state;
      const actions = firstOf(reply.actions as Tensor);
      this.record(reply, actions ?? []);
      if (reply.done === "yes" || actions === null) return this.hold(reply);
      await this.execute(actions);
    } catch (error) {
      this.fail(error);
    }
  }

  private async execute(actions: readonly number[]): Promise<void> {
    this.frames = (await this.session!.step(actions, this.cameras)).frames;
    this.last = actions;
    this.executed.value = [...this.executed.peek(), actions];
    this.picture.value = pixelsOf(await this.session!.render(this.cameras[0]!, SHOWN_SIDE));
  }

  private record(reply: ActResponse, actions: readonly number[]): void {
    const outcome = outcomeOf(this.reply.peek(), reply, this.spec.reached_threshold);
    const event = outcome || (this.isNewGoal ? "new goal" : "");
    this.isNewGoal = false;
    this.reply.value = reply;
    if (outcome) this.outcomes.value = [...this.outcomes.peek(), outcome];
    const { goal_confidence: confidence, in_distribution: familiar } = reply;
    this.history.value = [...this.history.peek().slice(1 - KEPT_STEPS), { actions, confidence, familiar, event }];
    const goal = this.goal.peek()!;
    if (outcome) say(`${nameOf(goal, reply.goal_index - 1)} ${outcome}, ${reply.goal_index} of ${partsOf(goal)} over`);
  }

  private hold(reply: ActResponse): void {
    this.status.value = "holding";
    say(
      reply.done_by === "step_limit"
        ? "Given up: the step limit was reached. The robot holds."
        : "All goals are reached. The robot holds.",
    );
  }

  private fail(error: unknown): void {
    if (this.status.peek() === "closed") return;
    this.problem.value = asProblem(error);
    this.status.value = "failed";
  }
}

/** Returns how a part of the goal ended with a reply; empty where none did. `goal_abandoned` tells of the first one only. */
export function outcomeOf(before: ActResponse | null, reply: ActResponse, threshold: number): Outcome | "" {
  if (reply.goal_index <= (before?.goal_index ?? 0)) return "";
  const isReached = before?.goal_abandoned ? reply.goal_confidence >= threshold : !reply.goal_abandoned;
  return isReached ? "reached" : "abandoned";
}

/** Returns the first action of a chunk (K, A); null where K = 0. */
function firstOf(chunk: Tensor): number[] | null {
  const [count = 0, size = 0] = chunk.shape;
  return count === 0 ? null : numbersOf(chunk).slice(0, size);
}

/** Returns all actions of a chunk (K, A). */
export function chunkOf(reply: ActResponse): number[][] {
  const chunk = reply.actions as Tensor;
  const [count = 0, size = 0] = chunk.shape;
  const numbers = numbersOf(chunk);
  return Array.from({ length: count }, (_, index) => numbers.slice(index * size, (index + 1) * size));
}
