/** A policy that acts in a world, step by step: what it sees, what it does, whether its goal is reached. */
import { signal } from "@preact/signals";
import { call } from "../../api/client";
import { asProblem, type Problem } from "../../api/problem";
import { imageOf, numbersOf, pixelsOf } from "../../api/tensors";
import type { ActResponse, GetSpecResponse, Tensor } from "../../api/types";
import { say } from "../../parts/say";
import { frameOf, SimSession } from "../../sim/session";
import { nameOf, partsOf, sentGoal, type Goal } from "./goal";

export const SHOWN_SIDE = 256;
const KEPT_STEPS = 400;

/** One control step, for the strips. */
export interface Moment {
  readonly actions: readonly number[];
  readonly confidence: number;
  readonly familiar: number;
  readonly event: "" | "reached" | "abandoned" | "new goal";
}

export type Status = "opening" | "ready" | "acting" | "paused" | "holding" | "failed" | "closed";

export class Episode {
  readonly status = signal<Status>("opening");
  readonly problem = signal<Problem | null>(null);
  /** What the camera shows people; larger than what the policy sees. */
  readonly picture = signal<ImageData | null>(null);
  readonly reply = signal<ActResponse | null>(null);
  readonly history = signal<readonly Moment[]>([]);
  readonly goal = signal<Goal | null>(null);
  readonly stepsPerSecond = signal(0);
  readonly executed: number[][] = [];
  private session: SimSession | null = null;
  private frame: Tensor | null = null;
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

  private get camera(): string {
    return this.spec.cameras[0]!.name;
  }

  get sessionId(): string {
    return this.session?.id ?? "";
  }

  private async open(): Promise<void> {
    try {
      const session = await SimSession.create(this.task, { seed: this.seed });
      if (this.status.peek() === "closed") return void session.close();
      this.session = session;
      this.frame = frameOf((await session.reset([this.camera])).frames, this.camera);
      this.picture.value = pixelsOf(await session.render(this.camera, SHOWN_SIDE));
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
    if (this.status.peek() === "holding") this.status.value = "paused";
  }

  /** Acts until it is paused, holds or fails. */
  async run(): Promise<void> {
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

  pause(): void {
    if (this.status.peek() === "acting") this.status.value = "paused";
  }

  /** Acts once. */
  async stepOnce(): Promise<void> {
    if (this.canAct()) await this.act();
  }

  private canAct(): boolean {
    return this.goal.peek() !== null && ["ready", "paused"].includes(this.status.peek());
  }

  private async act(): Promise<void> {
    try {
      const goal = this.goal.peek()!;
      const reply = await call("imitation/act", {
        model: this.spec.model ?? undefined,
        observation: { images: [imageOf(this.frame!, this.camera)] },
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
    const { frames } = await this.session!.step(actions, [this.camera]);
    this.frame = frameOf(frames, this.camera);
    this.last = actions;
    this.executed.push([...actions]);
    this.picture.value = pixelsOf(await this.session!.render(this.camera, SHOWN_SIDE));
  }

  private record(reply: ActResponse, actions: readonly number[]): void {
    const before = this.reply.peek();
    const hasMoved = before !== null && reply.goal_index > before.goal_index;
    const wasAbandoned = reply.goal_abandoned && !(before?.goal_abandoned ?? false);
    const event = this.isNewGoal ? "new goal" : wasAbandoned ? "abandoned" : hasMoved ? "reached" : "";
    this.isNewGoal = false;
    this.reply.value = reply;
    const { goal_confidence: confidence, in_distribution: familiar } = reply;
    this.history.value = [...this.history.peek().slice(1 - KEPT_STEPS), { actions, confidence, familiar, event }];
    const goal = this.goal.peek()!;
    if (event === "reached")
      say(`${nameOf(goal, reply.goal_index - 1)} reached, ${reply.goal_index} of ${partsOf(goal)}`);
    if (event === "abandoned") say(`${nameOf(goal, reply.goal_index - 1)} abandoned`);
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
