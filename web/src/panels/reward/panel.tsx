/** Reward: images and a sentence; reward over time, the rivals, and where its noun phrases are. */
import { useEffect, useState } from "preact/hooks";
import { call } from "../../api/client";
import { asProblem, Problem } from "../../api/problem";
import { useRemote } from "../../api/remote";
import type { RewardResponse, Task } from "../../api/types";
import { Empty, Failed, Loading, Shown } from "../../parts/notice";
import { say } from "../../parts/say";
import { amend, query } from "../../url/location";
import { Answer } from "./answer";
import { expertShots, fileShots, type Shot } from "./scene";

const FIRST_TASK = "blocks.yellow-left-of-green";

type Outcome = { readonly shots: readonly Shot[]; readonly text: string; readonly reward: RewardResponse };
/** Images, and the task or the files that they are of. */
type Taken = { readonly source: unknown; readonly shots: readonly Shot[] };
type Work =
  | { readonly state: "idle" }
  | { readonly state: "busy"; readonly what: string }
  | { readonly state: "done"; readonly outcome: Outcome }
  | { readonly state: "failed"; readonly problem: Problem };

export function RewardPanel() {
  const [remote, retry] = useRemote(async (signal) => (await call("sim/list-tasks", {}, { signal })).tasks, "tasks");
  return (
    <>
      <h1>Reward</h1>
      <p class="lede">
        How well each image shows what a sentence asks for: 1 where it fits better than all its rivals.
      </p>
      <Shown remote={remote} what="the worlds" retry={retry}>
        {(tasks) => <Judge tasks={tasks.filter((each) => each.goal_text !== "" && each.has_expert)} />}
      </Shown>
    </>
  );
}

function Judge({ tasks }: { tasks: readonly Task[] }) {
  const task = tasks.find((each) => each.name === (query.value.task ?? FIRST_TASK)) ?? tasks[0];
  const text = query.value.text ?? task?.goal_text ?? "";
  const [files, setFiles] = useState<readonly File[]>([]);
  const [rivals, setRivals] = useState("");
  const [taken, setTaken] = useState<Taken | null>(null);
  const [work, setWork] = useState<Work>({ state: "idle" });
  useEffect(() => void (task && judge()), []);
  const judge = async (): Promise<void> => {
    const source = files.length > 0 ? files : task;
    const known = taken?.source === source ? taken!.shots : null;
    try {
      setWork({ state: "busy", what: known ? "the reward" : "the images" });
      const seen = known ?? (await (files.length > 0 ? fileShots(files) : expertShots(task!, 7)));
      setTaken({ source, shots: seen });
      const more = rivals
        .split("\n")
        .map((each) => each.trim())
        .filter(Boolean);
      const reward = await call("reward/reward", {
        images: seen.map((each) => each.image),
        goal_text: text,
        rivals: more,
      });
      setWork({ state: "done", outcome: { shots: seen, text, reward } });
      say(`${reward.rewards.filter((each) => each > 0).length} of ${seen.length} images are rewarded.`);
    } catch (error) {
      setWork({ state: "failed", problem: asProblem(error) });
    }
  };
  const drop = (event: DragEvent): void => {
    event.preventDefault();
    setFiles([...(event.dataTransfer?.files ?? [])]);
  };
  return (
    <div class="reward-panel" onDragOver={(event) => event.preventDefault()} onDrop={drop}>
      <form
        class="card stacked"
        onSubmit={(event) => {
          event.preventDefault();
          void judge();
        }}
      >
        <label>
          Goal in words
          <textarea
            rows={2}
            maxLength={2000}
            required
            value={text}
            onInput={(event) => amend({ text: event.currentTarget.value })}
          />
        </label>
        <label>
          Images of the scripted expert in
          <select
            value={task?.name}
            disabled={files.length > 0}
            onChange={(event) => amend({ task: event.currentTarget.value, text: "", at: "" })}
          >
            {tasks.map((each) => (
              <option key={each.name} value={each.name}>
                {each.name}
              </option>
            ))}
          </select>
        </label>
        <label>
          Or your images, or a video (or drop them here)
          <input
            type="file"
            multiple
            accept="image/png,image/jpeg,image/webp,video/*"
            onChange={(event) => setFiles([...(event.currentTarget.files ?? [])])}
          />
        </label>
        <details>
          <summary>Rivals</summary>
          <label>
            Texts that the goal must beat, a line each; empty for its other relations
            <textarea rows={3} value={rivals} onInput={(event) => setRivals(event.currentTarget.value)} />
          </label>
        </details>
        <button type="submit" class="main-action" disabled={work.state === "busy" || (!task && files.length === 0)}>
          Reward
        </button>
      </form>
      <div class="reward-answer">
        {work.state === "idle" && (
          <Empty title="Nothing is judged yet">
            No world here has a goal and a scripted expert; drop images of your own.
          </Empty>
        )}
        {work.state === "busy" && <Loading what={work.what} />}
        {work.state === "failed" && <Failed problem={work.problem} retry={() => void judge()} />}
        {work.state === "done" && (
          <Answer
            shots={work.outcome.shots}
            reward={work.outcome.reward}
            text={work.outcome.text}
            onText={(next) => amend({ text: next })}
          />
        )}
      </div>
    </div>
  );
}
