/** Goals of a policy, and goal images that the scripted expert makes. */
import { pixelsOf } from "../../api/tensors";
import type { GetSpecResponse, Image } from "../../api/types";
import { frameOf, imagesOf, SimSession } from "../../sim/session";

export interface Landmark {
  /** One of each camera. */
  readonly images: readonly Image[];
  /** Of the first camera. */
  readonly picture: ImageBitmap;
}

export type Goal =
  | { readonly form: "images"; readonly landmarks: readonly Landmark[] }
  | { readonly form: "recipe"; readonly skills: readonly string[] }
  | { readonly form: "text"; readonly text: string };

/** Returns a goal as a request has it. */
export function sentGoal(goal: Goal): { images?: Image[]; recipe?: string[]; text?: string } {
  if (goal.form === "images") return { images: goal.landmarks.flatMap((each) => each.images) };
  return goal.form === "recipe" ? { recipe: [...goal.skills] } : { text: goal.text };
}

/** Number of goals that are reached one after the other. */
export function partsOf(goal: Goal): number {
  if (goal.form === "images") return goal.landmarks.length;
  return goal.form === "recipe" ? goal.skills.length : 1;
}

/** Returns what a part of a goal is called. */
export function nameOf(goal: Goal, index: number): string {
  if (goal.form === "text") return goal.text;
  return goal.form === "recipe" ? (goal.skills[index] ?? "") : `landmark ${index + 1}`;
}

export interface ExpertGoal {
  readonly task: string;
  readonly seed: number;
  /** Actions since the reset, which are repeated first: equal seeds and actions give equal frames. */
  readonly executed: readonly (readonly number[])[];
  readonly skill: string;
  readonly landmarks: number;
  /** Steps from one landmark to the next. */
  readonly every: number;
}

/** Returns what the cameras see every so many steps while the expert goes on from a state. */
export async function expertLandmarks(spec: GetSpecResponse, goal: ExpertGoal): Promise<Landmark[]> {
  const cameras = spec.cameras.map((each) => each.name);
  const session = await SimSession.create(goal.task, { seed: goal.seed, privileged: true });
  try {
    await session.reset([]);
    for (const actions of goal.executed) await session.step(actions, []);
    const landmarks: Landmark[] = [];
    for (let step = 1; landmarks.length < goal.landmarks; step += 1) {
      const { actions, isFinished } = await session.expertActions([goal.skill]);
      const isLandmark = step % goal.every === 0 || isFinished;
      const { frames } = await session.step(actions, isLandmark ? cameras : []);
      if (isLandmark) {
        const picture = await createImageBitmap(pixelsOf(frameOf(frames, cameras[0]!)));
        landmarks.push({ images: imagesOf(frames, cameras), picture });
      }
      if (isFinished) break;
    }
    return landmarks;
  } finally {
    void session.close();
  }
}
