/** Where the pictures of a recording come from: tiles of one image, a video, or pages of a dataset. */

export interface Box {
  readonly x: number;
  readonly y: number;
  readonly width: number;
  readonly height: number;
}

export interface Frames {
  readonly width: number;
  readonly height: number;
  /** Draws the frame of a timestep; false where it has none. */
  draw(context: CanvasRenderingContext2D, timestep: number, box: Box): Promise<boolean>;
  /** Draws a frame whose neighbours are not wanted. */
  drawAlone?(context: CanvasRenderingContext2D, timestep: number, box: Box): Promise<boolean>;
  /** Frees what no garbage collector does. */
  close?(): void;
}

/** Frames as tiles of one image, row by row. */
export class TiledFrames implements Frames {
  private readonly image: Promise<HTMLImageElement>;

  constructor(
    url: string,
    readonly width: number,
    readonly height: number,
    private readonly columns: number,
  ) {
    const image = new Image();
    image.src = url;
    this.image = image.decode().then(() => image);
  }

  async draw(context: CanvasRenderingContext2D, timestep: number, box: Box): Promise<boolean> {
    const [column, row] = [timestep % this.columns, Math.floor(timestep / this.columns)];
    const { x, y, width, height } = box;
    const from = [column * this.width, row * this.height, this.width, this.height] as const;
    context.drawImage(await this.image, ...from, x, y, width, height);
    return true;
  }
}

/** Frames of a video file, shown by the browser's own decoder, which may lack its codec. */
export class VideoFrames implements Frames {
  readonly width: number;
  readonly height: number;
  /** In seconds. */
  readonly duration: number;
  private last: Promise<unknown> = Promise.resolve();

  private constructor(
    private readonly video: HTMLVideoElement,
    private readonly timeOf: (timestep: number) => number,
  ) {
    this.width = video.videoWidth;
    this.height = video.videoHeight;
    this.duration = video.duration;
  }

  /** Returns the frames of a file; null where the browser cannot show them. */
  static async open(file: Blob, timeOf: (timestep: number) => number): Promise<VideoFrames | null> {
    const video = document.createElement("video");
    video.muted = true;
    video.preload = "auto";
    video.src = URL.createObjectURL(file);
    const isShown = await new Promise<boolean>((resolve) => {
      video.addEventListener("loadeddata", () => resolve(video.videoWidth > 0), { once: true });
      video.addEventListener("error", () => resolve(false), { once: true });
    });
    if (isShown) return new VideoFrames(video, timeOf);
    release(video);
    return null;
  }

  /** One after the other: a video is at one time at once. */
  draw(context: CanvasRenderingContext2D, timestep: number, box: Box): Promise<boolean> {
    const drawn = this.last.then(async () => {
      await this.seek(this.timeOf(timestep) + 0.001);
      context.drawImage(this.video, box.x, box.y, box.width, box.height);
      return true;
    });
    this.last = drawn.catch(() => undefined);
    return drawn;
  }

  private seek(time: number): Promise<void> {
    const to = Math.min(time, Math.max(0, this.video.duration - 0.001));
    if (Math.abs(this.video.currentTime - to) < 1e-4) return Promise.resolve();
    return new Promise((resolve, reject) => {
      this.video.onseeked = () => resolve();
      this.video.onerror = () => reject(new Error("The browser cannot decode the video here."));
      this.video.currentTime = to;
    });
  }

  close(): void {
    release(this.video);
  }
}

function release(video: HTMLVideoElement): void {
  URL.revokeObjectURL(video.src);
  video.removeAttribute("src");
  video.load();
}

const PAGE = 64;
const KEPT_PAGES = 12;

/** Frames that arrive a page at a time: only the pages that are looked at are loaded. */
export class PagedFrames implements Frames {
  private readonly pages = new Map<number, Promise<readonly ImageBitmap[]>>();

  /** @param load Returns the images of `count` timesteps from `first` on; at the end of the trajectory fewer. */
  constructor(
    readonly width: number,
    readonly height: number,
    private readonly load: (first: number, count: number) => Promise<readonly Blob[]>,
  ) {}

  async draw(context: CanvasRenderingContext2D, timestep: number, box: Box): Promise<boolean> {
    const page = await this.page(Math.floor(timestep / PAGE));
    const image = page[timestep % PAGE];
    if (image) context.drawImage(image, box.x, box.y, box.width, box.height);
    return image !== undefined;
  }

  async drawAlone(context: CanvasRenderingContext2D, timestep: number, box: Box): Promise<boolean> {
    if (this.pages.has(Math.floor(timestep / PAGE))) return this.draw(context, timestep, box);
    const [image] = await this.load(timestep, 1);
    if (image) context.drawImage(await createImageBitmap(image), box.x, box.y, box.width, box.height);
    return image !== undefined;
  }

  private page(index: number): Promise<readonly ImageBitmap[]> {
    const found = this.pages.get(index) ?? this.decode(index);
    this.pages.delete(index);
    this.pages.set(index, found);
    const [oldest] = this.pages.keys();
    if (this.pages.size > KEPT_PAGES) this.pages.delete(oldest!);
    return found;
  }

  private async decode(index: number): Promise<readonly ImageBitmap[]> {
    try {
      return await Promise.all((await this.load(index * PAGE, PAGE)).map((each) => createImageBitmap(each)));
    } catch (error) {
      this.pages.delete(index);
      throw error;
    }
  }
}
