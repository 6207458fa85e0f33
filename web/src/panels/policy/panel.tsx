/** A policy, live: it acts in a world towards a goal, and every call can be looked at. */
import { useEffect, useState } from "preact/hooks";
import { call, needsToken } from "../../api/client";
import { useRemote } from "../../api/remote";
import type { GetSpecResponse, Task } from "../../api/types";
import { Code } from "../../parts/code";
import { Empty, Failed, Loading, Shown } from "../../parts/notice";
import { Typed } from "../../parts/typed";
import { amend, query } from "../../url/location";
import { written } from "./commands";
import { Episode } from "./episode";
import { nameOf, partsOf, type Goal } from "./goal";
import { GoalForm } from "./goal_form";
import { Pictures } from "./pictures";
import { Strips } from "./strips";

interface Stage {
  readonly specs: readonly GetSpecResponse[];
  readonly tasks: readonly Task[];
}

export function PolicyPanel() {
  const [remote, retry] = useRemote(load, "policies");
  return (
    <>
      <h1>A policy, live</h1>
      <p class="lede">
        A learned policy moves a robot in a simulated world towards a goal. Give it a goal, then press Act.
      </p>
      <Shown remote={remote} what="policies and worlds" retry={retry}>
        {(stage) => <Chosen {...stage} />}
      </Shown>
    </>
  );
}

async function load(signal: AbortSignal): Promise<Stage> {
  const [{ models }, { tasks }] = await Promise.all([
    call("imitation/list-models", {}, { signal }),
    call("sim/list-tasks", {}, { signal }),
  ]);
  const names = models.filter((each) => each.active).map((each) => each.ref!.name);
  const specs = await Promise.all(names.map((name) => call("imitation/get-spec", { "model.name": name }, { signal })));
  return { specs: specs.filter((each) => each.robot_state_size === 0), tasks };
}

/** Returns the worlds whose cameras and actions are those of a policy. */
function worldsOf(spec: GetSpecResponse, tasks: readonly Task[]): Task[] {
  const hasCamera = (task: Task): boolean =>
    spec.cameras.every((camera) =>
      task.cameras.some((each) => each.name === camera.name && each.width === camera.width),
    );
  return tasks.filter((task) => hasCamera(task) && task.action?.names.join() === spec.action?.names.join());
}

function Chosen({ specs, tasks }: Stage) {
  const spec =
    specs.find((each) => each.model!.name === query.value.model) ??
    specs.find((each) => worldsOf(each, tasks).length > 0) ??
    specs[0];
  if (!spec)
    return (
      <Empty title="No active policy acts on images alone">Fit one of the imitation service under Runs and fits.</Empty>
    );
  const worlds = worldsOf(spec, tasks);
  const task = worlds.find((each) => each.name === query.value.world) ?? worlds[0];
  if (!task)
    return (
      <Empty title={`No world here has the cameras and actions of ${spec.model!.name}`}>
        Choose another policy, or give it a robot.
      </Empty>
    );
  const seed = Number(query.value.seed ?? 7) || 0;
  return (
    <Live
      key={`${spec.model!.name}${task.name}${seed}`}
      specs={specs}
      worlds={worlds}
      spec={spec}
      task={task}
      seed={seed}
    />
  );
}

function useEpisode(spec: GetSpecResponse, task: Task, seed: number, turn: number): Episode | null {
  const [episode, setEpisode] = useState<Episode | null>(null);
  useEffect(() => {
    const opened = new Episode(spec, task.name, seed);
    const pause = (): void => {
      if (document.hidden) void opened.pause();
    };
    document.addEventListener("visibilitychange", pause);
    setEpisode(opened);
    return () => {
      document.removeEventListener("visibilitychange", pause);
      opened.close();
    };
  }, [turn]);
  return episode;
}

interface LiveProps {
  readonly specs: readonly GetSpecResponse[];
  readonly worlds: readonly Task[];
  readonly spec: GetSpecResponse;
  readonly task: Task;
  readonly seed: number;
}

function Live({ specs, worlds, spec, task, seed }: LiveProps) {
  const [turn, setTurn] = useState(0);
  const episode = useEpisode(spec, task, seed, turn);
  if (!episode) return <Loading what="the world" />;
  const status = episode.status.value;
  const goal = episode.goal.value;
  const canAct = goal !== null && (status === "ready" || status === "paused");
  return (
    <div class="live">
      <div class="live-main">
        <Pictures episode={episode} />
        <p class="live-status">
          <StatusLine episode={episode} goal={goal} />
        </p>
        {episode.problem.value && <Failed problem={episode.problem.value} retry={() => setTurn(turn + 1)} />}
        <div class="buttons">
          <button
            type="button"
            class={goal ? "main-action" : ""}
            disabled={!canAct && status !== "acting"}
            title={goal ? undefined : "It needs a goal first"}
            onClick={() => void (status === "acting" ? episode.pause() : episode.run())}
          >
            {status === "acting" ? "Pause" : "Act"}
          </button>
          <button type="button" disabled={!canAct} onClick={() => void episode.stepOnce()}>
            Step
          </button>
          <button type="button" onClick={() => setTurn(turn + 1)}>
            New episode
          </button>
        </div>
        <Strips spec={spec} history={episode.history.value} reply={episode.reply.value} />
      </div>
      <div class="card live-side stacked">
        <label>
          Policy
          <select value={spec.model!.name} onChange={(event) => amend({ model: event.currentTarget.value, world: "" })}>
            {specs.map((each) => (
              <option key={each.model!.name} value={each.model!.name}>
                {each.model!.name}, follows{" "}
                {{ images: "goal images", recipe: "recipes", text: "texts" }[each.goal_form]}
              </option>
            ))}
          </select>
        </label>
        <label>
          World
          <select value={task.name} onChange={(event) => amend({ world: event.currentTarget.value })}>
            {worlds.map((each) => (
              <option key={each.name}>{each.name}</option>
            ))}
          </select>
        </label>
        <label>
          Seed of the start state
          <Typed type="number" min={0} value={seed} onValue={(text) => amend({ seed: text })} />
        </label>
        <GoalForm spec={spec} task={task} episode={episode} />
      </div>
      {goal && <Commands episode={episode} goal={goal} />}
    </div>
  );
}

function StatusLine({ episode, goal }: { episode: Episode; goal: Goal | null }) {
  const status = episode.status.value;
  const reply = episode.reply.value;
  const rate = episode.stepsPerSecond.value;
  const steps = episode.executed.value.length;
  const words = {
    opening: "The world opens …",
    ready: goal ? "Ready to act." : "Give it a goal, then let it act.",
    acting: `Acting, ${rate.toFixed(1)} steps per second.`,
    paused: "Paused.",
    holding:
      reply?.done_by === "step_limit"
        ? "Holding: a goal took too many steps."
        : "Holding: the policy saw its goals reached.",
    failed: "Stopped.",
    closed: "Closed.",
  }[status];
  return (
    <>
      <strong>{words}</strong>{" "}
      {goal && reply && (
        <>
          {reply.goal_index < partsOf(goal)
            ? `Now ${nameOf(goal, reply.goal_index)}, ${reply.goal_index} of ${partsOf(goal)} over.`
            : `All ${partsOf(goal)} over.`}{" "}
          {reply.goal_abandoned && <span class="unfamiliar-flag">a goal was abandoned</span>}
        </>
      )}{" "}
      <span class="faint">{steps} steps</span>
    </>
  );
}

function Commands({ episode, goal }: { episode: Episode; goal: Goal }) {
  const executed = episode.executed.value;
  const calls = written({
    origin: location.origin,
    task: episode.task,
    seed: episode.seed,
    session: episode.sessionId,
    stepId: executed.length,
    cameras: episode.cameras,
    model: episode.spec.model!.name,
    actions: executed.at(-1) ?? [],
    goal,
    needsToken: needsToken.value,
  });
  return (
    <details class="card live-commands">
      <summary>The same calls by hand</summary>
      {calls.map((each) => (
        <section key={each.name}>
          <h3>{each.name}</h3>
          <Code name={`${each.name} with curl`} text={each.curl} />
          <Code name={`${each.name} in Python`} text={each.python} />
        </section>
      ))}
    </details>
  );
}
