// Writes the types of the API: `node tools/types.mjs ORCHESTRATOR_URL [FILE]`, from the OpenAPI documents of running services.
import { writeFileSync } from "node:fs";
import { resolve } from "node:path";

const SERVICES = ["orchestrator", "segmentation", "imitation", "reward", "sim"];
const [url, file = resolve(import.meta.dirname, "../src/api/types.ts")] = process.argv.slice(2);
if (!url) throw new Error("Expected the URL of the orchestrator, such as http://127.0.0.1:8100.");

const schemas = new Map();
const calls = [];
for (const service of SERVICES) {
  const prefix = service === "orchestrator" ? "" : `/services/${service}`;
  const document = await (await fetch(`${url}${prefix}/openapi.json`)).json();
  for (const [name, schema] of Object.entries(document.components.schemas)) addSchema(name, schema);
  for (const [path, methods] of Object.entries(document.paths)) addCall(service, path, methods);
}
writeFileSync(file, text());

function addSchema(name, schema) {
  const type = name === "JsonValue" ? "unknown" : typeOf(schema, 0);
  if (schemas.has(name) && schemas.get(name) !== type) throw new Error(`Two services have different types ${name}.`);
  schemas.set(name, type);
}

function addCall(service, path, methods) {
  const [[method, operation]] = Object.entries(methods);
  const body = operation.requestBody?.content["application/json"]?.schema;
  const reply = operation.responses["200"]?.content?.["application/json"]?.schema;
  if (!reply) return;
  const request = method === "get" ? queryType(operation.parameters ?? []) : typeOf(body, 1);
  calls.push(`  "${service}${path.replace("/v1", "")}": { request: ${request}; reply: ${typeOf(reply, 1)} };`);
}

function queryType(parameters) {
  const fields = parameters
    .filter((each) => each.in === "query")
    .map((each) => `"${each.name}"?: ${typeOf(each.schema, 1)}`);
  return fields.length > 0 ? `{ ${fields.join("; ")} }` : "Record<string, never>";
}

function typeOf(schema, depth) {
  if (schema.$ref) return schema.$ref.split("/").at(-1);
  if (schema.title === "Config" || schema.title === "Card") return "Record<string, unknown>";
  if (schema.enum) return schema.enum.map((each) => JSON.stringify(each)).join(" | ");
  if (schema.anyOf) return [...new Set(schema.anyOf.map((each) => typeOf(each, depth)))].join(" | ");
  if (schema.type === "array") return listOf(typeOf(schema.items ?? {}, depth));
  if (schema.type === "integer" || schema.type === "number") return "number";
  if (schema.type === "object" && schema.properties) return objectType(schema, depth);
  if (schema.type === "object") return `Readonly<Record<string, ${typeOf(schema.additionalProperties || {}, depth)}>>`;
  return { string: "string", boolean: "boolean", null: "null" }[schema.type] ?? "unknown";
}

function listOf(type) {
  return type.includes(" | ") ? `readonly (${type})[]` : `readonly ${type}[]`;
}

/** Every field of a reply is there; `Sent` makes those of requests optional. */
function objectType(schema, depth) {
  const indent = "  ".repeat(depth + 1);
  const fields = Object.entries(schema.properties).map(
    ([name, each]) => `${indent}${name}: ${typeOf(each, depth + 1)};`,
  );
  return `{\n${fields.join("\n")}\n${"  ".repeat(depth)}}`;
}

function text() {
  const types = [...schemas].sort(([a], [b]) => (a < b ? -1 : 1)).map(([name, type]) => declaration(name, type));
  return [
    "// Types of the REST API, made by `npm run types` from the services' OpenAPI documents. Not to be edited.\n",
    "/** A request: what is left out has its default. */",
    "export type Sent<T> = T extends readonly (infer Item)[]\n  ? readonly Sent<Item>[]\n  : T extends object\n    ? { [Key in keyof T]?: Sent<T[Key]> }\n    : T;\n",
    ...types,
    `export interface Calls {\n${calls.map((each) => each.replace(/request: (\w+Request);/, "request: Sent<$1>;")).join("\n")}\n}\n`,
  ].join("\n");
}

function declaration(name, type) {
  return type.startsWith("{") ? `export interface ${name} ${type}\n` : `export type ${name} = ${type};\n`;
}
