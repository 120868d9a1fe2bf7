/** Forms out of JSON schemas: the fields of an application's parameters, and the parameters that were typed into them. */
import { command } from "./parts/terminal";

export interface Field {
  readonly name: string;
  readonly hint: string;
  readonly kind: "text" | "number" | "truth" | "choice" | "list" | "json";
  readonly required: boolean;
  readonly choices: readonly string[];
  readonly example: string;
}

type Schema = Readonly<Record<string, unknown>>;
type Texts = Readonly<Record<string, string>>;

/** The fields of an object's schema, in its order. */
export function fieldsOf(schema: Schema): readonly Field[] {
  const required = Array.isArray(schema.required) ? schema.required : [];
  const properties = isSchema(schema.properties) ? schema.properties : {};
  return Object.entries(properties).map(([name, property]) =>
    fieldOf(name, isSchema(property) ? property : {}, required.includes(name)),
  );
}

function fieldOf(name: string, schema: Schema, required: boolean): Field {
  const choices = Array.isArray(schema.enum) ? schema.enum.map(text) : [];
  const examples = Array.isArray(schema.examples) ? schema.examples : [];
  const shown = schema.default ?? examples[0];
  return {
    name,
    hint: [schema.description, bounds(schema)].filter((word) => typeof word === "string" && word).join("; "),
    kind: kindOf(schema, choices),
    required,
    choices,
    example: shown === undefined ? "" : Array.isArray(shown) ? shown.map(text).join(", ") : text(shown),
  };
}

function kindOf(schema: Schema, choices: readonly string[]): Field["kind"] {
  if (choices.length) return "choice";
  if (schema.type === "boolean") return "truth";
  if (schema.type === "integer" || schema.type === "number") return "number";
  if (schema.type === "string") return "text";
  const items = isSchema(schema.items) ? schema.items : {};
  return schema.type === "array" && items.type === "string" ? "list" : "json";
}

function bounds(schema: Schema): string {
  const [least, most] = [schema.minimum ?? schema.minItems, schema.maximum ?? schema.maxItems];
  if (least !== undefined && most !== undefined) return `${least} to ${most}`;
  if (least !== undefined) return `at least ${least}`;
  return most === undefined ? "" : `at most ${most}`;
}

const text = (value: unknown): string => (typeof value === "string" ? value : JSON.stringify(value));
const isSchema = (value: unknown): value is Schema =>
  typeof value === "object" && value !== null && !Array.isArray(value);

/** The parameters in the fields, those left empty left out; and what cannot be read, a sentence each. */
export function parametersOf(fields: readonly Field[], texts: Texts): [Record<string, unknown>, readonly string[]] {
  const parameters: Record<string, unknown> = {};
  const problems: string[] = [];
  for (const field of fields) {
    const typed = (texts[field.name] ?? "").trim();
    if (!typed) {
      if (field.required) problems.push(`${field.name} is missing.`);
      continue;
    }
    const value = valueOf(field, typed);
    if (value === undefined) problems.push(`${field.name} is no ${field.kind === "number" ? "number" : "JSON"}.`);
    else parameters[field.name] = value;
  }
  return [parameters, problems];
}

function valueOf(field: Field, typed: string): unknown {
  if (field.kind === "list") return typed.split(/[\s,]+/).filter(Boolean);
  if (field.kind === "text") return typed;
  if (field.kind === "number") return Number.isFinite(Number(typed)) ? Number(typed) : undefined;
  return parsed(typed, field.kind === "choice" ? typed : undefined);
}

function parsed(typed: string, otherwise: unknown): unknown {
  try {
    return JSON.parse(typed);
  } catch {
    return otherwise;
  }
}

/** The command that asks for the same on a terminal. */
export function commandOf(namespace: string, application: string, parameters: Record<string, unknown>): string {
  const options = Object.entries(parameters).map(
    ([name, value]) => `--parameter ${inQuotes(`${name}=${inYaml(value)}`)}`,
  );
  const names = command("robotkube", "task", "submit", "--namespace", namespace, "--application", application);
  return [names, ...options].join(" ");
}

const inYaml = (value: unknown): string => JSON.stringify(value);
const inQuotes = (word: string): string => `'${word.replaceAll("'", "'\\''")}'`;
