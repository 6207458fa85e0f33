/** Data and models: what there is to learn from, and what was learned. */
import { Link } from "../../parts/link";
import { query } from "../../url/location";
import { Datasets } from "./datasets";
import { Models } from "./models";

export function DataPanel() {
  const shown = query.value.show === "models" ? "models" : "datasets";
  return (
    <>
      <div class="heading">
        <h1>Data and models</h1>
        <nav aria-label="Data and models">
          <ul class="choices">
            <li>
              <Link to={{ view: "data", show: "" }} current={shown === "datasets"}>
                Datasets
              </Link>
            </li>
            <li>
              <Link to={{ view: "data", show: "models" }} current={shown === "models"}>
                Models
              </Link>
            </li>
          </ul>
        </nav>
      </div>
      <p class="lede">
        {shown === "datasets"
          ? "Recordings to learn from, with the skills that occur in them."
          : "What was learned. The active version of a name answers calls that name no version."}
      </p>
      {shown === "datasets" ? <Datasets /> : <Models />}
    </>
  );
}
