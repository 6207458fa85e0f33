/** Where the noun phrases of a goal are in an image, by the grounding model. */
import { useEffect, useRef, useState } from "preact/hooks";
import { call } from "../../api/client";
import { useRemote } from "../../api/remote";
import { numbersOf } from "../../api/tensors";
import type { Grounding, GroundResponse, Tensor } from "../../api/types";
import { Shown } from "../../parts/notice";
import { Typed } from "../../parts/typed";
import { phrasesOf } from "./phrases";
import type { Shot } from "./scene";

const IS_THERE = 0.5;

const numbers = new WeakMap<Shot, number>();
let shots = 0;

/** Returns a number of an image that no other has. */
function numberOf(shot: Shot): number {
  if (!numbers.has(shot)) numbers.set(shot, (shots += 1));
  return numbers.get(shot)!;
}

export function Heatmaps({ shot, statement }: { shot: Shot; statement: string }) {
  const [text, setText] = useState<string | null>(null);
  const phrases = text === null ? phrasesOf(statement) : phrasesOf(text.replaceAll(",", " near "));
  const load = async (signal: AbortSignal) => ({
    shot,
    answer: phrases.length > 0 ? await call("reward/ground", { image: shot.image, phrases }, { signal }) : null,
  });
  const [remote, retry] = useRemote(load, phrases.join("|"), numberOf(shot));
  return (
    <section class="card" aria-labelledby="heatmaps-title">
      <h2 id="heatmaps-title">Where its noun phrases are</h2>
      <label>
        Phrases, separated by commas
        <Typed value={text ?? phrases.join(", ")} onValue={setText} />
      </label>
      <Shown remote={remote} what="heatmaps" retry={retry}>
        {({ answer, shot: seen }) => answer && <Maps shot={seen} answer={answer} />}
      </Shown>
    </section>
  );
}

function Maps({ shot, answer }: { shot: Shot; answer: GroundResponse }) {
  const unknown = new Set(answer.unknown_phrases.map((each) => each.phrase));
  return (
    <div class="heatmaps">
      {answer.groundings.map((each) => (
        <figure key={each.phrase}>
          <Overlay shot={shot} grounding={each} />
          <figcaption>
            {unknown.has(each.phrase) ? <u>{each.phrase}</u> : <strong>{each.phrase}</strong>}
            <br />
            {unknown.has(each.phrase)
              ? "the model does not know it"
              : each.presence < IS_THERE
                ? `probably not there (${each.presence.toFixed(2)})`
                : `there with ${each.presence.toFixed(2)}, at ${each.x.toFixed(0)}, ${each.y.toFixed(0)} px`}
          </figcaption>
        </figure>
      ))}
    </div>
  );
}

function Overlay({ shot, grounding }: { shot: Shot; grounding: Grounding }) {
  const canvas = useRef<HTMLCanvasElement>(null);
  const { width, height } = shot.picture;
  useEffect(() => {
    const context = canvas.current!.getContext("2d")!;
    context.drawImage(shot.picture, 0, 0);
    const pixels = context.getImageData(0, 0, width, height);
    const heat = numbersOf(grounding.heatmap as Tensor);
    heat.forEach((each, index) => {
      const gray = (pixels.data[4 * index]! + pixels.data[4 * index + 1]! + pixels.data[4 * index + 2]!) / 3;
      const [red, green, blue] = [255, 190, 40];
      pixels.data[4 * index] = gray * 0.55 * (1 - each) + red * each;
      pixels.data[4 * index + 1] = gray * 0.55 * (1 - each) + green * each;
      pixels.data[4 * index + 2] = gray * 0.55 * (1 - each) + blue * each;
    });
    context.putImageData(pixels, 0, 0);
    if (grounding.presence < IS_THERE) return;
    const size = Math.max(2, width / 24);
    context.strokeStyle = "#fff";
    context.lineWidth = Math.max(1, width / 90);
    context.beginPath();
    context.arc(grounding.x, grounding.y, size, 0, 2 * Math.PI);
    context.stroke();
  }, [shot, grounding]);
  return (
    <canvas
      ref={canvas}
      class="picture"
      role="img"
      aria-label={`Heatmap of ${grounding.phrase}`}
      width={width}
      height={height}
    />
  );
}
