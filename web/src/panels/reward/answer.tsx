/** What a reward model said of images: over time, beside the rivals, and why. */
import { useEffect, useRef } from "preact/hooks";
import type { RewardResponse } from "../../api/types";
import { amend, query } from "../../url/location";
import { UNFAMILIAR } from "../segments/recording";
import { Heatmaps } from "./heatmaps";
import { markUnknown } from "./phrases";
import type { Shot } from "./scene";

interface AnswerProps {
  readonly shots: readonly Shot[];
  readonly reward: RewardResponse;
  readonly text: string;
  readonly onText: (text: string) => void;
}

export function Answer({ shots, reward, text, onText }: AnswerProps) {
  const count = reward.rewards.length;
  const at = Math.min(Math.max(Number(query.value.at ?? count - 1) || 0, 0), count - 1);
  const goTo = (index: number): void => amend({ at: String(index) });
  const familiar = reward.in_distribution[at];
  const winner = reward.winners[at] ?? 0;
  return (
    <>
      <Sentence text={text} reward={reward} onText={onText} />
      <div class="judged">
        <Picture shot={shots[at]!} name={`Image ${at + 1} of ${count}`} />
        <div>
          <p class="verdict">
            <span class={`state ${reward.rewards[at]! > 0 ? "good" : ""}`}>reward {reward.rewards[at]}</span>
            similarity {reward.similarities[at]?.toFixed(2)}
          </p>
          <p>
            {winner === 0 ? "The goal fits best: " : "A rival fits better: "}
            <q>{reward.texts[winner]}</q>
          </p>
          {familiar !== undefined && <Familiar value={familiar} />}
          <p class="faint">
            by model {reward.model?.name} {reward.model?.version}
          </p>
        </div>
      </div>
      <OverTime reward={reward} at={at} goTo={goTo} />
      <Heatmaps shot={shots[at]!} statement={reward.texts[0] ?? text} />
      <Numbers reward={reward} />
    </>
  );
}

function Sentence({ text, reward, onText }: { text: string; reward: RewardResponse; onText: (text: string) => void }) {
  const understood = reward.texts[0] ?? "";
  return (
    <div class="sentence">
      <p>
        {markUnknown(text, reward.unknown).map((each, index) =>
          each.isUnknown ? <u key={index}>{each.text}</u> : each.text,
        )}
      </p>
      {understood.toLowerCase() !== text.toLowerCase() && <p class="faint">read as: {understood}</p>}
      {reward.unknown.length > 0 && (
        <p role="alert">
          The model does not know {reward.unknown.map((each) => `“${each}”`).join(", ")}, so nothing is rewarded.
        </p>
      )}
      {reward.did_you_mean && (
        <p>
          Did you mean{" "}
          <button type="button" class="quiet" onClick={() => onText(reward.did_you_mean)}>
            {reward.did_you_mean}
          </button>
          ?
        </p>
      )}
    </div>
  );
}

function Familiar({ value }: { value: number }) {
  return (
    <p>
      <code>in_distribution</code> {value.toFixed(2)}:{" "}
      {value < UNFAMILIAR ? (
        <span class="unfamiliar-flag">unlike the training data, or hard to tell apart; do not trust it</span>
      ) : (
        <span class="faint">{Math.round(100 * value)} % of held-out images were no more familiar</span>
      )}
    </p>
  );
}

export function Picture({ shot, name }: { shot: Shot; name: string }) {
  const canvas = useRef<HTMLCanvasElement>(null);
  useEffect(() => canvas.current!.getContext("2d")!.drawImage(shot.picture, 0, 0), [shot]);
  return (
    <canvas
      ref={canvas}
      class="picture"
      role="img"
      aria-label={name}
      width={shot.picture.width}
      height={shot.picture.height}
    />
  );
}

function OverTime({ reward, at, goTo }: { reward: RewardResponse; at: number; goTo: (index: number) => void }) {
  const count = reward.rewards.length;
  if (count < 2) return null;
  const cells = (isOn: (index: number) => boolean, kind: string) =>
    Array.from({ length: count }, (_, index) => index)
      .filter(isOn)
      .map((index) => <rect key={index} class={kind} x={index} y={0} width={1} height={1} />);
  const lane = (label: string, kind: string, isOn: (index: number) => boolean) => (
    <div class="lane" key={label}>
      <span class="lane-label">{label}</span>
      <svg viewBox={`0 0 ${count} 1`} preserveAspectRatio="none" aria-hidden="true">
        {cells(isOn, kind)}
        <line class="here" x1={at + 0.5} x2={at + 0.5} y1={0} y2={1} />
      </svg>
    </div>
  );
  const [least, greatest] = [Math.min(...reward.similarities), Math.max(...reward.similarities)];
  const height = (index: number): number => (reward.similarities[index]! - least) / Math.max(greatest - least, 1e-6);
  const line = reward.similarities
    .map((_, index) => `${index === 0 ? "M" : "L"}${index + 0.5} ${(1 - height(index)).toFixed(3)}`)
    .join("");
  return (
    <section class="over-time" aria-label="Over time">
      {lane("reward", "on-good", (index) => reward.rewards[index]! > 0)}
      <div class="lane tall">
        <span class="lane-label">
          similarity {least.toFixed(2)} to {greatest.toFixed(2)}
        </span>
        <svg viewBox={`0 0 ${count} 1`} preserveAspectRatio="none" aria-hidden="true">
          <path d={line} />
          <line class="here" x1={at + 0.5} x2={at + 0.5} y1={0} y2={1} />
        </svg>
      </div>
      {reward.texts.map((each, text) =>
        lane(
          text === 0 ? `goal: ${each}` : each,
          text === 0 ? "on-good" : "on-rival",
          (index) => reward.winners[index] === text,
        ),
      )}
      {lane("unlike the training data", "on-warning", (index) => (reward.in_distribution[index] ?? 1) < UNFAMILIAR)}
      <div class="lane">
        <label class="lane-label" for="reward-at">
          image {at + 1} of {count}
        </label>
        <input
          id="reward-at"
          type="range"
          min={0}
          max={count - 1}
          value={at}
          onInput={(event) => goTo(event.currentTarget.valueAsNumber)}
        />
      </div>
    </section>
  );
}

function Numbers({ reward }: { reward: RewardResponse }) {
  return (
    <details>
      <summary>Numbers</summary>
      <div class="scrolled" tabIndex={0} role="region" aria-label="Rewards">
        <table>
          <thead>
            <tr>
              {["Image", "Reward", "Similarity", "Fits best", "In distribution"].map((each) => (
                <th key={each} scope="col">
                  {each}
                </th>
              ))}
            </tr>
          </thead>
          <tbody>
            {reward.rewards.map((each, index) => (
              <tr key={index}>
                <td>{index + 1}</td>
                <td>{each}</td>
                <td>{reward.similarities[index]?.toFixed(3)}</td>
                <td>{reward.texts[reward.winners[index] ?? 0]}</td>
                <td>{reward.in_distribution[index]?.toFixed(3) ?? "–"}</td>
              </tr>
            ))}
          </tbody>
        </table>
      </div>
    </details>
  );
}
