/** Runs and fits: what there is, one of them, or a new one. */
import { Link } from "../../parts/link";
import { query } from "../../url/location";
import { JobDetail } from "./detail";
import { JobList } from "./list";
import { NewJob } from "./new_job";

export function RunsPanel() {
  const { job, start } = query.value;
  return (
    <>
      <div class="heading">
        <h1>Runs and fits</h1>
        <nav aria-label="Runs and fits">
          <ul class="choices">
            <li>
              <Link to={{ view: "runs", job: "", with: "", start: "" }} current={!job && !start}>
                List
              </Link>
            </li>
            <li>
              <Link to={{ view: "runs", job: "", with: "", start: "run" }} current={start === "run"}>
                New run
              </Link>
            </li>
            <li>
              <Link to={{ view: "runs", job: "", with: "", start: "fit" }} current={start === "fit"}>
                New fit
              </Link>
            </li>
          </ul>
        </nav>
      </div>
      {!job && (
        <p class="lede">
          A run records data, trains or measures; a fit trains one model on one dataset. Both go on after a crash, and
          without this page.
        </p>
      )}
      {start === "run" || start === "fit" ? (
        <NewJob key={start} what={start} />
      ) : job ? (
        <JobDetail key={job} name={job} />
      ) : (
        <JobList />
      )}
    </>
  );
}
