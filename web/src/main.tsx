/** The page: mounts the shell. */
import { render } from "preact";
import "./styles/page.css";
import { Shell } from "./shell";

render(<Shell />, document.getElementById("page")!);
