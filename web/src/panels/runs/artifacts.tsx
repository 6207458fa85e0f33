/** The files of a run, one click away; the newest rollout plays. */
import { useState } from "preact/hooks";
import { useRemote } from "../../api/remote";
import type { Artifact } from "../../api/types";
import { Shown } from "../../parts/notice";
import { artifactPath, artifactsOf, type Job } from "./job";

export function Artifacts({ job }: { job: Job }) {
  const [remote, retry] = useRemote(
    () => artifactsOf(job),
    `${job.owner}/${job.id}`,
    job.step + (job.state === "running" ? 0 : 0.5),
  );
  if (job.owner !== "orchestrator") return null;
  return (
    <Shown remote={remote} what="artifacts" retry={retry}>
      {(artifacts) => <List job={job} artifacts={artifacts} />}
    </Shown>
  );
}

function List({ job, artifacts }: { job: Job; artifacts: readonly Artifact[] }) {
  if (artifacts.length === 0) return null;
  const rollouts = artifacts.filter((each) => each.name.endsWith(".mp4")).sort((a, b) => b.time_ns - a.time_ns);
  return (
    <section class="card" aria-label="Artifacts">
      {rollouts[0] && <Rollout key={rollouts[0].time_ns} job={job} artifact={rollouts[0]} />}
      <h3>Artifacts</h3>
      <ul>
        {artifacts.map((each) => (
          <li key={each.name}>
            <a href={artifactPath(job, each.name)} download={each.name}>
              {each.name}
            </a>{" "}
            <span class="faint">{sizeOf(each.size)}</span>
          </li>
        ))}
      </ul>
    </section>
  );
}

function Rollout({ job, artifact }: { job: Job; artifact: Artifact }) {
  const [isBad, setBad] = useState(false);
  return (
    <>
      <h3>Newest rollout</h3>
      {isBad ? (
        <p>This browser has no decoder for {artifact.name}; the file below plays elsewhere.</p>
      ) : (
        <video
          controls
          loop
          muted
          playsInline
          preload="auto"
          src={artifactPath(job, artifact.name)}
          aria-label={`Rollout ${artifact.name}`}
          onError={() => setBad(true)}
        />
      )}
    </>
  );
}

function sizeOf(bytes: number): string {
  const units = ["B", "kB", "MB", "GB"];
  const power = Math.min(units.length - 1, Math.floor(Math.log10(Math.max(bytes, 1)) / 3));
  return `${(bytes / 1000 ** power).toFixed(power === 0 ? 0 : 1)} ${units[power]}`;
}
