/** Sessions of the sim service, of one environment each; they are closed when the page goes. */
import { call, sendLast } from "../api/client";
import { imageOf, numbersOf } from "../api/tensors";
import type { ExpertActionsResponse, Image, ResetResponse, StepResponse, Task, Tensor } from "../api/types";

const LEASE_S = 120;
const RENEWAL_MS = (LEASE_S * 1000) / 3;
/** So many that no episode ends while somebody watches. */
const MOST_STEPS = 10_000;

const open = new Set<string>();

window.addEventListener("pagehide", () => open.forEach((session) => sendLast("sim/close-session", { session })));

export interface SessionOptions {
  readonly seed: number;
  /** Needed for the scripted expert. */
  readonly privileged?: boolean;
}

export class SimSession {
  private steps = 0;
  /** Renews the lease while the page is seen, as any call does. */
  private readonly renewal = window.setInterval(() => {
    if (document.visibilityState === "visible") this.render(this.task.cameras[0]!.name, 16).catch(() => undefined);
  }, RENEWAL_MS);

  private constructor(
    readonly id: string,
    readonly task: Task,
  ) {}

  static async create(task: string, { seed, privileged = false }: SessionOptions): Promise<SimSession> {
    const request = { task, seed, privileged, lease_s: LEASE_S, max_episode_steps: MOST_STEPS };
    const { session, task: made } = await call("sim/create-session", request);
    open.add(session);
    return new SimSession(session, made!);
  }

  async close(): Promise<void> {
    window.clearInterval(this.renewal);
    if (open.delete(this.id)) await call("sim/close-session", { session: this.id });
  }

  reset(cameras: readonly string[], recipe: readonly string[] = []): Promise<ResetResponse> {
    return call("sim/reset", { session: this.id, cameras, recipes: [{ skills: recipe }] });
  }

  /** Steps once.
   *
   * @param actions A tensor, or the numbers of the single environment.
   */
  async step(actions: Tensor | readonly number[], cameras: readonly string[]): Promise<StepResponse> {
    const step_id = this.steps + 1;
    const sent = "raw" in actions ? actions : [actions];
    const reply = await call("sim/step", { session: this.id, step_id, actions: sent, cameras });
    this.steps = step_id;
    return reply;
  }

  async render(camera: string, side: number): Promise<Tensor> {
    const reply = await call("sim/render", { session: this.id, cameras: [camera], height: side, width: side });
    return frameOf(reply.frames, camera);
  }

  /** The expert's action, and whether it has finished. */
  async expertActions(recipe: readonly string[] = []): Promise<{ actions: Tensor; isFinished: boolean }> {
    const recipes = recipe.length > 0 ? [{ skills: recipe }] : [];
    const reply: ExpertActionsResponse = await call("sim/expert-actions", { session: this.id, recipes });
    return { actions: reply.actions as Tensor, isFinished: numbersOf(reply.finished as Tensor)[0] === 1 };
  }
}

/** Returns the frames of a camera. */
export function frameOf(frames: ResetResponse["frames"], camera: string): Tensor {
  return frames[camera] as Tensor;
}

/** Returns the frames of cameras as the images of a request. */
export function imagesOf(frames: ResetResponse["frames"], cameras: readonly string[]): Image[] {
  return cameras.map((each) => imageOf(frameOf(frames, each), each));
}
