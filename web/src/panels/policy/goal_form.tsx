/** The form of a goal, in the form that the policy takes: landmarks, a recipe, or a text. */
import { useState } from "preact/hooks";
import { call } from "../../api/client";
import { asProblem, type Problem } from "../../api/problem";
import { toBase64 } from "../../api/tensors";
import type { GetSpecResponse, Image, Task } from "../../api/types";
import { Failed } from "../../parts/notice";
import { Typed } from "../../parts/typed";
import type { Episode } from "./episode";
import { expertLandmarks, type Goal, type Landmark } from "./goal";

interface GoalFormProps {
  readonly spec: GetSpecResponse;
  readonly task: Task;
  readonly episode: Episode;
}

export function GoalForm(props: GoalFormProps) {
  const [isBusy, setBusy] = useState(false);
  const [problem, setProblem] = useState<Problem | null>(null);
  const give = async (make: () => Promise<Goal>): Promise<void> => {
    setBusy(true);
    setProblem(null);
    try {
      props.episode.give(await make());
    } catch (error) {
      setProblem(asProblem(error));
    } finally {
      setBusy(false);
    }
  };
  const Form = { images: ImagesForm, recipe: RecipeForm, text: TextForm }[props.spec.goal_form];
  return (
    <fieldset class="goal-form">
      <legend>Goal</legend>
      <Form {...props} isBusy={isBusy} give={give} />
      {problem && <Failed problem={problem} />}
    </fieldset>
  );
}

/** A goal is what is to be done first. */
function emphasis(episode: Episode): string {
  return episode.goal.value === null ? "main-action" : "";
}

type FormProps = GoalFormProps & {
  readonly isBusy: boolean;
  readonly give: (make: () => Promise<Goal>) => Promise<void>;
};

/** Landmarks that the scripted expert passes from here on, or a person's own images. */
function ImagesForm({ spec, task, episode, isBusy, give }: FormProps) {
  const [skill, setSkill] = useState(task.skills[0] ?? "");
  const [landmarks, setLandmarks] = useState(6);
  const every = 6;
  const byExpert = async (): Promise<Goal> => {
    await episode.pause();
    const executed = episode.executed.peek();
    const { seed } = episode;
    return {
      form: "images",
      landmarks: await expertLandmarks(spec, { task: task.name, seed, executed, skill, landmarks, every }),
    };
  };
  const byFiles = async (files: readonly File[]): Promise<Goal> => ({
    form: "images",
    landmarks: await landmarksOfFiles(spec, files),
  });
  return (
    <>
      {task.has_expert && (
        <>
          <label>
            What the expert would do
            <select value={skill} onChange={(event) => setSkill(event.currentTarget.value)}>
              {task.skills.map((each) => (
                <option key={each}>{each}</option>
              ))}
            </select>
          </label>
          <label>
            Goal images, {every} steps apart
            <Typed
              type="number"
              min={1}
              max={12}
              value={landmarks}
              onValue={(text) => setLandmarks(Number(text) || 1)}
            />
          </label>
          <button type="button" class={emphasis(episode)} disabled={isBusy} onClick={() => void give(byExpert)}>
            {isBusy ? "The expert moves …" : "Give the expert's images"}
          </button>
        </>
      )}
      <label>
        Or your images, of {spec.cameras[0]!.width} × {spec.cameras[0]!.height} pixels
        {spec.cameras.length > 1 && `, for each goal one of ${spec.cameras.map((each) => each.name).join(", ")}`}
        <input
          type="file"
          multiple
          accept="image/png,image/jpeg,image/webp"
          onChange={(event) => void give(() => byFiles([...(event.currentTarget.files ?? [])]))}
        />
      </label>
    </>
  );
}

/** Returns landmarks of files in order: of each landmark an image of every camera. */
async function landmarksOfFiles({ cameras }: GetSpecResponse, files: readonly File[]): Promise<Landmark[]> {
  const landmarks = Array.from({ length: Math.ceil(files.length / cameras.length) }, (_, index) =>
    files.slice(index * cameras.length, (index + 1) * cameras.length),
  );
  return Promise.all(
    landmarks.map(async (each) => ({
      images: await Promise.all(each.map((file, index) => imageOfFile(file, cameras[index]!.name))),
      picture: await createImageBitmap(each[0]!),
    })),
  );
}

async function imageOfFile(file: File, camera: string): Promise<Image> {
  const encoding = file.type.replace("image/", "") as Image["encoding"];
  return { encoding, height: 0, width: 0, data: toBase64(new Uint8Array(await file.arrayBuffer())), camera };
}

function RecipeForm({ spec, task, episode, isBusy, give }: FormProps) {
  const [skills, setSkills] = useState<readonly string[]>(spec.skills.slice(0, 2));
  const draw = async (): Promise<void> => {
    const { recipes } = await call("sim/draw-recipes", {
      task: task.name,
      count: 1,
      seed: Math.floor(Math.random() * 2 ** 31),
    });
    setSkills(recipes[0]?.skills ?? []);
  };
  return (
    <>
      <p id="recipe-title">Recipe: skills in order</p>
      <ol class="recipe" aria-labelledby="recipe-title">
        {skills.map((each, index) => (
          <li key={index}>
            {each}
            <button
              type="button"
              class="quiet"
              aria-label={`Remove ${each}, skill ${index + 1}`}
              onClick={() => setSkills(skills.toSpliced(index, 1))}
            >
              remove
            </button>
          </li>
        ))}
      </ol>
      <div class="buttons">
        {spec.skills.map((each) => (
          <button key={each} type="button" onClick={() => setSkills([...skills, each])}>
            + {each}
          </button>
        ))}
        <button type="button" onClick={() => void draw()}>
          Draw one
        </button>
      </div>
      <button
        type="button"
        class={emphasis(episode)}
        disabled={isBusy || skills.length === 0}
        onClick={() => void give(async () => ({ form: "recipe", skills }))}
      >
        Give this recipe
      </button>
    </>
  );
}

function TextForm({ spec, episode, isBusy, give }: FormProps) {
  const [text, setText] = useState(spec.goal_texts[0] ?? "");
  return (
    <>
      <label>
        Goal in words
        <input
          list="goal-texts"
          maxLength={2000}
          value={text}
          onInput={(event) => setText(event.currentTarget.value)}
        />
      </label>
      <datalist id="goal-texts">
        {spec.goal_texts.map((each) => (
          <option key={each} value={each} />
        ))}
      </datalist>
      <button
        type="button"
        class={emphasis(episode)}
        disabled={isBusy || text.trim() === ""}
        onClick={() => void give(async () => ({ form: "text", text }))}
      >
        Give this goal
      </button>
    </>
  );
}
