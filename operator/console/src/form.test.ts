import { describe, expect, it } from "vitest";
import { commandOf, fieldsOf, parametersOf } from "./form";

const SCHEMA = {
  type: "object",
  required: ["vehicles"],
  properties: {
    vehicles: { type: "array", items: { type: "string" }, minItems: 1, maxItems: 8, description: "agents" },
    rate: { type: "number", default: 10 },
    mode: { enum: ["fast", 2] },
    verbose: { type: "boolean" },
    area: { type: "object" },
  },
};

describe("a form", () => {
  const fields = fieldsOf(SCHEMA);

  it("has a field for each property, of a kind that fits", () => {
    expect(fields.map((field) => field.kind)).toEqual(["list", "number", "choice", "truth", "json"]);
    expect(fields[0]).toMatchObject({ required: true, hint: "agents; 1 to 8" });
    expect(fields[1]?.example).toBe("10");
    expect(fieldsOf({})).toEqual([]);
  });
  it("makes parameters of what was typed, and leaves out what is empty", () => {
    const texts = { vehicles: "a, b\nc", rate: "5", mode: "2", verbose: "true", area: '{"x": 1}' };
    expect(parametersOf(fields, texts)).toEqual([
      { vehicles: ["a", "b", "c"], rate: 5, mode: 2, verbose: true, area: { x: 1 } },
      [],
    ]);
    expect(parametersOf(fields, { vehicles: "a", mode: "fast" })[0]).toEqual({ vehicles: ["a"], mode: "fast" });
  });
  it("says what is missing or cannot be read", () => {
    expect(parametersOf(fields, { rate: "much", area: "{" })[1]).toEqual([
      "vehicles is missing.",
      "rate is no number.",
      "area is no JSON.",
    ]);
  });
  it("is a command on a terminal, too", () => {
    expect(commandOf("cloud-0", "recording", { vehicles: ["it's"] })).toBe(
      `robotkube task submit --namespace cloud-0 --application recording --parameter 'vehicles=["it'\\''s"]'`,
    );
  });
});
