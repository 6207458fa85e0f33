/** The images of a reward, in order: of the expert in a world, or a person's own. */
import { imageOf, pixelsOf, toBase64 } from "../../api/tensors";
import { Problem } from "../../api/problem";
import type { Image, Task, Tensor } from "../../api/types";
import { frameOf, SimSession } from "../../sim/session";
import { VideoFrames } from "../segments/frames";

export interface Shot {
  /** As the service takes it. */
  readonly image: Image;
  readonly picture: CanvasImageSource & { readonly width: number; readonly height: number };
}

const MOST_VIDEO_FRAMES = 64;

/** Returns what the first camera sees while the scripted expert does a task, until it has finished or the episode ends. */
export async function expertShots(task: Task, seed: number): Promise<Shot[]> {
  const camera = task.cameras[0]!.name;
  const session = await SimSession.create(task.name, { seed, privileged: true });
  try {
    const shots = [await shotOf(frameOf((await session.reset([camera])).frames, camera))];
    while (shots.length <= task.max_episode_steps) {
      const { actions, isFinished } = await session.expertActions();
      if (isFinished) break;
      shots.push(await shotOf(frameOf((await session.step(actions, [camera])).frames, camera)));
    }
    return shots;
  } finally {
    void session.close();
  }
}

async function shotOf(tensor: Tensor): Promise<Shot> {
  return { image: imageOf(tensor, ""), picture: await createImageBitmap(pixelsOf(tensor)) };
}

const ENCODINGS: Readonly<Record<string, Image["encoding"]>> = {
  "image/png": "png",
  "image/jpeg": "jpeg",
  "image/webp": "webp",
};

/** Returns images of files, or frames of a video, evenly spaced. */
export async function fileShots(files: readonly File[]): Promise<Shot[]> {
  const [first] = files;
  if (files.length === 1 && !(first!.type in ENCODINGS)) return videoShots(first!);
  return Promise.all(files.map(imageShot));
}

async function imageShot(file: Blob): Promise<Shot> {
  const encoding = ENCODINGS[file.type];
  if (!encoding)
    throw new Problem(
      0,
      "unsupported_media",
      `Images must be PNG, JPEG or WebP files; got ${file.type || "another file"}.`,
      "A video is taken alone.",
    );
  const data = toBase64(new Uint8Array(await file.arrayBuffer()));
  return { image: { encoding, height: 0, width: 0, data, camera: "" }, picture: await createImageBitmap(file) };
}

async function videoShots(file: File): Promise<Shot[]> {
  const video = await VideoFrames.open(file, (timestep) => timestep / 1000);
  if (!video)
    throw new Problem(
      0,
      "unsupported_media",
      `This browser cannot decode ${file.name}.`,
      "Drop PNG, JPEG or WebP files of its frames.",
    );
  try {
    return await shotsOf(video);
  } finally {
    video.close();
  }
}

async function shotsOf(video: VideoFrames): Promise<Shot[]> {
  const canvas = new OffscreenCanvas(video.width, video.height);
  const context = canvas.getContext("2d")!;
  const shots: Shot[] = [];
  for (let index = 0; index < MOST_VIDEO_FRAMES; index += 1) {
    const ms = (1000 * video.duration * index) / (MOST_VIDEO_FRAMES - 1);
    const box = { x: 0, y: 0, width: canvas.width, height: canvas.height };
    await video.draw(context as unknown as CanvasRenderingContext2D, ms, box);
    shots.push(await imageShot(await canvas.convertToBlob({ type: "image/png" })));
  }
  return shots;
}
