/** The console's items, as the OpenAPI document has them. */
import type { components } from "../api";

type Schemas = components["schemas"];
export type Agent = Schemas["Agent"];
export type Pose = Schemas["Pose"];
export type Task = Schemas["Task"];
export type Plan = Schemas["Plan"];
export type Release = Schemas["Release"];
export type Pod = Schemas["Pod"];
export type RuleEvent = Schemas["Event"];
export type Rule = Schemas["Rule"];
export type CatalogueEntry = Schemas["CatalogueEntry"];
export type Stranger = Schemas["Stranger"];
export type Unchecked = Schemas["Unchecked"];
export type Certificate = Schemas["Certificate"];
export type Link = Schemas["Link"];
export type Recording = Schemas["Recording"];
export type TaskRequest = Schemas["TaskRequest"];
export type Explanation = Schemas["Explanation"];
export type Source = Schemas["Source"];
export type Kind = Schemas["Kind"];
export type WhyKind = Schemas["WhyKind"];
export type Items = Schemas["Items"];
export type Snapshot = Schemas["Snapshot"];
export type Change = Schemas["Change"];
export type Chain = Schemas["Chain"];
export type Step = Schemas["Step"];
export type Session = Schemas["Session"];
export type Problem = Schemas["Problem"];
export type Item<K extends Kind> = NonNullable<Items[K]>[string];

export const KINDS: readonly Kind[] = [
  "agents",
  "poses",
  "tasks",
  "plans",
  "releases",
  "pods",
  "events",
  "rules",
  "catalogue",
  "strangers",
  "unchecked",
  "certificates",
  "links",
  "recordings",
  "sources",
];
