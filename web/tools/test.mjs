// Runs the unit tests: bundles test/*.test.ts into a temporary folder, which Node then runs.
import { spawnSync } from "node:child_process";
import { mkdtempSync, readdirSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { buildSync } from "esbuild";

const tests = resolve(import.meta.dirname, "../test");
const folder = mkdtempSync(join(tmpdir(), "freerein-web-"));
const entryPoints = readdirSync(tests)
  .filter((name) => name.endsWith(".test.ts"))
  .map((name) => join(tests, name));
buildSync({
  entryPoints,
  outdir: folder,
  bundle: true,
  platform: "node",
  format: "esm",
  outExtension: { ".js": ".mjs" },
});
const built = readdirSync(folder).map((name) => join(folder, name));
const { status } = spawnSync(process.execPath, ["--test", ...built], { stdio: "inherit" });
rmSync(folder, { recursive: true });
process.exit(status ?? 1);
