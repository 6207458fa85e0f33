// Builds the page: `node tools/build.mjs [FOLDER] [--watch]`, by default into the orchestrator's package.
import { createHash } from "node:crypto";
import { mkdirSync, readFileSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import { basename, join, resolve } from "node:path";
import { context } from "esbuild";

const web = resolve(import.meta.dirname, "..");
const page = resolve(web, "../services/orchestrator/freerein_orchestrator/page");
const watch = process.argv.includes("--watch");
const folder = resolve(process.argv.slice(2).find((argument) => !argument.startsWith("--")) ?? page);
const BUNDLED = ["preact", "@preact/signals", "@preact/signals-core", "uplot"];

/** Writes index.html and the licences of what is bundled, once the bundle is there. */
const finish = {
  name: "finish",
  setup(build) {
    build.onStart(() => {
      rmSync(folder, { recursive: true, force: true });
      mkdirSync(folder, { recursive: true });
    });
    build.onEnd(({ metafile, errors }) => {
      if (errors.length > 0) return;
      const outputs = Object.entries(metafile.outputs);
      const entry = outputs.find(([, output]) => output.entryPoint?.endsWith("main.tsx"));
      const icon = hashed("icon", ".svg", readFileSync(join(web, "src/icon.svg")));
      const names = { SCRIPT: basename(entry[0]), STYLE: basename(entry[1].cssBundle), ICON: icon };
      const html = readFileSync(join(web, "src/index.html"), "utf8");
      writeFileSync(
        join(folder, "index.html"),
        html.replace(/\{(\w+)\}/g, (_, key) => names[key]),
      );
      writeFileSync(join(folder, "licences.txt"), BUNDLED.map(licence).join("\n\n"));
    });
  },
};

/** Writes a file under a name that holds its hash, which it returns. */
function hashed(name, extension, content) {
  const file = `${name}-${createHash("sha256").update(content).digest("hex").slice(0, 8)}${extension}`;
  writeFileSync(join(folder, file), content);
  return file;
}

function licence(name) {
  const package_ = join(web, "node_modules", name);
  const file = readdirSync(package_).find((each) => /^licen[cs]e/i.test(each));
  return `${name}\n\n${readFileSync(join(package_, file), "utf8").trim()}\n`;
}

const building = await context({
  absWorkingDir: web,
  entryPoints: { app: "src/main.tsx" },
  outdir: folder,
  bundle: true,
  splitting: true,
  minify: true,
  metafile: true,
  format: "esm",
  target: ["es2022"],
  jsx: "automatic",
  jsxImportSource: "preact",
  loader: { ".webp": "file" },
  publicPath: "/web",
  entryNames: "[name]-[hash]",
  chunkNames: "chunk-[hash]",
  assetNames: "[name]-[hash]",
  legalComments: "none",
  logLevel: "warning",
  plugins: [finish],
});
if (watch) await building.watch();
else {
  await building.rebuild();
  await building.dispose();
}
