/** Forms out of the JSON schemas of configurations: fields with defaults, bounds and words, and back to a configuration. */

export interface Schema {
  readonly title?: string;
  readonly type?: string;
  readonly description?: string;
  readonly default?: unknown;
  readonly const?: unknown;
  readonly enum?: readonly unknown[];
  readonly anyOf?: readonly Schema[];
  readonly items?: Schema;
  readonly minimum?: number;
  readonly maximum?: number;
  readonly exclusiveMinimum?: number;
  readonly properties?: Readonly<Record<string, Schema>>;
  readonly required?: readonly string[];
}

export type Kind = "integer" | "number" | "text" | "boolean" | "choice" | "list" | "json";

export interface Field {
  readonly key: string;
  readonly kind: Kind;
  readonly needed: boolean;
  readonly meaning: string;
  /** The default as text of the input; empty for none. */
  readonly initial: string;
  /** Choices of a `choice`. */
  readonly choices: readonly string[];
  /** Bounds as words, such as `1 to 1000`; empty without any. */
  readonly bounds: string;
  readonly minimum?: number;
  readonly maximum?: number;
}

export type Parsed = { readonly value: unknown } | { readonly error: string };

/** Returns the keys that can have one value only, such as the method of a fit. */
export function constantsOf(schema: Schema): Record<string, unknown> {
  const constants = Object.entries(schema.properties ?? {}).filter(([, each]) => isConstant(each));
  return Object.fromEntries(constants.map(([key, each]) => [key, each.const ?? each.enum![0]]));
}

function isConstant(schema: Schema): boolean {
  return schema.const !== undefined || schema.enum?.length === 1;
}

/** Returns the fields of a configuration, needed ones first. Constants are not asked for. */
export function fieldsOf(schema: Schema): Field[] {
  const needed = new Set(schema.required ?? []);
  const fields = Object.entries(schema.properties ?? {})
    .filter(([, each]) => !isConstant(each))
    .map(([key, each]) => fieldOf(key, each, needed.has(key)));
  return [...fields.filter((each) => each.needed), ...fields.filter((each) => !each.needed)];
}

function fieldOf(key: string, schema: Schema, needed: boolean): Field {
  const bounded = schema.anyOf?.find((each) => each.minimum !== undefined) ?? schema;
  return {
    key,
    kind: kindOf(schema),
    needed,
    meaning: schema.description ?? "",
    initial: schema.default === undefined ? "" : textOf(schema.default),
    choices: (schema.enum ?? []).map(String),
    bounds: boundsOf(bounded, schema),
    minimum: schema.minimum ?? schema.exclusiveMinimum,
    maximum: schema.maximum,
  };
}

function kindOf(schema: Schema): Kind {
  if (schema.enum) return "choice";
  if (schema.type === "array") return schema.items?.type === "string" ? "list" : "json";
  if (schema.type === "integer" || schema.type === "number" || schema.type === "boolean") return schema.type;
  return schema.type === "string" ? "text" : "json";
}

function boundsOf(bounded: Schema, schema: Schema): string {
  const words = (schema.anyOf ?? []).flatMap((each) => each.enum ?? (each.type === "null" ? ["null"] : []));
  const { minimum, exclusiveMinimum, maximum } = bounded;
  const least = minimum ?? exclusiveMinimum;
  if (least === undefined || maximum === undefined) return words.join(", ");
  const range = `${exclusiveMinimum === undefined ? "" : "above "}${least} to ${maximum}`;
  return [range, ...words].join(", or ");
}

/** Returns a value as the text of an input. */
export function textOf(value: unknown): string {
  if (typeof value === "string") return value;
  if (Array.isArray(value) && value.every((each) => typeof each === "string" && !/[,"]/.test(each)))
    return value.join(", ");
  return JSON.stringify(value);
}

/** Reads the text of an input; what it says of a bad one has what was expected and what came. */
export function parseField(field: Field, text: string): Parsed {
  const trimmed = text.trim();
  if (trimmed === "" && field.needed) return { error: `${field.key} is needed.` };
  if (trimmed === "" && field.kind !== "text" && field.kind !== "list")
    return parseField(field, field.initial || "null");
  if (field.kind === "integer" || field.kind === "number") return parseNumber(field, trimmed);
  if (field.kind === "boolean") return { value: trimmed === "true" };
  if (field.kind === "list") return { value: trimmed === "" ? [] : trimmed.split(",").map((each) => each.trim()) };
  return field.kind === "json" ? parseJson(field, trimmed) : { value: trimmed };
}

function parseNumber(field: Field, text: string): Parsed {
  const value = Number(text);
  const isRight = Number.isFinite(value) && (field.kind === "number" || Number.isInteger(value));
  const what = field.kind === "integer" ? "a whole number" : "a number";
  if (!isRight) return { error: `${field.key} must be ${what}; got “${text}”.` };
  const isWithin = value >= (field.minimum ?? -Infinity) && value <= (field.maximum ?? Infinity);
  return isWithin ? { value } : { error: `${field.key} must be ${field.bounds}; got ${text}.` };
}

/** Words need no quotes: `all` is the text, `5` the number. */
function parseJson(field: Field, text: string): Parsed {
  try {
    return { value: JSON.parse(text) };
  } catch {
    if (/^[\w.-]+$/.test(text)) return { value: text };
    return { error: `${field.key} must be JSON, such as {"steps": 600}; got “${text.slice(0, 40)}”.` };
  }
}

/** Returns the configuration of texts by key, with only what differs from the defaults, and the errors by key. */
export function configOf(
  fields: readonly Field[],
  texts: Readonly<Record<string, string>>,
): { config: Record<string, unknown>; errors: Record<string, string> } {
  const config: Record<string, unknown> = {};
  const errors: Record<string, string> = {};
  for (const field of fields) {
    const text = texts[field.key] ?? field.initial;
    if (!field.needed && text.trim() === field.initial) continue;
    const parsed = parseField(field, text);
    if ("error" in parsed) errors[field.key] = parsed.error;
    else config[field.key] = parsed.value;
  }
  return { config, errors };
}

/** Returns the schemas of the field `config` of a request of an OpenAPI document, by title. */
export function configSchemas(openapi: unknown, request: "StartRunRequest" | "StartFitRequest"): Schema[] {
  const document = openapi as { components?: { schemas?: Record<string, Schema> } };
  return [...(document.components?.schemas?.[request]?.properties?.config?.anyOf ?? [])];
}
